"""Primitive shapes and meshes without a bounder: the contacts of Newton's pass are the same, also of particles that
barely touch, and what is far is skipped."""

import warnings

import numpy as np
import pytest
import warp as wp

import warp_bounding as wb

newton = pytest.importorskip("newton", reason="Newton is not installed: pip install '.[newton]'")

from warp_bounding.newton import ParticleCull  # noqa: E402
from warp_bounding.newton.placing import PRIMITIVES  # noqa: E402

RECORDS, GAP = ("particle", "shape", "body_pos", "body_vel", "normal"), 0.03
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


def records(contacts) -> list[np.ndarray]:
    count = int(contacts.soft_contact_count.numpy()[0])
    return [getattr(contacts, f"soft_contact_{name}").numpy()[:count].copy() for name in RECORDS]


def scene(kind: str, place: wp.transform, points: np.ndarray, radius: float, *, on_body: bool = False):
    builder = newton.ModelBuilder()
    config = newton.ModelBuilder.ShapeConfig(margin=0.004)
    body, local = -1, place
    if on_body:
        carried = wp.transform(wp.vec3(-0.4, 2.0, 0.3), wp.quat_from_axis_angle(wp.vec3(0.6, 0.0, 0.8), 1.1))
        body = builder.add_body(xform=wp.transform_multiply(place, wp.transform_inverse(carried)), mass=1.0)
        local = carried
    ADDED[kind](builder, body=body, xform=local, cfg=config)
    count = len(points)
    builder.add_particles(points.tolist(), [[0.0] * 3] * count, [0.01] * count, [radius] * count)
    return newton.CollisionPipeline(builder.finalize(device="cpu"), soft_contact_gap=GAP)


def at_the_border(pipeline, rng, center: np.ndarray, size: float, steps: int = 40) -> np.ndarray:
    """Particles that Newton's pass barely touches, or barely not: on segments from far away inwards, bisected to the
    last bit."""
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
    pipeline = scene(kind, place, np.zeros((600, 3)), 0.02, on_body=on_body)
    hard = at_the_border(pipeline, rng, center, 1.0)
    near = center + rng.normal(size=(4000, 3)) * [2.0, 1.0, 2.0]
    pipeline = scene(kind, place, np.concatenate([hard, near]), 0.02, on_body=on_body)
    state, contacts = pipeline.model.state(), pipeline.contacts()
    pipeline.collide(state, contacts)
    there = records(contacts)
    cull = ParticleCull(pipeline)
    cull.collide(state, contacts)
    here = records(contacts)
    assert all((a == b).all() for a, b in zip(there, here, strict=True))
    assert len(there[0]) > 400  # of the hard ones, those that touch
    quiet = cull.pairs - len(there[0])
    assert cull.culled > 0.2 * quiet


def test_a_barrel_is_wider_than_its_ends():
    """A cylinder whose side is an arc, which the third number of its scale tells."""
    for barrel in (0.6, 0.61, 5.0, 2000.0):
        place = wp.transform(wp.vec3(0.3, 0.0, 0.1), wp.quat_from_axis_angle(wp.vec3(0.0, 0.6, 0.8), 0.7))
        made = []
        for points in (np.zeros((400, 3)), None):
            hard = points
            if hard is None:
                hard = at_the_border(made[0], np.random.default_rng(1), np.array([0.3, 0.0, 0.1]), 1.0)
            pipeline = scene("cylinder", place, hard, 0.01)
            pipeline.model.shape_scale.assign(np.float32([[0.4, 0.6, barrel]]))
            # Newton's own box does not know of the change; it is wide enough for every barrel here.
            pipeline.model.shape_gap.fill_(1.0)
            made.append(pipeline)
        pipeline = made[1]
        state, contacts = pipeline.model.state(), pipeline.contacts()
        pipeline.collide(state, contacts)
        there, cull = records(contacts), ParticleCull(pipeline)
        cull.collide(state, contacts)
        assert all((a == b).all() for a, b in zip(there, records(contacts), strict=True))
        assert len(there[0]) >= 400


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 1e38, -1e38])
def test_numbers_that_are_none_stay(bad):
    """Where a particle or a scale is not finite, or nearly not, nothing is denied that Newton's pass would take."""
    for kind in ADDED:
        points = np.zeros((64, 3), np.float32)
        points[::3, 2], points[1::3, 0] = bad, bad
        pipeline = scene(kind, wp.transform_identity(), points, 0.02)
        state, contacts = pipeline.model.state(), pipeline.contacts()
        pipeline.collide(state, contacts)
        there, cull = records(contacts), ParticleCull(pipeline)
        cull.collide(state, contacts)
        assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(there, records(contacts), strict=True))
        state.particle_q.zero_()
        pipeline.model.shape_scale.fill_(bad)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            pipeline.collide(state, contacts)
            there = records(contacts)
            cull.collide(state, contacts)
        assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(there, records(contacts), strict=True))


def test_height_fields_say_once_that_they_have_no_test():
    builder = newton.ModelBuilder()
    field = newton.Heightfield(np.zeros((4, 4), np.float32), nrow=4, ncol=4, hx=1.0, hy=1.0)
    index = builder.add_shape_heightfield(heightfield=field)
    builder.add_ground_plane()
    builder.add_particles([[0.0, 0.0, 1.0]] * 20, [[0.0] * 3] * 20, [0.01] * 20, [0.02] * 20)
    pipeline = newton.CollisionPipeline(builder.finalize(device="cpu"))
    with pytest.warns(wb.BoundingWarning, match=r"keep all their pairs, having no test: hfield \(1\)"):
        cull = ParticleCull(pipeline)
    cull.candidates(pipeline.model.state())
    tally = cull.tally()
    assert (tally["hfield"].culled, tally["plane"].culled) == (0, 20)
    assert str(tally["plane"]) == "20 of 20 (100.0 %)"
    ParticleCull(pipeline, untested=[index])  # says nothing: it was asked for


def test_untested_shapes_keep_all_their_pairs():
    pipeline = scene("mesh", wp.transform_identity(), np.full((50, 3), 9.0), 0.02)
    state = pipeline.model.state()
    assert len(ParticleCull(pipeline).candidates(state)) == 0
    assert len(ParticleCull(pipeline, untested=[0]).candidates(state)) == 50
    for wrong in (1, -1, "mesh", True):
        with pytest.raises(wb.BounderError, match="untested must be indices of shapes, from 0 to 0, got"):
            ParticleCull(pipeline, untested=[wrong])


def test_every_primitive_that_newton_has_is_tested():
    """A kind of shape that a later Newton adds shows here."""
    rest = {"NONE", "HFIELD", "MESH", "CONVEX_MESH", "SDF", "GAUSSIAN"}
    assert {kind.name for kind in newton.GeoType if int(kind) not in PRIMITIVES} <= rest
