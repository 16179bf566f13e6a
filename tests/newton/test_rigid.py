"""Newton's rigid contacts of meshes with and without the cull of pairs: the same records; misfits are refused."""

import numpy as np
import pytest
import trimesh
import warp as wp

import warp_bounding as wb

newton = pytest.importorskip("newton", reason="Newton is not installed: pip install '.[newton]'")

from warp_bounding.newton import Cull  # noqa: E402
from warp_bounding.pairs import Balls  # noqa: E402

RECORDS = ("shape0", "shape1", "point0", "point1", "normal", "margin0", "margin1")


@pytest.fixture(scope="module")
def mesh() -> wb.shapes.Mesh:
    """An L of two boxes in one surface."""
    corners = np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]]) * 0.3
    solid = trimesh.creation.extrude_triangulation(corners, [[0, k, k + 1] for k in range(1, 5)], 0.3)
    return wb.shapes.Mesh(solid.vertices, solid.faces, name="L")


@pytest.fixture(scope="module")
def own(mesh):
    far = wb.fit(mesh, "distance", "distance-grid", nodes=10, budget=60, device="cpu")
    return far, Balls.of(mesh, 64)


def scene(mesh, count: int, scale=(1.0, 1.0, 1.0), spread: float = 1.2, margin: float = 0.0, gap: float = 0.01):
    """Bodies with an L each, at random, a box, and a ground."""
    rng = np.random.default_rng(4)
    builder = newton.ModelBuilder()
    given = newton.Mesh(mesh.vertices, mesh.faces.reshape(-1))
    config = newton.ModelBuilder.ShapeConfig(margin=margin, gap=gap)
    shapes = []
    for _ in range(count):
        turn = rng.normal(size=4)
        place = wp.transform(wp.vec3(*(rng.normal(size=3) * spread)), wp.quat(*(turn / np.linalg.norm(turn))))
        body = builder.add_body(xform=place, mass=1.0)
        local = wp.transform(wp.vec3(*(rng.normal(size=3) * 0.1)), wp.quat_identity())
        shapes.append(builder.add_shape_mesh(body=body, mesh=given, xform=local, scale=wp.vec3(*scale), cfg=config))
    builder.add_shape_box(body=builder.add_body(mass=1.0), hx=0.3, hy=0.3, hz=0.3, cfg=config)
    builder.add_ground_plane()
    return builder.finalize(device="cpu"), shapes


def culled(pipeline, own: dict[int, tuple]) -> Cull:
    """A cull with bounders and balls of shapes."""
    far, balls = ({shape: pair[k] for shape, pair in own.items() if pair[k] is not None} for k in (0, 1))
    return Cull(pipeline, far, balls=balls)


def contacts_of(pipeline, state, cull: Cull | None = None) -> list[np.ndarray]:
    contacts = pipeline.contacts()
    (cull or pipeline).collide(state, contacts)
    count = int(contacts.rigid_contact_count.numpy()[0])
    rows = [getattr(contacts, f"rigid_contact_{name}").numpy()[:count].copy() for name in RECORDS]
    if pipeline.deterministic:
        return rows
    # Contacts of a pair are reduced in a table, and places in it depend on how many pairs there are.
    keys = np.column_stack([np.asarray(row, np.float64).reshape(count, -1) for row in rows]).T
    order = np.lexsort(keys[::-1])
    return [row[order] for row in rows]


@pytest.mark.parametrize("phase", ["nxn", "sap", "explicit"])
@pytest.mark.parametrize("scale", [(1, 1, 1), (1.5, 1.5, 1.5), (-1, 1, 1), (1.0, 1.3, 0.8)])
def test_contacts_are_the_same(mesh, own, phase, scale):
    if phase != "nxn" and scale != (1, 1, 1):
        pytest.skip("one phase is asked with all scales")
    model, shapes = scene(mesh, 24, scale)
    pipeline, state, rng = newton.CollisionPipeline(model, broad_phase=phase), model.state(), np.random.default_rng(0)
    whole = newton.CollisionPipeline(model, broad_phase=phase)
    cull = culled(pipeline, dict.fromkeys(shapes, own))
    gone = made = 0
    for _ in range(4):
        expected, found = contacts_of(whole, state), contacts_of(pipeline, state, cull)
        assert all(np.array_equal(a, b) for a, b in zip(expected, found, strict=True))
        gone, made = gone + cull.tally()["pairs of meshes"].culled, made + len(expected[0])
        place = state.body_q.numpy()
        place[:, :3] += rng.normal(size=(len(place), 3)) * 0.2
        state.body_q.assign(place)
    assert made
    assert gone == 0 if scale == (1.0, 1.3, 0.8) else gone > 0


def test_margins_and_gaps_are_read_in_each_pass(mesh, own):
    model, shapes = scene(mesh, 24, margin=0.02, gap=0.05)
    pipeline, whole = (newton.CollisionPipeline(model, deterministic=True) for _ in range(2))
    cull = culled(pipeline, dict.fromkeys(shapes, own))
    for size in (0.0, 0.3):
        model.shape_gap.fill_(size)
        expected, found = contacts_of(whole, model.state()), contacts_of(pipeline, model.state(), cull)
        assert all(np.array_equal(a, b) for a, b in zip(expected, found, strict=True))


def test_one_side_may_have_the_bounder_and_the_other_the_balls(mesh, own):
    model, shapes = scene(mesh, 2, spread=0.0)
    place = model.state()
    q = place.body_q.numpy()
    q[1, :3] = q[0, :3] + [0.75, 0.75, 0.0]
    place.body_q.assign(q)
    for first, second in ((0, 1), (1, 0)):
        pipeline = newton.CollisionPipeline(model)
        cull = culled(pipeline, {shapes[first]: (own[0], None), shapes[second]: (None, own[1])})
        expected, found = contacts_of(newton.CollisionPipeline(model), place), contacts_of(pipeline, place, cull)
        assert all(np.array_equal(a, b) for a, b in zip(expected, found, strict=True))
        assert cull.tally()["pairs of meshes"].pairs
    pipeline = newton.CollisionPipeline(model)
    cull = Cull(pipeline, balls={shapes[0]: own[1]})  # and no bounder
    contacts_of(pipeline, place, cull)
    assert cull.tally()["pairs of meshes"].culled == 0


def test_what_does_not_fit_is_refused(mesh, own):
    model, shapes = scene(mesh, 2)
    pipeline, (far, balls) = newton.CollisionPipeline(model), own
    other = wb.shapes.Mesh(mesh.vertices * np.float32(2), mesh.faces, name="other")
    first, box = shapes[0], model.shape_count - 1
    cases = {
        "whole number": (far, {99: balls}),
        "expected a mesh": (far, {box: balls}),
        "expected balls": (far, {first: far}),
        "hold another mesh": (far, {first: Balls.of(other, 8)}),
        "another mesh, other": (wb.fit(other, "distance", "aabb", device="cpu"), {first: balls}),
        "proven": (far.to().freeze(far.threshold, None), {first: balls}),
        "mapping from indices of shapes to balls, got Balls": (far, balls),
    }
    for message, (bounder, held) in cases.items():
        with pytest.raises(wb.BounderError, match=message):
            Cull(pipeline, {first: bounder}, balls=held)


def test_a_mesh_whose_inside_newton_tells_by_normals_is_refused(mesh):
    """Inside out, and with a face without area: Newton finds contacts of bodies that are apart."""
    faces = np.concatenate([mesh.faces[:, ::-1], [[0, 1, 1]]])
    other = wb.shapes.Mesh(mesh.vertices, faces, name="inside out")
    assert other.watertight
    model, shapes = scene(other, 2)
    pair = wb.fit(other, "distance", "aabb", device="cpu"), Balls.of(other, 8)
    with pytest.raises(wb.BounderError, match="normals"):
        culled(newton.CollisionPipeline(model), {shapes[0]: pair})
