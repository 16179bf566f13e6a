"""Every public name's docstring has an example, and every example runs as it says.

They share a few names, which each example may use without making them: ``ball``, ``grid``, ``mesh``, ``motion``, ``bounder``, ``points``,
``far``, a distance bounder of the ball, and ``ball_distances``, those of the points.
"""

import doctest
from inspect import getdoc

import numpy as np
import pytest
import warp as wp

import warp_bounding as wb
from warp_bounding.proof import soak
from warp_bounding.proof.attest.soak import Soak

pytest.importorskip("torch", reason="torch is not installed")

METHODS = {
    wb.Bounder: ("candidates", "data", "freeze", "func", "prepare", "query", "save", "to", "values"),
    wb.BounderLibrary: ("manifest", "names", "path", "query_pairs", "stack"),
    wb.BounderStack: ("query",),
    wb.Prepared: ("launch", "move"),
    wb.Certificate: ("from_dict", "proven", "to_dict"),
    wb.DistanceBounder: ("boxes", "data", "distance", "distance_func", "query", "rays", "save", "segments", "to"),
    wb.IndicatorFunction: ("refute",),
    wb.IndicatorGrid: ("cell_coordinate", "contains", "position", "to_grid"),
    wb.IndicatorMesh: ("to_grid",),
    wb.IndicatorMotion: ("to_grid", "vertices_at"),
    wb.Rates: ("to_dict",),
    Soak: ("complete", "rate", "to_dict"),
}
DOCUMENTED = {name: getattr(wb, name) for name in wb.__all__ if name not in ("DISTANCES", "METHODS", "__version__")}
DOCUMENTED |= {"Soak": Soak} | {f"solids.{name}": getattr(wb.solids, name) for name in wb.solids.__all__}
DOCUMENTED |= {f"{kind.__name__}.{name}": getattr(kind, name) for kind, names in METHODS.items() for name in names}


@pytest.fixture(scope="module")
def made() -> dict:
    """What examples share."""
    ball = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 6
    grid, bounder = wb.load_indicator(ball), wb.fit(ball, method="obb", device="cpu")
    vertices, faces = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
    mesh = wb.IndicatorMesh(vertices, faces)
    motion = wb.IndicatorMotion([mesh.vertices, mesh.vertices + 0.5], mesh.faces, times=[0.0, 2.0])
    points = np.random.default_rng(0).random((100, 3), dtype=np.float32)
    far = wb.fit(ball, "distance", "sphere", device="cpu")
    ball_distances = grid.distances(points)[:, 1]
    names = {"far": far, "ball_distances": ball_distances}
    names |= {"ball": ball, "grid": grid, "mesh": mesh, "motion": motion, "bounder": bounder, "points": points}
    return names | {"np": np, "wp": wp, "wb": wb, "soak": soak, "__name__": __name__}


@pytest.mark.parametrize("name", DOCUMENTED)
def test_examples_run(name, made, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    test = doctest.DocTestParser().get_doctest(getdoc(DOCUMENTED[name]), dict(made), name, None, 0)
    assert test.examples, f"{name} has no example"
    said = []
    doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(test, out=said.append, clear_globs=False)
    assert not said, "".join(said)
