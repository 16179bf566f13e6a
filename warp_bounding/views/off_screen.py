"""Drawing with pyvista in a process of its own, off-screen: no display is needed.

Where there is no OpenGL, VTK does not raise an exception, it crashes; so a crash costs the pictures, not the program, and its complaints go
to a log instead of the terminal. Without a display the process asks for EGL, then for OSMesa. A module of pictures has a
``draw(data, folder)`` that runs there.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

__all__ = ["WINDOWS", "Drawn", "draw_with", "with_palette"]

SECONDS = 120  # for drawing
COLOURS = 256  # of a picture's palette
WINDOWS = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow")
KEPT = "Everything else is complete."
PROGRAM = """
import importlib, pathlib, sys
import numpy
importlib.import_module(sys.argv[1]).draw(dict(numpy.load(sys.argv[2])), pathlib.Path(sys.argv[3]))
"""  # of the process that draws


class Drawn(NamedTuple):
    """The pictures that were drawn, and in one line why some were not."""

    paths: list[Path]
    problem: str = ""

    def lines(self) -> str:
        """For people."""
        told = [f"No pictures: {self.problem}. {KEPT}"] if self.problem else []
        return "\n".join([*(f"Picture: {path}" for path in self.paths), *told])


def draw_with(module: str, folder: Path, data: dict[str, np.ndarray], colours: int | None = COLOURS) -> Drawn:
    """Let a module draw.

    Args:
        module: Its name; ``draw(data, folder)`` in it writes PNG files into a folder, with pyvista.
        folder: Where they go; made if there is none. A picture is replaced only whole.
        data: Arrays by name.
        colours: Of each picture's palette; ``None`` for pictures as they were drawn.

    Returns:
        The pictures, or why there are none.
    """
    from PIL import Image

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    root = str(Path(__file__).resolve().parents[2])
    with tempfile.TemporaryDirectory(dir=folder, prefix=".drawing") as work:
        file, problem = Path(work) / "data.npz", ""
        np.savez(file, **data)
        for window in _windows():
            environment = {**os.environ, **window}
            environment["PYTHONPATH"] = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
            command = [sys.executable, "-c", PROGRAM, module, str(file), work]
            try:
                done = subprocess.run(
                    command, env=environment, capture_output=True, text=True, timeout=SECONDS, check=False
                )
            except subprocess.TimeoutExpired:
                problem = problem or f"drawing took more than {SECONDS} s"
                continue
            made = sorted(Path(work).glob("*.png"))
            if done.returncode == 0 and made:
                for path in made if colours else ():
                    with_palette(Image.open(path), colours).save(path, optimize=True)
                return Drawn([path.replace(folder / path.name) for path in made])
            problem = problem or _reason(done)
    return Drawn([], problem)


def with_palette(image, colours: int = COLOURS):
    """A Pillow image with a palette, which makes its file a third as large, and no difference that one could see."""
    from PIL import Image

    return image.convert("RGB").quantize(colours, Image.Quantize.MAXCOVERAGE, kmeans=2, dither=Image.Dither.NONE)


def _windows() -> list[dict[str, str]]:
    """Environments to try: the user's own choice or display first."""
    if os.environ.get("VTK_DEFAULT_OPENGL_WINDOW") or not sys.platform.startswith("linux"):
        return [{}]
    off_screen = [{"VTK_DEFAULT_OPENGL_WINDOW": name, "DISPLAY": ""} for name in WINDOWS]
    return [{}, *off_screen] if os.environ.get("DISPLAY") else off_screen


def _reason(done: subprocess.CompletedProcess) -> str:
    """Why the drawing process failed, in a few words."""
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    if "No module named 'pyvista'" in done.stderr:
        return "pyvista is not installed (pip install 'warp-bounding[show]')"
    if done.returncode < 0 or "OpenGL" in done.stderr or "EGL" in done.stderr or "OSMesa" in done.stderr:
        return "this machine has no OpenGL for off-screen drawing (libEGL or libOSMesa)"
    return f"drawing failed ({lines[-1] if lines else f'status {done.returncode}'})"
