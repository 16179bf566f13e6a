"""Which faces enclose an inside, whatever was exported with them."""

from collections import Counter
from itertools import combinations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

import warp_bounding as wb
from warp_bounding.certificates.statement import statement
from warp_bounding.indicators import IndicatorMesh, IndicatorMotion
from warp_bounding.indicators.surfaces import distinct_rows, surface_of
from warp_bounding.indicators.triangles.cells import surface_cells

BOX = trimesh.creation.box(extents=(1, 2, 3))
VERTICES, FACES = np.asarray(BOX.vertices), np.asarray(BOX.faces)
CENTRE = np.zeros((1, 3))


def with_faces(*more):
    return IndicatorMesh(VERTICES, np.concatenate([FACES, *[np.atleast_2d(face) for face in more]]))


def with_part(vertices, faces):
    return IndicatorMesh(np.concatenate([VERTICES, vertices]), np.concatenate([FACES, np.array(faces) + len(VERTICES)]))


def zero_area(start, end):
    """A face of three vertices on one line, the middle one on none of the box's."""
    return with_part([VERTICES[start], VERTICES[end], (VERTICES[start] + VERTICES[end]) / 2], [[0, 1, 2]])


CLOSED = {
    "as it is": lambda: with_faces(),
    "a face without area along an edge": lambda: zero_area(*FACES[0, :2]),
    "a face without area across the inside": lambda: zero_area(0, 7),
    "a collapsed face": lambda: with_faces([0, 1, 1]),
    "a face that is a point": lambda: with_faces([3, 3, 3]),
    "a doubled face": lambda: with_faces(FACES[4]),
    "a doubled face, turned": lambda: with_faces(FACES[4][::-1]),
    "a face three times": lambda: with_faces(FACES[4], FACES[4][[1, 2, 0]]),
    "a doubled face with vertices of its own": lambda: with_part(VERTICES[FACES[4]], [[0, 1, 2]]),
    "every face twice": lambda: with_faces(FACES),
    "one face turned": lambda: IndicatorMesh(VERTICES, np.concatenate([FACES[1:], FACES[:1, ::-1]])),
    "all faces turned": lambda: IndicatorMesh(VERTICES, FACES[:, ::-1]),
    "vertices of no face": lambda: IndicatorMesh(np.concatenate([VERTICES, [[9, 9, 9], [0, 0, 0]]]), FACES),
    "no vertex is shared": lambda: IndicatorMesh(VERTICES[FACES.ravel()], np.arange(36).reshape(-1, 3)),
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
    "a hole": lambda: IndicatorMesh(VERTICES, FACES[1:]),
    "a triangle": lambda: IndicatorMesh(VERTICES, FACES[:1]),
    "a triangle with two sides": lambda: IndicatorMesh(VERTICES, [FACES[0], FACES[0][::-1]]),
    "a hole, one face doubled": lambda: IndicatorMesh(VERTICES, np.concatenate([FACES[1:], FACES[-1:]])),
    "almost equal vertices": lambda: IndicatorMesh(
        VERTICES[FACES.ravel()] + 1e-6 * np.arange(36)[:, None], np.arange(36).reshape(-1, 3)
    ),
}


@pytest.mark.parametrize("name", CLOSED)
def test_a_closed_mesh_is_bounded_with_its_inside(name):
    mesh = CLOSED[name]()
    assert mesh.watertight
    grid = mesh.to_grid(resolution=12)
    assert grid.note == ""
    assert grid.contains(CENTRE).all()
    assert grid.contains(np.random.default_rng(0).uniform(VERTICES.min(0), VERTICES.max(0), (2000, 3))).all()


@pytest.mark.parametrize("name", OPEN_IN_PART)
def test_closed_parts_are_bounded_whole_and_the_message_names_the_rest(name):
    make, loose = OPEN_IN_PART[name]
    mesh = make()
    assert not mesh.watertight
    grid = mesh.to_grid(resolution=40)
    assert f"surface only for {loose} of {len(mesh.faces)} faces" in grid.note
    inside = np.random.default_rng(0).uniform(VERTICES.min(0), VERTICES.max(0), (2000, 3))
    assert grid.contains(inside).all()
    assert grid.contains(mesh.vertices).all()


@pytest.mark.parametrize("name", OPEN)
def test_an_open_mesh_is_bounded_by_its_surface_only(name):
    mesh = OPEN[name]()
    assert not mesh.watertight
    grid = mesh.to_grid(resolution=12)
    assert "surface only" in grid.note
    assert not grid.contains(CENTRE).any() or name == "a triangle"


@pytest.mark.parametrize(
    "cases", [CLOSED, {k: v[0] for k, v in OPEN_IN_PART.items()}, OPEN], ids=["closed", "in part", "open"]
)
def test_no_face_leaves_the_surface(cases):
    """Whatever is told of a face, the cells that it meets are occupied."""
    for make in cases.values():
        mesh = make()
        grid = mesh.to_grid(resolution=12, margin=0.05)
        scale = grid.cells_per_unit[0]
        in_cells = mesh.vertices.astype(np.float64) * scale - grid.offset
        assert grid.occupancy[surface_cells(in_cells, mesh.faces, grid.shape, 0.05 * scale)].all()


@pytest.mark.parametrize("walls", [1, 2])
def test_two_chambers_may_share_a_wall(walls):
    """Three or four faces meet in each of its edges."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1]])
    outer = [[a, b, tip] for tip in (3, 4) for a, b in ((0, 1), (1, 2), (2, 0))]
    mesh = IndicatorMesh(vertices, outer + [[0, 1, 2]] * walls)
    assert mesh.watertight
    assert mesh.to_grid(resolution=20).contains(np.array([[0.2, 0.2, 0.3], [0.2, 0.2, -0.3]])).all()


def test_a_face_without_area_may_close_a_crack():
    """The middle of an edge is a vertex on one side only: closed by the sliver between, open without it."""
    a, b, c = FACES[0]
    middle = len(VERTICES)
    vertices = np.concatenate([VERTICES, [(VERTICES[a] + VERTICES[b]) / 2]])
    halves = np.concatenate([FACES[1:], [[a, middle, c], [middle, b, c]]])
    assert not IndicatorMesh(vertices, halves).watertight
    mended = IndicatorMesh(vertices, np.concatenate([halves, [[a, b, middle]]]))
    assert mended.watertight
    assert mended.to_grid(resolution=12).contains(CENTRE).all()


def test_a_motion_with_a_doubled_face_and_a_crumb_is_closed():
    frames = np.stack([VERTICES, VERTICES + np.array([0.5, 0, 0])])
    grid = IndicatorMotion(frames, np.concatenate([FACES, FACES[2:3], [[0, 0, 1]]]), time_cells=2).to_grid(resolution=8)
    assert grid.note == ""
    assert grid.contains(np.array([[0.5, 0.25, 0, 0]])).all()
    beside = np.concatenate([VERTICES, VERTICES + np.array([0, 5, 0])])
    motion = IndicatorMotion(np.stack([beside, beside + 0.1]), np.concatenate([FACES, FACES[1:] + 8]), time_cells=1)
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


def test_a_long_open_tube_is_told_at_once():
    """Taken away ring by ring; each ring costs what it holds, not what the mesh holds."""
    rings, sides = 3000, 4
    faces = [
        [[r * sides + i, r * sides + (i + 1) % sides, (r + 1) * sides + i] for i in range(sides)]
        + [[r * sides + (i + 1) % sides, (r + 1) * sides + i, (r + 1) * sides + (i + 1) % sides] for i in range(sides)]
        for r in range(rings)
    ]
    vertices = np.random.default_rng(0).random(((rings + 1) * sides, 3))
    assert not surface_of(vertices, np.concatenate(faces)).closed.any()


SURFACE_ONLY = "surface only: the mesh is open"


@pytest.mark.parametrize("resolution", [None, 12])
@pytest.mark.parametrize("query", ["point", "box", "distance"])
def test_an_open_mesh_is_told_wherever_something_is_told_of_its_bounder(query, resolution):
    """What lies deeper in it than the margin is answered with no, which somebody with particles in there must know."""
    hole, told = IndicatorMesh(VERTICES, FACES[1:], name="hole.obj"), {"resolution": resolution, "device": "cpu"}
    with pytest.warns(wb.BoundingWarning, match=f"hole.obj: {SURFACE_ONLY}.*close it first") as caught:
        bounder = wb.fit(hole, query, "aabb", margin=0.05, **told)
    assert {warning.filename for warning in caught if SURFACE_ONLY in str(warning.message)} == {__file__}
    assert SURFACE_ONLY in bounder.certificate.message.split(". ", 2)[1]  # of the second sentence
    assert SURFACE_ONLY in bounder.info["note"]
    assert SURFACE_ONLY in wb.certify(bounder, hole).message
    assert SURFACE_ONLY in statement(bounder)["note"]


@pytest.mark.parametrize("resolution", [None, 12])
@pytest.mark.parametrize("query", ["point", "box", "distance"])
def test_nothing_of_it_is_told_of_a_closed_one(query, resolution):
    """Warnings are errors here."""
    whole = wb.fit(with_faces(FACES[4]), query, "aabb", margin=0.25, resolution=resolution, device="cpu")
    told = [whole.certificate.message, whole.info["note"], *statement(whole).values(), repr(with_faces(FACES[4]))]
    assert not any("surface only" in text or "open" in text for text in told)


def test_what_is_made_of_an_open_mesh_tells_so_too():
    hole = IndicatorMesh(VERTICES, FACES[1:], name="hole.obj")
    closed = IndicatorMesh(VERTICES + 5, FACES)
    both = wb.solids.Union(hole, closed)
    moving = IndicatorMotion(np.stack([VERTICES, VERTICES + 0.5]), FACES[1:])
    for shape in (
        both,
        wb.solids.Dilation(both, 0.1),
        both.dilated(0.1),
        wb.Complement(hole),
        moving,
        hole.dilated(0.1),
    ):
        assert SURFACE_ONLY in shape.restriction
        assert SURFACE_ONLY in repr(shape) or isinstance(shape, wb.Complement)
    assert both.restriction.startswith("hole.obj: ")
    assert SURFACE_ONLY in both.to_grid(resolution=8).note
    assert not wb.solids.Union(closed, closed).restriction
    with pytest.warns(wb.BoundingWarning, match=SURFACE_ONLY):
        wb.hierarchy(hole, method="kdop", levels=1, margin=0.05, device="cpu", progress=False)
    with pytest.warns(wb.BoundingWarning, match=SURFACE_ONLY) as caught:
        wb.choose(hole, narrow_ns=50.0, methods=["aabb", "obb"], networks=(), budget=1.0, device="cpu", progress=False)
    assert len(caught) == 1


@pytest.mark.parametrize("dtype", [np.float32, np.int64])
@pytest.mark.parametrize(("rows", "columns"), [(1, 3), (500, 2), (500, 3), (0, 3)])
def test_distinct_rows_are_those_of_numpy(dtype, rows, columns):
    values = np.random.default_rng(0).integers(-3, 4, (rows, columns)).astype(dtype)
    unique, first, inverse = np.unique(values, axis=0, return_index=True, return_inverse=True)
    found = distinct_rows(values)
    for one, other in zip(found, (unique, first, inverse.reshape(-1)), strict=True):
        assert (one == other).all()
        assert one.shape == other.shape
