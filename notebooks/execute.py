"""Executes the notebooks in place: ``python notebooks/execute.py [NAME ...] [--budget SECONDS]``.

A notebook is its own source: cells are edited in Jupyter, outputs are written here. Each one runs from top to bottom in
a fresh kernel of this Python, in an empty folder; ``NOTEBOOK_BUDGET`` tells it how many seconds a fit may take. What
would differ from machine to machine without telling a reader anything (timestamps, versions of the kernel) is taken
out, and pictures get a palette, so that files stay small. A notebook is not written if a cell fails, complains on
standard error or names a path of this machine, or if it gets too large. One that needs a package that is not installed
is left as it is, with a line that says which.
"""

import argparse
import base64
import io
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from PIL import Image

from sims.drawing import with_palette

__all__ = ["FOLDER", "execute", "lacking", "main", "problems", "sources"]

FOLDER = Path(__file__).resolve().parent
BUDGET = 20.0  # seconds a fit, the notebooks' own default
SECONDS = 1800  # for one cell
LARGEST = 400_000  # bytes of a notebook
NO_NEWS = "Warp CUDA warning: Could not find or load the NVIDIA CUDA driver."  # native code says so without being asked
PNG = "image/png"
KERNEL = {"display_name": "Python 3 (ipykernel)", "language": "python", "name": "python3"}


def sources() -> list[Path]:
    """All notebooks, in the order of their names."""
    return sorted(FOLDER.glob("*.ipynb"))


def execute(path: Path, budget: float = BUDGET, seconds: int | None = SECONDS) -> nbformat.NotebookNode:
    """Run a notebook; its file is not changed.

    Args:
        path: The notebook.
        budget: Seconds for each fit in it.
        seconds: Time allowed for one cell; any if ``None``.

    Returns:
        The notebook with new outputs.

    Raises:
        CellExecutionError: If a cell fails.
    """
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs, cell.execution_count = [], None
    with tempfile.TemporaryDirectory() as work:
        client = NotebookClient(
            notebook,
            timeout=seconds,
            kernel_name=KERNEL["name"],
            resources={"metadata": {"path": work}},
            record_timing=False,
            coalesce_streams=True,
            extra_arguments=["--IPKernelApp.log_level=ERROR"],
        )
        inherited = {name: value for name, value in os.environ.items() if name != "MPLBACKEND"}
        client.execute(env={**inherited, "NOTEBOOK_BUDGET": f"{budget:g}", "IPYTHONDIR": work})
    for cell in notebook.cells:
        cell.metadata = nbformat.NotebookNode()
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if not _no_news(output)]
            for data in (output.data for output in cell.outputs if "data" in output):
                if PNG in data:
                    data[PNG] = _with_palette(data[PNG])
    notebook.metadata = nbformat.from_dict({"kernelspec": KERNEL, "language_info": {"name": "python"}})
    return notebook


def problems(notebook: nbformat.NotebookNode) -> list[str]:
    """What is wrong with an executed notebook, in one line each; none if it may be committed."""
    found = []
    for count, cell in enumerate((c for c in notebook.cells if c.cell_type == "code"), start=1):
        if cell.execution_count != count:
            found.append(f"cell {cell.id}: expected execution number {count}, got {cell.execution_count}")
        for output in cell.outputs:
            if output.output_type == "error":
                found.append(f"cell {cell.id}: {output.ename}: {output.evalue}")
            if output.output_type == "stream" and output.name == "stderr":
                found.append(f"cell {cell.id}: expected nothing on standard error, got {output.text.strip()!r}")
        shown = "\n".join([cell.source, *(text for output in cell.outputs for text in _texts(output))])
        found += [f"cell {cell.id}: names the path {place} of this machine" for place in _places() if place in shown]
    return found


def lacking(error: CellExecutionError) -> str:
    """What a failed cell says of a package that is not installed; empty if that is not why it failed."""
    return error.evalue if "pip install 'warp-bounding[" in error.evalue else ""


def _with_palette(picture: str) -> str:
    """A PNG picture (base64) with a palette, if that makes it smaller."""
    image, content = Image.open(io.BytesIO(base64.b64decode(picture))), io.BytesIO()
    with_palette(image).save(content, "PNG", optimize=True)
    smaller = base64.b64encode(content.getvalue()).decode()
    return smaller if len(smaller) < len(picture) else picture


def _no_news(output: nbformat.NotebookNode) -> bool:
    """Whether an output says nothing but that the machine has no GPU."""
    lines = output.get("text", "").splitlines()
    return output.get("name") == "stderr" and all(line.startswith(NO_NEWS) for line in lines)


def _texts(output: nbformat.NotebookNode) -> list[str]:
    """All that is text in an output."""
    data = output.get("data", {})
    return [str(output.get("text", "")), *(str(data[kind]) for kind in data if kind.startswith("text/"))]


def _places() -> list[str]:
    """Folders that must not be named: of the project, the interpreter, the user and temporary files."""
    places = {FOLDER.parent, Path(sys.prefix), Path(tempfile.gettempdir()).resolve(), Path.home()}
    return sorted(str(place) for place in places if len(place.parts) > 1)


def main(arguments: Sequence[str] | None = None) -> int:
    """Execute notebooks and write them; exit status 1 if one of them cannot be."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="notebooks, or how their names begin; all of them if none is given")
    parser.add_argument("--budget", type=float, default=BUDGET, help="seconds for each fit (default: %(default)g)")
    options = parser.parse_args(arguments)
    for name in options.names:
        if not any(path.name.startswith(name) for path in sources()):
            parser.error(f"expected one of {', '.join(p.stem for p in sources())}, got {name!r}")
    status = 0
    for path in sources():
        if options.names and not any(path.name.startswith(name) for name in options.names):
            continue
        try:
            notebook = execute(path, options.budget)
            text = nbformat.writes(notebook)
            found = problems(notebook)
        except CellExecutionError as error:
            if reason := lacking(error):
                print(f"{path.name}: left as it is; {reason}")
                continue
            text, found = "", [str(error)]
        if len(text.encode()) > LARGEST:
            found.append(f"expected at most {LARGEST:,} bytes, got {len(text.encode()):,}")
        for problem in found:
            print(f"{path.name}: {problem}", file=sys.stderr)
        if found:
            status = 1
            continue
        path.write_text(text if text.endswith("\n") else text + "\n")
        print(f"{path.name}: {len(text.encode()):,} bytes")
    return status


if __name__ == "__main__":
    sys.exit(main())
