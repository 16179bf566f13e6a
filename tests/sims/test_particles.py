import sys

import numpy as np
import pytest
import warp as wp

import warp_bounding as wb
from sims import pictures
from sims.bounder_table import bounder_rows, load_network
from sims.particles import compare, simulate
from sims.rain import RADIUS, Example, Scene, collide

PARTICLES, STEPS, RESOLUTION = 2000, 20, 48
CLASSICS = ("aabb", "kdop", "voxels")
DEVICES = ["cpu", *(["cuda:0"] if wp.is_cuda_available() else [])]


@pytest.fixture(scope="module", params=DEVICES)
def scene(request):
    return Scene.bunny(request.param)


@pytest.fixture(scope="module")
def grid(scene):
    return scene.shape.to_grid(resolution=RESOLUTION, margin=scene.margin)


@pytest.fixture(scope="module")
def bounders(scene, grid):
    def fit(method):
        return wb.fit(grid, method=method, margin=grid.margin, resolution=RESOLUTION, device=str(scene.device))

    return {method: fit(method) for method in CLASSICS}


@pytest.fixture(scope="module")
def examples(scene, bounders):
    return simulate(scene, bounders, particles=PARTICLES, steps=STEPS)


def denying(bounder):
    """The bounder with its threshold raised, so that it denies a part of the object."""
    raised = bounder.to(str(bounder.device))
    inside = raised.values(np.float32([[-0.2, 0.6, 0.1]])).numpy()[0]
    return raised.freeze(float(np.nextafter(inside, np.float32(np.inf))), None)


def test_there_is_rain_on_the_bunny(examples):
    reference = examples["none"]
    touched = [int(np.unpackbits(step).sum()) for step in reference.touched]
    assert min(touched) > 0
    assert touched[0] > touched[-1]  # what began inside was pushed out at once
    assert np.isfinite(reference.positions.numpy()).all()
    assert reference.lives.numpy().max() >= 1  # some have reached the floor and begun again


def test_no_contact_lies_deeper_than_it_may(examples, grid):
    reference = examples["none"]
    last = reference.positions.numpy()[reference.contacts.numpy() == 1]
    assert grid.contains(last).all()  # pushed out to the contact distance, no further


@pytest.mark.parametrize("method", CLASSICS)
def test_a_proven_bounder_changes_nothing_but_the_number_of_calls(examples, method):
    reference, example = examples["none"], examples[method]
    example.test_final(reference)
    assert example.missed(reference) == 0
    assert example.state() == reference.state()
    assert all(few < all_ for few, all_ in zip(example.calls, reference.calls, strict=True))


def test_a_tighter_bounder_calls_less(examples):
    assert sum(examples["voxels"].calls) < sum(examples["kdop"].calls) < sum(examples["aabb"].calls)


@pytest.mark.parametrize("method", CLASSICS)
def test_a_bounder_that_denies_a_part_of_the_object_is_found_out(scene, bounders, method):
    runs = simulate(scene, {"broken": denying(bounders[method])}, particles=PARTICLES, steps=3)
    rows, identical = compare(runs, {})
    assert not identical
    assert rows[1]["missed"] > 0
    with pytest.raises(AssertionError, match="contacts were missed"):
        runs["broken"].test_final(runs["none"])


def test_the_same_seed_gives_the_same_rain(scene):
    first, second, other = (Example(scene, particles=200, seed=seed) for seed in (3, 3, 4))
    for example in (first, second, other):
        for _ in range(3):
            example.step()
    assert first.state() == second.state() != other.state()


def test_threads_do_not_change_the_rain(scene, examples, monkeypatch):
    monkeypatch.setenv("WARP_BOUNDING_THREADS", "1")
    single = Example(scene, particles=PARTICLES)
    for _ in range(STEPS):
        single.step()
    assert single.state() == examples["none"].state()


def test_the_margin_covers_the_contact_distance_and_its_rounding(scene):
    assert RADIUS < scene.margin < RADIUS * 1.001


def test_the_sign_agrees_with_the_cells_far_from_the_bunny(scene, grid):
    """No particle outside the dilated object is ever pushed: the sign is never wrong there."""
    example = Example(scene, particles=20_000, seed=11)
    rng = np.random.default_rng(5)
    x = grid.lower + rng.random((20_000, 3)) * (grid.upper - grid.lower)
    example.positions.assign(x.astype(np.float32))
    arrays = [example.positions, example.velocities, example.contacts]
    example._launch(collide, 20_000, [scene.mesh.id, example._everyone, example._count], arrays)
    assert not (example.contacts.numpy().astype(bool) & ~grid.contains(x.astype(np.float32))).any()


def test_rows_of_bounders(bounders, grid):
    rows = bounder_rows(bounders, grid, samples=20_000)
    assert [row["bounder"] for row in rows] == list(CLASSICS)
    assert all(row["fn"] == 0 and row["proven"] and row["ns_query"] > 0 and row["bytes"] > 0 for row in rows)


def test_a_bounder_file_of_another_margin_is_refused(scene, bounders, tmp_path):
    path = tmp_path / "aabb.safetensors"
    bounders["aabb"].save(path)
    assert (
        load_network(path, scene.shape.to_grid(resolution=RESOLUTION, margin=scene.margin), device="cpu").method
        == "aabb"
    )
    with pytest.raises(wb.BounderError, match="expected margin"):
        load_network(path, scene.shape.to_grid(resolution=RESOLUTION, margin=0.05), device="cpu")


def test_without_opengl_pictures_are_skipped_with_one_line(examples, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    drawn = pictures.render(tmp_path, pictures.rain_data(examples["none"]))
    assert drawn.paths == []
    assert drawn.problem.startswith("No pictures: ")
    assert "\n" not in drawn.problem
    assert list(tmp_path.iterdir()) == []


def test_pictures(examples, scene, bounders, tmp_path):
    pytest.importorskip("pyvista")
    data = pictures.bounds_data(scene.shape, {"kdop": (bounders["kdop"], 1.0)}) | pictures.rain_data(examples["none"])
    drawn = pictures.render(tmp_path, data)
    if not drawn.paths:
        pytest.skip(drawn.problem)
    assert [path.name for path in drawn.paths] == ["bounds.png", "rain.png"]
    assert all(path.stat().st_size > 20_000 for path in drawn.paths)
