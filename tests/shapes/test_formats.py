"""Every format is read as it was written, noted or refused; so are arrays and objects of other libraries."""

import contextlib
import subprocess
import sys
import zlib

import numpy as np
import pytest
import trimesh
import warp as wp
from format_cases import READ, REFUSED, cubes, obj, ros, usd, usd_mesh, written
from PIL import Image

import warp_bounding as wb
from warp_bounding.errors import ShapeError
from warp_bounding.shapes import Grid, load_shape
from warp_bounding.shapes.formats import arrays, load
from warp_bounding.shapes.formats.load import READERS

LONGEST = 400  # characters of an error


def refused(source, *words, **options):
    """One line that holds the words."""
    with pytest.raises(ShapeError) as caught:
        load_shape(source, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < LONGEST
    for word in words:
        assert word in message, message


def id_of(value) -> str:
    return value if isinstance(value, str) and len(value) < 30 else ""


@pytest.mark.parametrize(("name", "content", "options", "check", "words"), READ, ids=id_of)
def test_what_is_read(tmp_path, name, content, options, check, words):
    shape = load_shape(written(tmp_path, name, content), **options)
    message = f"{shape.restriction}{getattr(shape, 'remark', '')}"
    assert words in message
    assert bool(message) == (words != "")
    check(shape)


@pytest.mark.parametrize(("name", "content", "options", "words"), REFUSED, ids=id_of)
def test_what_is_refused(tmp_path, name, content, options, words):
    refused(written(tmp_path, name, content), name[-4:], words, **options)


COUNTED = (".stl", ".ply", ".off", ".glb", ".gltf", ".dae", ".png", ".binvox", ".npy", ".npz")
CUTS = 6


@pytest.mark.parametrize(("name", "content", "options"), [row[:3] for row in READ if row[0][1:] in COUNTED], ids=id_of)
def test_what_is_cut_off_is_refused_or_whole(tmp_path, name, content, options):
    """Files of formats that say how much they hold end early, at places that differ from row to row."""
    path = written(tmp_path, name, content)
    whole, content = load_shape(path, **options), path.read_bytes()
    rng = np.random.default_rng(zlib.crc32(content))
    for end in rng.integers(1, len(content), CUTS):
        path.write_bytes(content[:end])
        with contextlib.suppress(ShapeError):
            assert load_shape(path, **options).digest == whole.digest


BINARY = [row[:3] for row in READ if row[0][1:] in (*COUNTED, ".pgm") and isinstance(row[1], bytes)]
BINARY = [row for row in BINARY if b"\0" in row[1] or not row[1].isascii()]


@pytest.mark.parametrize(("name", "content", "options"), BINARY, ids=id_of)
def test_a_byte_more_or_less_never_moves_what_follows_it(tmp_path, name, content, options):
    path = written(tmp_path, name, content)
    whole = load_shape(path, **options)
    rng = np.random.default_rng(zlib.crc32(content))
    for at in [*rng.integers(1, min(len(content), 100), CUTS), *rng.integers(1, len(content), CUTS), len(content)]:
        for other in (content[:at] + bytes([rng.integers(256)]) + content[at:], content[:at] + content[at + 1 :]):
            path.write_bytes(other)
            with contextlib.suppress(ShapeError):
                assert load_shape(path, **options).digest == whole.digest


QUIET = """
import sys, warp_bounding as wb
from warp_bounding.runtime.progress import quiet_warp
quiet_warp()
for path, level, hollow in zip(*[iter(sys.argv[1:])] * 3):
    try:
        wb.load_shape(path, level=level or None, hollow=hollow or None)
    except wb.BoundingError:
        pass
"""


def test_no_reader_writes_to_standard_error(tmp_path):
    """Neither a library's log, nor its warnings, nor what it prints."""
    given = []
    for number, (name, content, options, *_) in enumerate([*READ, *REFUSED]):
        (folder := tmp_path / str(number)).mkdir()
        given += [str(written(folder, name, content)), options.get("level", ""), options.get("hollow", "")]
    command = [sys.executable, "-W", "default", "-c", QUIET, *given]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")


PIXELS = [row[:3] for row in READ if row[0][1:] in (".png", ".pgm", ".yaml", ".binvox")]


@pytest.mark.parametrize(("name", "content", "options"), PIXELS, ids=id_of)
def test_the_limit_of_cells_is_the_only_one(tmp_path, monkeypatch, name, content, options):
    path = written(tmp_path, name, content)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 1)
    shape = load_shape(path, **options)
    size = getattr(shape, "local", shape).occupancy.size
    assert Image.MAX_IMAGE_PIXELS == 1
    monkeypatch.setattr(arrays, "MAX_CELLS", size - 1)
    refused(path, f"expected 1 to {size - 1} cells, got ", **options)


def test_slow_files_are_reported_by_name(tmp_path, monkeypatch):
    path, seen = written(tmp_path, "a.obj", obj()), []
    monkeypatch.setattr(load, "slow", lambda what: contextlib.nullcontext(seen.append(what)))
    for source in (path, str(path), BOX, np.eye(4)):
        load_shape(source)
    assert seen == ["reading a.obj"] * 2


def test_a_package_of_usd(tmp_path):
    from pxr import Sdf, UsdUtils

    path = written(tmp_path, "a.usda", usd(usd_mesh()))
    assert UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(path)), str(tmp_path / "b.usdz"))
    cubes()(load_shape(tmp_path / "b.usdz"))


def test_a_fan_holds_a_polygon_that_is_not_convex(tmp_path, rng):
    """A prism over a U: what is in it is in the shape, although a triangle lies across the opening."""
    ring = np.array([[0, 0], [3, 0], [3, 3], [2, 3], [2, 1], [1, 1], [1, 3], [0, 3]], float)
    points = np.array([[x, y, z] for z in (0, 1) for x, y in ring])
    walls = [(k, (k + 1) % 8, (k + 1) % 8 + 8, k + 8) for k in range(8)]
    shape = load_shape(
        written(tmp_path, "u.obj", obj((tuple(range(7, -1, -1)), tuple(range(8, 16)), *walls), points=points))
    )
    x = rng.uniform([0, 0, 0], [3, 3, 1], (2000, 3))
    inside = (x[:, 1] < 1) | (np.abs(x[:, 0] - 1.5) > 0.5)
    assert shape.contains(x)[inside].all()


BOX = trimesh.creation.box(extents=(1, 2, 3))


@pytest.mark.parametrize(("ndim", "dtype"), [(1, bool), (3, np.int64), (4, np.float16), (6, bool)])
def test_arrays_and_npy_of_any_dimension(tmp_path, rng, ndim, dtype):
    occupancy = rng.random((4,) * ndim) < 0.5
    occupancy.flat[:2] = False, True
    array = occupancy.astype(dtype)
    np.save(tmp_path / "a.npy", array)
    for grid in load_shape(array), load_shape(str(tmp_path / "a.npy")), load_shape(tmp_path / "a.npy"):
        assert isinstance(grid, Grid)
        assert np.array_equal(grid.occupancy, occupancy)
        assert grid.time == (ndim == 4)


def test_arrays_are_copied_and_time_comes_first_in_4d():
    array = np.eye(4, dtype=bool)
    grid = load_shape(array)
    before = grid.occupancy.copy()
    array[:] = ~array
    assert np.array_equal(grid.occupancy, before)
    with pytest.raises(ValueError, match="read-only"):
        grid.occupancy[0, 0] = True
    for ndim, time, expected in ((4, None, True), (4, False, False), (3, None, False), (3, True, True)):
        array = np.arange(2**ndim).reshape((2,) * ndim) < 3
        assert load_shape(array, time=time).time is expected


def test_scenes_of_trimesh():
    ball = trimesh.creation.icosphere(subdivisions=1).apply_translation([10, 0, 0])
    mesh = load_shape(trimesh.Scene([BOX, ball]))
    assert (mesh.vertices.dtype, mesh.faces.dtype) == (np.float32, np.int32)
    assert (len(mesh.faces), mesh.watertight) == (12 + 80, True)
    assert np.allclose(mesh.bounds, [[-0.5, -1, -1.5], [11, 1, 1.5]])
    assert "PointCloud" in load_shape(trimesh.Scene([BOX, trimesh.PointCloud([[0, 0, 0], [5, 5, 5]])])).note


@pytest.mark.parametrize("name", ["a.npy", "a.obj"])
def test_a_file_gives_its_name_and_not_its_folder(tmp_path, name):
    path = tmp_path / "somebody" / name
    path.parent.mkdir()
    np.save(path, np.eye(4)) if path.suffix == ".npy" else BOX.export(path)
    shape = load_shape(path)
    assert shape.name == shape.to_grid().name == name
    bounder = wb.fit(shape, method="aabb", device="cpu")
    assert bounder.info["name"] == name
    bounder.save(tmp_path / "b.safetensors")
    assert b"somebody" not in (tmp_path / "b.safetensors").read_bytes()


MAP = np.array([[0, 254, 205], [127, 128, 255]], dtype=np.uint8)  # a map of a robot: dark is a wall, white is free
VERTICES, FACES = np.asarray(BOX.vertices, dtype=np.float32), np.asarray(BOX.faces, dtype=np.int32)


def test_meshes_and_arrays_of_other_libraries(device):
    torch = pytest.importorskip("torch")
    points = wp.array(VERTICES, dtype=wp.vec3, device=device)
    mesh = wp.Mesh(points, wp.array(FACES.ravel(), dtype=wp.int32, device=device))
    for source, name in (
        ((VERTICES.tolist(), FACES.tolist()), "mesh"),
        ((torch.tensor(VERTICES, requires_grad=True), torch.tensor(FACES)), "mesh"),
        ((points, wp.array(FACES, dtype=wp.int32, device=device)), "mesh"),
        (mesh, "wp.Mesh"),
    ):
        shape = load_shape(source)
        assert (shape.digest, shape.name) == (load_shape(BOX).digest, name)
    bounder = wb.fit(mesh, method="aabb", resolution=8)
    assert wb.certify(bounder, mesh).proven
    assert wb.evaluate(bounder, mesh, samples=1000).fn == 0
    occupancy = np.random.default_rng(0).random((4, 5, 6)) < 0.3
    signed = torch.tensor(np.where(occupancy, -1.0, 1.0))
    for source, options in (
        (torch.tensor(occupancy), {}),
        (wp.array(occupancy.astype(np.uint8), device=device), {}),
        (signed, {"level": "<=0"}),
    ):
        assert load_shape(source, **options).digest == load_shape(occupancy).digest
    refused(signed, "level='<=0'")


@pytest.mark.parametrize(
    ("origin", "resolution"),
    [((-2.03, -3.11), 0.05), ((1e-9, -1e-9), 0.03), ((500000.13, 4649776.37), 0.1), ((-7e8, 3.3), 0.15)],
)
def test_no_wall_of_a_map_is_denied_wherever_it_lies(tmp_path, origin, resolution):
    values = np.full((30, 50), 254, np.uint8)
    values[4:9, 10:31] = values[20:, 40:] = 0
    shape = load_shape(written(tmp_path, "m.yaml", ros(values, origin=[*origin, 0], resolution=resolution)))
    bounder = wb.fit(shape, method="aabb", device="cpu")
    assert bounder.certificate.proven
    row, column = np.nonzero(values == 0)
    walls = np.stack([column, len(values) - 1 - row], axis=1) * resolution + np.array(origin)  # lower corners
    steps = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0.5, 0.5]]) * resolution
    x = (walls[:, None] + steps).reshape(-1, 2)  # corners and centres, as float64 has them
    assert bounder.query(x).numpy().all()
    near = np.abs(x).max() * 2.0**-24 < resolution / 8  # of what float32 holds, the same, but for its own rounding
    middles = (walls + resolution / 2).astype(np.float32)
    assert not near or bounder.query(middles).numpy().all()
    assert not bounder.query(np.array(origin)[None] - resolution).numpy().any()
    assert wb.certify(bounder, shape).proven


@pytest.mark.parametrize("query", ["ray", "plane", "box"])
def test_regions_of_a_map_at_any_origin(tmp_path, query):
    values = np.full((12, 16), 254, np.uint8)
    values[3:6, 5:9] = 0
    shape = load_shape(written(tmp_path, "m.yaml", ros(values, origin=[500000.13, 4649776.37, 0])))
    bounder = wb.fit(shape, query, "kdop", device="cpu")
    middle = shape.origin + 0.05 * np.array([7.0, 12 - 4.5])
    x = {"ray": [middle - [0.3, 0], [1, 0]], "plane": [[1, 0], middle], "box": [middle, middle]}[query]
    assert bounder.query(np.concatenate(x)[None]).numpy()[0] == 1
    away = {"ray": [middle + 9, [1, 0]], "plane": [[1, 0], middle + 9], "box": [middle + 9, middle + 10]}[query]
    assert bounder.query(np.concatenate(away)[None]).numpy()[0] == 0
    assert wb.certify(bounder, shape).proven


def test_pictures_as_objects():
    picture = Image.fromarray(MAP)
    np.testing.assert_array_equal(load_shape(picture, level="<128").occupancy, MAP < 128)
    refused(picture, "level")
    alpha = Image.fromarray(np.stack([MAP] * 4, axis=2))
    np.testing.assert_array_equal(load_shape(alpha).occupancy, MAP >= 128)


@pytest.mark.parametrize(
    ("kind", "value"), [(np.float32, 0.1), (np.int64, 2**53), (np.uint64, 2**62), (np.float16, 0.1)]
)
def test_levels_compare_exactly(kind, value):
    array = np.array([value, 0], kind)
    exact = int(array[0]) if array.dtype.kind in "iu" else float(array[0])
    bound = float(value)
    for sign, holds in (("<", exact < bound), ("<=", exact <= bound), (">", exact > bound), (">=", exact >= bound)):
        occupied = load_shape(
            np.array([array[0]] * 2 + [0 if holds == (sign[0] == ">") else 2 * array[0] + 1], kind),
            level=f"{sign}{value!r}",
        ).occupancy
        assert bool(occupied[0]) == holds


@pytest.mark.parametrize(
    ("name", "module", "package"),
    [
        ("a.png", "PIL.Image", "pillow"),
        ("a.usd", "pxr.Usd", "usd-core"),
        ("a.stl", "trimesh", "trimesh"),
        ("m.yaml", "yaml", "pyyaml"),
    ],
)
def test_missing_package_names_what_to_install(tmp_path, monkeypatch, name, module, package):
    (tmp_path / name).write_bytes(b"content")
    monkeypatch.setitem(sys.modules, module, None)  # makes the import fail
    refused(tmp_path / name, name, package, "pip install 'warp-bounding[train]'")


@pytest.mark.parametrize("suffix", READERS)
def test_what_is_no_file_of_a_format(tmp_path, suffix, rng):
    for name, make, word in (
        ("gone", lambda path: None, "no such file"),
        ("empty", lambda path: path.touch(), "it is empty"),
        ("folder", lambda path: path.mkdir(), "a directory"),
        ("noise", lambda path: path.write_bytes(rng.bytes(5000)), "expected"),
    ):
        make(path := tmp_path / f"{name}{suffix}")
        refused(path, path.name, word)


CELLS = MAP < 128
NO_SHAPES = (
    *((MAP, "level must be a number or a text such as", {"level": t}) for t in ("", "<x", True, np.nan, [3])),
    (CELLS, "spacing must be positive", {"spacing": 0}),
    (CELLS, "spacing must be 2 numbers or one for all", {"spacing": (1, 2, 3)}),
    (CELLS, "cells_per_unit must be positive float32", {"spacing": 1e-60}),
    *((CELLS, "origin must be 2 numbers", {"origin": origin}) for origin in (1.0, (0, np.inf))),
    (np.arange(120).reshape(2, 3, 4, 5) % 3 == 0, "spacing must be 4 numbers", {"spacing": 0.1}),
    *(((VERTICES, FACES), "is for arrays and images", {name: 1.0}) for name in ("level", "spacing", "origin")),
    ((VERTICES,), "a pair (vertices, faces), got a tuple of 1", {}),
    ((VERTICES, [[0, 1, 99]]), "got vertex 99", {}),
    *((source, "", {}) for source in ([VERTICES, FACES], None, 3, [[0, 1]], b"\0", object(), "a\0b.png", "")),
    (CELLS, "time must be", {"time": "yes"}),
    (np.array([0, 1]), "time", {"time": True}),
    (BOX, "no time coordinate", {"time": True}),
)


def test_what_is_no_shape():
    for source, words, options in NO_SHAPES:
        refused(source, words, **options)
    refused(load_shape(CELLS), "is for arrays and images", "Grid", level=1)
