"""The rain: a proven bounder changes no bit of it, a broken one is found out, and the narrow phase's own claims
hold."""

import numpy as np
import pytest
import warp as wp
from broken import denying

import warp_bounding as wb
from sims.base import compare
from sims.particles import run
from sims.particles.broad import MovingBox, OfMotion, OfSides
from sims.particles.demo import MOVING_BOX, simulate
from sims.particles.example import CONTACT, CONTAINMENT, Example
from sims.particles.kernels import RADIUS, collide
from sims.particles.scene import PERIOD, Scene
from sims.prefitted import FOLDER, FitSpec, fit

PARTICLES, STEPS = 2000, 12
CLASSICS = {"aabb": 20, "kdop": 20, "voxels": 20}  # of coarse cells, which are bounded in a moment
DEVICES = ["cpu", *(["cuda:0"] if wp.is_cuda_available() else [])]


@pytest.fixture(scope="module", params=DEVICES)
def scene(request):
    return Scene.bunny(request.param)


@pytest.fixture(scope="module")
def bounders(scene):
    specs = {name: FitSpec(name, resolution=cells) for name, cells in CLASSICS.items()}
    return {name: fit(spec, scene.shape, device=str(scene.device)) for name, spec in specs.items()}


@pytest.fixture(scope="module")
def inner(scene):
    return wb.load(FOLDER / "rain-inside-mlp.safetensors", device=str(scene.device))


@pytest.mark.parametrize("reach", [CONTAINMENT, CONTACT])
def test_proven_bounders_change_nothing_but_the_number_of_calls(scene, bounders, reach, monkeypatch):
    broad = {MOVING_BOX: MovingBox(scene)} | {name: OfMotion(b, scene) for name, b in bounders.items()}
    runs = simulate(scene, broad, reach=reach, particles=PARTICLES, steps=STEPS)
    reference = runs.pop("none")
    assert all(step.any() for step in reference.touched)
    last = reference.positions.numpy()[reference.contacts.numpy() == 1]
    assert scene.shape.contains(np.insert(last, 0, reference.time, axis=1).astype(np.float32)).all()
    for each in runs.values():
        each.test_final(reference)
        assert (each.missed(reference), each.state()) == (0, reference.state())
        assert all(few < all_ for few, all_ in zip(each.calls, reference.calls, strict=True))
    monkeypatch.setenv("WARP_BOUNDING_THREADS", "1")
    alone, other = Example(scene, reach=reach, particles=PARTICLES), Example(scene, particles=PARTICLES, seed=1)
    for _ in range(STEPS):
        alone.step()
    assert alone.state() == reference.state() != other.state()


@pytest.fixture(scope="module")
def broken(scene, bounders):
    """A bounder, the same denying a part of the object, and a short run with each."""
    shown = {"kdop": bounders["kdop"], "broken": denying(bounders["kdop"], [[0.3, -0.2, 0.6, 0.1]])}
    return shown, simulate(scene, {n: OfMotion(b, scene) for n, b in shown.items()}, particles=PARTICLES, steps=3)


def test_a_bounder_that_denies_a_part_of_the_object_is_found_out(broken):
    shown, runs = broken
    row = compare(runs, {name: {name: b} for name, b in shown.items()})[2]
    assert row.missed > 0
    assert not row.identical
    with pytest.raises(AssertionError, match="contacts were missed"):
        runs["broken"].test_final(runs["none"])


def test_what_certainly_is_in_a_porous_bunny_needs_no_narrow_phase(scene, bounders, inner):
    outer, broken = bounders["voxels"], denying(inner, [[0.3, -0.7, 1.5, 0.5]])  # calls free space inside
    broad = {"voxels": OfMotion(outer, scene), "sided": OfSides(outer, inner, scene)}
    broad["broken"] = OfSides(outer, broken, scene)
    runs = simulate(scene, broad, porous=True, particles=PARTICLES, steps=STEPS)
    reference = runs["none"]
    for name in ("voxels", "sided"):
        runs[name].test_final(reference)
        assert (np.stack(runs[name].touched) == np.stack(reference.touched)).all()
    assert 0 < sum(runs["sided"].calls) < sum(runs["voxels"].calls) < sum(reference.calls)
    with pytest.raises(AssertionError, match=r"contacts were missed|the final states differ"):
        runs["broken"].test_final(reference)
    with pytest.raises(wb.BoundingError, match="of a porous mesh only"):
        Example(scene, broad["sided"], particles=10)


def test_the_margin_covers_the_contact_distance_and_its_rounding(scene):
    assert RADIUS < scene.margin < RADIUS * 1.001
    assert RADIUS - scene.core.margin == pytest.approx(scene.margin - RADIUS)
    assert all(0.0 < scene.time(step) < PERIOD for step in range(1000))


def test_the_sign_agrees_with_the_shape_and_no_point_is_deeper_than_containment_looks(scene):
    """No particle outside the dilated object is ever pushed, and all of the object is within reach of its surface."""
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
        touched, held = example.contacts.numpy().astype(bool), scene.shape.contains(x)
        deep = scene.motion.contains(x)
        assert deep.any()
        assert not (touched & ~held).any()
        assert touched[deep].all()


def test_nothing_to_simulate_is_refused(tmp_path):
    for option in ("particles", "steps"):
        with pytest.raises(wb.BoundingError, match="at least 1"):
            run(tmp_path, **{option: 0})
    with pytest.raises(wb.DeviceError, match="no such device"):
        Scene.bunny("cuda:99")
