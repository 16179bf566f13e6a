"""The rain: a proven bounder changes no bit of it, a broken one is found out."""

import numpy as np
import pytest
import warp as wp
from bounding_shapes import denying

import warp_bounding as wb
from sims.particles.broad import MovingBox, OfMotion, OfSides
from sims.particles.demo import MOVING_BOX, simulate
from sims.particles.example import CONTACT, CONTAINMENT, Example
from sims.particles.kernels import collide
from sims.particles.scene import Scene
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
