"""Newton's passes over whole soft faces and edges with and without the cull: the same contacts, to the last bit."""

import numpy as np
import pytest
import trimesh
import warp as wp

import warp_bounding as wb

newton = pytest.importorskip("newton", reason="Newton is not installed: pip install '.[newton]'")

from warp_bounding.newton import Cull, sieve  # noqa: E402

RADIUS, GAP = 0.01, 0.02
RECORDS = ("particle", "shape", "body_pos", "body_vel", "normal", "indices", "barycentric", "rigid_indices")


@pytest.fixture(scope="module")
def mesh() -> wb.shapes.Mesh:
    """A ring. Points in its hole are outside."""
    solid = trimesh.creation.torus(0.4, 0.15, major_sections=24, minor_sections=12)
    return wb.shapes.Mesh(solid.vertices, solid.faces, name="ring")


@pytest.fixture(scope="module")
def far(mesh) -> wb.Bounder:
    return wb.fit(mesh, "distance", "bvh", leaves=64, device="cpu")


def rings(mesh: wb.shapes.Mesh, scale=(1.0, 1.0, 1.0), *, moving: bool = True):
    """A builder with rings on the ground and on bodies, a box, and their indices."""
    builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
    builder.default_shape_cfg.has_shape_collision = (
        False  # rigid contacts compile for long, and no cull here touches them
    )
    given, shapes = newton.Mesh(mesh.vertices, mesh.faces.reshape(-1)), []
    for k in range(4):
        turn = wp.quat_from_axis_angle(wp.normalize(wp.vec3(1.0, float(k), 0.5)), 0.8 * k)
        place = wp.transform(wp.vec3(1.1 * (k % 2), 1.1 * (k // 2), 0.3), turn)
        body = builder.add_body(xform=place, mass=1.0) if moving and k % 2 else -1
        local = wp.transform(wp.vec3(0.05, 0.0, 0.0), wp.quat_identity()) if body >= 0 else place
        shapes.append(builder.add_shape_mesh(body=body, mesh=given, xform=local, scale=wp.vec3(*scale)))
    builder.add_shape_box(
        body=-1, xform=wp.transform(wp.vec3(0.5, 0.5, 0.2), wp.quat_identity()), hx=0.1, hy=0.1, hz=0.1
    )
    builder.add_ground_plane()
    return builder, shapes


def soft(builder, side: int = 20) -> newton.Model:
    """A cloth that cuts the rings, a soft cube that touches one, and an edge without a face."""
    cell = 2.4 / side
    builder.add_cloth_grid(
        pos=wp.vec3(-0.6, -0.6, 0.35), rot=wp.quat_identity(), vel=wp.vec3(0.0), dim_x=side, dim_y=side, cell_x=cell,
        cell_y=cell, mass=0.01, particle_radius=RADIUS,
    )  # fmt: skip
    builder.add_soft_grid(
        pos=wp.vec3(0.2, -0.1, 0.3), rot=wp.quat_identity(), vel=wp.vec3(0.0), dim_x=2, dim_y=2, dim_z=2, cell_x=0.1,
        cell_y=0.1, cell_z=0.1, density=100.0, k_mu=1e3, k_lambda=1e3, k_damp=0.0, particle_radius=RADIUS,
    )  # fmt: skip
    ends = [builder.add_particle(wp.vec3(*x), wp.vec3(0.0), 0.01, RADIUS) for x in ((1.1, 1.1, 0.5), (1.6, 1.2, 0.2))]
    builder.add_edge(-1, -1, *ends)
    return builder.finalize(device="cpu")


def pipeline_of(model: newton.Model, gap: float = GAP, *, primitives: bool = False) -> newton.CollisionPipeline:
    """A pipeline; its passes over soft faces and ``primitives``, which no cull touches, compile for long."""
    pipeline = newton.CollisionPipeline(model, soft_contact_gap=gap, enable_rigid_soft_full_surface_contact=True)
    if not primitives:
        pipeline.soft_edge_rigid_pairs = pipeline.soft_face_rigid_pairs = wp.empty(0, dtype=wp.vec2i, device="cpu")
    return pipeline


def records(collide, pipeline, state) -> list[np.ndarray]:
    """Contacts in their order."""
    contacts = pipeline.contacts()
    collide(state, contacts)
    count = int(contacts.soft_contact_count.numpy()[0])
    rows = [getattr(contacts, f"soft_contact_{name}").numpy()[:count].copy() for name in RECORDS]
    return [*rows, contacts._soft_contact_mesh_features.numpy()[:count].copy()]


def check(pipeline, cull, state, least: int = 1, ordered=lambda rows: rows) -> list[np.ndarray]:
    """The contacts, which are those of the whole pass."""
    found = ordered(records(pipeline.collide, pipeline, state))
    for own, other in zip(found, ordered(records(cull.collide, pipeline, state)), strict=True):
        assert np.array_equal(own, other, equal_nan=True)
    assert len(found[0]) >= least
    return found


def shake(state, rng, size: float) -> None:
    for array in (state.particle_q, state.body_q):
        values = array.numpy()
        values[:, :3] += rng.normal(size=(len(values), 3)) * size
        array.assign(values)


@pytest.mark.parametrize("bounded", [False, True])
@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.0), (0.6, 1.3, -0.9)])
@pytest.mark.parametrize("lists", [False, True])
def test_contacts_are_the_same(mesh, far, bounded, scale, lists, monkeypatch):
    monkeypatch.setattr(sieve, "in_lists", lambda _: lists)
    builder, shapes = rings(mesh, scale)
    pipeline = pipeline_of(soft(builder))
    state, rng = pipeline.model.state(), np.random.default_rng(0)
    cull = Cull(pipeline, dict.fromkeys(shapes, far) if bounded else None, reads_back=not lists)
    ordered = by_themselves if lists else lambda rows: rows  # pairs of lists come in another order
    kinds = np.zeros(4, int)
    for _ in range(3):
        found = check(pipeline, cull, state, 100, ordered)
        kinds += np.bincount(found[-1][:, 0][found[-1][:, 0] >= 0] & 7, minlength=4)
        tally = cull.tally()
        for name in ("soft faces", "corners", "edges", "faces", "mesh with a bounder" if bounded else "mesh"):
            assert 0 < tally[name].culled < tally[name].pairs
        shake(state, rng, 0.02)
    assert (kinds[:3] > 0).all()  # of corners, edges and faces


def by_themselves(rows: list[np.ndarray]) -> list[np.ndarray]:
    """Contacts in an order of their own."""
    keys = np.column_stack([np.asarray(row, np.float64).reshape(len(rows[0]), -1) for row in rows]).T
    order = np.lexsort(keys[::-1])
    return [row[order] for row in rows]


def test_faces_that_barely_touch(mesh, far):
    """Triangles in all sizes that are moved until they touch to the last bit, each by itself."""
    builder, shapes = rings(mesh, (1.2, 0.7, 1.0), moving=False)
    rng, count = np.random.default_rng(1), 150
    sizes = 10 ** rng.uniform(-2, 0, (count, 1, 1))
    corners = rng.normal(size=(count, 3, 3)) * 0.3 * sizes
    q = corners.reshape(-1, 3)
    for x, radius in zip(q, rng.uniform(0, 0.02, len(q)), strict=True):
        builder.add_particle(wp.vec3(*x), wp.vec3(0.0), 0.01, float(radius))
    for k in range(count):
        builder.add_triangle(3 * k, 3 * k + 1, 3 * k + 2)
        builder.add_edge(-1, 3 * k, 3 * k + 1, 3 * k + 2)
    pipeline = pipeline_of(builder.finalize(device="cpu"), 0.005)
    state = pipeline.model.state()
    cull = Cull(pipeline, dict.fromkeys(shapes, far))
    place = np.array([[1.1 * (k % 2), 1.1 * (k // 2), 0.3] for k in range(4)])[rng.integers(4, size=count)]
    inside = place + rng.normal(size=(count, 3)) * 0.05
    inside += [0.4, 0.0, 0.0]
    outside = place + rng.normal(size=(count, 3)) * 3.0
    for _ in range(30):
        middle = (inside + outside) / 2
        state.particle_q.assign((corners + middle[:, None]).reshape(-1, 3).astype(np.float32))
        found = records(pipeline.collide, pipeline, state)
        of_meshes = np.isin(found[1], shapes)
        touched = np.zeros(count, bool)
        touched[found[5][of_meshes, 0] // 3] = True
        inside = np.where(touched[:, None], middle, inside)
        outside = np.where(touched[:, None], outside, middle)
        check(pipeline, cull, state, 0)
    for moved in (inside, outside):
        state.particle_q.assign((corners + moved[:, None]).reshape(-1, 3).astype(np.float32))
        check(pipeline, cull, state, 0)


def test_numbers_that_are_none_and_other_meshes_stay(mesh, far):
    builder, shapes = rings(mesh)
    pipeline = pipeline_of(soft(builder))
    model, state = pipeline.model, pipeline.model.state()
    cull, before = Cull(pipeline, dict.fromkeys(shapes, far)), state.particle_q.numpy()
    for number in (np.nan, np.inf, 1e30):
        q = before.copy()
        q[::7, 1] = number
        state.particle_q.assign(q)
        check(pipeline, cull, state, 0)
    state.particle_q.assign(before)
    model.particle_radius.fill_(0.3)
    check(pipeline, cull, state)
    model.particle_radius.fill_(RADIUS)
    flags = model.shape_flags.numpy()
    flags[shapes[0]] &= ~int(newton.ShapeFlags.COLLIDE_PARTICLES)
    model.shape_flags.assign(flags)
    found = check(pipeline, cull, state)
    assert shapes[0] not in found[1]
    turn = model.shape_transform.numpy()
    turn[:, 3:] *= 1.3  # no rotations any more
    model.shape_transform.assign(turn)
    check(pipeline, cull, state)
    assert len(model.shape_flags) == model.shape_count  # nothing of the cull is left in the model


def test_a_mesh_with_a_hole_keeps_its_pairs(mesh, far):
    """Newton tells its inside by normals, and may find one far away."""
    hole = wb.shapes.Mesh(mesh.vertices, mesh.faces[5:], name="hole")
    builder, shapes = rings(hole)
    pipeline = pipeline_of(soft(builder))
    with pytest.warns(wb.BoundingWarning, match=r"keep all their pairs, having no test: mesh \(4\)"):
        cull = Cull(pipeline)
    check(pipeline, cull, pipeline.model.state())
    assert cull.tally()["mesh"].culled == cull.tally()["edges"].culled == 0
    with pytest.warns(wb.BoundingWarning, match="surface only"):
        own = wb.fit(hole, "distance", "aabb", device="cpu")
    with pytest.raises(wb.BounderError, match="by normals"):
        Cull(pipeline, dict.fromkeys(shapes, own))


@pytest.mark.slow  # Newton's solver compiles for two minutes
def test_a_simulation_goes_the_same_way(mesh, far):
    """A cloth falls on rings; every position of every step is the same."""
    ways = []
    for culls in (False, True):
        builder, shapes = rings(mesh, moving=False)
        builder.add_cloth_grid(
            pos=wp.vec3(-0.4, -0.4, 0.75), rot=wp.quat_identity(), vel=wp.vec3(0.0, 0.0, -1.5), dim_x=12, dim_y=12,
            cell_x=0.15, cell_y=0.15, mass=0.01, particle_radius=RADIUS, tri_ke=1e3, tri_ka=1e3, tri_kd=1e-2,
        )  # fmt: skip
        builder.color()
        model = builder.finalize(device="cpu")
        pipeline = pipeline_of(model, primitives=True)
        collide = Cull(pipeline, dict.fromkeys(shapes, far)).collide if culls else pipeline.collide
        solver = newton.solvers.SolverVBD(model, iterations=3)
        first, second, contacts, found = model.state(), model.state(), pipeline.contacts(), []
        for _ in range(25):
            collide(first, contacts)
            solver.step(first, second, model.control(), contacts, 1 / 120)
            first, second = second, first
            found.append((first.particle_q.numpy().copy(), int(contacts.soft_contact_count.numpy()[0])))
        ways.append(found)
    for (q, count), (other, same) in zip(*ways, strict=True):
        assert np.array_equal(q, other)
        assert count == same
    assert ways[0][-1][1] > 0
