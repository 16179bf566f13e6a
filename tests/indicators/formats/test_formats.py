"""Every format is read as it was written."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

import warp_bounding as wb
from warp_bounding.indicators import IndicatorGrid, IndicatorMesh, load_indicator

DATA = Path(os.environ.get("WARP_BOUNDING_DATA", Path(__file__).parents[4] / "shared" / "data"))
BOX = trimesh.creation.box(extents=(1, 2, 3))


def save_png(path, alpha, mode="RGBA"):
    picture = Image.new("RGBA", alpha.shape[::-1], (10, 20, 30, 255))
    picture.putalpha(Image.fromarray(alpha))
    picture.convert(mode).save(path)


@pytest.mark.parametrize("mode", ["RGBA", "LA"])
def test_png_reads_rows_first_and_half_alpha_as_occupied(tmp_path, mode):
    alpha = np.array([[0, 127, 128], [255, 1, 200]], dtype=np.uint8)
    save_png(tmp_path / "a.png", alpha, mode)
    grid = load_indicator(tmp_path / "a.png")
    assert grid.occupancy.tolist() == [[False, False, True], [True, False, True]]
    assert not grid.time
    assert grid.name.endswith("a.png")


def test_png_palette_with_transparency(tmp_path):
    picture = Image.new("P", (2, 2))
    picture.putpalette([0, 0, 0, 255, 0, 0, 0, 255, 0])
    picture.putdata([0, 1, 1, 2])
    picture.save(tmp_path / "p.png", transparency=bytes([0, 255, 128]))
    assert load_indicator(tmp_path / "p.png").occupancy.tolist() == [[False, True], [True, True]]


def test_png_transparent_colour(tmp_path):
    pixels = np.zeros((2, 2, 3), dtype=np.uint8)
    pixels[0, 1] = 9
    Image.fromarray(pixels).save(tmp_path / "c.png", transparency=(9, 9, 9))
    assert load_indicator(tmp_path / "c.png").occupancy.tolist() == [[True, False], [True, True]]


def test_binvox_round_trip(tmp_path, blob, write_binvox):
    write_binvox(tmp_path / "a.binvox", blob)
    assert np.array_equal(load_indicator(tmp_path / "a.binvox").occupancy, blob)


def test_binvox_runs_longer_than_a_byte(tmp_path, write_binvox):
    occupancy = np.zeros((10, 10, 10), dtype=bool)
    occupancy[3:] = True
    write_binvox(tmp_path / "a.binvox", occupancy)
    assert np.array_equal(load_indicator(tmp_path / "a.binvox").occupancy, occupancy)


def test_binvox_order_is_x_z_y(tmp_path):
    """The second voxel of the file is the neighbour in y."""
    header = b"#binvox 1\ndim 2 2 2\ntranslate 0 0 0\nscale 1\ndata\n"
    (tmp_path / "a.binvox").write_bytes(header + bytes([0, 1, 1, 1, 0, 6]))
    assert load_indicator(tmp_path / "a.binvox").occupied.tolist() == [[0, 1, 0]]


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=30)
@given(shape=st.lists(st.integers(1, 9), min_size=3, max_size=3), seed=st.integers(0, 2**32 - 1))
def test_binvox_round_trip_of_any_shape(tmp_path, write_binvox, shape, seed):
    occupancy = np.random.default_rng(seed).random(shape) < 0.5
    if occupancy.all() or not occupancy.any():
        return
    write_binvox(tmp_path / "a.binvox", occupancy)
    assert np.array_equal(load_indicator(tmp_path / "a.binvox").occupancy, occupancy)


@pytest.mark.parametrize("ndim", [1, 2, 3, 4, 5, 6])
@pytest.mark.parametrize("dtype", [bool, np.uint8, np.int64, np.float16, np.float64])
def test_arrays_and_npy_of_any_dimension(tmp_path, rng, ndim, dtype):
    occupancy = rng.random((4,) * ndim) < 0.5
    occupancy.flat[:2] = False, True
    array = occupancy.astype(dtype)
    np.save(tmp_path / "a.npy", array)
    for grid in load_indicator(array), load_indicator(str(tmp_path / "a.npy")), load_indicator(tmp_path / "a.npy"):
        assert isinstance(grid, IndicatorGrid)
        assert np.array_equal(grid.occupancy, occupancy)
        assert grid.time == (ndim == 4)


@pytest.mark.parametrize("order", ["C", "F"])
def test_array_memory_order_is_no_matter(tmp_path, blob, order):
    np.save(tmp_path / "a.npy", np.array(blob, order=order))
    assert load_indicator(tmp_path / "a.npy").digest == load_indicator(blob).digest


def test_the_array_is_copied(blob):
    grid = load_indicator(blob)
    before = grid.occupancy.copy()
    blob[:] = ~blob
    assert np.array_equal(grid.occupancy, before)
    with pytest.raises(ValueError, match="read-only"):
        grid.occupancy[0, 0, 0] = True


def test_npz_single_or_named(tmp_path, blob):
    np.savez(tmp_path / "one.npz", anything=blob)
    np.savez_compressed(tmp_path / "many.npz", occupancy=blob, other=np.zeros(3))
    assert np.array_equal(load_indicator(tmp_path / "one.npz").occupancy, blob)
    assert np.array_equal(load_indicator(tmp_path / "many.npz").occupancy, blob)


@pytest.mark.parametrize(
    ("ndim", "time", "expected"), [(4, None, True), (4, False, False), (3, None, False), (3, True, True)]
)
def test_time(ndim, time, expected):
    array = np.arange(2**ndim).reshape((2,) * ndim) < 3
    assert load_indicator(array, time=time).time is expected
    assert load_indicator(load_indicator(array), time=expected).time is expected


def test_indicators_pass_through(blob):
    grid, mesh = load_indicator(blob), load_indicator(BOX)
    assert load_indicator(grid) is grid
    assert load_indicator(mesh) is mesh


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".stl", ".glb", ".gltf", ".off", ".OBJ"])
def test_mesh_formats(tmp_path, suffix):
    if suffix == ".gltf":
        for name, content in trimesh.Scene(BOX).export(file_type="gltf").items():
            (tmp_path / name).write_bytes(content)
        path = tmp_path / "model.gltf"
    else:
        path = tmp_path / f"box{suffix}"
        BOX.export(path, file_type=suffix[1:].lower())
    mesh = load_indicator(path)
    assert isinstance(mesh, IndicatorMesh)
    assert mesh.ndim == 3
    assert mesh.vertices.dtype == np.float32
    assert mesh.faces.dtype == np.int32
    assert len(mesh.faces) == 12
    assert mesh.watertight
    assert np.array_equal(mesh.bounds, [[-0.5, -1, -1.5], [0.5, 1, 1.5]])


def test_obj_with_polygons_and_negative_indices(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf -4 -3 -2 -1\n")
    mesh = load_indicator(tmp_path / "a.obj")
    assert len(mesh.faces) == 2
    assert mesh.bounds.tolist() == [[0, 0, 0], [1, 1, 0]]


def test_scenes_keep_every_part_in_its_place(tmp_path):
    scene = trimesh.Scene()
    scene.add_geometry(BOX, geom_name="box")
    scene.add_geometry(
        trimesh.creation.icosphere(subdivisions=1), transform=trimesh.transformations.translation_matrix([10, 0, 0])
    )
    scene.export(tmp_path / "s.glb")
    for mesh in load_indicator(tmp_path / "s.glb"), load_indicator(scene):
        assert np.allclose(mesh.bounds, [[-0.5, -1, -1.5], [11, 1, 1.5]])
        assert len(mesh.faces) == 12 + 80
        assert mesh.watertight


def test_parts_that_are_no_meshes_are_named():
    scene = trimesh.Scene([BOX, trimesh.PointCloud([[0, 0, 0], [5, 5, 5]])])
    mesh = load_indicator(scene)
    assert "PointCloud" in mesh.note
    assert "PointCloud" in mesh.to_grid(resolution=4).note


@pytest.mark.skipif(not DATA.is_dir(), reason=f"the paper's data set is not at {DATA} (set WARP_BOUNDING_DATA)")
@pytest.mark.parametrize(("folder", "shape"), [("2D", (32, 32)), ("3D", (32, 32, 32)), ("4D", (10, 32, 32, 32))])
def test_the_papers_data_set(folder, shape):
    paths = sorted(p for p in (DATA / folder).iterdir() if p.suffix in (".png", ".binvox", ".npy"))
    assert paths
    for path in paths:
        grid = load_indicator(path)
        assert grid.shape == shape, path
        assert grid.time == (folder == "4D")
        assert grid.note == ""


def test_import_is_light():
    """What is optional stays unimported until it is needed."""
    code = (
        "import sys, warp_bounding.indicators; "
        "print([m for m in ('torch', 'trimesh', 'pxr', 'PIL', 'scipy', 'pyvista', 'matplotlib') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip().splitlines()[-1] == "[]"


def test_npz_is_a_zip_with_arrays(tmp_path):
    """An archive made by hand, with a directory that NumPy did not write."""
    np.save(tmp_path / "a.npy", np.array([True, False]))
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.write(tmp_path / "a.npy", "occupancy.npy")
    assert load_indicator(tmp_path / "a.npz").occupancy.tolist() == [True, False]


@pytest.mark.parametrize("name", ["a.png", "a.npy", "a.npz", "a.binvox", "a.obj", "a.glb", "a.usda"])
def test_a_file_gives_its_name_and_not_its_folder(tmp_path, name, blob, write_binvox):
    path = tmp_path / "somebody" / name
    path.parent.mkdir()
    match path.suffix:
        case ".png":
            save_png(path, np.uint8(255 * np.eye(4)))
        case ".npy":
            np.save(path, blob)
        case ".npz":
            np.savez(path, blob)
        case ".binvox":
            write_binvox(path, blob)
        case ".usda":
            pytest.importorskip("pxr", reason="usd-core is not installed")
            text = """#usda 1.0
def Mesh "m" {
    uniform token subdivisionScheme = "none"
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    int[] faceVertexCounts = [3, 3, 3, 3]
    int[] faceVertexIndices = [0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3]
}
"""
            path.write_text(text)
        case _:
            BOX.export(path)
    shape = load_indicator(path)
    assert shape.name == name
    assert shape.to_grid().name == name
    bounder = wb.fit(shape, method="aabb", device="cpu")
    assert bounder.info["name"] == name
    bounder.save(tmp_path / "b.safetensors")
    assert b"somebody" not in (tmp_path / "b.safetensors").read_bytes()
