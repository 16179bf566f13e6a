"""What the verifier's arithmetic says holds of the exact numbers: operations beside Arb, geometry beside fractions."""

import ast
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import trimesh
from bounding_shapes import DEEP, random_layers

flint = pytest.importorskip("flint", reason="the verifier needs python-flint (the extra verify)")
from verifier import files, float32, grid, mesh, network  # noqa: E402

FOLDER = Path(network.__file__).parent
RNG = np.random.default_rng(0)


@pytest.fixture(autouse=True)
def precise():
    with flint.ctx.workprec(200):
        yield


def test_nothing_of_the_library_is_imported():
    for path in FOLDER.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [node.module] if isinstance(node, ast.ImportFrom) else []
            names += [each.name for each in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                root = name.partition(".")[0]
                assert root in ("flint", "numpy", "verifier") or root in sys.stdlib_module_names, name
        assert "import_module" not in path.read_text(encoding="utf-8")


# --- balls -----------------------------------------------------------------------------------------------------------


def balls(*shape):
    """Of all sizes, with and without a radius."""
    mid = RNG.normal(size=shape) * 2.0 ** RNG.integers(-40, 8, shape)
    return network.Ball(
        mid, np.abs(RNG.normal(size=shape)) * 2.0 ** RNG.integers(-60, 2, shape) * RNG.integers(0, 2, shape)
    )


def members(ball):
    """Exact numbers of a ball: its ends, or one between."""
    share = np.vectorize(Fraction, otypes=[object])(RNG.choice([-1.0, 1.0, 0.375], ball.mid.shape))
    mid, rad = (np.vectorize(Fraction, otypes=[object])(each) for each in (ball.mid, ball.rad))
    return mid + share * rad


def holds(ball, exact):
    mid, rad = (np.vectorize(Fraction, otypes=[object])(each) for each in (ball.mid, ball.rad))
    return (abs(exact - mid) <= rad).all()


def test_operations_hold_exact_results():
    for _ in range(20):
        a, b = balls(30, 7), balls(30, 7)
        x, y = members(a), members(b)
        assert holds(a + b, x + y)
        assert holds(a * b, x * y)
        weight = RNG.normal(size=(5, 30))
        assert holds(weight @ a, np.vectorize(Fraction, otypes=[object])(weight) @ x)
        assert (np.vectorize(Fraction)(a.lower()) <= x).all()
        assert (np.vectorize(Fraction)(a.lower(-1)) <= -x).all()
        assert (np.vectorize(Fraction)(a.size()) >= abs(x)).all()


def test_sines_and_cosines_hold_those_of_arb():
    z = np.concatenate([RNG.uniform(-20, 20, 2000), RNG.uniform(-4096, 4096, 2000), np.arange(-50, 50) * np.pi / 2])
    z = network.Ball(z, np.abs(RNG.normal(size=len(z))) * 2.0 ** RNG.integers(-60, -20, len(z)))
    found = z.sine_cosine()
    for i, x in enumerate(members(z)):
        x = flint.arb(flint.fmpq(x.numerator, x.denominator))
        for ball, value in zip(found, (x.sin(), x.cos()), strict=True):
            assert abs(value - flint.arb(float(ball.mid[i]))) < flint.arb(float(ball.rad[i]))
    with pytest.raises(OverflowError):
        network.Ball(np.array([1e18])).sine_cosine()


# --- networks --------------------------------------------------------------------------------------------------------


def exactly(layers, activation, x):
    """f of a point by Arb."""
    values = [flint.arb(float(each)) for each in x]
    for index, (weight, bias) in enumerate(layers):
        if index:
            values = [z.sin() if activation == "sin" else z.max(flint.arb(0)) for z in values]
        values = [
            sum((flint.arb(float(w)) * h for w, h in zip(row, values, strict=True)), flint.arb(float(b)))
            for row, b in zip(weight, bias, strict=True)
        ]
    return values[0]


@pytest.mark.parametrize("activation", ["sin", "relu"])
@pytest.mark.parametrize("hidden", [(8,), DEEP, (13, 30, 5)])
def test_no_value_lies_under_its_bound(hidden, activation):
    layers = [(w.astype(float), b.astype(float)) for w, b in random_layers((3, *hidden, 1), RNG, 1.5, 4.0)]
    middle, half = RNG.uniform(-1, 1, (60, 3)), 2.0 ** RNG.integers(-14, 1, (60, 3)).astype(float)
    lower, upper = middle - half, middle + half
    least, base, slope, bent = network.lowest(layers, activation, lower, upper)
    assert (bent >= 0).all()
    for i in range(60):
        for corner in (RNG.integers(0, 2, 3), RNG.random(3), RNG.random(3)):
            x = np.clip(lower[i] + corner * (upper[i] - lower[i]), lower[i], upper[i])
            value = exactly(layers, activation, x)
            assert value >= least[i]
            away = [flint.arb(x[k]) - flint.arb(lower[i, k] + upper[i, k]) / 2 for k in range(3)]
            assert value >= flint.arb(base[i]) + sum(flint.arb(slope[i, k]) * away[k] for k in range(3))
    close = np.flatnonzero(half.max(axis=1) < 1 / 16)[:8]
    for i in close:
        given = layers, activation, lower[i], upper[i], (lower[i] + upper[i]) / 2
        assert network.confirms(*given, base[i], slope[i])
        assert network.confirms(*given, least[i], 0 * slope[i])
        value = float(exactly(layers, activation, middle[i]).mid())
        assert not network.confirms(*given, value + 1e-6, slope[i], 6)


def test_the_sine_of_float32_is_within_its_bound():
    z = np.concatenate([RNG.uniform(-6, 6, 100_000), RNG.uniform(-800, 800, 100_000)]).astype(np.float32)
    f = np.float32
    for fused in (False, True):
        wide = (lambda x: x.astype(float)) if fused else (lambda x: x)  # products that are rounded with the sum
        q = (wide(z) * f(1 / np.pi) + f(12582912.0)).astype(f)
        n = q - f(12582912.0)
        r = ((z - n * f(float32.PI_HIGH)) - wide(n) * f(float32.PI_LOW)).astype(f)
        s = r * r
        inner = (wide(s) * f(float32.S3) + f(float32.S2)).astype(f)
        inner = (wide(s) * inner + f(float32.S1)).astype(f)
        p = (wide(r * s) * inner + r).astype(f)
        off = np.abs(np.where(n % 2 == 0, p, -p).astype(float) - np.sin(z.astype(float)))
        assert off[:100_000].max() < float32.sine(6.0) < 3e-6
        assert off.max() < float32.sine(800.0) < 1e-4


def between(values, t):
    """What is multilinear between values at the nodes of a grid, one axis after the other, in fractions."""
    cell, exactly = np.minimum(t.astype(int), np.array(values.shape) - 2), np.vectorize(Fraction, otypes=[object])
    found = exactly(values[tuple(slice(k, k + 2) for k in cell)])
    for share in exactly(t - cell):
        found = found[0] + share * (found[1] - found[0])
    return found


def test_no_value_between_nodes_lies_under_its_bound():
    values, cells = RNG.normal(size=(9, 4, 6)), np.array([8, 3, 5])
    lower = RNG.integers(0, cells * 64, (80, 3)) / 64
    lower[:20] = RNG.integers(0, cells - 1, (20, 3))
    upper = np.floor(lower) + 1
    upper[:20] += RNG.integers(0, 2, (20, 3))
    upper[40:] = (upper[40:] + lower[40:]) / 2
    wide = (upper - lower > 1).any(axis=1)
    least, base, slope, _ = grid.lowest(values, lower, upper)
    for i in range(80):
        shares = np.concatenate([grid.CORNERS, RNG.integers(0, 65, (20, 3)) / 64])
        places = lower[i] + shares * (upper[i] - lower[i])
        f = [-between(values, t) for t in places]
        affine = [
            sum(Fraction(a) * Fraction(b) for a, b in zip(slope[i], t, strict=True))
            for t in places - places[:8].mean(axis=0)
        ]
        over = [value - part - Fraction(base[i]) for value, part in zip(f, affine, strict=True)]
        assert min(f) >= least[i]
        assert min(over) >= 0
        assert wide[i] or max(min(f) - Fraction(least[i]), min(over)) < 1e-9


# --- geometry --------------------------------------------------------------------------------------------------------


def test_what_separates_does_so_exactly_and_crossings_are_certain_or_unknown():
    for scale in (1.0, 2.0**-30, 1e10):
        corners = RNG.integers(-2, 3, (1500, 3, 3)) * scale
        corners[700:] *= 1 + RNG.integers(-1, 2, (800, 3, 3)) * 2.0**-52
        x, half = RNG.integers(-4, 5, (1500, 3)) * scale, RNG.integers(0, 3, (1500, 1)) * scale / 2
        direction, gap = RNG.integers(-4, 5, (1500, 3)) / 8, scale * RNG.integers(-1, 3, 1500)
        slope = RNG.integers(-4, 5, (1500, 3)) / 8 * RNG.integers(0, 2, (1500, 1))
        direction[::4] = -slope[::4]
        given = direction, corners, x - half, x + half, gap, slope
        said, exact = mesh.separates(*given), [mesh.exactly_separates(*each) for each in zip(*given, strict=True)]
        assert not (said & ~np.array(exact)).any()
        assert said.any()
        assert not mesh.exactly_separates(direction[0] + 4, corners[0], x[0], x[0], gap[0] - 99 * scale, slope[0])
        sign, certain = mesh.crossing(corners, x)
        assert certain.any()
        for i in np.flatnonzero(certain):
            assert sign[i] == crosses(corners[i], x[i])


def crosses(corners, x):
    """+1 or -1 where a half-line along axis 0 crosses a triangle's inside, in fractions."""
    seen = [[Fraction(a) - Fraction(b) for a, b in zip(corner, x, strict=True)] for corner in corners]
    areas = [q[1] * r[2] - q[2] * r[1] for q, r in ((seen[1], seen[2]), (seen[2], seen[0]), (seen[0], seen[1]))]
    turn = 1 if min(areas) > 0 else -1 if max(areas) < 0 else 0
    return turn * (turn * sum(area * corner[0] for area, corner in zip(areas, seen, strict=True)) > 0)


def test_points_and_boxes_outside_a_ring():
    ring = trimesh.creation.torus(0.7, 0.3, major_sections=12, minor_sections=8)
    made = mesh.Mesh(np.float32(ring.vertices).astype(float), np.array(ring.faces))
    x = RNG.uniform(-1.2, 1.2, (4000, 3)) * (1, 1, 0.4)
    inside = ring.contains(x)
    assert (made.outside(x) == ~inside).all()
    assert not made.outside(ring.vertices[:8]).any()
    box, triangle = (each.reshape(-1) for each in np.indices((200, len(ring.faces))))
    low, high = x[:200] - 0.02, x[:200] + 0.02
    near = made.gaps(low, high, box, triangle) <= 0.05**2
    gap, slope = np.full(200, 0.05), np.zeros((200, 3))
    free = np.bincount(box[near][~made.apart(low, high, box[near], triangle[near], gap, slope)], minlength=200) == 0
    nearest, away, _ = trimesh.proximity.closest_point(ring, x[:200])
    assert (away[free] > 0.05).all()
    assert free[away > 0.05 + 0.08].all()
    slope = (x[:200] - nearest) / away[:, None] * np.where(inside[:200, None], -0.9, 0.9)  # boxes may meet the surface
    free = np.bincount(box[~made.apart(low, high, box, triangle, 0.8 * away - 0.02, slope)], minlength=200) == 0
    for i in np.flatnonzero(free):
        y = x[i] + RNG.uniform(-0.02, 0.02, (20, 3))
        assert (trimesh.proximity.closest_point(ring, y)[1] > 0.8 * away[i] - 0.02 + (y - x[i]) @ slope[i]).all()
    assert free.sum() > 100
    assert (away[free] < 0.02).any()


@pytest.mark.parametrize("change", ["hole", "turned", "none"])
def test_meshes_without_a_certain_inside_are_refused(change):
    vertices, faces = np.eye(4)[:, :3] * 2, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    if change == "none":
        mesh.Mesh(
            vertices[[*range(4), 0]], np.where(faces == 0, [[4], [0], [0], [0]], faces)
        )  # one place, two vertices
        return
    faces = faces[:3] if change == "hole" else np.concatenate([faces[:3], faces[3:, ::-1]])
    with pytest.raises(ValueError, match="not closed"):
        mesh.Mesh(vertices, faces)


# --- files -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["obj", "stl", "ply"])
def test_mesh_files_are_read(tmp_path, kind):
    ring = trimesh.creation.torus(0.7, 0.3, major_sections=12, minor_sections=8)
    path = tmp_path / f"ring.{kind[:3]}"
    ring.export(path, file_type=kind, **({"digits": 17} if kind == "obj" else {}))
    vertices, faces = files.read_mesh(path)
    assert (np.float32(vertices) == vertices).all()
    tolerance = 0 if kind == "ply" else 1e-6
    assert np.abs(vertices[faces] - np.float32(ring.vertices)[ring.faces]).max() <= tolerance
    mesh.Mesh(vertices, faces)


DAMAGED = [("a.obj", "v 0 0 0\nf 1 2 3\n"), ("a.obj", "v a\n"), ("a.off", "OFF"), ("a.stl", "solid\n" + 40 * "facet ")]
DAMAGED += [("a.ply", "ply\nformat ascii 1.0\nend_header\n")]


@pytest.mark.parametrize(("name", "text"), DAMAGED)
def test_damaged_meshes_are_refused(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    with pytest.raises((ValueError, LookupError)):
        files.read_mesh(tmp_path / name)
