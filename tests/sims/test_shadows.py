"""Shadows: the same pictures, bit by bit, with every proven bounder; the scene is what it says."""

import numpy as np
import pytest
import warp as wp

import warp_bounding as wb
from sims.shadows import Example, Scene
from sims.shadows.demo import simulate
from sims.shadows.scene import LENGTH, LIFT, margin_of
from warp_bounding.queries import oracle

RESOLUTION, STEPS, SIZE = 32, 2, (120, 90)
CLOSED = ("aabb", "kdop", "bvh")
DEVICES = ["cpu", *(["cuda:0"] if wp.is_cuda_available() else [])]


@pytest.fixture(scope="module", params=DEVICES)
def scene(request):
    return Scene.still_life(*SIZE, request.param)


@pytest.fixture(scope="module")
def cells(scene):
    return {name: shape.to_grid(resolution=RESOLUTION, margin=margin_of(shape)) for name, shape in scene.shapes.items()}


@pytest.fixture(scope="module")
def bounders(scene, cells):
    def fit(method, grid):
        options = {"margin": grid.margin, "resolution": RESOLUTION, "length": LENGTH, "device": str(scene.device)}
        return wb.fit(grid, query="ray", method=method, **options)

    return {method: {name: fit(method, grid) for name, grid in cells.items()} for method in CLOSED}


@pytest.fixture(scope="module")
def examples(scene, bounders):
    return simulate(scene, bounders, steps=STEPS)


def facing(scene, example, step=0):
    return (scene.seen.normals.numpy().astype(np.float64) @ example.suns[step].astype(np.float64)) > 0


def shadow_rays(scene, example, step=0):
    """The shadow rays of a picture, in NumPy, in the order of the pixels."""
    points, normals = scene.seen.points.numpy(), scene.seen.normals.numpy()
    origins = (points + normals * np.float32(LIFT)).astype(np.float32)[facing(scene, example, step)]
    return np.concatenate([origins, np.broadcast_to(example.suns[step], origins.shape)], axis=1).astype(np.float32)


def stopped_by(scene, example, step=0):
    """Which objects stop these rays, a bit each."""
    return example.shadows[step][scene.seen.things >= 0][facing(scene, example, step)]


def test_proven_bounders_change_nothing_but_the_number_of_calls(scene, examples, monkeypatch):
    reference, things = examples["none"], scene.seen.things
    for bit in (1, 2):
        assert all(((s & bit != 0) & (things == 0)).sum() > 50 for s in reference.shadows)  # of both on the floor
    assert all((s[things < 0] == 0).all() for s in reference.shadows)
    own = {
        name: wb.fit(shape, "distance", "bvh", leaves=64, margin=margin_of(shape), device=str(scene.device))
        for name, shape in scene.shapes.items()
    }
    marching, again = Example(scene, own, steps=STEPS), Example(scene, steps=STEPS)
    monkeypatch.setenv("WARP_BOUNDING_THREADS", "1")
    for _ in range(STEPS):
        marching.step()
        again.step()
    assert again.state() == reference.state()
    for each in [*(examples[method] for method in CLOSED), marching]:
        each.test_final(reference)
        assert (each.missed(reference), each.state(), each.hits) == (0, reference.state(), reference.hits)
        assert sum(each.calls) < 0.5 * sum(reference.calls)
    assert sum(examples["bvh"].calls) < sum(examples["kdop"].calls) < sum(examples["aabb"].calls)


def test_every_stopped_ray_meets_the_cells(scene, cells, examples):
    """The exact truth of the very rays that the narrow phase stops: each meets the dilated object."""
    for step in range(STEPS):
        rays, shadow = (each(scene, examples["none"], step) for each in (shadow_rays, stopped_by))
        for bit, grid in enumerate(cells.values()):
            stopped = rays[shadow & (1 << bit) != 0]
            assert len(stopped) > 100
            assert oracle("ray", grid, str(scene.device), LENGTH)(stopped).all()
