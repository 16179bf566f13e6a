"""Small meshes of which it is known what they enclose, the truth about them in rational arithmetic, and checks."""

from fractions import Fraction

import numpy as np

from warp_bounding.shapes import Mesh
from warp_bounding.shapes.shape import IN, OUT


def _fractions(x) -> list[Fraction]:
    return [v if isinstance(v, Fraction) else Fraction(float(v)) for v in x]


def _minus(a, b):
    return [p - q for p, q in zip(a, b, strict=True)]


def _dot(a, b):
    return sum(p * q for p, q in zip(a, b, strict=True))


def _cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _squared_to_segment(p, a, b) -> Fraction:
    e, w = _minus(b, a), _minus(p, a)
    length = _dot(e, e)
    t = min(max(_dot(w, e) / length, Fraction(0)), Fraction(1)) if length else Fraction(0)
    d = [x - t * y for x, y in zip(w, e, strict=True)]
    return _dot(d, d)


def _squared_to_triangle(p, a, b, c) -> Fraction:
    n = _cross(_minus(b, a), _minus(c, a))
    if any(n):
        sides = [_dot(_cross(_minus(v, u), _minus(p, u)), n) for u, v in ((a, b), (b, c), (c, a))]
        if min(sides) >= 0:
            return _dot(_minus(p, a), n) ** 2 / _dot(n, n)
    return min(_squared_to_segment(p, *ends) for ends in ((a, b), (b, c), (c, a)))


def squared_distance(vertices: np.ndarray, faces: np.ndarray, x: np.ndarray) -> Fraction:
    """From a point to the nearest of the faces."""
    p, corners = _fractions(x), [_fractions(v) for v in vertices]
    return min(_squared_to_triangle(p, *(corners[i] for i in face)) for face in faces)


def in_tetrahedron(corners: np.ndarray, x: np.ndarray) -> bool:
    """Whether a point lies in the closed tetrahedron of four corners, which is not flat."""
    p, corners = _fractions(x), [_fractions(v) for v in corners]
    for i in range(4):
        top, (a, b, c) = corners[i], [v for k, v in enumerate(corners) if k != i]
        n = _cross(_minus(b, a), _minus(c, a))
        if _dot(n, _minus(top, a)) * _dot(n, _minus(p, a)) < 0:
            return False
    return True


def squared_between_segments(a, b, c, d) -> Fraction:
    """Between the segments from a to b and from c to d."""
    found = [_squared_to_segment(a, c, d), _squared_to_segment(b, c, d)]
    found += [_squared_to_segment(c, a, b), _squared_to_segment(d, a, b)]
    u, v, w = _minus(b, a), _minus(d, c), _minus(a, c)
    uu, uv, vv, uw, vw = _dot(u, u), _dot(u, v), _dot(v, v), _dot(u, w), _dot(v, w)
    determinant = uu * vv - uv * uv
    if determinant:
        s, t = (uv * vw - vv * uw) / determinant, (uu * vw - uv * uw) / determinant
        if 0 <= s <= 1 and 0 <= t <= 1:
            between = [x + s * y - t * z for x, y, z in zip(w, u, v, strict=True)]
            found.append(_dot(between, between))
    return min(found)


def _crosses(p, q, a, b, c) -> bool:
    """Whether the segment from p to q meets the triangle, if they do not lie in one plane."""
    n = _cross(_minus(b, a), _minus(c, a))
    start, end = _dot(n, _minus(p, a)), _dot(n, _minus(q, a))
    if start * end > 0 or start == end:
        return False
    t = start / (start - end)
    return _squared_to_triangle([x + t * (y - x) for x, y in zip(p, q, strict=True)], a, b, c) == 0


def _apart(points, others, limit) -> bool:
    """Whether the boxes around two sets of points are further apart, by the squares of distances; a quick way out."""
    gap = [max(min(x) - max(y), min(y) - max(x), 0) for x, y in zip(zip(*points), zip(*others), strict=True)]  # noqa: B905
    return _dot(gap, gap) > limit


def _segment_is_near(p, q, triangle, limit) -> bool:
    a, b, c = triangle
    if _apart((p, q), triangle, limit):
        return False
    if _crosses(p, q, a, b, c) or min(_squared_to_triangle(x, a, b, c) for x in (p, q)) <= limit:
        return True
    return any(squared_between_segments(p, q, *edge) <= limit for edge in ((a, b), (b, c), (c, a)))


def segment_is_near(
    vertices: np.ndarray, faces: np.ndarray, limit: Fraction, start: np.ndarray, end: np.ndarray
) -> bool:
    """Whether a segment comes as near to a face as the root of the limit."""
    p, q, corners = _fractions(start), _fractions(end), [_fractions(v) for v in vertices]
    return any(_segment_is_near(p, q, [corners[i] for i in face], limit) for face in faces)


def box_is_near(vertices: np.ndarray, faces: np.ndarray, limit: Fraction, lower: np.ndarray, upper: np.ndarray) -> bool:
    """Whether a closed box comes as near to a face as the root of the limit."""
    low, high, points = _fractions(lower), _fractions(upper), [_fractions(v) for v in vertices]
    ends = [[(low, high)[bit >> k & 1][k] for k in range(3)] for bit in range(8)]
    edges = [(ends[i], ends[i | 1 << k]) for i in range(8) for k in range(3) if not i >> k & 1]
    for face in faces:
        triangle = a, b, c = [points[i] for i in face]
        if _apart((low, high), triangle, limit):
            continue
        for v in triangle:
            gap = [max(x - y, z - x, Fraction(0)) for x, y, z in zip(v, high, low, strict=True)]
            if _dot(gap, gap) <= limit:
                return True
        if any(passes_box(*edge, low, high) for edge in ((a, b), (b, c), (c, a))):
            return True
        if any(_segment_is_near(*edge, triangle, limit) for edge in edges):
            return True
    return False


def passes_box(u, v, low, high) -> bool:
    """Whether a segment meets a closed box: the times at which it lies between the sides of each axis overlap."""
    first, last = Fraction(0), Fraction(1)
    for x, y, z, w in zip(u, v, low, high, strict=True):
        if x == y:
            if not z <= x <= w:
                return False
        else:
            times = sorted(((z - x) / (y - x), (w - x) / (y - x)))
            first, last = max(first, times[0]), min(last, times[1])
    return first <= last


def plane_meets(vertices: np.ndarray, faces: np.ndarray, margin: float, normal: np.ndarray, point: np.ndarray) -> bool:
    """Whether a plane comes within the margin of a face."""
    n, p = _fractions(normal), _fractions(point)
    heights = [_dot(n, _minus(_fractions(v), p)) for v in vertices]
    limit = Fraction(margin) ** 2 * _dot(n, n)
    for face in faces:
        least, most = (f(heights[i] for i in face) for f in (min, max))
        if (least <= 0 or least**2 <= limit) and (most >= 0 or most**2 <= limit):
            return True
    return False


SIDES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])  # of a tetrahedron


def _tetrahedra(corners: list[np.ndarray]) -> Mesh:
    faces = np.concatenate([SIDES + 4 * i for i in range(len(corners))])
    return Mesh(np.concatenate(corners).astype(np.float32), faces)


def _random(rng, size=1.0, shift=0.0):
    return (rng.uniform(-size, size, (4, 3)) + shift).astype(np.float32)


def mesh_case(name: str, rng) -> tuple[Mesh, list[np.ndarray]]:
    """A mesh, and the corners of the tetrahedra (three at most, so that they enclose no hollow) that it encloses."""
    one = _random(rng)
    if name == "tetrahedron":
        return _tetrahedra([one]), [one]
    if name == "flipped":
        mesh = _tetrahedra([one])
        faces = mesh.faces.copy()
        faces[1:3] = faces[1:3, ::-1]
        return Mesh(mesh.vertices, faces), [one]
    if name == "doubled":
        mesh = _tetrahedra([one])
        return Mesh(mesh.vertices, np.concatenate([mesh.faces, mesh.faces[:3], [[0, 0, 1]]])), [one]
    if name == "nested":
        inner = (one.mean(axis=0) + 0.25 * (one - one.mean(axis=0))).astype(np.float32)
        return _tetrahedra([one, inner]), [one, inner]
    if name == "overlapping":
        parts = [one, _random(rng), _random(rng)]
        return _tetrahedra(parts), parts
    if name == "wall":  # two that share a face: three faces meet at its edges
        other = one.copy()
        other[3] = 2 * one[:3].mean(axis=0) - one[3]
        return _tetrahedra([one, other]), [one, other]
    if name == "on round numbers":
        one = rng.integers(-2, 3, (4, 3)).astype(np.float32)
        flat = abs(np.linalg.det((one[1:] - one[0]).astype(float))) < 0.5
        return mesh_case(name, rng) if flat else (_tetrahedra([one]), [one])
    if name == "far away":
        one = _random(rng, shift=1e6)
        flat = abs(np.linalg.det((one[1:] - one[0]).astype(float))) < 1e-3
        return mesh_case(name, rng) if flat else (_tetrahedra([one]), [one])
    if name == "open":
        mesh = _tetrahedra([one])
        return Mesh(mesh.vertices, mesh.faces[1:]), []
    if name == "soup":
        vertices = rng.uniform(-1, 1, (30, 3)).astype(np.float32)
        faces = np.concatenate([np.arange(30).reshape(10, 3), [[0, 1, 1], [2, 2, 2]]])
        return Mesh(vertices, faces), []
    raise AssertionError(name)


NAMES = (
    "tetrahedron", "flipped", "doubled", "nested", "overlapping", "wall", "on round numbers", "far away", "open",
        "soup",
)  # fmt: skip


def hard_points(mesh: Mesh, margin: float, rng, count: int) -> np.ndarray:
    """At random, near faces, at the margin from faces, and on round numbers, vertices and edges."""
    size = np.ptp(mesh.bounds, axis=0).max()
    low, high = mesh.bounds[0] - margin - 0.2 * size, mesh.bounds[1] + margin + 0.2 * size
    corners = mesh.vertices.astype(np.float64)[mesh.faces[rng.integers(len(mesh.faces), size=(3, count))]]
    on = np.einsum("fk,fkx->fx", rng.dirichlet(np.ones(3), count), corners[0])
    away = rng.normal(size=(count, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    normal = np.cross(corners[0, :, 1] - corners[0, :, 0], corners[0, :, 2] - corners[0, :, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    found = [rng.uniform(low, high, (count, 3)), on + away * size * 10.0 ** rng.uniform(-12, -1, (count, 1))]
    found += [on + margin * normal * (1 + rng.choice([-1e-15, 0, 1e-15, 1e-6, -1e-6], (count, 1)))]
    found += [rng.uniform(low, high, (count, 3)).astype(np.float32).astype(np.float64)]
    found += [np.rint(rng.uniform(low, high, (count, 3)) * 2) / 2]
    return np.concatenate([*found, corners[1, :, 0], (corners[2, :, 0] + corners[2, :, 1]) / 2])


def check_decided(answer: np.ndarray, held: np.ndarray, free: np.ndarray | None = None) -> None:
    """No point of the object is called outside, no other one inside; what is neither held nor free may be either."""
    assert not (held & (answer == OUT)).any()
    assert not ((~held if free is None else free) & (answer == IN)).any()


def check_boxes(shape, points, answer, held, free, rng) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Boxes with these points, many on their borders: one with a point of the object is not empty, one with another
    point lies not inside. So are the points themselves. Returns the boxes' corners and which are empty.
    """
    below, above = (rng.uniform(0, 1, points.shape) * 10.0 ** rng.uniform(-9, 0, (len(points), 1)) for _ in "ab")
    below[rng.random(points.shape) < 0.4] = 0
    above[rng.random(points.shape) < 0.4] = 0
    lower, upper = points - below, points + above
    found = shape.empty(lower, upper)
    assert not (found & held).any()
    assert not (shape.inside(lower, upper) & free).any()
    empty, inside = shape.empty(points, points), shape.inside(points, points)
    assert not (empty & (answer != OUT)).any()
    assert not (inside & (answer == OUT)).any()
    assert (empty | (answer != OUT)).all()
    return lower, upper, found
