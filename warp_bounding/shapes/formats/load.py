"""``load_shape``: one door for files, arrays and meshes; and the readers of the formats that hold arrays.

Which reader a file gets depends on its extension alone (``READERS``); what it holds must then be what the extension
says. Meshes come from their own readers and usd-core (``usd.py``), pixels and maps from ``images.py``.
What an array's values mean and where its cells lie is in ``arrays.py``, meshes and arrays of other libraries below.
Shapes of other kinds are objects with a ``to_grid`` (``ShapeLike``), as ours are, or files whose reader makes one.
"""

import os
import re
import sys
import zipfile
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.runtime.progress import slow
from warp_bounding.runtime.whole_file import BOUNDER
from warp_bounding.shapes.formats.arrays import UNKNOWN, Cells, Placement, Wanted, check_cells, grid_of, level_of
from warp_bounding.shapes.formats.images import WHICH, image_from, read_netpbm, read_png, read_ros_map
from warp_bounding.shapes.formats.meshes import MESH_READERS, parts_of, read_mesh
from warp_bounding.shapes.formats.reading import joined, reading
from warp_bounding.shapes.formats.usd import USD_SUFFIXES, read_usd
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.mesh import Mesh, mesh_of
from warp_bounding.shapes.motion import MovingMesh
from warp_bounding.shapes.recentred import Recentred
from warp_bounding.shapes.shape import HOLLOW

# --- Objects of other libraries ---------------------------------------------------------------------------------------
#
# Shapes as others hold them: meshes of trimesh, Newton and Warp, arrays of torch and Warp.
#
# None of these libraries is imported here: whoever passes an object of one has imported it.


def _from_trimesh(source: Any) -> Mesh | Recentred:
    """One mesh of all meshes of a scene, transforms applied; raises ``ShapeError`` for a scene without a mesh."""
    if isinstance(source, sys.modules["trimesh"].Trimesh):
        return mesh_of(np.asarray(source.vertices), np.asarray(source.faces), name="trimesh")
    with reading("trimesh", "a scene of meshes"):
        vertices, faces, notes = joined(*parts_of(source))
    return mesh_of(vertices, faces, name="trimesh", note="; ".join(notes))


def _from_torch(source: Any) -> np.ndarray:
    try:
        return source.detach().cpu().numpy()
    except (TypeError, RuntimeError) as error:  # sparse, or of a type that NumPy does not have
        got = f"{source.dtype}, {source.layout}: {' '.join(str(error).split())}"
        raise ShapeError(f"expected a tensor that NumPy can hold, got {got}") from error


def _indexed(vertices: Any, indices: Any, name: str) -> Mesh:
    indices = np.asarray(indices)
    if indices.size % 3:
        raise ShapeError(f"{name}: expected three indices a face, got {indices.size}")
    return Mesh(np.asarray(vertices), indices.reshape(-1, 3), name=name)


# By module and class: each makes a shape or an array.
_OTHERS: dict[tuple[str, str], Callable[[Any], Any]] = {
    ("trimesh", "Trimesh"): _from_trimesh,
    ("trimesh", "Scene"): _from_trimesh,
    ("newton", "Mesh"): lambda source: _indexed(source.vertices, source.indices, "newton.Mesh"),
    ("warp", "Mesh"): lambda source: _indexed(source.points.numpy(), source.indices.numpy(), "wp.Mesh"),
    ("numpy", "ndarray"): lambda source: source,
    ("torch", "Tensor"): _from_torch,
    ("warp", "array"): lambda source: source.numpy(),
}
ACCEPTED = "a path, an array of NumPy, torch or Warp, (vertices, faces), a mesh of trimesh, Newton or Warp, or a shape"


def _converted(source: object) -> Any:
    """The shape of another library's mesh, or its array as NumPy's; ``None`` for anything else."""
    for (module, name), convert in _OTHERS.items():
        if (known := getattr(sys.modules.get(module), name, None)) is not None and isinstance(source, known):
            return convert(source)
    return None


def _from_pair(source: tuple) -> Mesh | Recentred:
    if len(source) != 2:
        raise ShapeError(f"expected a pair (vertices, faces), got a tuple of {len(source)}")
    arrays = []
    for name, part in zip(("vertices", "faces"), source, strict=True):
        array = _converted(part)
        try:
            arrays.append(np.asarray(part if array is None else array))
        except ValueError as error:  # lists of unequal length
            raise ShapeError(f"mesh: expected {name} as an array of 3 columns, got {type(part).__name__}") from error
    return mesh_of(*arrays)


# --- Files ------------------------------------------------------------------------------------------------------------


@runtime_checkable
class ShapeLike(Protocol):
    """A shape: all that is asked of one.

    Attributes:
        name: For people.
        extent: ``(n,)``, its size along each axis, object units.
    """

    name: str
    extent: np.ndarray

    def to_grid(self, *, resolution: int | None = None, margin: float = 0.0) -> Grid:
        """Closed cells with all points within ``margin`` of the shape; ``resolution`` of them on the longest axis."""


def load_shape(
    source: object,
    *,
    time: bool | None = None,
    level: float | str | None = None,
    spacing: float | Sequence[float] | None = None,
    origin: Sequence[float] | None = None,
    unknown: str | None = None,
    hollow: str | None = None,
) -> ShapeLike:
    """Make a shape of a file, an array or a mesh.

    Coordinate k is array axis k: of an image, coordinate 0 is the row, from the top, and coordinate 1 the column.

    Args:
        source: A path to ``.png`` (alpha of at least 0.5 is occupied), ``.binvox`` (coordinates x, y, z), ``.npy``,
            ``.npz`` (one array, or one named ``occupancy``), ``.pgm``; ROS's ``.yaml`` with its image, a map of which
            coordinate 0 is x, to the right, and 1 is y, up; a mesh (``.obj``, ``.ply``, ``.stl``, ``.glb``, ``.gltf``,
            ``.off``, ``.dae``) or USD (``.usd``, ``.usda``, ``.usdc``, ``.usdz``); an n-D array of NumPy, torch or Warp
            that holds truth values, or 0 and 1; a ``PIL.Image``; a pair ``(vertices, faces)``, a ``trimesh.Trimesh`` or
            ``trimesh.Scene``, a ``newton.Mesh`` or a ``wp.Mesh``; a ``Grid``, ``Mesh`` or ``MovingMesh``, or whatever
            else has their ``name``, ``extent`` and ``to_grid``, which is returned as it is.
        time: Whether coordinate 0 is time. By default it is for 4-D arrays and motions; a mesh never moves.
        level: Which values of an array, or grey values of an image, are occupied: a text such as ``"<128"``,
            ``"<=0"``, ``">0.5"``, or a number, from which on they are.
        spacing: Of an array, voxel file or image: the size of a cell, object units; one number, or one for each axis.
            By default the centres of the first and the last cell lie on 0 and 1, as in the paper, on every axis,
            however many cells it has.
        origin: Of an array, voxel file or image: where the centre of the first cell is, object units; 0 on every axis
            by default. Where cells do not lie at multiples of half a cell the result is ``Recentred``.
        unknown: Of a map, what cells are that nobody has seen: ``"occupied"``, the default, or ``"free"``.
        hollow: What air is that a mesh encloses, as a tank does: ``"filled"``, inside, the default, or ``"empty"``. Air
            is where surfaces go around a point as often one way as the other (winding number 0), so faces must be
            turned alike.

    Returns:
        A ``Grid`` for images, voxels and arrays, a ``Mesh`` for meshes. Or one that is ``Recentred``: a grid between
        multiples of half a cell, or a mesh that lies so far from 0 that float32 would move its vertices; it has an
        ``origin``, and what is asked of it, and of its bounders, is in world coordinates all the same.

    Raises:
        ShapeError: In one line, for everything that cannot be read or bounded, or that may mean two things.

    Example:
        >>> wb.load_shape(ball)
        <Grid array: 3D, 16 x 16 x 16 cells, 912 occupied, extent 1.067 x 1.067 x 1.067>
        >>> wb.load_shape(np.eye(3), level=">0.5", spacing=0.1).extent
        array([0.3, 0.3])
    """
    if time is not None and not isinstance(time, bool | np.bool_):
        raise ShapeError(f"time must be True, False or None, got {time!r}")
    for name, value, known in (("unknown", unknown, UNKNOWN), ("hollow", hollow, HOLLOW)):
        if value is not None and value not in known:
            raise ShapeError(f"{name} must be {' or '.join(map(repr, known))}, got {value!r}")
    wanted = Wanted(None if level is None else level_of(level), unknown)
    file = isinstance(source, str | os.PathLike)
    with slow(f"reading {Path(os.fsdecode(source)).name}") if file else nullcontext():
        found = _load(source, wanted)
        if isinstance(found, Cells):
            if found.placement is not None and (spacing is not None or origin is not None):
                got = f"got spacing={spacing}, origin={origin}"
                raise ShapeError(f"{found.name}: its own resolution and origin place it, {got}")
            place = found.placement or Placement(spacing, origin)
            # where it has a place of its own, its reader asked what is occupied
            own = wanted if found.placement is None else Wanted()
            found = grid_of(found.values, found.name, time, own, place, found.remark)
        else:
            given = {"level": level, "spacing": spacing, "origin": origin, "unknown": unknown}
            for option in (key for key, value in given.items() if value is not None):
                got = f"{option}={given[option]!r} for {type(found).__name__}"
                raise ShapeError(f"{found.name}: {option} is for arrays and images, got {got}")
    if hollow is not None:
        local = getattr(found, "local", found)
        if not isinstance(local, Mesh):
            raise ShapeError(f"{found.name}: hollow is for meshes at rest; cells: scipy.ndimage.binary_fill_holes")
        local = replace(local, hollow=hollow)
        found = Recentred(local, found.coordinates) if isinstance(found, Recentred) else local
    if not isinstance(found, Grid):
        moves = isinstance(found, MovingMesh) or getattr(found, "time", False) is True
        what = {Mesh: "a mesh", MovingMesh: "a motion"}.get(type(found), f"this {type(found).__name__}")
        if moves and time is False:
            raise ShapeError(f"{found.name}: coordinate 0 of {what} is time, got time=False")
        if time and not moves:
            raise ShapeError(f"{found.name}: {what} has no time coordinate, got time=True")
        return found
    if time is not None and time != found.time:
        found = replace(found, time=bool(time))
    if found.time and found.ndim < 2:
        raise ShapeError(f"{found.name}: time and at least one more coordinate expected, got {found.ndim}")
    return found


def _load(source: object, wanted: Wanted) -> Cells | ShapeLike:
    if isinstance(source, ShapeLike):
        return source
    if isinstance(source, str | os.PathLike):
        return _load_file(Path(os.fsdecode(source)), wanted)
    if isinstance(source, tuple):
        return _from_pair(source)
    found = image_from(source, grey=wanted.level is not None)
    found = _converted(source) if found is None else found
    if found is None:
        raise ShapeError(f"expected {ACCEPTED}, got {type(source).__name__}")
    return Cells(found, "array") if isinstance(found, np.ndarray) else found


def _load_file(path: Path, wanted: Wanted) -> Cells | ShapeLike:
    suffix = path.suffix.lower()
    with reading(path, f"a {suffix} file"):
        if not path.exists():
            raise ShapeError(f"{path}: no such file")
        if not path.is_file():
            raise ShapeError(f"{path}: expected a file, got {'a directory' if path.is_dir() else 'something else'}")
        if suffix == BOUNDER:
            raise ShapeError(f"{path}: expected a shape, got a bounder's file; load (or info) reads it")
        if suffix not in READERS:
            raise ShapeError(f"{path}: expected one of {' '.join(READERS)}, got {suffix or 'no extension'!r}")
        with path.open("rb") as file:
            if not file.read(1):
                raise ShapeError(f"{path}: expected a {suffix} file, but it is empty")
        return READERS[suffix](path, wanted)


def _read_npy(path: Path) -> Cells:
    with path.open("rb") as file:
        return Cells(_whole_array(file), path.name)


def _whole_array(file) -> np.ndarray:
    array = np.lib.format.read_array(file, allow_pickle=False)
    if file.read(1):
        raise ValueError(f"expected the end of the file after {array.size} numbers, got more data")
    return array


def _read_npz(path: Path) -> Cells:
    if not zipfile.is_zipfile(path):
        raise ValueError("expected a NumPy .npz archive, got a file that is not a zip archive")
    with zipfile.ZipFile(path) as archive:
        names = [name.removesuffix(".npy") for name in archive.namelist()]
        wanted = names[0] if len(names) == 1 else "occupancy"
        if names.count(wanted) != 1:
            raise ValueError(f"expected one array or one named 'occupancy', got {names}")
        if f"{wanted}.npy" not in archive.namelist():
            raise ValueError(f"expected an archive of NumPy arrays, got the file {wanted!r}")
        with archive.open(f"{wanted}.npy") as member:
            array = _whole_array(member)
    others = ", ".join(name for name in names if name != wanted)
    return Cells(array, path.name, f"not read: {others}" if others else "")


BINVOX = {b"#binvox": 1, b"dim": 3, b"translate": 3, b"scale": 1}  # and how many words follow


def read_binvox(path: Path) -> Cells:
    """Voxels ``(X, Y, Z)`` bool of a binvox file (P. Min, https://www.patrickmin.com/binvox/binvox.html).

    A header of text, then pairs of bytes, a value and how often it repeats, in the order x, z, y (y fastest). As in the
    paper, voxels span the unit cube, from centre to centre. trimesh reads cubes of voxels only.
    """
    header, *rest = re.split(rb"\ndata\r?\n", path.read_bytes(), maxsplit=1)
    fields = {words[0]: words[1:] for line in header.splitlines() if (words := line.split())}
    known = all(len(words) == BINVOX.get(key) for key, words in fields.items())
    if not rest or not known or fields.get(b"#binvox") != [b"1"] or b"dim" not in fields:
        raise ValueError(f"expected a header of binvox 1 with {b' '.join(BINVOX).decode()}, got {header[:80]!r}")
    shape = tuple(map(int, fields[b"dim"]))
    count = check_cells(shape)
    if len(rest[0]) % 2:
        raise ValueError(f"expected pairs of bytes behind the header, got {len(rest[0])} bytes")
    values, counts = np.frombuffer(rest[0], np.uint8).reshape(-1, 2).T
    if (values > 1).any():
        raise ValueError(f"expected voxel values 0 and 1, got {int(values.max())}")
    if (total := int(counts.sum(dtype=np.int64))) != count:
        raise ValueError(f"expected {count} voxels ({' x '.join(map(str, shape))}), got {total}")
    x_z_y = np.repeat(values.astype(bool), counts).reshape(shape)
    place = [float(word) for key in (b"translate", b"scale") for word in fields.get(key, ())]
    remark = "the header's translate and scale are not used; spacing= and origin= place the voxels"
    return Cells(x_z_y.transpose(0, 2, 1), path.name, remark if place not in ([], [0, 0, 0, 1]) else "")


def _read_pgm(path: Path, wanted: Wanted) -> Cells:
    if wanted.level is None:
        raise ShapeError(f"{path}: expected a level for its grey values; {WHICH}")
    values = read_netpbm(path)
    if values.ndim != 2:
        raise ShapeError(f"{path}: expected grey values, P2 or P5, got colours")
    return Cells(values, path.name)


# By extension: each is given a path and what the caller says of values, and makes ``Cells`` or a ``ShapeLike``.
READERS: dict[str, Callable[[Path, Wanted], Cells | ShapeLike]] = {
    ".png": lambda path, wanted: Cells(read_png(path, grey=wanted.level is not None), path.name),
    ".pgm": _read_pgm,
    ".yaml": read_ros_map,
    ".yml": read_ros_map,
    ".binvox": lambda path, _: read_binvox(path),
    ".npy": lambda path, _: _read_npy(path),
    ".npz": lambda path, _: _read_npz(path),
    **dict.fromkeys(MESH_READERS, lambda path, _: read_mesh(path)),
    **dict.fromkeys(USD_SUFFIXES, lambda path, _: read_usd(path)),
}
