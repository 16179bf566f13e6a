"""Whatever is wrong with a file, a mesh or an array: one clear line that names it."""

import io
import signal
import struct
import sys

import numpy as np
import pytest
import trimesh
from PIL import Image

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators import IndicatorGrid, IndicatorMesh, load_indicator
from warp_bounding.indicators.formats.load import READERS

BINVOX = b"#binvox 1\ndim 2 2 2\ntranslate 0 0 0\nscale 1\ndata\n"
TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


def fails(source, *words, **options):
    """The error's message, checked to be one line that holds the words."""
    with pytest.raises(IndicatorError) as caught:
        load_indicator(source, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 400
    for word in words:
        assert word in message, message
    return message


def png(mode="RGBA", size=(8, 8)):
    buffer = io.BytesIO()
    Image.effect_noise(size, 50).convert(mode).save(buffer, "PNG")
    return buffer.getvalue()


def npy(array, **options):
    buffer = io.BytesIO()
    np.save(buffer, array, **options)
    return buffer.getvalue()


def npz(**arrays):
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def usda(body):
    return f'#usda 1.0\ndef Mesh "m" {{\n{body}\n}}\n'.encode()


GLB = trimesh.Scene(trimesh.creation.box()).export(file_type="glb")
STL = trimesh.creation.box().export(file_type="stl")
PLY = trimesh.creation.box().export(file_type="ply")
ARRAY = np.arange(24).reshape(2, 3, 4) > 5

BAD_FILES = {
    # --- images
    "opaque.png": (png("RGB"), "alpha channel", "RGB", "threshold='<128'", "threshold='>=128'"),
    "grey.png": (png("L"), "alpha channel", "threshold='<128'"),
    "cut.png": (png()[:-40], "PNG image"),
    "header.png": (png()[:20], "PNG image"),
    "other.png": (b"GIF89a and so on", "PNG image"),
    # --- voxels
    "other.binvox": (b"hello there", "#binvox"),
    "version.binvox": (b"#binvox 2\ndim 2 2 2\ndata\n", "version 1"),
    "endless.binvox": (b"#binvox 1\ndim 2 2 2\n", "'data'"),
    "long.binvox": (b"#binvox 1\n" + b"x" * 10_000, "'data'"),
    "nodim.binvox": (b"#binvox 1\nscale 1\ndata\n\x01\x08", "'dim'"),
    "baddim.binvox": (b"#binvox 1\ndim 2 2\ndata\n\x01\x08", "'dim'", "3 positive integers"),
    "zerodim.binvox": (b"#binvox 1\ndim 2 0 2\ndata\n\x01\x08", "3 positive integers"),
    "negdim.binvox": (b"#binvox 1\ndim 2 -2 2\ndata\n\x01\x08", "3 positive integers"),
    "hugedim.binvox": (b"#binvox 1\ndim 99999 99999 99999\ndata\n\x01\x08", "at most"),
    "scale.binvox": (b"#binvox 1\ndim 2 2 2\nscale x\ndata\n\x01\x08", "'scale'"),
    "key.binvox": (b"#binvox 1\nfoo 2\ndim 2 2 2\ndata\n\x01\x08", "header line"),
    "odd.binvox": (BINVOX + b"\x01\x04\x00", "pairs of bytes"),
    "short.binvox": (BINVOX + b"\x01\x04", "expected 8 voxels", "got 4"),
    "long8.binvox": (BINVOX + b"\x01\x04\x00\x05", "expected 8 voxels", "got 9"),
    "value.binvox": (BINVOX + b"\x02\x04\x00\x04", "0 and 1", "got 2"),
    "zero.binvox": (BINVOX + b"\x01\x00\x00\x08", "a run of 0"),
    "none.binvox": (BINVOX, "expected 8 voxels", "got 0"),
    "empty8.binvox": (BINVOX + b"\x00\x08", "nothing to bound"),
    "full8.binvox": (BINVOX + b"\x01\x08", "nothing to leave out"),
    # --- arrays
    "other.npy": (b"not an array at all", ".npy array"),
    "zip.npy": (npz(a=ARRAY), ".npy array"),
    "cut.npy": (npy(ARRAY)[:-3], ".npy array"),
    "cuthead.npy": (npy(ARRAY)[:9], ".npy array"),
    "more.npy": (npy(ARRAY) + b"!", "more data"),
    "object.npy": (npy(np.array([1, None], dtype=object), allow_pickle=True), "allow_pickle=False"),
    "pickle.npy": (b"\x80\x04N.", ".npy array"),
    "complex.npy": (npy(np.array([1j, 0])), "real numbers", "complex128"),
    "text.npy": (npy(np.array(["a", "b"])), "real numbers"),
    "date.npy": (npy(np.array(["2020-01-01"], dtype="M8[D]")), "real numbers"),
    "record.npy": (npy(np.zeros(2, dtype=[("a", "f4")])), "real numbers"),
    "nan.npy": (npy(np.array([0, np.nan, 1])), "NaN in 1 of 3"),
    "scalar.npy": (npy(np.array(1.0)), "at least one cell"),
    "zero.npy": (npy(np.zeros((0, 3))), "at least one cell"),
    "empty.npy": (npy(np.zeros((4, 4))), "nothing to bound"),
    "full.npy": (npy(np.ones((4, 4))), "nothing to leave out"),
    "other.npz": (b"not an archive", "not a zip archive"),
    "array.npz": (npy(ARRAY), "not a zip archive"),
    "cut.npz": (npz(a=ARRAY)[:-30], ".npz archive"),
    "none.npz": (npz(), "one array", "got []"),
    "many.npz": (npz(a=ARRAY, b=ARRAY), "one array", "'a', 'b'"),
    # --- meshes
    "other.obj": (b"this is prose\n", "mesh"),
    "points.obj": (b"v 0 0 0\nv 1 0 0\n", "mesh"),
    "nan.obj": (b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "finite"),
    "inf.obj": (b"v inf 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "finite"),
    "large.obj": (b"v 1e39 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "finite float32"),
    "range.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", ""),
    "line.obj": (b"v 0 0 0\nv 1 1 1\nv 2 2 2\nf 1 2 3\n", "without area"),
    "words.obj": (b"v a b c\nf 1 2 3\n", "mesh"),
    "other.ply": (b"nothing of the kind", ".ply mesh"),
    "cut.ply": (PLY[:-20], ".ply mesh"),
    "cut.stl": (STL[:-20], "mesh"),
    "other.stl": (b"prose", "mesh"),
    "facets.stl": (b"\0" * 80 + struct.pack("<I", 0), "mesh"),
    "range.off": (b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", ""),
    "other.off": (b"prose", ".off mesh"),
    "cut.glb": (GLB[:-200], ".glb mesh"),
    "other.glb": (b"prose and more prose", ".glb mesh"),
    "other.gltf": (b"{", ".gltf mesh"),
    # --- USD
    "other.usd": (b"prose", "USD stage"),
    "cut.usda": (b'#usda 1.0\ndef Mesh "m" {', "USD stage"),
    "other.usdc": (b"PXR-USDC\0\0\0\0 and nothing more", "USD stage"),
    "other.usdz": (b"PK and nothing more", "USD stage"),
    "none.usda": (b"#usda 1.0\n", "meshes", "none"),
    "ball.usda": (b'#usda 1.0\ndef Sphere "c" {}\n', "meshes", "Sphere", "/c"),
    "bare.usda": (usda(""), "faces"),
    "counts.usda": (
        usda("point3f[] points=[(0,0,0),(1,0,0),(0,1,0)] int[] faceVertexCounts=[3,3] int[] faceVertexIndices=[0,1,2]"),
        "/m",
        "expected 6 indices",
    ),
    "range.usda": (
        usda("point3f[] points=[(0,0,0),(1,0,0),(0,1,0)] int[] faceVertexCounts=[3] int[] faceVertexIndices=[0,1,3]"),
        "/m",
        "got vertex 3",
    ),
    "edge.usda": (
        usda("point3f[] points=[(0,0,0),(1,0,0)] int[] faceVertexCounts=[2] int[] faceVertexIndices=[0,1]"),
        "at least 3 vertices",
    ),
    "nan.usda": (
        usda("point3f[] points=[(nan,0,0),(1,0,0),(0,1,0)] int[] faceVertexCounts=[3] int[] faceVertexIndices=[0,1,2]"),
        "finite",
    ),
    "reference.usda": (b'#usda 1.0\ndef Xform "x" (references = @gone.usda@) {}\n', "complete USD stage"),
    "instancer.usda": (b'#usda 1.0\ndef PointInstancer "p" {}\n', "point instancer"),
    # --- anything else
    "shape.xyz": (b"1 2 3", "expected one of", "'.xyz'"),
    "shape": (b"1 2 3", "expected one of", "no extension"),
    "bunny.safetensors": (b"a bounder", "expected a shape, got a bounder's file"),
}
for _name in "range.usda", "counts.usda", "edge.usda", "nan.usda":  # one property a line, as USD wants it
    _content, *_words = BAD_FILES[_name]
    BAD_FILES[_name] = (_content.replace(b" int[]", b"\nint[]"), *_words)


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_file(tmp_path, name):
    content, *words = BAD_FILES[name]
    (tmp_path / name).write_bytes(content)
    fails(tmp_path / name, name, *words)


@pytest.mark.parametrize("suffix", READERS)
class TestEveryFormat:
    def test_missing(self, tmp_path, suffix):
        fails(tmp_path / f"gone{suffix}", f"gone{suffix}", "no such file")

    def test_empty(self, tmp_path, suffix):
        (tmp_path / f"empty{suffix}").touch()
        fails(tmp_path / f"empty{suffix}", f"empty{suffix}", "it is empty")

    def test_directory(self, tmp_path, suffix):
        (tmp_path / f"folder{suffix}").mkdir()
        fails(tmp_path / f"folder{suffix}", f"folder{suffix}", "a directory")

    def test_noise(self, tmp_path, suffix, rng):
        (tmp_path / f"noise{suffix}").write_bytes(rng.bytes(5000))
        fails(tmp_path / f"noise{suffix}", f"noise{suffix}", "expected")


@pytest.mark.parametrize("part", range(1, 10))
@pytest.mark.parametrize("content", ["png", "npy", "npz", "stl", "ply", "glb", "binvox"])
def test_truncated_anywhere(tmp_path, content, part):
    whole = {
        "png": png(), "npy": npy(ARRAY), "npz": npz(a=ARRAY), "stl": STL, "ply": PLY, "glb": GLB,
        "binvox": BINVOX + bytes([0, 1, 1, 1] * 4),
    }[content]  # fmt: skip
    path = tmp_path / f"cut.{content}"
    path.write_bytes(whole[: len(whole) * part // 10])
    fails(path, path.name)


def test_usdc_truncated_anywhere(tmp_path, bunny_path):
    whole = bunny_path.read_bytes()
    for part in range(1, 10):
        path = tmp_path / f"cut{part}.usd"
        path.write_bytes(whole[: len(whole) * part // 10])
        fails(path, path.name)


@pytest.mark.parametrize("source", [None, 3, 1.5, [[0, 1]], b"\0", object(), "a\0b.png", ""])
def test_sources_of_another_kind(source):
    fails(source)


@pytest.mark.parametrize("time", [1, "yes", np.array([True])])
def test_time_must_be_a_truth_value(time):
    fails(ARRAY, "time must be", time=time)


def test_time_needs_a_second_coordinate():
    fails(np.array([0, 1]), "time", time=True)


def test_meshes_have_no_time():
    fails(trimesh.creation.box(), "no time coordinate", time=True)


def test_distances_with_infinity_are_asked_about():
    message = fails(np.array([[0.0, np.inf], [3.0, 5.0]]), "load_indicator(a < 2.5)")
    assert "a < inf" not in message


@pytest.mark.parametrize("spacing", ["0.1", True, [True, True], 1j])
def test_what_is_no_spacing(spacing):
    fails(ARRAY[0], "spacing must be 2 numbers", "got", spacing=spacing)


def test_masked_arrays_are_refused():
    fails(np.ma.array([0, 1], mask=[0, 1]), "masked")


def test_unreadable_file_name_too_long():
    fails("a" * 300 + ".png")


@pytest.mark.parametrize(
    ("name", "module", "package"),
    [("a.png", "PIL.Image", "pillow"), ("a.usd", "pxr.Usd", "usd-core")],
)
def test_missing_package_names_what_to_install(tmp_path, monkeypatch, name, module, package):
    (tmp_path / name).write_bytes(b"content")
    monkeypatch.setitem(sys.modules, module, None)  # makes the import fail
    fails(tmp_path / name, name, package, "pip install 'warp-bounding[train]'")


def test_ctrl_c_is_not_lost_in_an_import(tmp_path, monkeypatch):
    """Some packages look for their optional parts with ``except BaseException``."""
    seen = []

    def swallows(module):
        try:
            signal.raise_signal(signal.SIGINT)
        except BaseException as error:
            seen.append(error)
        return sys.modules[module]

    (tmp_path / "a.png").write_bytes(png())
    monkeypatch.setattr("importlib.import_module", swallows)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a process in the background may ignore it
    try:
        with pytest.raises(KeyboardInterrupt):
            load_indicator(tmp_path / "a.png")
        assert not seen
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


BAD_MESHES = {
    "no faces": (TRIANGLE, np.zeros((0, 3), dtype=int), "faces"),
    "flat vertices": ([0, 0, 0], [[0, 1, 2]], "(V, 3)"),
    "2-D vertices": ([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], "(V, 3)"),
    "text": ([["a", "b", "c"]], [[0, 0, 0]], "(V, 3)"),
    "nan": ([[np.nan, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], "finite"),
    "infinite": ([[np.inf, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], "finite"),
    "overflow": ([[1e39, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], "finite float32"),
    "unused nan": ([*TRIANGLE, [np.nan, 0, 0]], [[0, 1, 2]], "finite"),
    "quads": ([*TRIANGLE, [1, 1, 0]], [[0, 1, 2, 3]], "(F, 3)"),
    "float faces": (TRIANGLE, [[0.0, 1.0, 2.0]], "integers"),
    "too high": (TRIANGLE, [[0, 1, 3]], "vertex 3"),
    "too low": (TRIANGLE, [[-1, 1, 2]], "vertex -1"),
    "a point": ([[1, 2, 3]] * 3, [[0, 1, 2]], "without area"),
    "lines": ([[0, 0, 0], [1, 2, 3], [2, 4, 6]], [[0, 1, 2], [0, 0, 1]], "without area"),
}


@pytest.mark.parametrize("case", BAD_MESHES)
def test_bad_mesh(case):
    vertices, faces, word = BAD_MESHES[case]
    with pytest.raises(IndicatorError, match=r"part\.stl: expected") as caught:
        IndicatorMesh(np.array(vertices), np.array(faces), name="part.stl")
    assert word in str(caught.value)


def test_a_trimesh_that_went_wrong():
    box = trimesh.creation.box()
    box.vertices[3] = np.nan
    fails(box, "finite")
    fails(trimesh.Trimesh(), "faces")
    fails(trimesh.Scene(), "faces")


@pytest.mark.parametrize("resolution", [1, 0, -4, 1025, 2.5, 64.0, "64", True, np.nan])
def test_bad_resolution(resolution):
    with pytest.raises(IndicatorError, match="resolution must be an integer from 2 to 1024"):
        load_indicator(trimesh.creation.box()).to_grid(resolution=resolution)


@pytest.mark.parametrize("margin", [-1e-9, -1, np.nan, np.inf, "wide", None])
def test_bad_margin_of_a_mesh(margin):
    with pytest.raises(IndicatorError, match="margin must be finite and non-negative"):
        load_indicator(trimesh.creation.box()).to_grid(margin=margin)


@pytest.mark.parametrize("margin", [1e300, 1e40])
def test_margin_too_large_for_float32_cells(margin):
    with pytest.raises(IndicatorError, match="that float32 cells can divide"):
        load_indicator(trimesh.creation.box()).to_grid(margin=margin)


def test_mesh_too_far_away():
    far = trimesh.creation.box()
    far.apply_translation([1e6, 0, 0])
    with pytest.raises(IndicatorError, match="of the origin"):
        load_indicator(far).to_grid()


@pytest.mark.parametrize(
    ("margin", "words"), [(-1, "non-negative"), (np.nan, "finite"), (1e300, "suffice"), (1e9, "suffice")]
)
def test_bad_margin_of_a_grid(margin, words):
    with pytest.raises(IndicatorError, match=words):
        IndicatorGrid(ARRAY).to_grid(margin=margin)


def test_a_grid_brings_its_own_resolution():
    with pytest.raises(IndicatorError, match="its own resolution"):
        IndicatorGrid(ARRAY).to_grid(resolution=8)
