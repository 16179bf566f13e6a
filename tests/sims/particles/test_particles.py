import sys
from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from PIL import Image

import warp_bounding as wb
from sims import drawing
from sims.base import compare
from sims.particles import run
from sims.particles.bounds import bounds_data
from sims.particles.broad import MovingBox, OfMotion, OfSides
from sims.particles.demo import MOVING_BOX, simulate
from sims.particles.example import CONTACT, CONTAINMENT, Example, rain_data
from sims.particles.kernels import RADIUS, collide
from sims.particles.scene import GRAIN, PERIOD, Scene
from sims.prefitted import FOLDER, FitSpec, fit
from sims.report import CHOSEN

PARTICLES, STEPS, RESOLUTION = 2000, 20, 20
CLASSICS = ("aabb", "kdop", "voxels")
DEVICES = ["cpu", *(["cuda:0"] if wp.is_cuda_available() else [])]


@pytest.fixture(scope="module", params=DEVICES)
def scene(request):
    return Scene.bunny(request.param)


@pytest.fixture(scope="module")
def bounders(scene):
    """Of coarse cells, which are bounded in a moment."""
    specs = {name: FitSpec(name, resolution=RESOLUTION) for name in CLASSICS}
    return {name: fit(spec, scene.shape, device=str(scene.device)) for name, spec in specs.items()}


@pytest.fixture(scope="module", params=[CONTAINMENT, CONTACT], ids=["containment", "contact"])
def examples(request, scene, bounders):
    broad = {MOVING_BOX: MovingBox(scene)} | {name: OfMotion(b, scene) for name, b in bounders.items()}
    return simulate(scene, broad, reach=request.param, particles=PARTICLES, steps=STEPS)


def denying(bounder):
    """The bounder with its threshold raised, so that it denies a part of the object."""
    raised = bounder.to(str(bounder.device))
    inside = raised.values(np.float32([[0.3, -0.2, 0.6, 0.1]])).numpy()[0]
    return raised.freeze(float(np.nextafter(inside, np.float32(np.inf))), None)


def test_there_is_rain_on_the_bunny(examples):
    reference = examples["none"]
    touched = [int(np.unpackbits(step).sum()) for step in reference.touched]
    assert min(touched) > 0
    assert np.isfinite(reference.positions.numpy()).all()
    assert reference.lives.numpy().max() >= 1  # some have reached the floor and begun again


def test_the_bunny_moves_and_comes_back(scene):
    motion = scene.motion
    begin, quarter, end = (motion.vertices_at(share * PERIOD) for share in (0.0, 0.25, 1.0))
    assert np.abs(begin - quarter).max() > 0.3
    assert np.abs(begin - end).max() <= 1 / GRAIN
    assert motion.watertight
    assert scene.time(150) == pytest.approx(scene.time(0), abs=1e-6)
    assert all(0.0 < scene.time(step) < PERIOD for step in range(1000))


def test_no_contact_lies_deeper_than_it_may(examples, scene):
    reference = examples["none"]
    last = reference.positions.numpy()[reference.contacts.numpy() == 1]
    assert len(last)
    assert scene.shape.contains(np.insert(last, 0, reference.time, axis=1).astype(np.float32)).all()


@pytest.mark.parametrize("method", [MOVING_BOX, *CLASSICS])
def test_a_proven_bounder_changes_nothing_but_the_number_of_calls(examples, method):
    reference, example = examples["none"], examples[method]
    example.test_final(reference)
    assert example.missed(reference) == 0
    assert example.state() == reference.state()
    assert all(few < all_ for few, all_ in zip(example.calls, reference.calls, strict=True))


def test_a_tighter_bounder_calls_less(examples):
    calls = [sum(examples[name].calls) for name in ("voxels", "kdop", "aabb")]
    assert calls[0] < calls[1] < calls[2]
    assert calls[0] < sum(examples[MOVING_BOX].calls) < calls[2]


@pytest.mark.parametrize("method", CLASSICS)
def test_a_bounder_that_denies_a_part_of_the_object_is_found_out(scene, bounders, method):
    broken = {"broken": denying(bounders[method])}
    runs = simulate(scene, {"broken": OfMotion(broken["broken"], scene)}, particles=PARTICLES, steps=3)
    row = compare(runs, {"broken": broken})[1]
    assert not row.identical
    assert row.missed > 0
    with pytest.raises(AssertionError, match="contacts were missed"):
        runs["broken"].test_final(runs["none"])


def test_the_same_seed_gives_the_same_rain(scene):
    first, second, other = (Example(scene, particles=200, seed=seed) for seed in (3, 3, 4))
    for example in (first, second, other):
        for _ in range(3):
            example.step()
    assert first.state() == second.state() != other.state()


def test_threads_do_not_change_the_rain(scene, monkeypatch):
    states = []
    for threads in ("1", "3"):
        monkeypatch.setenv("WARP_BOUNDING_THREADS", threads)
        example = Example(scene, particles=PARTICLES)
        for _ in range(5):
            example.step()
        states.append(example.state())
    assert states[0] == states[1]


def test_the_margin_covers_the_contact_distance_and_its_rounding(scene):
    assert RADIUS < scene.margin < RADIUS * 1.001
    assert RADIUS - scene.core.margin == pytest.approx(scene.margin - RADIUS)


# --- a porous bunny, and a bounder from the inside ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def inner(scene):
    return wb.load(FOLDER / "rain-inside-mlp.safetensors", device=str(scene.device))


def seeping(scene, broad):
    return simulate(scene, broad, porous=True, particles=PARTICLES, steps=STEPS)


def test_what_certainly_is_in_a_porous_bunny_needs_no_narrow_phase(scene, bounders, inner):
    outer = bounders["voxels"]
    runs = seeping(scene, {"voxels": OfMotion(outer, scene), "voxels+inside": OfSides(outer, inner, scene)})
    reference, without, with_ = runs.values()
    assert reference.porous
    slow = np.linalg.norm(reference.velocities.numpy()[reference.contacts.numpy() == 1], axis=1)
    fast = np.linalg.norm(reference.velocities.numpy()[reference.contacts.numpy() == 0], axis=1)
    assert np.median(slow) < np.median(fast) / 2
    for each in (without, with_):
        each.test_final(reference)
        assert (np.stack(each.touched) == np.stack(reference.touched)).all()
    assert 0 < sum(with_.calls) < sum(without.calls) < sum(reference.calls)


def test_a_bounder_that_calls_free_space_inside_is_found_out(scene, bounders, inner):
    broken = inner.to(str(inner.device))
    away = broken.values(np.float32([[0.3, -0.7, 1.5, 0.5]])).numpy()[0]
    broken.freeze(float(np.nextafter(away, np.float32(np.inf))), None)
    runs = seeping(scene, {"voxels+inside": OfSides(bounders["voxels"], broken, scene)})
    assert not runs["voxels+inside"].identical(runs["none"])
    with pytest.raises(AssertionError, match=r"contacts were missed|the final states differ"):
        runs["voxels+inside"].test_final(runs["none"])


def test_where_to_push_a_drop_is_for_the_narrow_phase_to_say(scene, bounders, inner):
    with pytest.raises(wb.BoundingError, match="of a porous mesh only"):
        Example(scene, OfSides(bounders["voxels"], inner, scene), particles=10)


def test_the_sign_agrees_with_the_shape(scene):
    """No particle outside the dilated object is ever pushed: the sign is never wrong there."""
    rng, count = np.random.default_rng(5), 20_000
    for step in (0, 37, 110):
        example = Example(scene, particles=count, seed=11)
        example.steps = step
        example._move_mesh()
        example.mesh.refit()
        x = scene.shape.lower + rng.random((count, 4)) * (scene.shape.upper - scene.shape.lower)
        x[:, 0] = example.time
        x = x.astype(np.float32)
        example.positions.assign(np.ascontiguousarray(x[:, 1:]))
        arrays = [example.positions, example.velocities, example.contacts]
        inputs = [example.mesh.id, CONTAINMENT, example._everyone, example._count]
        wb.launch_on_cores(collide, count, inputs, arrays, scene.device)
        touched = example.contacts.numpy().astype(bool)
        assert touched.any()
        assert not (touched & ~scene.shape.contains(x)).any()


def test_no_point_of_the_bunny_is_deeper_than_containment_looks(scene):
    """All of the object is within reach of its surface."""
    shape = scene.shape
    for step in (0, 37, 75, 110):
        time = scene.time(step)
        mesh = wp.Mesh(
            wp.array(scene.motion.vertices_at(time), dtype=wp.vec3, device=scene.device),
            wp.array(scene.motion.faces.reshape(-1), dtype=wp.int32, device=scene.device),
        )
        rng = np.random.default_rng(step)
        x = (shape.lower + rng.random((20_000, 4)) * (shape.upper - shape.lower)).astype(np.float32)
        x[:, 0] = time
        x = x[shape.contains(x)][:, 1:]
        found = wp.zeros(len(x), dtype=wp.int32, device=scene.device)
        points = wp.array(np.ascontiguousarray(x), dtype=wp.vec3, device=scene.device)
        wp.launch(within, dim=len(x), inputs=[mesh.id, CONTAINMENT, points], outputs=[found], device=scene.device)
        assert found.numpy().all()


@wp.kernel(enable_backward=False)
def within(
    # inputs
    mesh: wp.uint64,
    reach: float,
    points: wp.array(dtype=wp.vec3),
    # outputs
    found: wp.array(dtype=wp.int32),
):
    i = wp.tid()
    if wp.mesh_query_point_no_sign(mesh, points[i], reach).result:
        found[i] = 1


@pytest.mark.slow
def test_the_demo(tmp_path, capsys):
    specs = {name: FitSpec(name, resolution=12) for name in ("aabb", "voxels")}
    specs["mlp"] = FitSpec("mlp", options={"hidden": (12, 12), "steps": 20})
    specs["kdop"] = FitSpec("kdop")
    specs["kdop+mlp"] = FitSpec("kdop+mlp")
    specs["occupancy"] = FitSpec("occupancy", options={"hidden": (12, 12), "steps": 20})
    inner = FitSpec("mlp", options={"hidden": (12, 12), "steps": 20, "side": "inside"})
    options = {"particles": 1500, "steps": 4, "device": "cpu", "inner": inner}
    result = run(tmp_path, specs=specs, refit=True, **options)
    assert result["identical"]
    proven = [name for name in specs if name != "occupancy"]
    assert [(r["section"], r["bounder"]) for r in result["runs"]] == [
        (section, name)
        for section in ("containment", "contact")
        for name in ("none", MOVING_BOX, *proven, CHOSEN, "occupancy")  # what has no proof comes last
    ] + [("porous", name) for name in ("none", MOVING_BOX, "voxels", "mlp", "voxels+inside", "mlp+inside", "occupancy")]
    assert all(r["missed"] == 0 and r["identical"] for r in result["runs"] if r["bounder"] != "occupancy")
    assert {row["certificate"] for row in result["bounders"] if row["bounder"] != "occupancy"} == {"proven"}
    assert result["bounders"][-1]["bounder"] == "inside"
    for row in [*result["bounders"], *result["runs"]]:  # of cells are those that say so, and looser than against these
        cells = row["fp_rate_cells"]
        assert (cells is not None) == (row["bounder"] in ("aabb", "voxels")) or row["bounder"] == CHOSEN
        assert cells is None or cells < row["fp_rate"]
    text = capsys.readouterr().out
    assert "missed none of the contacts" in text
    options.pop("inner")
    again = run(tmp_path, specs={"mlp": specs["mlp"]}, bounder_file=tmp_path / "rain-mlp.safetensors", **options)
    assert again["identical"]
    with pytest.raises(wb.BounderError, match="of its cells at resolution 13, got one of the shape itself"):
        run(
            tmp_path,
            specs={"mlp": replace(specs["mlp"], resolution=13)},
            bounder_file=tmp_path / "rain-mlp.safetensors",
            **options,
        )


@pytest.mark.parametrize("option", ["particles", "steps"])
def test_nothing_to_simulate_is_refused(tmp_path, option):
    with pytest.raises(wb.BoundingError, match="at least 1"):
        run(tmp_path, **{option: 0})


def test_an_unknown_device_is_refused():
    with pytest.raises(wb.DeviceError, match="no such device"):
        Scene.bunny("cuda:99")


def test_without_opengl_pictures_are_skipped_with_one_line(examples, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    drawn = drawing.draw_with("sims.particles.pictures", tmp_path, rain_data({"none": examples["none"]}))
    assert drawn.paths == []
    assert drawn.lines().startswith("No pictures: ")
    assert "\n" not in drawn.lines()
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def rains(scene, bounders):
    """A run without a broad phase, one with a proven bounder, and one with a bounder that denies a part of the object; and the bounders."""
    shown = {"kdop": bounders["kdop"], "broken": denying(bounders["kdop"])}
    broad = {name: OfMotion(bounder, scene) for name, bounder in shown.items()}
    return simulate(scene, broad, particles=PARTICLES, steps=3), shown


def test_the_picture_of_the_rain_says_what_a_run_lost(rains):
    runs, shown = rains
    data = rain_data({name: runs[name] for name in shown}, shown, runs["none"])
    kept, lost = (str(data[f"rain{number}_caption"]) for number in (0, 1))
    assert "0 contacts missed in 3 steps\nidentical" in kept
    assert f"{runs['broken'].missed(runs['none']):,} contacts missed in 3 steps\nred" in lost
    assert not data["rain0_lost"].any()
    assert 0 < data["rain1_lost"].sum() <= runs["broken"].missed(runs["none"])
    assert data["rain0_balls"].sum() == runs["kdop"].calls[-1]  # what touches is pushed, and stays within the bound


def test_pictures(scene, rains, tmp_path):
    pytest.importorskip("pyvista")
    runs, shown = rains
    time = runs["none"].time
    data = bounds_data(scene, time, {"kdop": (shown["kdop"], 1.0)})
    data |= rain_data({name: runs[name] for name in shown}, shown, runs["none"])
    drawn = drawing.draw_with("sims.particles.pictures", tmp_path, data)
    if not drawn.paths:
        pytest.skip(drawn.problem)
    assert [path.name for path in drawn.paths] == ["bounds.png", "rain.png"]
    assert all(path.stat().st_size > 20_000 for path in drawn.paths)
    colours = np.asarray(Image.open(tmp_path / "rain.png").convert("RGB")).astype(int)
    red = (colours[:, :, 0] > 180) & (colours[:, :, 1:].max(axis=2) < 110)
    kept, lost = np.split(red, 2, axis=1)
    assert lost.sum() > 20
    assert not kept.any()


def test_an_island_of_a_bound_is_explained(scene, bounders):
    """A bound of one piece needs no words; one with pieces apart from the object has them."""
    motion_time = scene.time(0)
    whole = bounds_data(scene, motion_time, {"kdop": (bounders["kdop"], 1.0)})
    assert not str(whole["bound0_caption"]).split("\n")[2]
    apart = wb.load(FOLDER / "rain-mlp.safetensors", device=str(scene.device))
    islands = bounds_data(scene, motion_time, {"mlp": (apart, 1.0)})
    assert "false positives" in str(islands["bound0_caption"]).split("\n")[2]
