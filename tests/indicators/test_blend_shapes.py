"""Meshes that deform with pose numbers, against the mesh at each pose."""

import itertools

import numpy as np
import pytest
import trimesh

import warp_bounding as wb
from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.blend_shapes import patches_of
from warp_bounding.indicators.shape import IN, OUT, UNDECIDED


def blob(poses: int = 2, margin: float = 0.0, halvings: int = 2) -> wb.IndicatorBlendShapes:
    """A ball that is drawn out along x, and one end of it bent upwards."""
    ball = trimesh.creation.icosphere(subdivisions=halvings)
    x, y, z = ball.vertices.T
    out, up = np.stack([x, 0 * y, 0 * z], 1), np.stack([0 * x, 0 * y, np.maximum(x, 0) ** 2], 1)
    return wb.IndicatorBlendShapes(
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


def test_points_on_the_surface_are_not_lost(rng):
    shape = blob()
    x = shape.landmarks()
    assert (shape.decide(x) != OUT).all()
    for own, answer in (
        (shape, UNDECIDED),
        (blob(margin=0.1), IN),
    ):  # the surface itself, and what lies deep in the dilated object
        found = own.points(500, rng)
        assert len(found) > 450
        assert (own.decide(found) == answer).mean() > 0.9
    assert not shape.contains(np.append(np.zeros(3), [0.9, 0.0])[None]).any()  # no such pose
    assert not shape.contains(np.full((1, 5), np.nan)).any()
    assert shape.contains(np.append(np.zeros(3), shape.upper[3:])[None]).all()


@pytest.mark.parametrize("margin", [0.0, 0.1])
def test_boxes_are_empty_and_full_where_it_is_said(margin, rng):
    shape = blob(margin=margin)
    lower = asked(shape, rng, 20_000)
    upper = lower + rng.uniform(0, 0.3, lower.shape) * rng.choice([0.1, 1.0], (len(lower), 1))
    empty, inside = shape.empty(lower, upper), shape.inside(lower, upper)
    assert 0.2 < empty.mean() < 0.9
    assert inside.mean() > 0.001
    assert not (empty & inside).any()
    for _ in range(40):
        share = rng.random(lower.shape)
        share = np.where(rng.random(lower.shape) < 0.5, np.round(share), share)
        truth = shape.contains(lower + share * (upper - lower))
        assert not (empty & truth).any()
        within = lower + share * (upper - lower) <= shape.upper
        assert (truth | ~within.all(axis=1))[inside].all()
    assert not shape.empty(upper, lower).any()
    assert not shape.empty(np.full((1, 5), np.nan), np.zeros((1, 5))).any()
    beyond = shape.upper + 1
    assert shape.empty(beyond[None], beyond[None] + 1).all()


@pytest.mark.parametrize("margin", [0.0, 0.1])
@pytest.mark.parametrize(("poses", "halvings"), [(1, 0), (2, 0), (2, 2)])
def test_half_spaces_hold_the_object_in_their_boxes(poses, halvings, margin, rng):
    shape = blob(poses, margin, halvings)
    border = blob(poses, 0.0, halvings).points(4000, rng)
    size = 10.0 ** rng.uniform(-3, -0.3, (len(border), 1))
    lower, upper = border - size * rng.random(border.shape), border + size * rng.random(border.shape)
    known = shape.half_spaces(lower, upper)
    assert (known.empty == shape.empty(lower, upper)).all()
    assert not known.empty.any()
    found = known.slope.any(axis=1)
    assert found.mean() > 0.1
    cut = held = 0
    for turn in range(20):
        share = rng.random(lower.shape)
        x = lower + np.where(rng.random(lower.shape) < 0.3, np.round(share), share) * (upper - lower)
        x = border if turn == 0 else x.clip(lower, upper)
        value, there = known.level + (known.slope * (x - known.center)).sum(axis=1), shape.decide(x) == IN
        assert (value[there] >= 0).all()
        cut, held = cut + (value < 0).sum(), held + there[found].sum()
    assert (known.level + (known.slope * (border - known.center)).sum(axis=1) >= 0).all()  # the surface itself
    assert cut > 1000
    assert held > 1000
    beside = shape.half_spaces(shape.upper[None] + 1.0, shape.upper[None] + 2.0)
    assert beside.empty.all()
    assert not shape.half_spaces(upper[:3], lower[:3]).empty.any()


@pytest.mark.parametrize("margin", [0.0, 0.1])
def test_the_box_holds_the_object_where_limits_are_rounded_outwards(margin, rng):
    """A limit that is no float32 number is asked about as the next one, where the mesh reaches farther."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    shape = wb.IndicatorBlendShapes(ball.vertices, [ball.vertices * [1.0, 0.0, 0.0]], ball.faces, upper=[0.7])
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


def test_pose_numbers_beyond_float32_are_refused():
    ball = trimesh.creation.icosphere(subdivisions=1)
    with pytest.raises(IndicatorError, match="beyond float32"):
        wb.IndicatorBlendShapes(ball.vertices, [ball.vertices], ball.faces, upper=[1e39])


@pytest.mark.parametrize("scale", [1e-150, 1e-81, 1.2e-81, 1e-40, 1e30, 1e80, 1e150])
def test_half_spaces_of_tiny_and_huge_meshes_deny_nothing(scale, rng):
    """Where squares are no normal numbers any more, nothing is said."""
    box = trimesh.creation.box(extents=(2, 2, 2))
    vertices = np.concatenate([box.vertices, box.vertices + np.array([0, 0, 5])])
    faces, moved = np.concatenate([box.faces, box.faces + 8]), np.tile(box.vertices * [0.1, 0, 0], (2, 1))
    shape = wb.IndicatorBlendShapes(vertices * scale, [moved * scale], faces, margin=0.2 * scale)
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


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e308])
@pytest.mark.parametrize("column", [0, 4])
def test_half_spaces_of_boxes_that_are_none(bad, column):
    shape = blob()
    lower, upper = np.zeros((1, 5)), np.full((1, 5), 0.1)
    for side in (lower, upper):
        side[0, column] = bad
        with np.errstate(invalid="ignore"):
            known = shape.half_spaces(lower, upper)
            assert (known.empty == shape.empty(lower, upper)).all()
        assert np.isfinite(known.level).all()
        assert np.isfinite(known.slope).all()


def test_what_is_far_larger_than_a_box_needs_no_luck(rng):
    """Boxes that are nearly points: what is certain of them is what is certain of points."""
    shape = blob()
    x = asked(shape, rng, 5000)
    truth = shape.decide(x)
    assert (shape.empty(x - 1e-9, x + 1e-9)[truth == OUT]).mean() > 0.999
    assert (shape.inside(x - 1e-9, x + 1e-9)[truth == IN]).mean() > 0.999


def test_rays_through_corners_and_along_edges_decide_nothing_wrong():
    """A box's faces are split along a diagonal, and rays along x through its middle, its sides and its corners meet edges."""
    made = trimesh.creation.box()
    shape = wb.IndicatorBlendShapes(made.vertices, [made.vertices * [1.0, 0, 0]], made.faces)
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


def test_patches_hold_their_faces_at_every_pose(rng):
    shape = blob()
    patches = patches_of(shape.vertices, shape.deltas, shape.faces)
    allowed = float(shape._blends.allowance)  # what the kernels take off for the rounding of such sums
    assert sorted(map(tuple, patches.faces)) == sorted(map(tuple, shape.faces))
    assert (np.diff(patches.first) > 0).all()
    assert len(patches.low) > 20
    for pose in rng.uniform(*shape._limits, (20, 2)):
        at = shape.at(pose)
        ends = [pose[:, None, None] * each for each in (patches.low_deltas, patches.high_deltas)]
        low, high = patches.low + np.minimum(*ends).sum(axis=0), patches.high + np.maximum(*ends).sum(axis=0)
        for patch, (first, last) in enumerate(itertools.pairwise(patches.first)):
            own = at[patches.faces[first:last].ravel()]
            assert (own >= low[patch] - allowed).all()
            assert (own <= high[patch] + allowed).all()


@pytest.mark.parametrize("method", ["mlp", "learned-kdop"])
def test_a_bounder_of_one_pose_number_is_proven(method, tmp_path):
    shape = blob(1, halvings=0)
    options = {"hidden": (12, 12), "steps": 200} if method == "mlp" else {"steps": 60}
    bounder = wb.fit(shape, method=method, device="cpu", progress=False, **options)
    assert bounder.certificate.proven
    assert wb.evaluate(bounder, shape, samples=50_000).fn == 0
    bounder.save(tmp_path / "b.safetensors")
    again = wb.load(tmp_path / "b.safetensors", device="cpu")
    assert wb.certify(again, shape, seconds=120).proven
    assert not wb.certify(again, blob(1, margin=0.2, halvings=0), seconds=5).proven


def test_a_digest_tells_them_apart():
    ball = trimesh.creation.icosphere(subdivisions=1)
    delta = [ball.vertices]

    def made(**options):
        return wb.IndicatorBlendShapes(ball.vertices, delta, ball.faces, **options)

    shapes = [made(), made(upper=[2.0]), wb.IndicatorBlendShapes(ball.vertices, [2 * ball.vertices], ball.faces)]
    assert len({shape.digest for shape in shapes}) == 3
    assert made(name="x").digest == shapes[0].digest
    assert shapes[0].dilated(0.1).geometry == shapes[0].geometry
    assert shapes[0].dilated(0.1).digest != shapes[0].digest
    assert (shapes[0].dilated(0.1).upper[:3] > shapes[0].upper[:3] + 0.09).all()


@pytest.mark.parametrize(
    "name", ["open", "deltas", "vertices", "nan", "faces", "names", "limits", "order", "many", "text", "margin"]
)
def test_what_is_no_blend_is_refused_in_one_line(name):
    ball = trimesh.creation.icosphere(subdivisions=1)
    given = {"vertices": ball.vertices, "deltas": [ball.vertices], "faces": ball.faces}
    given |= {
        "open": {"faces": ball.faces[1:]},
        "deltas": {"deltas": [ball.vertices[1:]]},
        "vertices": {"vertices": ball.vertices[:, :2]},
        "nan": {"deltas": [ball.vertices * np.nan]},
        "faces": {"faces": ball.faces.astype(float)},
        "names": {"faces": ball.faces + 100},
        "limits": {"lower": [0.0, 1.0]},
        "order": {"lower": [1.0], "upper": [1.0]},
        "many": {"deltas": [ball.vertices] * 6},
        "text": {"vertices": "ball"},
        "margin": {"margin": -1.0},
    }[name]
    with pytest.raises(IndicatorError) as error:
        wb.IndicatorBlendShapes(**given)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("turned", [False, True])
def test_parts_that_overlap_do_not_cancel(turned, rng):
    """Whichever way each closed part is turned, both are held where they overlap, as in a mesh."""
    one, other = trimesh.creation.box(extents=[2, 2, 2]), trimesh.creation.box(extents=[2, 2, 2])
    other.apply_translation([1, 0.25, 0.5])
    faces = np.concatenate([one.faces, (other.faces[:, ::-1] if turned else other.faces) + len(one.vertices)])
    vertices = np.concatenate([one.vertices, other.vertices])
    deltas = np.where(np.arange(len(vertices)) < len(one.vertices), 0.0, 1.0)[None, :, None] * np.array([0, 0, 0.5])
    shape = wb.IndicatorBlendShapes(vertices, deltas, faces)
    assert len(set(patches_of(vertices, deltas, faces).part.tolist())) == 2
    x = asked(shape, rng, 3000)
    truth = (np.abs(x[:, :3]) <= 1).all(axis=1)
    truth |= (np.abs(x[:, :3] - [1, 0.25, 0.5] - x[:, 3:] * [0, 0, 0.5]) <= 1).all(axis=1)
    truth &= (x[:, 3] >= 0) & (x[:, 3] <= 1)
    assert (shape.decide(x) == np.where(truth, IN, OUT)).mean() > 0.99
    assert not (truth & (shape.decide(x) == OUT)).any()
    assert not shape.empty(x, x)[truth].any()
    mesh = wb.IndicatorMesh(shape.at([0.5]), faces)
    x[:, 3] = 0.5
    assert not (mesh.contains(x[:, :3]) & (shape.decide(x) == OUT)).any()
