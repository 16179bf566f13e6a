"""Every public name has an example, and every example runs as it says.

Names have theirs in their docstrings; others stand on the pages of the API reference, and those of the many methods of
a bounder that only authors of methods call in ``authors.md``. They share a few names, which each example may use
without making them: ``ball``, ``grid``, ``mesh``, ``motion``, ``bounder``, ``points``, ``far``, a distance bounder of
the ball, and ``ball_distances``, those of the points; ``balls``, which hold the mesh, and ``pair``, of both; and
``motions``, which proves those of an arm of one joint beside a ball.
"""

import doctest
import re
import runpy
from inspect import getdoc

import numpy as np
import pytest
import warp as wp
from reading_order import ROOT

import warp_bounding as wb
from warp_bounding.proof import stress_test
from warp_bounding.proof.stress import StressResult

pytest.importorskip("torch", reason="torch is not installed")

PAGES = tuple(f"docs/api/{name}.md" for name in ("arms", "choose", "composition", "pairs"))
PAGES += ("tests/authors.md",)
METHODS = {
    wb.Bounder: ("candidates", "data", "freeze", "func", "prepare", "query", "save", "to", "values"),
    wb.baking.BounderLibrary: ("manifest", "names", "path"),
    wb.Prepared: ("launch", "move"),
    wb.Certificate: ("from_dict", "proven", "to_dict"),
    wb.arms.Motions: ("path",),
    wb.pairs.Balls: ("certify", "load", "of", "save"),
    wb.pairs.RobotBalls: ("certify", "load", "of", "save"),
    wb.pairs.Pair: ("contact_time", "distance", "func", "query"),
    wb.DistanceBounder: ("boxes", "data", "distance", "distance_func", "query", "rays", "save", "segments", "to"),
    wb.shapes.Function: ("check",),
    wb.shapes.Grid: ("cell_coordinate", "contains", "position", "to_grid"),
    wb.shapes.Mesh: ("to_grid",),
    wb.shapes.MovingMesh: ("to_grid", "vertices_at"),
    wb.Rates: ("to_dict",),
}
MODULES = {"shapes": wb.shapes, "baking": wb.baking, "pairs": wb.pairs, "arms": wb.arms}
NO_EXAMPLE = {"DISTANCES", "METHODS", "__version__", "shapes.READERS", "shapes.ShapeLike", "arms.WORLD"}
PUBLIC = {name: getattr(wb, name) for name in wb.__all__ if name not in NO_EXAMPLE}
for prefix, module in MODULES.items():
    named = {f"{prefix}.{name}": getattr(module, name) for name in module.__all__}
    PUBLIC |= {name: value for name, value in named.items() if name not in NO_EXAMPLE}
DOCUMENTED = PUBLIC | {"StressResult": StressResult, "proof.clear_segments": wb.proof.clear_segments}
DOCUMENTED |= {f"{kind.__name__}.{name}": getattr(kind, name) for kind, names in METHODS.items() for name in names}


def shown(page: str) -> str:
    """The examples of a page."""
    return "\n".join(re.findall(r"```pycon\n(.*?)```", (ROOT / page).read_text(), re.DOTALL))


@pytest.fixture(scope="module")
def made() -> dict:
    """What examples share."""
    ball = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 6
    grid, bounder = wb.load_shape(ball), wb.fit(ball, method="obb", device="cpu")
    vertices, faces = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
    mesh = wb.shapes.Mesh(vertices, faces)
    motion = wb.shapes.MovingMesh([mesh.vertices, mesh.vertices + 0.5], mesh.faces, times=[0.0, 2.0])
    points = np.random.default_rng(0).random((100, 3), dtype=np.float32)
    far = wb.fit(ball, "distance", "kdop", device="cpu")
    ball_distances = grid.distances(points)[:, 1]
    balls = wb.pairs.Balls.of(mesh, 16)
    arm = wb.arms.Arm([wb.arms.Joint()], [wb.arms.Body.capsule([0, 0, 0], [0.5, 0, 0], 0.05, link=0)])
    motions = wb.arms.Motions(arm, [wb.arms.Body.sphere([0.5, 0, 0], 0.1, name="ball")])
    names = {
        "motions": motions,
        "far": far,
        "ball_distances": ball_distances,
        "balls": balls,
        "pair": wb.pairs.Pair(far, balls),
    }
    names |= {"ball": ball, "grid": grid, "mesh": mesh, "motion": motion, "bounder": bounder, "points": points}
    return names | {"np": np, "wp": wp, "wb": wb, "stress_test": stress_test}


BALL = '<link name="{}"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>'
HINGE = '<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/><origin xyz="0.5 0 0"/>'
HINGE += '<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>'
JOINTS = (("shoulder", "base", "upper"), ("elbow", "upper", "lower"), ("finger", "lower", "hand"))
ROBOT = [*map(BALL.format, ("base", "upper", "lower", "hand")), *(HINGE.format(*names) for names in JOINTS)]


def run(text: str, name: str, made: dict) -> None:
    """Run a text's examples; each must say what stands below it. Its kernels are compiled without those of others."""
    names = made | {"__name__": re.sub(r"\W", "_", name)}
    test = doctest.DocTestParser().get_doctest(text, names, name, None, 0)
    assert test.examples, f"{name} has no example"
    said = []
    doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(test, out=said.append, clear_globs=False)
    assert not said, "".join(said)


@pytest.mark.parametrize("name", DOCUMENTED)
def test_examples_run(name, made, tmp_path, monkeypatch):
    if name == "arms.load_urdf" or name.startswith(("RobotBalls", "pairs.RobotBalls", "pairs.LinkHeld")):
        (tmp_path / "arm.urdf").write_text(f'<robot name="arm">{"".join(ROBOT)}</robot>')
    monkeypatch.chdir(tmp_path)
    run(getdoc(DOCUMENTED[name]), name, made)


@pytest.mark.parametrize("page", PAGES)
def test_examples_of_pages_run(page, made, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(shown(page), page, made)


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted((ROOT / "notebooks").glob("*.ipynb")), ids=lambda path: path.stem)
def test_notebooks_run_with_a_small_budget(path):
    for name in ("nbformat", "nbclient", "ipykernel", "matplotlib"):
        pytest.importorskip(name)
    before, told = path.read_bytes(), runpy.run_path(str(ROOT / "notebooks/execute.py"))
    try:
        executed = told["execute"](path, 0.3, None)
    except told["CellExecutionError"] as error:
        if reason := told["lacking"](error):
            pytest.skip(reason)
        raise
    assert told["problems"](executed) == []
    assert path.read_bytes() == before


def test_every_public_name_is_on_one_page_of_the_reference():
    pages = "\n".join(path.read_text() for path in (ROOT / "docs/api").glob("*.md"))
    shown = re.findall(r"^\.\. auto\w+:: warp_bounding\.([\w.]+)$", pages, re.MULTILINE)
    assert len(shown) == len(set(shown))
    assert {name for name in PUBLIC if name not in MODULES or f"`wb.{name}`" not in pages} <= set(shown)
    assert all(f"`wb.{name}`" in pages for name in ("DISTANCES", "METHODS", "__version__"))
