"""Pictures and windows, drawn off-screen; they are skipped where nothing can be drawn."""

import io
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bounding_shapes import shape

import warp_bounding as wb
from warp_bounding.errors import BoundingError
from warp_bounding.views import Drawn, draw_with, view_of
from warp_bounding.views.draw import BOUND, STONE, WINDOWS, picture, placing
from warp_bounding.views.view import facts_of

pytest.importorskip("pyvista")
Image = pytest.importorskip("PIL.Image")


def seen(name: str, query: str = "point", **options):
    bounder = wb.fit(shape(name), query, "aabb", device="cpu")
    view = view_of(bounder, shape(name), resolution=16, samples=500, **options)
    view.facts = facts_of(bounder, shape(name), view)
    return view


def drawn(view, **options) -> np.ndarray:
    """The pixels of a picture; the test is skipped where this machine cannot draw."""
    try:
        png = picture(view, "a test", "y", **options)
    except BoundingError as error:
        if "OpenGL" not in str(error):
            raise
        pytest.skip(str(error))
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def near(pixels: np.ndarray, colour: str) -> np.ndarray:
    """Which pixels have about this colour."""
    wanted = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    return np.abs(pixels - wanted).max(axis=-1) < 24


def test_a_plane_stands_as_the_image_does():
    """The shape c is open towards the last columns, which are to the right."""
    pixels = drawn(seen("c"))[60:680]  # without the text
    body = np.argwhere(near(pixels, STONE))
    low, high = body.min(axis=0), body.max(axis=0)
    middle = (low + high) // 2
    row = near(pixels, STONE)[middle[0], low[1] : high[1] + 1]
    assert row[: len(row) // 6].all()
    assert not row[len(row) // 2 :].any()
    assert near(pixels, BOUND)[middle[0], middle[1] + (high[1] - middle[1]) // 2]


@pytest.mark.slow
def test_a_panel_for_each_radius():
    view = seen("star", "distance", radii=[0.0, 0.2])
    pixels = drawn(view, cut="z")
    assert pixels.shape == (760, 1520, 3)
    blue = (pixels[..., 2] > pixels[..., 0] + 60).reshape(760, 2, 760).sum(axis=(0, 2))
    assert 1000 < blue[0] < blue[1]  # the larger radius has the larger bound


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_places_are_turned_and_not_mirrored(up):
    view = seen("star")
    place = placing(view, up)
    turned = place(np.eye(3))
    assert np.linalg.det(turned) == pytest.approx(1.0)
    np.testing.assert_array_equal(turned["xyz".index(up)], [0, 0, 1])


def test_without_opengl_there_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    found = draw_with("warp_bounding.views.draw", tmp_path, {})
    assert found.paths == []
    assert re.fullmatch(r"drawing failed \(status 1\)", found.problem)
    assert list(tmp_path.iterdir()) == []
    assert Drawn([], found.problem).lines() == f"No pictures: {found.problem}. Everything else is complete."
    with pytest.raises(BoundingError, match="no picture: drawing failed"):
        picture(seen("c"), "a test", "y")


WINDOW = """
import sys
import numpy as np
from bounding_shapes import shape
import warp_bounding as wb
from warp_bounding.views import view_of
from warp_bounding.views.draw import Window

far = wb.fit(shape("star"), "distance", "aabb", device="cpu")
view = view_of(far, shape("star"), radii=[0.0, 0.1], resolution=12, samples=500)
window = Window(view, "a test", "y", off_screen=True)
plotter = window.plotter
assert {"object", "bound"} <= set(plotter.actors)
assert "false-positives" not in plotter.actors
before = plotter.actors["bound"].bounds
window.go(1.2)
np.testing.assert_allclose(np.abs(np.subtract(plotter.actors["bound"].bounds, before)), 0.1, atol=2e-3)
window.cut((0, 1, 0), plotter.actors["object"].center)
assert plotter.actors["bound"].bounds[2] > before[2] + 0.2
window.toggle("bound", False)
window.toggle("false-positives", True)
assert "bound" not in plotter.actors
assert "false-positives" in plotter.actors
assert window._bound().n_cells
print("done")
"""


@pytest.mark.slow
def test_a_window_slides_cuts_and_hides():
    """In a process of its own, since VTK does not raise an exception where there is no OpenGL, but crashes."""
    root = Path(__file__).parents[2]
    paths = os.pathsep.join([str(root), str(root / "tests" / "shared")])
    for kind in WINDOWS:
        options = {"VTK_DEFAULT_OPENGL_WINDOW": kind, "DISPLAY": "", "PYTHONPATH": paths}
        command, environment = [sys.executable, "-c", WINDOW], os.environ | options
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)
        assert "Traceback" not in done.stderr, done.stderr
        if done.stdout.endswith("done\n"):
            return
    pytest.skip("this machine has no OpenGL for off-screen drawing")
