"""Numbers that nobody should use, and models that were changed: whatever Newton's pass makes of them, the cull loses no contact."""

import numpy as np
import pytest
import warp as wp

import warp_bounding as wb

newton = pytest.importorskip("newton", reason="Newton is not installed: pip install '.[newton]'")

from warp_bounding.newton import ParticleCull  # noqa: E402

RECORDS = ("particle", "shape", "indices", "barycentric", "body_pos", "body_vel", "normal")
TILTED = wp.transform(wp.vec3(), wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), float(np.pi / 4)))
BOX = {"body": -1, "mesh": newton.Mesh.create_box(1.0, 1.0, 1.0)}


def with_margin(margin: float = 0.0, gap: float | None = None):
    config = newton.ModelBuilder.ShapeConfig(margin=margin)
    if gap is not None:
        config.gap = gap
    return config


def pipeline_of(add, reach: float, radius: float, gap: float, count: int = 2000):
    builder, rng = newton.ModelBuilder(), np.random.default_rng(0)
    add(builder)
    points = rng.uniform(-reach, reach, (count, 3))
    builder.add_particles(points.tolist(), [[0.0] * 3] * count, [0.01] * count, [radius] * count)
    return newton.CollisionPipeline(builder.finalize(device="cpu"), soft_contact_gap=gap)


def touching(collide, pipeline) -> list[np.ndarray]:
    contacts = pipeline.contacts()
    collide(pipeline.model.state(), contacts)
    count = int(contacts.soft_contact_count.numpy()[0])
    arrays = [getattr(contacts, f"soft_contact_{name}", None) for name in RECORDS]
    return [array.numpy()[:count].copy() for array in arrays if array is not None]


def assert_none_is_lost(pipeline, cull) -> None:
    expected, found = touching(pipeline.collide, pipeline), touching(cull.collide, pipeline)
    assert len(expected[0]) > 0
    for one, other in zip(expected, found, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("scale", "margin", "gap", "radius"),
    [(0.2, -0.02, 0.05, 0.005), (0.1, -0.03, 0.05, 0.01), (2.0, 0.0, -0.1, 0.01), (0.1, 0.0, 0.05, -0.03)],
)
def test_a_mesh_with_negative_margin_gap_or_radius(scale, margin, gap, radius):
    def add(builder):
        builder.add_shape_mesh(scale=wp.vec3(scale), cfg=with_margin(margin), **BOX)

    pipeline = pipeline_of(add, 1.3 * scale, radius, max(gap, 0.0))
    pipeline.soft_contact_gap = gap  # the constructor refuses negative ones, the attribute does not
    assert_none_is_lost(pipeline, ParticleCull(pipeline))


def test_a_distance_and_a_negative_radius():
    mesh = BOX["mesh"]
    pipeline = pipeline_of(lambda b: b.add_shape_mesh(scale=wp.vec3(0.1), **BOX), 0.13, -0.03, 0.05)
    far = wb.fit(mesh, "distance", "bvh", device="cpu")
    assert_none_is_lost(pipeline, ParticleCull(pipeline, {0: far}))


@pytest.mark.parametrize("thin", [1e-8, 0.0])
def test_a_thin_ellipsoid_far_away(thin):
    def add(builder):
        builder.add_shape_ellipsoid(body=-1, rx=1e4, ry=1e4, rz=thin, xform=TILTED)

    pipeline = pipeline_of(add, 7000.0, 0.02, 0.03)
    assert_none_is_lost(pipeline, ParticleCull(pipeline))


@pytest.mark.parametrize(("gap", "radius", "scale"), [(2e6, 0.02, 1.0), (2e6, 0.02, 0.5), (0.01, 1.5e6, 1.0)])
def test_a_mesh_and_reaches_beyond_newtons_largest_distance(gap, radius, scale):
    pipeline = pipeline_of(lambda b: b.add_shape_mesh(scale=wp.vec3(scale), **BOX), 1.99e6, radius, gap, 1000)
    assert_none_is_lost(pipeline, ParticleCull(pipeline))


def test_the_mesh_on_the_device_counts_and_not_the_one_of_the_host():
    mesh = newton.Mesh.create_box(1.0, 1.0, 1.0)
    pipeline = pipeline_of(lambda b: b.add_shape_mesh(body=-1, mesh=mesh), 1.3, 0.01, 0.03)
    mesh.vertices = 0.1 * mesh.vertices
    assert_none_is_lost(pipeline, ParticleCull(pipeline))
    changed = wb.fit(mesh, method="kdop", margin=0.1, device="cpu")
    with pytest.raises(wb.BounderError, match="made for another mesh"):
        ParticleCull(pipeline, {0: changed})


def test_a_shape_whose_mesh_is_another_later():
    def add(builder):
        builder.add_shape_mesh(body=-1, mesh=newton.Mesh.create_box(0.1, 0.1, 0.1))
        builder.add_shape_mesh(body=-1, mesh=newton.Mesh.create_box(1.0, 1.0, 1.0))

    pipeline = pipeline_of(add, 1.3, 0.01, 0.03)
    cull, model = ParticleCull(pipeline), pipeline.model
    ids = model.shape_source_ptr.numpy()
    model.shape_source_ptr.assign(ids[::-1].copy())
    assert_none_is_lost(pipeline, cull)


def test_a_shape_whose_type_is_another_later():
    pipeline = pipeline_of(
        lambda b: b.add_shape_mesh(body=-1, mesh=newton.Mesh.create_box(0.1, 0.1, 0.1)), 1.3, 0.01, 0.03
    )
    cull = ParticleCull(pipeline)
    pipeline.model.shape_type.fill_(int(newton.GeoType.SPHERE))
    assert_none_is_lost(pipeline, cull)
