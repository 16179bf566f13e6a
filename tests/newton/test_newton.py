"""Newton's particle-shape pass with and without the cull: the same contacts, record by record; bounders that do not fit are refused."""

import os

import numpy as np
import pytest
import warp as wp

import warp_bounding as wb

newton = pytest.importorskip("newton", reason="Newton is not installed: pip install '.[newton]'")

import warp.examples  # noqa: E402

from warp_bounding.newton import ParticleCull, kernels, margin_for  # noqa: E402
from warp_bounding.newton.kernels import runs_of  # noqa: E402

RADIUS, RECORDS = 0.02, ("particle", "shape", "body_pos", "body_vel", "normal")


@pytest.fixture(scope="module")
def bunny() -> wb.IndicatorMesh:
    return wb.load_indicator(os.path.join(warp.examples.get_asset_directory(), "bunny.usd"))


def scene(bunny, *, moving=False, particles=4000, seed=0):
    """Bunnies that are turned, scaled and (some) carried by bodies, a ground plane and a box, and particles."""
    rng = np.random.default_rng(seed)
    builder = newton.ModelBuilder(up_axis=newton.Axis.Y)
    mesh = newton.Mesh(bunny.vertices, bunny.faces.reshape(-1))
    shapes = []
    for i in range(2):
        for k in range(3):
            turn = wp.quat_from_axis_angle(wp.normalize(wp.vec3(1.0, 2.0, float(i))), 0.7 * k)
            place = wp.transform(wp.vec3(2.0 * i, 0.0, 2.0 * k), turn)
            body = builder.add_body(xform=place, mass=1.0) if moving and k == 1 else -1
            local = wp.transform(wp.vec3(0.1, 0.0, 0.0), wp.quat_identity()) if body >= 0 else place
            shapes.append(
                builder.add_shape_mesh(body=body, mesh=mesh, xform=local, scale=wp.vec3(1.0, 1.0 + 0.2 * k, 0.8))
            )
    builder.add_ground_plane()
    builder.add_shape_box(
        body=-1, xform=wp.transform(wp.vec3(1.0, 0.5, 1.0), wp.quat_identity()), hx=0.2, hy=0.2, hz=0.2
    )
    for x in rng.uniform([-1.5, -0.5, -1.5], [3.5, 2.0, 5.5], (particles, 3)):
        builder.add_particle(wp.vec3(*x), wp.vec3(0.0), 0.01, radius=float(RADIUS * rng.uniform(0.5, 1.0)))
    model = builder.finalize(device="cpu")
    return model, mesh, shapes


def bounder_of(bunny, mesh, pipeline, method="voxels", extra=1.0) -> wb.Bounder:
    reach = RADIUS + pipeline.soft_contact_gap
    return wb.fit(
        bunny, method=method, margin=extra * margin_for(mesh, reach, scale=0.8, world=10.0), resolution=48, device="cpu"
    )


def records(contacts) -> list[np.ndarray]:
    count = int(contacts.soft_contact_count.numpy()[0])
    return [getattr(contacts, f"soft_contact_{name}").numpy()[:count].copy() for name in RECORDS]


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("gap", [0.01, pytest.param(0.2, marks=pytest.mark.slow)])
def test_contacts_are_the_same(bunny, moving, gap):
    model, mesh, shapes = scene(bunny, moving=moving)
    pipeline = newton.CollisionPipeline(model, soft_contact_gap=gap)
    state, contacts = model.state(), pipeline.contacts()
    pipeline.collide(state, contacts)
    there = records(contacts)
    assert len(there[0]) > 100
    cull = ParticleCull(pipeline, dict.fromkeys(shapes, bounder_of(bunny, mesh, pipeline)))
    rng = np.random.default_rng(1)
    for _ in range(3):
        cull.collide(state, contacts)
        assert all((a == b).all() for a, b in zip(there, records(contacts), strict=True))
        assert cull.survivors < 0.75 * cull.pairs
        state.particle_q.assign(
            state.particle_q.numpy() + rng.normal(size=(model.particle_count, 3)).astype(np.float32) * 0.1
        )
        if model.body_count:
            place = state.body_q.numpy()
            place[:, :3] += rng.normal(size=(len(place), 3)) * 0.2
            state.body_q.assign(place)
        pipeline.collide(state, contacts)
        there = records(contacts)


@pytest.mark.parametrize("dilated", [0.0, 0.03])
def test_one_bounder_of_distances_serves_every_gap_radius_and_scale(bunny, dilated):
    """Contacts are the same at gaps and radii that it was never told, and also of particles that are far from the origin."""
    model, _, shapes = scene(bunny, moving=True)
    pipeline = newton.CollisionPipeline(model, soft_contact_gap=0.01)
    far = wb.fit(bunny, "distance", "bvh", leaves=256, margin=dilated, device="cpu")
    cull = ParticleCull(pipeline, dict.fromkeys(shapes, far))
    state, contacts, survivors = model.state(), pipeline.contacts(), []
    for gap, size, away in ((0.0, 1.0, 0.0), (0.01, 1.0, 0.0), (0.2, 1.0, 0.0), (0.05, 20.0, 0.0), (0.01, 1.0, 3000.0)):
        changed = model.particle_radius, state.particle_q, model.shape_transform
        radius, *places = before = [array.numpy() for array in changed]
        model.particle_radius.assign(size * radius)
        for array, place in zip(changed[1:], places, strict=True):
            array.assign(place + np.float32([away, *[0.0] * (place.shape[1] - 1)]))
        pipeline.soft_contact_gap = gap
        pipeline.collide(state, contacts)
        there = records(contacts)
        cull.collide(state, contacts)
        assert all((a == b).all() for a, b in zip(there, records(contacts), strict=True))
        assert len(there[0]) > 10
        assert cull.survivors < cull.pairs
        survivors.append(cull.survivors)
        for array, values in zip(changed, before, strict=True):
            array.assign(values)
    assert survivors[0] <= survivors[1] < survivors[2] < survivors[3]


@pytest.mark.parametrize("of_distances", [False, True])
def test_pairs_in_any_order(bunny, of_distances):
    """Where neighbours in the list are not neighbours in space, pairs are looked at one by one: the same ones survive."""
    model, mesh, shapes = scene(bunny, moving=True)
    pipeline = newton.CollisionPipeline(model)
    far = wb.fit(bunny, "distance", "bvh", leaves=64, device="cpu") if of_distances else None
    own = dict.fromkeys(shapes, far or bounder_of(bunny, mesh, pipeline))
    state, contacts = model.state(), pipeline.contacts()
    in_order = ParticleCull(pipeline, own).candidates(state).numpy()
    pairs = pipeline.soft_rigid_contact_pairs.numpy()
    assert runs_of(pairs).mean() > 0.9
    pairs = np.random.default_rng(2).permutation(pairs)[:-7]  # not a multiple of what is looked at together
    assert not runs_of(pairs).any()
    pipeline.soft_rigid_contact_pairs = wp.array(pairs, dtype=wp.vec2i, device="cpu")
    pipeline.collide(state, contacts)
    there, cull = records(contacts), ParticleCull(pipeline, own)
    cull.collide(state, contacts)
    assert all((a == b).all() for a, b in zip(there, records(contacts), strict=True))
    assert len(there[0]) > 100
    here = {(*pair,) for pair in cull.candidates(state).numpy().tolist()}
    assert here == {(*pair,) for pair in in_order.tolist()} & {(*pair,) for pair in pairs.tolist()}


@pytest.mark.parametrize("method", ["mlp", "bvh", "sphere"])
def test_distances_in_lanes_are_those_one_by_one(bunny, method):
    """What a CPU does with many pairs at a time, and CUDA with one; but for the last bits of a distance."""
    options = {"mlp": {"hidden": (12, 12), "steps": 300}, "bvh": {"leaves": 64}}.get(method, {})
    model, _, shapes = scene(bunny, moving=True, particles=6000)
    pipeline = newton.CollisionPipeline(model, soft_contact_gap=0.02)
    far = wb.fit(bunny, "distance", method, margin=0.01, device="cpu", **options)
    cull, state = ParticleCull(pipeline, dict.fromkeys(shapes, far)), model.state()
    cull.candidates(state)
    lanes, keep = cull._keep.numpy().copy(), cull._keep
    keep.fill_(9)
    given = [0, kernels.block_size(cull._device), far.data, 0, 0.01, cull._shapes.bounder_of, cull._all]
    given += [
        state.particle_q,
        model.particle_radius,
        cull._placed,
        cull._hulls,
        cull._undecided,
        cull._undecided_count,
    ]
    wp.launch(kernels.ask_distances(far.source), len(cull._undecided_count), given, [keep], device="cpu")
    one = keep.numpy()
    asked = one != 9
    assert asked.sum() == cull._undecided_count.numpy().sum() > 1000
    assert 0 < lanes[asked].sum() < asked.sum()
    assert (one != lanes)[asked].mean() < 1e-3


def test_distances_that_do_not_fit_are_refused(bunny):
    model, _, shapes = scene(bunny, particles=100)
    pipeline = newton.CollisionPipeline(model)
    other = wb.fit(wb.IndicatorMesh(bunny.vertices * 1.5, bunny.faces), "distance", "aabb", device="cpu")
    with pytest.raises(wb.BounderError, match="another mesh"):
        ParticleCull(pipeline, {shapes[0]: other})
    flat = wb.fit(wb.IndicatorGrid(np.eye(4, dtype=bool)), "distance", "aabb", device="cpu")
    with pytest.raises(wb.BounderError, match="expected a bounder of 3D points or distances, got one of 2D"):
        ParticleCull(pipeline, {shapes[0]: flat})
    far = wb.fit(bunny, "distance", "aabb", device="cpu").freeze(0.0, None)
    with pytest.raises(wb.BounderError, match="expected a proven bounder"):
        ParticleCull(pipeline, {shapes[0]: far})


def test_particles_that_are_larger_or_far_away_are_not_lost(bunny):
    model, mesh, shapes = scene(bunny, particles=500)
    pipeline = newton.CollisionPipeline(model)
    cull = ParticleCull(pipeline, dict.fromkeys(shapes, bounder_of(bunny, mesh, pipeline)))
    state = model.state()

    def culled() -> int:
        cull.candidates(state)
        return cull.tally()["mesh with a bounder"].culled

    many = culled()
    assert many > 0.5 * len(shapes) * model.particle_count
    model.particle_radius.fill_(0.5)
    assert culled() == 0
    model.particle_radius.fill_(RADIUS)
    assert culled() >= 0.9 * many
    state.particle_q.assign(state.particle_q.numpy() + np.float32(1e5))
    assert culled() == 0


@pytest.mark.parametrize(
    "turn", [(0.0, 0.0, 0.0, 1.0), (0.7, 0.0, 0.0, 0.7), (0.0, 0.9, 0.0, 0.5), (0.0, 1e-4, 0.0, 1.0)]
)
def test_rotations_that_are_not_quite_ones(bunny, turn):
    """A mesh that lies far from its origin, turned by a quaternion of another length than 1: taken as Newton takes it."""
    far = wb.IndicatorMesh(bunny.vertices + np.float32([0.0, 0.0, 9.0]), bunny.faces)
    mesh = newton.Mesh(far.vertices, far.faces.reshape(-1))
    builder = newton.ModelBuilder(up_axis=newton.Axis.Y)
    shape = builder.add_shape_mesh(body=-1, mesh=mesh, xform=wp.transform(wp.vec3(0.3, 0.2, 0.1), wp.quat(*turn)))
    rng = np.random.default_rng(0)
    x = far.vertices[rng.integers(len(far.vertices), size=3000)] + rng.normal(0, 0.1, (3000, 3))
    for place in x:
        at = wp.transform_point(wp.transform(wp.vec3(0.3, 0.2, 0.1), wp.quat(*turn)), wp.vec3(*place))
        builder.add_particle(at, wp.vec3(0.0), 0.01, radius=RADIUS)
    pipeline = newton.CollisionPipeline(builder.finalize(device="cpu"))
    state, contacts = pipeline.model.state(), pipeline.contacts()
    pipeline.collide(state, contacts)
    there = records(contacts)
    margin = margin_for(mesh, RADIUS + pipeline.soft_contact_gap, world=20.0)
    cull = ParticleCull(pipeline, {shape: wb.fit(far, method="voxels", margin=margin, resolution=48, device="cpu")})
    cull.collide(state, contacts)
    assert all((a == b).all() for a, b in zip(there, records(contacts), strict=True))
    assert len(there[0]) > 100
    assert cull.survivors < cull.pairs


def test_candidates_of_another_gap_are_refused(bunny):
    model, mesh, shapes = scene(bunny, particles=200)
    pipeline = newton.CollisionPipeline(model)
    cull, state, contacts = (
        ParticleCull(pipeline, {shapes[0]: bounder_of(bunny, mesh, pipeline)}),
        model.state(),
        pipeline.contacts(),
    )
    kept = cull.candidates(state)
    cull.collide(state, contacts, candidates=kept)
    with pytest.raises(wb.BounderError, match=r"contact gap of 0\.02, got ones for 0\.01"):
        cull.collide(state, contacts, candidates=kept, soft_contact_margin=0.02)


def test_arrays_with_gaps_between_their_numbers(bunny):
    """Views of larger arrays: Newton reads them as they are meant, and so must the cull."""
    model, mesh, shapes = scene(bunny, particles=2000)
    pipeline = newton.CollisionPipeline(model)
    state, contacts = model.state(), pipeline.contacts()
    pipeline.collide(state, contacts)
    there = records(contacts)
    for name, of in (("particle_q", state), ("particle_radius", model)):
        values = getattr(of, name).numpy()
        wide = np.stack([values, np.zeros_like(values) - 99.0], axis=1)
        setattr(of, name, wp.array(wide, dtype=getattr(of, name).dtype, device="cpu")[:, 0])
        assert not getattr(of, name).is_contiguous
    cull = ParticleCull(pipeline, dict.fromkeys(shapes, bounder_of(bunny, mesh, pipeline)))
    cull.collide(state, contacts)
    here = records(contacts)
    assert len(there[0]) == len(here[0]) > 10
    assert all((a == b).all() for a, b in zip(there, here, strict=True))
    assert cull.survivors < cull.pairs


@pytest.mark.parametrize(
    ("reach", "scale", "world"), [(-0.1, 1.0, 1.0), (0.1, 0.0, 1.0), (0.1, 1.0, -1.0), (0.1, 1.0, float("nan"))]
)
def test_a_margin_of_nonsense_is_refused(bunny, reach, scale, world):
    mesh = newton.Mesh(bunny.vertices, bunny.faces.reshape(-1))
    with pytest.raises(wb.BounderError, match="at least 0 and scale not 0"):
        margin_for(mesh, reach, scale=scale, world=world)
    assert margin_for(mesh, 0.1, scale=-2.0, world=1.0) == margin_for(mesh, 0.1, scale=2.0, world=1.0) > 0.1 / 2


def test_no_pair_is_left(bunny):
    model, mesh, shapes = scene(bunny, particles=200)
    pipeline = newton.CollisionPipeline(model)
    state, contacts = model.state(), pipeline.contacts()
    state.particle_q.assign(state.particle_q.numpy() * 0.01 + np.float32([40.0, 7.0, 0.0]))
    bounder = wb.fit(
        bunny, method="voxels", margin=margin_for(mesh, 0.05, scale=0.8, world=60.0), resolution=48, device="cpu"
    )
    cull = ParticleCull(pipeline, dict.fromkeys(shapes, bounder))
    cull.collide(state, contacts)
    assert cull.survivors == 0
    assert not len(records(contacts)[0])


def test_what_does_not_fit_is_refused(bunny):
    model, mesh, shapes = scene(bunny, particles=100)
    pipeline = newton.CollisionPipeline(model)
    with pytest.raises(wb.BounderError, match=r"margin of 0\.\d+ at least, got 0\.\d+"):
        ParticleCull(pipeline, {shapes[0]: bounder_of(bunny, mesh, pipeline, extra=0.5)})
    other = wb.fit(wb.IndicatorMesh(bunny.vertices * 1.5, bunny.faces), method="aabb", margin=0.1, device="cpu")
    with pytest.raises(wb.BounderError, match="another mesh"):
        ParticleCull(pipeline, {shapes[0]: other})
    good = bounder_of(bunny, mesh, pipeline)
    for wrong, message in ((model, "must be a newton.CollisionPipeline, got Model"), (None, "got NoneType")):
        with pytest.raises(wb.BounderError, match=message):
            ParticleCull(wrong, {shapes[0]: good})
    for bounders, message in (
        ([good], "mapping from indices of shapes to bounders, got list"),
        ({shapes[0]: "file"}, "expected a bounder, got str"),
        ({"bunny": good}, "whole number from 0 to"),
    ):
        with pytest.raises(wb.BounderError, match=message):
            ParticleCull(pipeline, bounders)
    with pytest.raises(wb.BounderError, match="expected a mesh"):
        ParticleCull(pipeline, {len(shapes) + 1: good})
    with pytest.raises(wb.BounderError, match="from 0 to"):
        ParticleCull(pipeline, {99: good})
    with pytest.raises(wb.BounderError, match="differentiable"):
        ParticleCull(newton.CollisionPipeline(model, requires_grad=True), {shapes[0]: good})
    occupancy = wb.fit(bunny, method="occupancy", steps=5, margin=0.05, resolution=16, device="cpu")
    with pytest.raises(wb.BounderError, match="proven"):
        ParticleCull(pipeline, {shapes[0]: occupancy})
    ParticleCull(pipeline, {shapes[0]: occupancy}, unproven=True)


def test_full_surface_contacts_are_told_not_to_be_culled(bunny):
    model, _, _ = scene(bunny, particles=4)
    pipeline = newton.CollisionPipeline(model, enable_rigid_soft_full_surface_contact=True)
    with pytest.warns(wb.BoundingWarning, match="every edge and face") as told:
        ParticleCull(pipeline)
    assert len(told) == 1
