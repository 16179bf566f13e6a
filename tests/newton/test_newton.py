"""Newton's particle-shape pass with and without the cull: the same contacts, to the last bit; misfits are refused."""

import os
import warnings

import numpy as np
import pytest
import warp as wp

import warp_bounding as wb

newton = pytest.importorskip("newton", reason="Newton is not installed: pip install '.[newton]'")

import warp.examples  # noqa: E402

from warp_bounding.newton import Cull, margin_for, sieve  # noqa: E402
from warp_bounding.newton.kernels import runs_of  # noqa: E402

RADIUS, GAP, RECORDS = 0.02, 0.03, ("particle", "shape", "body_pos", "body_vel", "normal", "indices", "barycentric")


@pytest.fixture(scope="module")
def bunny() -> wb.shapes.Mesh:
    return wb.load_shape(os.path.join(warp.examples.get_asset_directory(), "bunny.usd"))


def scene(bunny, *, moving=False, particles=1500):
    """Bunnies that are turned, scaled and (some) carried by bodies, a ground plane and a box, and particles."""
    rng = np.random.default_rng(0)
    builder = newton.ModelBuilder(up_axis=newton.Axis.Y)
    builder.default_shape_cfg.has_shape_collision = (
        False  # rigid contacts compile for long, and no cull here touches them
    )
    mesh = newton.Mesh(bunny.vertices, bunny.faces.reshape(-1))
    shapes = []
    for i in range(2):
        for k in range(3):
            turn = wp.quat_from_axis_angle(wp.normalize(wp.vec3(1.0, 2.0, float(i))), 0.7 * k)
            place = wp.transform(wp.vec3(2.0 * i, 0.0, 2.0 * k), turn)
            body = builder.add_body(xform=place, mass=1.0) if moving and k == 1 else -1
            local = wp.transform(wp.vec3(0.1, 0.0, 0.0), wp.quat_identity()) if body >= 0 else place
            scale = wp.vec3(1.0, 1.0 + 0.2 * k, 0.8)
            shapes.append(builder.add_shape_mesh(body=body, mesh=mesh, xform=local, scale=scale))
    builder.add_ground_plane()
    place = wp.transform(wp.vec3(1.0, 0.5, 1.0), wp.quat_identity())
    builder.add_shape_box(body=-1, xform=place, hx=0.2, hy=0.2, hz=0.2)
    x, sizes = rng.uniform([-1.5, -0.5, -1.5], [3.5, 2.0, 5.5], (particles, 3)), rng.uniform(0.5, 1.0, particles)
    builder.add_particles(x.tolist(), [[0.0] * 3] * particles, [0.01] * particles, (RADIUS * sizes).tolist())
    return builder.finalize(device="cpu"), mesh, shapes


def bounder_of(bunny, mesh, pipeline, extra=1.0) -> wb.Bounder:
    margin = extra * margin_for(mesh, RADIUS + pipeline.soft_contact_gap, scale=0.8, world=10.0)
    return wb.fit(bunny, method="voxels", margin=margin, resolution=48, device="cpu")


def records(contacts) -> list[np.ndarray]:
    """Contacts in their order; on CUDA, where that is by chance, in one of their own."""
    count = int(contacts.soft_contact_count.numpy()[0])
    arrays = [getattr(contacts, f"soft_contact_{name}", None) for name in RECORDS]
    rows = [array.numpy()[:count].copy() for array in arrays if array is not None]
    by_chance = contacts.soft_contact_count.device.is_cuda or sieve.in_lists(wp.get_device("cpu"))
    order = np.lexsort((rows[1], rows[0])) if by_chance else np.arange(count)
    return [row[order] for row in rows]


def contacts_of(collide, pipeline, state=None) -> list[np.ndarray]:
    contacts = pipeline.contacts()
    collide(pipeline.model.state() if state is None else state, contacts)
    return records(contacts)


def same(a: list[np.ndarray], b: list[np.ndarray], numbers: bool = True) -> bool:
    return len(a) == len(b) and all(np.array_equal(x, y, equal_nan=not numbers) for x, y in zip(a, b, strict=True))


def check(pipeline, cull, state=None, least: int = 1, numbers: bool = True) -> list[np.ndarray]:
    """The contacts, which are those of the whole pass; unless all are numbers, NaN at the same places, too."""
    found = contacts_of(pipeline.collide, pipeline, state)
    assert same(found, contacts_of(cull.collide, pipeline, state), numbers)
    assert len(found[0]) >= least
    return found


@pytest.mark.parametrize("moving", [False, True])
def test_contacts_are_the_same(bunny, moving):
    model, mesh, shapes = scene(bunny, moving=moving)
    pipeline, state = newton.CollisionPipeline(model, soft_contact_gap=0.01), model.state()
    cull = Cull(pipeline, dict.fromkeys(shapes, bounder_of(bunny, mesh, pipeline)))
    rng = np.random.default_rng(1)
    for _ in range(3):
        check(pipeline, cull, state, 100)
        assert cull.survivors < 0.75 * cull.pairs
        x = state.particle_q.numpy()
        state.particle_q.assign(x + np.float32(0.1 * rng.normal(size=x.shape)))
        if model.body_count:
            place = state.body_q.numpy()
            place[:, :3] += rng.normal(size=(len(place), 3)) * 0.2
            state.body_q.assign(place)


@pytest.mark.parametrize("dilated", [0.0, 0.03])
def test_one_bounder_of_distances_serves_every_gap_radius_and_scale(bunny, dilated):
    """The same contacts at gaps and radii that it was never told, and far from the origin."""
    model, _, shapes = scene(bunny, moving=True)
    pipeline, state, survivors = newton.CollisionPipeline(model, soft_contact_gap=0.01), model.state(), []
    far = wb.fit(bunny, "distance", "bvh", leaves=64, margin=dilated, device="cpu")
    cull = Cull(pipeline, dict.fromkeys(shapes, far))
    changed = model.particle_radius, state.particle_q, model.shape_transform
    radius, *places = [array.numpy() for array in changed]
    for gap, size, away in ((0.0, 1.0, 0.0), (0.01, 1.0, 0.0), (0.2, 1.0, 0.0), (0.05, 20.0, 0.0), (0.01, 1.0, 3000.0)):
        model.particle_radius.assign(size * radius)
        for array, place in zip(changed[1:], places, strict=True):
            array.assign(place + np.float32([away, *[0.0] * (place.shape[1] - 1)]))
        pipeline.soft_contact_gap = gap
        check(pipeline, cull, state, 10)
        survivors.append(cull.survivors)
    assert survivors[0] <= survivors[1] < survivors[2] < survivors[3] < cull.pairs > survivors[4]


@pytest.mark.parametrize("of_distances", [False, True])
def test_pairs_in_any_order(bunny, of_distances):
    """Where neighbours in the list are not neighbours in space, the same pairs survive."""
    model, mesh, shapes = scene(bunny, moving=True)
    pipeline, state = newton.CollisionPipeline(model), model.state()
    far = wb.fit(bunny, "distance", "bvh", leaves=64, device="cpu") if of_distances else None
    own = dict.fromkeys(shapes, far or bounder_of(bunny, mesh, pipeline))
    in_order = Cull(pipeline, own).candidates(state).numpy()
    pairs = pipeline.soft_rigid_contact_pairs.numpy()
    assert runs_of(pairs).mean() > 0.9
    pairs = np.random.default_rng(2).permutation(pairs)[:-7]  # not a multiple of what is looked at together
    assert not runs_of(pairs).any()
    pipeline.soft_rigid_contact_pairs = wp.array(pairs, dtype=wp.vec2i, device="cpu")
    pipeline._soft_contact_pair_count = len(pairs)
    cull = Cull(pipeline, own)
    check(pipeline, cull, state, 100)
    here = {(*pair,) for pair in cull.candidates(state).numpy().tolist()}
    assert here == {(*pair,) for pair in in_order.tolist()} & {(*pair,) for pair in pairs.tolist()}


def test_particles_that_are_larger_or_far_away_are_not_lost(bunny):
    model, mesh, shapes = scene(bunny, particles=500)
    pipeline, state = newton.CollisionPipeline(model), model.state()
    cull = Cull(pipeline, dict.fromkeys(shapes, bounder_of(bunny, mesh, pipeline)))

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


@pytest.mark.parametrize("turn", [(0.7, 0.0, 0.0, 0.7), (0.0, 0.9, 0.0, 0.5), (0.0, 1e-4, 0.0, 1.0)])
def test_rotations_that_are_not_quite_ones(bunny, turn):
    """A mesh far from its origin, turned by a quaternion of another length than 1: taken as Newton takes it."""
    far = wb.shapes.Mesh(bunny.vertices + np.float32([0.0, 0.0, 9.0]), bunny.faces)
    mesh, place = newton.Mesh(far.vertices, far.faces.reshape(-1)), wp.transform(wp.vec3(0.3, 0.2, 0.1), wp.quat(*turn))
    builder, rng = newton.ModelBuilder(up_axis=newton.Axis.Y), np.random.default_rng(0)
    shape = builder.add_shape_mesh(body=-1, mesh=mesh, xform=place)
    for x in far.vertices[rng.integers(len(far.vertices), size=3000)] + rng.normal(0, 0.1, (3000, 3)):
        builder.add_particle(wp.transform_point(place, wp.vec3(*x)), wp.vec3(0.0), 0.01, radius=RADIUS)
    pipeline = newton.CollisionPipeline(builder.finalize(device="cpu"))
    margin = margin_for(mesh, RADIUS + pipeline.soft_contact_gap, world=20.0)
    cull = Cull(pipeline, {shape: wb.fit(far, method="voxels", margin=margin, resolution=48, device="cpu")})
    check(pipeline, cull, least=100)
    assert cull.survivors < cull.pairs


def test_arrays_with_gaps_between_their_numbers(bunny):
    """Views of larger arrays: Newton reads them as they are meant, and so must the cull."""
    model, mesh, shapes = scene(bunny, particles=2000)
    pipeline, state = newton.CollisionPipeline(model), model.state()
    there = contacts_of(pipeline.collide, pipeline, state)
    for name, of in (("particle_q", state), ("particle_radius", model)):
        values = getattr(of, name).numpy()
        wide = np.stack([values, np.zeros_like(values) - 99.0], axis=1)
        setattr(of, name, wp.array(wide, dtype=getattr(of, name).dtype, device="cpu")[:, 0])
        assert not getattr(of, name).is_contiguous
    cull = Cull(pipeline, dict.fromkeys(shapes, bounder_of(bunny, mesh, pipeline)))
    assert same(there, contacts_of(cull.collide, pipeline, state))
    assert cull.survivors < cull.pairs


def test_what_does_not_fit_is_refused(bunny):
    model, mesh, shapes = scene(bunny, particles=100)
    pipeline, state = newton.CollisionPipeline(model), model.state()
    good = bounder_of(bunny, mesh, pipeline)
    larger, flat = wb.shapes.Mesh(bunny.vertices * 1.5, bunny.faces), wb.shapes.Grid(np.eye(4, dtype=bool))
    occupancy = wb.fit(bunny, method="occupancy", steps=5, margin=0.05, resolution=16, device="cpu")
    for bounders, message in (
        ([good], "mapping from indices of shapes to bounders, got list"),
        ({shapes[0]: "file"}, "expected a bounder, got str"),
        ({99: good}, "from 0 to"),
        ({len(shapes) + 1: good}, "expected a mesh"),
        ({shapes[0]: bounder_of(bunny, mesh, pipeline, extra=0.5)}, r"margin of 0\.\d+ or more, got 0\.\d+"),
        ({shapes[0]: wb.fit(larger, "distance", "aabb", device="cpu")}, "another mesh"),
        ({shapes[0]: wb.fit(flat, "distance", "aabb", device="cpu")}, "3D points or distances, got one of 2D"),
        ({shapes[0]: wb.fit(bunny, "distance", "aabb", device="cpu").freeze(0.0, None)}, "expected a proven bounder"),
        ({shapes[0]: occupancy}, "proven"),
    ):
        with pytest.raises(wb.BounderError, match=message):
            Cull(pipeline, bounders)
    Cull(pipeline, {shapes[0]: occupancy}, unproven=True)
    for wrong, message in (
        (model, "must be a newton.CollisionPipeline, got Model"),
        (newton.CollisionPipeline(model, requires_grad=True), "differentiable"),
    ):
        with pytest.raises(wb.BounderError, match=message):
            Cull(wrong, {shapes[0]: good})
    cull = Cull(pipeline, {shapes[0]: good})
    kept = cull.candidates(state)
    with pytest.raises(wb.BounderError, match=r"contact gap 0\.02, got ones for 0\.01"):
        cull.collide(state, pipeline.contacts(), candidates=kept, soft_contact_margin=0.02)
    with pytest.raises(wb.BounderError, match="at least 0 and scale not 0"):
        margin_for(mesh, -0.1, scale=1.0, world=1.0)
    assert margin_for(mesh, 0.1, scale=-2.0, world=1.0) == margin_for(mesh, 0.1, scale=2.0, world=1.0) > 0.1 / 2


# --- where no count is read back: inside a captured graph, and wherever the caller wants it ------------------------


def two_bunnies(bunny, device: str):
    """Two bunnies, one with a bounder of distances, one with its box alone, a ground plane, and a state to be moved."""
    builder, mesh = newton.ModelBuilder(up_axis=newton.Axis.Y), newton.Mesh(bunny.vertices, bunny.faces.reshape(-1))
    places = [wp.transform(wp.vec3(2.5 * i, 0.0, 0.0), wp.quat_identity()) for i in range(2)]
    first, _ = (builder.add_shape_mesh(body=-1, mesh=mesh, xform=place) for place in places)
    builder.add_ground_plane()
    x = np.random.default_rng(0).uniform([-1.5, -0.1, -1.5], [4.0, 2.0, 1.5], (3000, 3))
    builder.add_particles(x.tolist(), [[0.0] * 3] * len(x), [0.01] * len(x), [0.02] * len(x))
    pipeline = newton.CollisionPipeline(builder.finalize(device=device), soft_contact_gap=0.02)
    return pipeline, {first: wb.fit(bunny, "distance", "bvh", leaves=64, device=device)}


def test_nothing_is_read_back(bunny, device, monkeypatch):
    """Not one array is copied to the host, nothing waits for the device, and a denied pair stands for all others."""
    pipeline, bounders = two_bunnies(bunny, device)
    state, contacts = pipeline.model.state(), pipeline.contacts()
    cull = Cull(pipeline, bounders, reads_back=False)
    usual = Cull(pipeline, bounders).candidates(state).numpy()

    def refused(*_, **__):
        raise AssertionError("something was read back")

    with monkeypatch.context() as patch:
        for name in ("numpy", "list", "__getitem__", "__array__"):
            patch.setattr(wp.array, name, refused, raising=False)
        for name in ("synchronize", "synchronize_device", "synchronize_stream", "synchronize_event"):
            patch.setattr(wp, name, refused)
        kept = cull.candidates(state)
    cull.collide(state, contacts, candidates=kept)
    assert same(contacts_of(pipeline.collide, pipeline, state), records(contacts))
    assert len(kept) == cull.pairs
    pairs, left = kept.numpy(), cull.survivors
    assert len(usual) == left < 0.5 * cull.pairs
    denied = next(pair for pair in pairs if not (usual == pair).all(axis=1).any())
    left = pairs[(pairs != denied).any(axis=1)]
    if device != "cpu":  # where their order is by chance
        left, usual = (rows[np.lexsort(rows.T)] for rows in (left, usual))
        assert np.abs(state.particle_q.numpy()[denied[0]] - [2.5 * denied[1], 0.7, 0.0]).max() > 1.0  # a far one
    assert (left == usual).all()


def test_a_graph_holds_the_whole_pass(bunny, device):
    """Captured once, without a pass before it, and launched for other places: contacts are those of all pairs."""
    pipeline, bounders = two_bunnies(bunny, device)
    state, contacts = pipeline.model.state(), pipeline.contacts()
    rng, first, there = np.random.default_rng(1), state.particle_q.numpy(), []
    places = [first + rng.normal(0, 0.2, first.shape).astype(np.float32) for _ in range(3)]
    for place in places:
        state.particle_q.assign(place)
        there.append(contacts_of(pipeline.collide, pipeline, state))
    state.particle_q.assign(first)
    cull = Cull(pipeline, bounders)
    try:
        with wp.ScopedCapture(device) as capture:
            cull.collide(state, contacts)
    except (RuntimeError, TypeError) as error:
        if device != "cpu":
            raise
        pytest.skip(f"this Warp captures no graphs on a CPU: {error}")
    if capture.graph is None:
        pytest.skip("this Warp captures no graphs on a CPU")
    for place, own in zip(places, there, strict=True):
        state.particle_q.assign(place)
        wp.capture_launch(capture.graph)
        assert same(own, records(contacts))
        assert 0 < cull.survivors < 0.5 * cull.pairs
        assert cull.tally()["plane"].culled > 0
    cull.collide(state, contacts)  # and without a graph again
    assert same(there[-1], records(contacts))


@pytest.mark.parametrize(("warps", "by_place"), [(1, False), (7, True), (64, False), (2**20, False)])
def test_the_lists_of_a_gpu_are_right_on_a_cpu(bunny, monkeypatch, warps, by_place):
    """All survivors, and besides them one denied pair, are laid out, however many warps share them."""
    monkeypatch.setattr(sieve, "in_lists", lambda _: True)
    monkeypatch.setattr(sieve, "WARPS", warps)
    monkeypatch.setattr(sieve, "SORTED", 0 if by_place else 2**62)
    pipeline, bounders = two_bunnies(bunny, "cpu")
    state, one = pipeline.model.state(), next(iter(bounders))
    bounders[one + 1] = wb.fit(bunny, method="bvh", margin=0.5, leaves=16, device="cpu")
    cull, reading = (Cull(pipeline, bounders, reads_back=back, unproven=True) for back in (False, True))
    for gap in (0.02, 0.3):
        pipeline.soft_contact_gap = gap
        check(pipeline, reading)
        check(pipeline, cull)
        kept, left = cull.candidates(state).numpy(), reading.candidates(state).numpy()
        assert len(kept) == cull.pairs > cull.survivors == len(left) == len({*map(tuple, left)})
        filler = next(pair for pair in map(tuple, kept) if pair not in {*map(tuple, left)})
        assert sorted(map(tuple, left)) == sorted(pair for pair in map(tuple, kept) if pair != filler)
        in_warps = np.append(kept, np.full((-len(kept) % 32, 2), filler), axis=0).reshape(-1, 32, 2)
        most = (in_warps != filler).any(axis=2).sum(axis=1).max()
        assert most == min(32, -(-len(left) // min(warps, cull.pairs // 32)))


def pipeline_around(add, points: np.ndarray, radius: float, gap: float = GAP):
    """A model of what ``add`` puts into a builder, and of particles of a radius."""
    builder, count = newton.ModelBuilder(), len(points)
    add(builder)
    builder.add_particles(points.tolist(), [[0.0] * 3] * count, [0.01] * count, [radius] * count)
    pipeline = newton.CollisionPipeline(builder.finalize(device="cpu"), soft_contact_gap=max(gap, 0.0))
    pipeline.soft_contact_gap = gap  # the constructor refuses negative ones, the attribute does not
    return pipeline


@pytest.mark.parametrize("count", [1, 20, 33, 70])
def test_few_particles_and_none_or_all_that_stay(monkeypatch, count):
    """Lists that do not fill a warp; particles that all touch, and none that does."""
    monkeypatch.setattr(sieve, "in_lists", lambda _: True)
    for height, stays in ((0.0, count), (5.0, 0)):
        x = np.array([[0.1 * k, 0.0, height] for k in range(count)])
        pipeline = pipeline_around(lambda builder: builder.add_ground_plane(), x, 0.02)
        cull = Cull(pipeline, reads_back=False)
        check(pipeline, cull, least=stays)
        assert cull.survivors == stays


# --- numbers that nobody should use, and models that were changed ---------------------------------------------------

TILTED = wp.transform(wp.vec3(), wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), float(np.pi / 4)))


def box(size: float = 1.0, **options):
    return lambda builder: builder.add_shape_mesh(body=-1, mesh=newton.Mesh.create_box(size, size, size), **options)


def pipeline_of(add, reach: float, radius: float, gap: float, count: int = 2000):
    return pipeline_around(add, np.random.default_rng(0).uniform(-reach, reach, (count, 3)), radius, gap)


def shrunk(scale: float, margin: float):
    return box(scale=wp.vec3(scale), cfg=newton.ModelBuilder.ShapeConfig(margin=margin))


def flat(thin: float):
    return lambda b: b.add_shape_ellipsoid(body=-1, rx=1e4, ry=1e4, rz=thin, xform=TILTED)


ODD = (  # a shape, how far particles reach, their radius, and the gap
    *((shrunk(0.2, -0.02), 0.26, 0.005, 0.05), (shrunk(0.1, -0.03), 0.13, 0.01, 0.05)),  # negative numbers
    *((shrunk(2.0, 0.0), 2.6, 0.01, -0.1), (shrunk(0.1, 0.0), 0.13, -0.03, 0.05)),
    *((flat(thin), 7000.0, 0.02, 0.03) for thin in (1e-8, 0.0)),  # thin and far away
    *((box(scale=wp.vec3(scale)), 1.99e6, 0.02, 2e6) for scale in (1.0, 0.5)),  # beyond Newton's largest distance
    (box(), 1.99e6, 1.5e6, 0.01),
)


@pytest.mark.parametrize("case", range(len(ODD)))
def test_numbers_that_nobody_should_use(case):
    add, reach, radius, gap = ODD[case]
    pipeline = pipeline_of(add, reach, radius, gap, 2000 if reach < 1e5 else 1000)
    check(pipeline, Cull(pipeline))
    if radius < 0:
        far = wb.fit(newton.Mesh.create_box(1.0, 1.0, 1.0), "distance", "bvh", device="cpu")
        check(pipeline, Cull(pipeline, {0: far}))


def test_the_mesh_on_the_device_counts_and_not_the_one_of_the_host():
    mesh = newton.Mesh.create_box(1.0, 1.0, 1.0)
    pipeline = pipeline_of(lambda b: b.add_shape_mesh(body=-1, mesh=mesh), 1.3, 0.01, 0.03)
    mesh.vertices = 0.1 * mesh.vertices
    check(pipeline, Cull(pipeline))
    with pytest.raises(wb.BounderError, match="made for another mesh"):
        Cull(pipeline, {0: wb.fit(mesh, method="kdop", margin=0.1, device="cpu")})


def test_shapes_whose_mesh_or_type_is_another_later():
    pipeline = pipeline_of(lambda b: (box(0.1)(b), box()(b)), 1.3, 0.01, 0.03)
    cull, model = Cull(pipeline), pipeline.model
    model.shape_source_ptr.assign(model.shape_source_ptr.numpy()[::-1].copy())
    check(pipeline, cull)
    model.shape_type.fill_(int(newton.GeoType.SPHERE))
    check(pipeline, cull)


# --- primitive shapes, also of particles that barely touch ------------------------------------------------------------

ADDED = {  # how a builder is given each, of about unit size
    "sphere": lambda b, **k: b.add_shape_sphere(radius=0.7, **k),
    "box": lambda b, **k: b.add_shape_box(hx=0.9, hy=0.2, hz=0.5, **k),
    "capsule": lambda b, **k: b.add_shape_capsule(radius=0.3, half_height=0.6, **k),
    "cylinder": lambda b, **k: b.add_shape_cylinder(radius=0.4, half_height=0.6, **k),
    "cone": lambda b, **k: b.add_shape_cone(radius=0.5, half_height=0.6, **k),
    "ellipsoid": lambda b, **k: b.add_shape_ellipsoid(rx=0.3, ry=0.8, rz=0.5, **k),
    "plane": lambda b, **k: b.add_shape_plane(width=1.5, length=0.8, **k),
    "infinite plane": lambda b, **k: b.add_shape_plane(width=0.0, length=0.0, **k),
    "mesh": lambda b, **k: b.add_shape_mesh(mesh=newton.Mesh.create_box(0.9, 0.2, 0.5), **k),
}


def primitive(kind: str, place: wp.transform, points: np.ndarray, radius: float, *, on_body: bool = False):
    def add(builder) -> None:
        body, local = -1, place
        if on_body:
            local = wp.transform(wp.vec3(-0.4, 2.0, 0.3), wp.quat_from_axis_angle(wp.vec3(0.6, 0.0, 0.8), 1.1))
            body = builder.add_body(xform=wp.transform_multiply(place, wp.transform_inverse(local)), mass=1.0)
        ADDED[kind](
            builder,
            body=body,
            xform=local,
            cfg=newton.ModelBuilder.ShapeConfig(margin=0.004, has_shape_collision=False),
        )

    return pipeline_around(add, points, radius)


def at_the_border(pipeline, rng, center: np.ndarray, size: float, steps: int = 40) -> np.ndarray:
    """Particles that Newton's pass barely touches, or barely not: on segments inwards, bisected to the last bit."""
    state, contacts = pipeline.model.state(), pipeline.contacts()
    count = pipeline.model.particle_count
    inside = center + rng.uniform(-0.1, 0.1, (count, 3)) * size
    outside = center + rng.normal(size=(count, 3)) * 3.0 * size
    for _ in range(steps):
        middle = ((inside + outside) / 2).astype(np.float32)
        state.particle_q.assign(middle)
        pipeline.collide(state, contacts)
        hit = np.zeros(count, dtype=bool)
        hit[records(contacts)[0]] = True
        inside, outside = np.where(hit[:, None], middle, inside), np.where(hit[:, None], outside, middle)
    return np.concatenate([inside, outside]).astype(np.float32)


@pytest.mark.parametrize("kind", ADDED)
@pytest.mark.parametrize("away", [0.0, 500.0])
def test_contacts_are_the_same_to_the_last_bit(kind, away):
    rng = np.random.default_rng(len(kind))
    center = np.array([away, -0.5 * away, 0.3])
    turn = wp.normalize(wp.quat(*rng.normal(size=4)))
    on_body = kind in ("box", "cylinder", "mesh")
    place = wp.transform(wp.vec3(*center), turn)
    pipeline = primitive(kind, place, np.zeros((600, 3)), 0.02, on_body=on_body)
    hard = at_the_border(pipeline, rng, center, 1.0)
    near = center + rng.normal(size=(4000, 3)) * [2.0, 1.0, 2.0]
    pipeline = primitive(kind, place, np.concatenate([hard, near]), 0.02, on_body=on_body)
    cull = Cull(pipeline)
    there = check(pipeline, cull, least=401)  # of the hard ones, those that touch
    assert cull.culled > 0.2 * (cull.pairs - len(there[0]))


def test_a_barrel_is_wider_than_its_ends():
    """A cylinder whose side is an arc, which the third number of its scale tells."""
    for barrel in (0.6, 0.61, 5.0, 2000.0):
        place = wp.transform(wp.vec3(0.3, 0.0, 0.1), wp.quat_from_axis_angle(wp.vec3(0.0, 0.6, 0.8), 0.7))
        made = []
        for points in (np.zeros((400, 3)), None):
            hard = points
            if hard is None:
                hard = at_the_border(made[0], np.random.default_rng(1), np.array([0.3, 0.0, 0.1]), 1.0)
            pipeline = primitive("cylinder", place, hard, 0.01)
            pipeline.model.shape_scale.assign(np.float32([[0.4, 0.6, barrel]]))
            # Newton's own box does not know of the change; it is wide enough for every barrel here.
            pipeline.model.shape_gap.fill_(1.0)
            made.append(pipeline)
        check(made[1], Cull(made[1]), least=400)


@pytest.mark.parametrize("kind", ADDED)
def test_numbers_that_are_none_stay(kind):
    """Where a particle or a scale is not finite, or nearly not, nothing is denied that Newton's pass would take."""
    bad, points = [float("nan"), float("inf"), 1e38, -1e38], np.zeros((256, 3), np.float32)
    for k, number in enumerate(bad):
        points[64 * k : 64 * k + 64 : 3, 2] = points[64 * k + 1 : 64 * k + 64 : 3, 0] = number
    pipeline = primitive(kind, wp.transform_identity(), points, 0.02)
    state, cull = pipeline.model.state(), Cull(pipeline)
    check(pipeline, cull, state, 0, numbers=False)
    state.particle_q.zero_()
    for number in bad:
        pipeline.model.shape_scale.fill_(number)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            check(pipeline, cull, state, 0, numbers=False)


def test_height_fields_say_once_that_they_have_no_test():
    field = newton.Heightfield(np.zeros((4, 4), np.float32), nrow=4, ncol=4, hx=1.0, hy=1.0)
    add = lambda builder: (builder.add_shape_heightfield(heightfield=field), builder.add_ground_plane())  # noqa: E731
    pipeline = pipeline_around(add, np.full((20, 3), [0.0, 0.0, 1.0]), 0.02)
    with pytest.warns(wb.BoundingWarning, match=r"keep all their pairs, having no test: hfield \(1\)"):
        cull = Cull(pipeline)
    cull.candidates(pipeline.model.state())
    tally = cull.tally()
    assert (tally["hfield"].culled, tally["plane"].culled) == (0, 20)
    assert str(tally["plane"]) == "20 of 20 (100.0 %)"
    Cull(pipeline, untested=[0])  # says nothing: it was requested
    far = primitive("mesh", wp.transform_identity(), np.full((50, 3), 9.0), 0.02)
    for untested, pairs in (((), 0), ([0], 50)):
        assert len(Cull(far, untested=untested).candidates(far.model.state())) == pairs
    with pytest.raises(wb.BounderError, match="shape must be a whole number from 0 to 0, got"):
        Cull(far, untested=[1])
