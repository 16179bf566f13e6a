"""Shapes as other libraries hold them."""

import numpy as np
import pytest
import trimesh
import warp as wp

import warp_bounding as wb
from warp_bounding.errors import IndicatorError
from warp_bounding.indicators import load_indicator

BOX = trimesh.creation.box(extents=(1, 2, 3))
VERTICES, FACES = np.asarray(BOX.vertices, dtype=np.float32), np.asarray(BOX.faces, dtype=np.int32)
EXPECTED = load_indicator(BOX).digest


def test_a_pair_of_vertices_and_faces():
    torch = pytest.importorskip("torch")
    for pair in (
        (VERTICES, FACES),
        (VERTICES.tolist(), FACES.tolist()),
        (torch.tensor(VERTICES, requires_grad=True), torch.tensor(FACES)),
        (wp.array(VERTICES, dtype=wp.vec3, device="cpu"), wp.array(FACES, dtype=wp.int32, device="cpu")),
    ):
        mesh = load_indicator(pair)
        assert (mesh.digest, mesh.name) == (EXPECTED, "mesh")
    assert wb.fit((VERTICES, FACES), method="aabb", resolution=8).certificate.proven


def test_a_warp_mesh(device):
    mesh = wp.Mesh(
        wp.array(VERTICES, dtype=wp.vec3, device=device), wp.array(FACES.ravel(), dtype=wp.int32, device=device)
    )
    indicator = load_indicator(mesh)
    assert (indicator.digest, indicator.name) == (EXPECTED, "wp.Mesh")
    bounder = wb.fit(mesh, method="aabb", resolution=8)
    assert wb.certify(bounder, mesh).proven
    assert wb.evaluate(bounder, mesh, samples=1000).fn == 0


def test_a_newton_mesh():
    newton = pytest.importorskip("newton")
    indicator = load_indicator(newton.Mesh(VERTICES, FACES.ravel(), compute_inertia=False))
    assert (indicator.digest, indicator.name) == (EXPECTED, "newton.Mesh")


def test_arrays_of_other_libraries():
    torch = pytest.importorskip("torch")
    occupancy = np.random.default_rng(0).random((4, 5, 6)) < 0.3
    expected = load_indicator(occupancy).digest
    assert load_indicator(torch.tensor(occupancy)).digest == expected
    assert load_indicator(wp.array(occupancy.astype(np.uint8), dtype=wp.uint8, device="cpu")).digest == expected
    assert load_indicator(torch.tensor(np.where(occupancy, -1.0, 1.0)), threshold="<=0").digest == expected
    with pytest.raises(IndicatorError, match=r"load_indicator\(a <= 0\)"):
        load_indicator(torch.tensor(np.where(occupancy, -1.0, 1.0)))


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ((VERTICES,), "a pair (vertices, faces), got a tuple of 1"),
        ((VERTICES, FACES, FACES), "a tuple of 3"),
        ((FACES, VERTICES), "faces as integers"),
        (([[0, 1], [2]], FACES), "expected vertices"),
        ((VERTICES, [[0, 1, 99]]), "got vertex 99"),
        ((None, None), "expected vertices as numbers"),
        ([VERTICES, FACES], "expected a path, an array (NumPy, torch, Warp), (vertices, faces)"),
    ],
)
def test_pairs_that_are_none(source, words):
    with pytest.raises(IndicatorError) as caught:
        load_indicator(source)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_tensors_that_numpy_cannot_hold():
    torch = pytest.importorskip("torch")
    for change in (lambda t: t.to_sparse(), lambda t: t.bfloat16()):
        with pytest.raises(IndicatorError, match=r"^expected a tensor that NumPy can hold, got torch[^\n]*$"):
            load_indicator(change(torch.eye(5)))
