"""The notebooks run from top to bottom, and the ones in the repository are shown with their outputs."""

import importlib.util
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
pytest.importorskip("nbclient", reason="nbclient is not installed")
pytest.importorskip("ipykernel", reason="ipykernel is not installed")
pytest.importorskip("matplotlib", reason="matplotlib is not installed")

FOLDER = Path(__file__).resolve().parent.parent / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
BUDGET = 0.3  # seconds a fit


def _module():
    spec = importlib.util.spec_from_file_location("notebooks_execute", FOLDER / "execute.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


execute = _module()


def _with_output(text: str = "", *, count: int = 1, name: str = "stdout", outputs=None):
    """A notebook of one cell that has been executed."""
    outputs = [nbformat.v4.new_output("stream", text=text, name=name)] if outputs is None else outputs
    return nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("1", outputs=outputs, execution_count=count)])


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_runs_with_a_small_budget(path: Path):
    before = path.read_bytes()
    notebook = execute.execute(path, BUDGET, None)
    assert execute.problems(notebook) == []
    assert path.read_bytes() == before


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_is_committed_with_its_outputs(path: Path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert (notebook.nbformat, notebook.nbformat_minor) == (4, 5)
    assert notebook.metadata.kernelspec.name == "python3"
    assert execute.problems(notebook) == []
    assert path.stat().st_size <= execute.LARGEST


def test_problems_are_found(tmp_path: Path):
    assert execute.problems(_with_output("all is well")) == []
    error = nbformat.v4.new_output("error", ename="ValueError", evalue="expected 1, got 2", traceback=[])
    shown = nbformat.v4.new_output("display_data", data={"text/html": f"<b>{FOLDER}</b>"})
    for notebook, words in (
        (_with_output(count=None), "expected execution number 1, got None"),
        (_with_output(count=3), "expected execution number 1, got 3"),
        (_with_output(outputs=[error]), "ValueError: expected 1, got 2"),
        (_with_output("beware", name="stderr"), "standard error"),
        (_with_output(f"saved {tmp_path / 'bunny.safetensors'}"), "names the path"),
        (_with_output(outputs=[shown]), "names the path"),
    ):
        assert words in execute.problems(notebook)[0]


def test_a_cell_that_fails_ends_the_script(tmp_path: Path, monkeypatch, capsys):
    path = tmp_path / "fails.ipynb"
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("raise ValueError('on purpose')")])
    nbformat.write(notebook, path)
    before = path.read_bytes()
    monkeypatch.setattr(execute, "FOLDER", tmp_path)
    assert execute.main(["fails"]) == 1
    assert "on purpose" in capsys.readouterr().err
    assert path.read_bytes() == before


def test_the_script_writes_outputs_and_nothing_that_changes(tmp_path: Path, monkeypatch, capsys):
    path = tmp_path / "counts.ipynb"
    cells = [nbformat.v4.new_code_cell("import os\nprint(os.environ['NOTEBOOK_BUDGET'])", id="budget")]
    nbformat.write(nbformat.v4.new_notebook(cells=cells), path)
    monkeypatch.setattr(execute, "FOLDER", tmp_path)
    assert execute.main(["--budget", "2.5"]) == 0
    first = path.read_bytes()
    (cell,) = nbformat.read(path, as_version=4).cells
    assert (cell.id, cell.execution_count, cell.outputs[0].text) == ("budget", 1, "2.5\n")
    assert execute.main(["counts", "--budget", "2.5"]) == 0
    assert path.read_bytes() == first
    with pytest.raises(SystemExit, match="2"):
        execute.main(["no-such-notebook"])
