"""Which faces enclose an inside, whether enclosed air is empty, and cells that hold all of it: no tolerance."""

from collections import Counter
from itertools import combinations

import numpy as np
import pytest
import trimesh
from exact_mesh import check_decided
from hypothesis import given, settings
from hypothesis import strategies as st

import warp_bounding as wb
from warp_bounding.certificates.statement import statement
from warp_bounding.errors import ShapeError
from warp_bounding.shapes import Mesh, MovingMesh, load_shape
from warp_bounding.shapes.shape import OUT
from warp_bounding.shapes.surfaces import surface_of

BOX = trimesh.creation.box(extents=(1, 2, 3))
VERTICES, FACES = np.asarray(BOX.vertices), np.asarray(BOX.faces)
WITHIN = np.concatenate(
    [np.zeros((1, 3)), np.random.default_rng(0).uniform(VERTICES.min(0), VERTICES.max(0), (2000, 3))]
)


def with_faces(*more):
    return Mesh(VERTICES, np.concatenate([FACES, *[np.atleast_2d(face) for face in more]]))


def with_part(vertices, faces):
    return Mesh(np.concatenate([VERTICES, vertices]), np.concatenate([FACES, np.array(faces) + len(VERTICES)]))


def zero_area(start, end):
    """A face of three vertices on one line, the middle one on none of the box's."""
    return with_part([VERTICES[start], VERTICES[end], (VERTICES[start] + VERTICES[end]) / 2], [[0, 1, 2]])


CLOSED = {
    "as it is": lambda: with_faces(),
    "a face without area across the inside": lambda: zero_area(0, 7),
    "a collapsed face": lambda: with_faces([0, 1, 1]),
    "a doubled face, turned": lambda: with_faces(FACES[4][::-1]),
    "a doubled face with vertices of its own": lambda: with_part(VERTICES[FACES[4]], [[0, 1, 2]]),
    "one face turned": lambda: Mesh(VERTICES, np.concatenate([FACES[1:], FACES[:1, ::-1]])),
    "all faces turned": lambda: Mesh(VERTICES, FACES[:, ::-1]),
    "vertices of no face": lambda: Mesh(np.concatenate([VERTICES, [[9, 9, 9], [0, 0, 0]]]), FACES),
    "no vertex is shared": lambda: Mesh(VERTICES[FACES.ravel()], np.arange(36).reshape(-1, 3)),
    "a shell in it": lambda: with_part(VERTICES / 2, FACES),
    "a shell in it that faces inwards": lambda: with_part(VERTICES / 2, FACES[:, ::-1]),
    "a solid that goes through it": lambda: with_part(VERTICES + 0.25, FACES),
}
OPEN_IN_PART = {
    "a fin": (lambda: with_part([VERTICES[0], VERTICES[1], [5, 5, 5]], [[0, 1, 2]]), 1),
    "a sheet beside it": (lambda: with_part([[2, 0, 0], [3, 0, 0], [3, 1, 0], [2, 1, 0]], [[0, 1, 2], [0, 2, 3]]), 2),
    "a sheet in it": (lambda: with_part([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], [[0, 1, 2]]), 1),
    "another that is open": (lambda: with_part(VERTICES + 9, FACES[1:]), 11),
}
OPEN = {
    "a hole": lambda: Mesh(VERTICES, FACES[1:]),
    "a triangle": lambda: Mesh(VERTICES, FACES[:1]),
    "a triangle with two sides": lambda: Mesh(VERTICES, [FACES[0], FACES[0][::-1]]),
    "a hole, one face doubled": lambda: Mesh(VERTICES, np.concatenate([FACES[1:], FACES[-1:]])),
    "almost equal vertices": lambda: Mesh(
        VERTICES[FACES.ravel()] + 1e-6 * np.arange(36)[:, None], np.arange(36).reshape(-1, 3)
    ),
}


@pytest.mark.parametrize("name", [*CLOSED, *OPEN_IN_PART, *OPEN])
def test_closed_parts_are_bounded_with_their_inside_and_open_ones_by_their_surface(name):
    make, loose = OPEN_IN_PART[name] if name in OPEN_IN_PART else ((CLOSED | OPEN)[name], None)
    mesh = make()
    grid = mesh.to_grid(resolution=12 if loose is None else 40)
    assert mesh.watertight == (name in CLOSED)
    assert ("surface only" in grid.note) == (name not in CLOSED)
    assert loose is None or f"surface only for {loose} of {len(mesh.faces)} faces" in grid.note
    assert grid.contains(mesh.vertices[mesh.faces].reshape(-1, 3)).all()
    if name not in OPEN:
        assert (mesh.decide(WITHIN) != OUT).all()
        assert grid.contains(WITHIN).all()
    elif name != "a triangle":
        assert mesh.decide(np.zeros((1, 3))) == OUT
        assert not grid.contains(np.zeros((1, 3))).any()


def test_two_chambers_may_share_a_wall():
    """Three or four faces meet in each of its edges."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1]])
    outer = [[a, b, tip] for tip in (3, 4) for a, b in ((0, 1), (1, 2), (2, 0))]
    for walls in (1, 2):
        mesh = Mesh(vertices, outer + [[0, 1, 2]] * walls)
        assert mesh.watertight
        assert mesh.to_grid(resolution=20).contains(np.array([[0.2, 0.2, 0.3], [0.2, 0.2, -0.3]])).all()


def test_a_face_without_area_may_close_a_crack():
    """The middle of an edge is a vertex on one side only: closed by the sliver between, open without it."""
    a, b, c = FACES[0]
    middle = len(VERTICES)
    vertices = np.concatenate([VERTICES, [(VERTICES[a] + VERTICES[b]) / 2]])
    halves = np.concatenate([FACES[1:], [[a, middle, c], [middle, b, c]]])
    assert not Mesh(vertices, halves).watertight
    mended = Mesh(vertices, np.concatenate([halves, [[a, b, middle]]]))
    assert mended.watertight
    assert mended.to_grid(resolution=12).contains(WITHIN).all()


def test_a_motion_with_a_doubled_face_and_a_crumb_is_closed():
    frames = np.stack([VERTICES, VERTICES + np.array([0.5, 0, 0])])
    grid = MovingMesh(frames, np.concatenate([FACES, FACES[2:3], [[0, 0, 1]]]), time_cells=2).to_grid(resolution=8)
    assert grid.note == ""
    assert grid.contains(np.array([[0.5, 0.25, 0, 0]])).all()
    beside = np.concatenate([VERTICES, VERTICES + np.array([0, 5, 0])])
    motion = MovingMesh(np.stack([beside, beside + 0.1]), np.concatenate([FACES, FACES[1:] + 8]), time_cells=1)
    grid = motion.to_grid(resolution=16)
    assert "surface only for 11 of 23 faces" in grid.note
    assert grid.contains(np.array([[0.5, 0.05, 0.05, 0.05]])).all()
    assert not grid.contains(np.array([[0.5, 0.05, 5.05, 0.05]])).any()


def peeled(faces):
    """The faces that stay, by the definition."""
    left = {tuple(sorted(face)) for face in faces.tolist() if len(set(face)) == 3}
    while True:
        count = Counter(edge for face in left for edge in combinations(face, 2))
        free = {face for face in left if any(count[edge] == 1 for edge in combinations(face, 2))}
        if not free:
            return np.array([tuple(sorted(face)) in left for face in faces.tolist()])
        left -= free


@settings(deadline=None, max_examples=200)
@given(st.lists(st.tuples(*[st.integers(0, 5)] * 3), min_size=1, max_size=25))
def test_against_the_definition(faces):
    faces = np.array(faces)
    points = np.array([[t, t * t, t**3] for t in range(6)])  # no three on a line
    surface = surface_of(points, faces)
    stays = peeled(faces)
    assert surface.closed.tolist() == stays.tolist()
    three = np.array([len(set(face)) == 3 for face in faces.tolist()])
    assert surface.loose.tolist() == (three & ~stays).tolist()


SURFACE_ONLY = "surface only: the mesh is open"


@pytest.mark.parametrize(("query", "resolution"), [("point", None), ("box", 12), ("distance", None)])
def test_an_open_mesh_is_told_wherever_something_is_told_of_its_bounder(query, resolution):
    """What lies deeper in it than the margin is answered with no, which somebody with particles in there must know."""
    hole, reported = Mesh(VERTICES, FACES[1:], name="hole.obj"), {"resolution": resolution, "device": "cpu"}
    with pytest.warns(wb.BoundingWarning, match=f"hole.obj: {SURFACE_ONLY}.*close it first") as caught:
        bounder = wb.fit(hole, query, "aabb", margin=0.05, **reported)
    assert {warning.filename for warning in caught if SURFACE_ONLY in str(warning.message)} == {__file__}
    assert SURFACE_ONLY in bounder.certificate.message.split(". ", 2)[1]  # of the second sentence
    assert SURFACE_ONLY in bounder.info["note"]
    assert SURFACE_ONLY in wb.certify(bounder, hole).message
    assert SURFACE_ONLY in statement(bounder)["note"]


def test_the_digest_is_of_the_geometry_and_arrays_are_copied(rng):
    vertices = BOX.vertices.astype(np.float32)
    mesh = Mesh(vertices, BOX.faces)
    same = Mesh(vertices.copy(), mesh.faces, name="other", note="other")
    vertices[:] = 0
    assert mesh.bounds[1].tolist() == [0.5, 1, 1.5]
    for array in (mesh.vertices, mesh.faces):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    moved = mesh.vertices.copy()
    moved[3, 1] = np.nextafter(moved[3, 1], np.float32(9))
    assert mesh.digest == load_shape(BOX).digest == same.digest
    assert mesh.digest not in (Mesh(moved, mesh.faces).digest, Mesh(mesh.vertices, mesh.faces[:-1]).digest)
    turned = Mesh(mesh.vertices, rng.permutation(mesh.faces))
    assert turned.to_grid(resolution=20, margin=0.05).digest == mesh.to_grid(resolution=20, margin=0.05).digest


def box(half: float, inverted: bool = False) -> trimesh.Trimesh:
    made = trimesh.creation.box(extents=[2 * half] * 3)
    if inverted:
        made.invert()
    return made


def walls() -> list[trimesh.Trimesh]:
    """Six boxes that run through one another: a room without a door."""
    made = []
    for axis in range(3):
        for low, high in ((-1, -0.8), (0.8, 1)):
            corners = np.array([[-1.0] * 3, [1.0] * 3])
            corners[:, axis] = low, high
            made.append(trimesh.creation.box(bounds=corners))
    return made


def cube(half: float):
    return lambda x: np.abs(x).max(axis=1) <= half


def hole(half: float):
    return lambda x: np.abs(x).max(axis=1) < half


TANK = [box(1), box(0.8, True)]
# name: parts, which points are solid, closed hollows
HOLLOW = {
    "tank": (TANK, lambda x: cube(1)(x) & ~hole(0.8)(x), 1),
    "tank turned inside out": ([box(1, True), box(0.8)], lambda x: cube(1)(x) & ~hole(0.8)(x), 1),
    "thin tank": ([box(1), box(0.999, True)], lambda x: cube(1)(x) & ~hole(0.999)(x), 1),
    "tank in a tank": (
        [*TANK, box(0.6), box(0.4, True)],
        lambda x: (cube(1)(x) & ~hole(0.8)(x)) | (cube(0.6)(x) & ~hole(0.4)(x)),
        2,
    ),
    "room of walls": (walls(), lambda x: cube(1)(x) & ~hole(0.8)(x), 1),
    "box in a box": ([box(1), box(0.5)], cube(1), 0),  # both turned outwards: solid twice over
    "boxes that overlap": (
        [trimesh.creation.box(bounds=[[-1] * 3, [0.3] * 3]), trimesh.creation.box(bounds=[[-0.3] * 3, [1] * 3])],
        lambda x: ((x >= -1) & (x <= 0.3)).all(axis=1) | ((x >= -0.3) & (x <= 1)).all(axis=1),
        0,
    ),
}


def made(parts, **options):
    joined = trimesh.util.concatenate(parts)
    return load_shape((joined.vertices, joined.faces), **options)


@pytest.mark.parametrize("name", HOLLOW)
def test_empty_hollows_of_a_mesh(name):
    parts, solid, hollows = HOLLOW[name]
    filled, empty = (made(parts, hollow=hollow) for hollow in ("filled", "empty"))
    words = f"{hollows} closed hollow{'s' * (hollows != 1)} " if hollows else ""
    assert (filled.remark, empty.remark) == tuple(words + word if words else "" for word in ("filled", "empty"))
    assert filled.digest != empty.digest
    assert filled.digest == made(parts).digest
    rng = np.random.default_rng(0)
    x = rng.uniform(-1.2, 1.2, (6000, 3))
    x[:1000] = np.round(x[:1000] * 10) / 10  # on faces, edges and diagonals
    truth, found = solid(x), empty.decide(x)
    whole = solid(x) if name == "boxes that overlap" else cube(1)(x)
    assert not (whole & (filled.decide(x) == OUT)).any()
    on = np.isclose(np.abs(x)[..., None], [1, 0.999, 0.8, 0.6, 0.5, 0.4, 0.3]).any(axis=(1, 2))
    check_decided(found, truth & ~on, ~truth & ~on)
    assert ((found == OUT) == ~truth)[~on].mean() > 0.99
    reach = rng.uniform(0, 0.2, (6000, 1))
    lower, upper = x - reach, x + reach
    inner = solid((lower[:, None] + (upper - lower)[:, None] * rng.random((6000, 16, 3))).reshape(-1, 3)).reshape(
        -1, 16
    )
    assert not (empty.empty(lower, upper) & inner.any(axis=1)).any()
    assert not (empty.inside(lower, upper) & ~inner.all(axis=1)).any()
    low, high = empty.distances(x).T
    assert (low[truth & ~on] == 0).all()
    assert (low <= high).all()
    for margin in (0.0, 0.05):
        grid = empty.to_grid(resolution=24, margin=margin)
        assert grid.contains(x[truth]).all()
        if hollows and name != "tank in a tank":
            assert not grid.contains(np.zeros((1, 3)))[0]
            assert filled.to_grid(resolution=24, margin=margin).contains(np.zeros((1, 3)))[0]


def test_bounders_of_a_tank():
    tank = made(TANK, hollow="empty")
    x = np.random.default_rng(1).uniform(-1.2, 1.2, (20000, 3))
    bounder = wb.fit(tank, method="bvh", leaves=64, resolution=24, device="cpu")
    answers = bounder.query(x).numpy()
    assert answers[HOLLOW["tank"][1](x)].all()
    assert answers[hole(0.6)(x)].mean() < 0.05
    assert wb.certify(bounder, tank).proven
    assert "1 closed hollow empty" in bounder.certificate.message
    assert wb.certify(bounder, made(TANK)).kind == "refuted"  # of the filled one it would not be true


def test_faces_must_be_turned_alike_for_empty_hollows():
    joined = trimesh.util.concatenate(TANK)
    faces = joined.faces.copy()
    faces[0] = faces[0][::-1]
    with pytest.raises(wb.BoundingError, match="turned alike"):
        load_shape((joined.vertices, faces), hollow="empty")
    assert "turned alike" in load_shape((joined.vertices, faces)).remark
    assert load_shape((box(1).vertices, box(1).faces)).remark == ""


TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
BAD_MESHES = {
    "no faces": (TRIANGLE, np.zeros((0, 3), dtype=int), "faces"),
    "2-D vertices": ([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], "(V, 3)"),
    "text": ([["a", "b", "c"]], [[0, 0, 0]], "(V, 3)"),
    "unused nan": ([*TRIANGLE, [np.nan, 0, 0]], [[0, 1, 2]], "finite"),
    "overflow": ([[1e39, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], "finite float32"),
    "quads": ([*TRIANGLE, [1, 1, 0]], [[0, 1, 2, 3]], "(F, 3)"),
    "float faces": (TRIANGLE, [[0.0, 1.0, 2.0]], "integers"),
    "too high": (TRIANGLE, [[0, 1, 3]], "vertex 3"),
    "too low": (TRIANGLE, [[-1, 1, 2]], "vertex -1"),
    "lines": ([[0, 0, 0], [1, 2, 3], [2, 4, 6]], [[0, 1, 2], [0, 0, 1]], "without area"),
}


@pytest.mark.parametrize("case", BAD_MESHES)
def test_bad_mesh(case):
    vertices, faces, word = BAD_MESHES[case]
    with pytest.raises(ShapeError, match=r"part\.stl: expected") as caught:
        Mesh(np.array(vertices), np.array(faces), name="part.stl")
    assert word in str(caught.value)
