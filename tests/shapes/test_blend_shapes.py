"""Meshes that deform with pose numbers, against the mesh at each pose."""

import numpy as np
import pytest
import trimesh

import warp_bounding as wb
from warp_bounding.errors import ShapeError
from warp_bounding.shapes.shape import IN, OUT, UNDECIDED


def blob(poses: int = 2, margin: float = 0.0, halvings: int = 2) -> wb.shapes.BlendShapes:
    """A ball that is drawn out along x, and one end of it bent upwards."""
    ball = trimesh.creation.icosphere(subdivisions=halvings)
    x, y, z = ball.vertices.T
    out, up = np.stack([x, 0 * y, 0 * z], 1), np.stack([0 * x, 0 * y, np.maximum(x, 0) ** 2], 1)
    return wb.shapes.BlendShapes(
        ball.vertices,
        [out, up][:poses],
        ball.faces,
        lower=[-0.4, -0.8][:poses],
        upper=[0.8, 0.8][:poses],
        margin=margin,
    )


def asked(shape, rng, count: int) -> np.ndarray:
    return rng.uniform(shape.sample_lower, shape.sample_upper, (count, shape.ndim))


@pytest.mark.parametrize("margin", [0.0, 0.1])
def test_truth_is_that_of_the_mesh_at_the_pose(margin, rng):
    shape = blob(margin=margin)
    for pose in ([-0.4, 0.0], [0.3, 0.7], [0.8, -0.8]):
        mesh = trimesh.Trimesh(shape.at(pose), shape.faces, process=False)
        x = asked(shape, rng, 1500)
        x[:, 3:] = pose
        _, far, _ = trimesh.proximity.closest_point(mesh, x[:, :3])
        truth = mesh.contains(x[:, :3]) | (far <= margin)
        sure = np.abs(far - margin) > 1e-9
        assert (shape.contains(x) == truth)[sure].all()
        assert 0.02 < truth.mean() < 0.9


@pytest.mark.parametrize("margin", [0.0, 0.1])
def test_the_box_holds_the_object_where_limits_are_rounded_outwards(margin, rng):
    """A limit that is no float32 number is asked about as the next one, where the mesh reaches farther."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    shape = wb.shapes.BlendShapes(ball.vertices, [ball.vertices * [1.0, 0.0, 0.0]], ball.faces, upper=[0.7])
    pose = shape.upper[3]
    assert pose > 0.7
    at = shape.at([pose])
    tip = at[at[:, 0].argmax()]
    assert tip[0] <= shape.upper[0]
    x = np.append(tip - [1e-8, 0, 0], pose)[None]
    assert (shape.decide(x) == IN).all()
    shape = shape.dilated(margin)
    size = 10.0 ** rng.uniform(-9, -1, (2000, 1))
    lower, upper = (x + sign * size * rng.random((2000, 4)) for sign in (-1, 1))
    assert not shape.empty(lower, upper).any()
    known = shape.half_spaces(lower, upper)
    assert not known.empty.any()
    assert (known.level + (known.slope * (x - known.center)).sum(axis=1) >= 0).all()


@pytest.mark.parametrize("scale", [1e-150, 1.2e-81, 1e80])
def test_half_spaces_of_tiny_and_huge_meshes_deny_nothing(scale, rng):
    """Where squares are no normal numbers any more, nothing is said."""
    box = trimesh.creation.box(extents=(2, 2, 2))
    vertices = np.concatenate([box.vertices, box.vertices + np.array([0, 0, 5])])
    faces, moved = np.concatenate([box.faces, box.faces + 8]), np.tile(box.vertices * [0.1, 0, 0], (2, 1))
    shape = wb.shapes.BlendShapes(vertices * scale, [moved * scale], faces, margin=0.2 * scale)
    with np.errstate(over="ignore", invalid="ignore"):
        x = np.column_stack([rng.uniform(-1.5, 1.5, (5000, 3)) * scale, rng.random(5000)])
        size = np.append(np.full(3, 0.3 * scale), 0.3) * rng.random((5000, 4))
        known = shape.half_spaces(x - size, x + size)
        assert (known.empty <= shape.empty(x - size, x + size)).all()
        for share in (0.0, 0.5, 1.0):
            p = x + (2 * share - 1) * size * rng.random((5000, 4))
            there = (shape.decide(p) == IN) & ~known.empty
            value = known.level + (known.slope * (p - known.center)).sum(axis=1)
            assert (value[there] >= 0).all()


def test_rays_through_corners_and_along_edges_decide_nothing_wrong():
    """A box's faces are split along a diagonal, and rays along x through its middle, its sides and its corners meet
    edges."""
    made = trimesh.creation.box()
    shape = wb.shapes.BlendShapes(made.vertices, [made.vertices * [1.0, 0, 0]], made.faces)
    y, z = np.meshgrid(np.linspace(-0.75, 0.75, 13), np.linspace(-0.75, 0.75, 13), indexing="ij")
    for x, within in ((-2.0, False), (-0.25, True), (0.75, True), (1.25, False)):
        asked = np.column_stack([np.full(y.size, x), y.ravel(), z.ravel(), np.ones(y.size)])
        inside = within & (np.abs(asked[:, 1:3]) < 0.5).all(axis=1)
        onto = (np.abs(asked[:, 1:3]) <= 0.5).all(axis=1) & ~inside if within else np.zeros(len(asked), dtype=bool)
        assert (shape.decide(asked) == np.where(onto, UNDECIDED, np.where(inside, IN, OUT))).all()
        small = 2.0**-20
        assert (shape.empty(asked - small, asked + small) == (~inside & ~onto)).all()
        kept = asked.copy()
        kept[:, 3] = 1 - small
        assert (shape.inside(kept - small, kept + small) == inside).all()


def test_a_bounder_of_one_pose_number_is_proven(tmp_path):
    shape = blob(1, halvings=0)
    bounder = wb.fit(shape, method="mlp", hidden=(8,), steps=60, device="cpu", progress=False)
    assert bounder.certificate.proven
    assert wb.evaluate(bounder, shape, samples=50_000).fn == 0
    bounder.save(tmp_path / "b.safetensors")
    again = wb.load(tmp_path / "b.safetensors", device="cpu")
    assert wb.certify(again, shape, budget=120).proven
    assert not wb.certify(again, blob(1, margin=0.2, halvings=0), budget=5).proven


def test_what_is_no_blend_is_refused_in_one_line():
    ball = trimesh.creation.icosphere(subdivisions=1)
    given = {"vertices": ball.vertices, "deltas": [ball.vertices], "faces": ball.faces}
    wrong = {"lower": [0.0, 1.0], "upper": [1e39], "margin": -1.0, "vertices": ball.vertices[:, :2]}
    faces = (ball.faces[1:], ball.faces.astype(float), ball.faces + 100)  # open, no integers, of no vertices
    deltas = ([ball.vertices[1:]], [ball.vertices * np.nan], [ball.vertices] * 6)
    for changes in (
        *({name: value} for name, value in wrong.items()),
        *({"faces": value} for value in faces),
        *({"deltas": value} for value in deltas),
        {"lower": [1.0], "upper": [1.0]},
    ):
        with pytest.raises(ShapeError) as error:
            wb.shapes.BlendShapes(**(given | changes))
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("turned", [False, True])
def test_parts_that_overlap_do_not_cancel(turned, rng):
    """Whichever way each closed part is turned, both are held where they overlap, as in a mesh."""
    one, other = trimesh.creation.box(extents=[2, 2, 2]), trimesh.creation.box(extents=[2, 2, 2])
    other.apply_translation([1, 0.25, 0.5])
    faces = np.concatenate([one.faces, (other.faces[:, ::-1] if turned else other.faces) + len(one.vertices)])
    vertices = np.concatenate([one.vertices, other.vertices])
    deltas = np.where(np.arange(len(vertices)) < len(one.vertices), 0.0, 1.0)[None, :, None] * np.array([0, 0, 0.5])
    shape = wb.shapes.BlendShapes(vertices, deltas, faces)
    x = asked(shape, rng, 3000)
    truth = (np.abs(x[:, :3]) <= 1).all(axis=1)
    truth |= (np.abs(x[:, :3] - [1, 0.25, 0.5] - x[:, 3:] * [0, 0, 0.5]) <= 1).all(axis=1)
    truth &= (x[:, 3] >= 0) & (x[:, 3] <= 1)
    assert (shape.decide(x) == np.where(truth, IN, OUT)).mean() > 0.99
    assert not (truth & (shape.decide(x) == OUT)).any()
    assert not shape.empty(x, x)[truth].any()
    mesh = wb.shapes.Mesh(shape.at([0.5]), faces)
    x[:, 3] = 0.5
    assert not (mesh.contains(x[:, :3]) & (shape.decide(x) == OUT)).any()
