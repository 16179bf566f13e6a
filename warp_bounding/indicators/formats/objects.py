"""Shapes as others hold them: meshes of trimesh, Newton and Warp, arrays of torch and Warp, objects that answer.

None of these libraries is imported here: whoever passes an object of one has imported it.
"""

import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators.formats.reading import reading
from warp_bounding.indicators.functions.function import IndicatorFunction
from warp_bounding.indicators.mesh import IndicatorMesh, check_faces, mesh_of
from warp_bounding.indicators.recentred import Recentred

__all__ = ["ACCEPTED", "array_from", "function_from", "mesh_from"]


class _Kind(NamedTuple):
    """Classes of a library, and the function that makes an indicator or an array of their objects."""

    module: str
    classes: tuple[str, ...]
    convert: Callable[[Any], Any]


def _from_trimesh(source: Any) -> IndicatorMesh | Recentred:
    """One mesh of all the meshes of a scene, their transforms applied; raises ``IndicatorError`` for a scene without a mesh."""
    trimesh, name = sys.modules["trimesh"], "trimesh"
    with reading(name, "a scene of meshes"):
        parts = [source] if isinstance(source, trimesh.Trimesh) else source.dump()
    meshes = [part for part in parts if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    others = sorted({type(part).__name__ for part in parts if not isinstance(part, trimesh.Trimesh)})
    if not meshes:
        raise IndicatorError(f"{name}: expected a mesh with faces, got {', '.join(others) or 'none'}")
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    for mesh in meshes:  # before the parts are joined: an index out of range would then point into another part
        check_faces(np.asarray(mesh.faces), len(mesh.vertices), name)
    return mesh_of(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]),
        faces=np.concatenate([np.asarray(mesh.faces) + start for mesh, start in zip(meshes, starts, strict=False)]),
        name=name,
        note=f"not read, as they are not meshes: {', '.join(others)}" if others else "",
    )


def _from_newton(source: Any) -> IndicatorMesh:
    return IndicatorMesh(np.asarray(source.vertices), _triangles(source.indices, "newton.Mesh"), name="newton.Mesh")


def _from_warp(source: Any) -> IndicatorMesh:
    return IndicatorMesh(source.points.numpy(), _triangles(source.indices.numpy(), "wp.Mesh"), name="wp.Mesh")


def _from_torch(source: Any) -> np.ndarray:
    try:
        return source.detach().cpu().numpy()
    except (TypeError, RuntimeError) as error:  # sparse, or of a type that NumPy does not have
        reason = " ".join(str(error).split())
        raise IndicatorError(
            f"expected a tensor that NumPy can hold, got {source.dtype}, {source.layout}: {reason}"
        ) from error


def _triangles(indices: Any, name: str) -> np.ndarray:
    indices = np.asarray(indices)
    if indices.size % 3:
        raise IndicatorError(f"{name}: expected three indices a face, got {indices.size}")
    return indices.reshape(-1, 3)


_MESHES = (
    _Kind("trimesh", ("Trimesh", "Scene"), _from_trimesh),
    _Kind("newton", ("Mesh",), _from_newton),
    _Kind("warp", ("Mesh",), _from_warp),
)
_ARRAYS = (
    _Kind("numpy", ("ndarray",), lambda source: source),
    _Kind("torch", ("Tensor",), _from_torch),
    _Kind("warp", ("array",), lambda source: source.numpy()),
)
_QUESTIONS = ("ndim", "lower", "upper", "contains", "empty")  # what is asked of a shape of one's own
ACCEPTED = "a path, an array (NumPy, torch, Warp), (vertices, faces), a trimesh.Trimesh, newton.Mesh or wp.Mesh, or an indicator"


def mesh_from(source: object) -> IndicatorMesh | Recentred | None:
    """The indicator of another library's mesh, or of a pair ``(vertices, faces)`` of arrays; ``None`` for anything else.

    Raises:
        IndicatorError: For a mesh that cannot be bounded.
    """
    if isinstance(source, tuple):
        return _from_pair(source)
    return _converted(source, _MESHES)


def array_from(source: object) -> np.ndarray | None:
    """Another library's array as NumPy's; ``None`` for anything else."""
    return _converted(source, _ARRAYS)


def function_from(source: object) -> IndicatorFunction | None:
    """The indicator of an object that answers as a shape does; ``None`` for anything else.

    Args:
        source: Has ``ndim``, ``lower``, ``upper``, ``contains`` and ``empty`` with the meaning that they have in
            ``Shape``, and perhaps ``name``, ``note`` and ``time``.

    Raises:
        IndicatorError: If its box or its answers contradict that.
    """
    if isinstance(source, type) or not all(hasattr(source, name) for name in _QUESTIONS):
        return None
    about = {name: getattr(source, name) for name in ("name", "note", "time") if hasattr(source, name)}
    about = {"name": type(source).__name__} | about
    found = IndicatorFunction(source.contains, source.lower, source.upper, empty=source.empty, **about)
    if found.ndim != source.ndim:
        raise IndicatorError(f"{found.name}: expected corners of ndim={source.ndim} numbers, got {found.ndim}")
    return found


def _from_pair(source: tuple) -> IndicatorMesh | Recentred:
    if len(source) != 2:
        raise IndicatorError(f"expected a pair (vertices, faces), got a tuple of {len(source)}")
    arrays = []
    for name, part in zip(("vertices", "faces"), source, strict=True):
        array = array_from(part)
        try:
            arrays.append(np.asarray(part) if array is None else array)
        except ValueError as error:  # lists of unequal length
            raise IndicatorError(
                f"mesh: expected {name} as an array of 3 columns, got {type(part).__name__}"
            ) from error
    return mesh_of(*arrays)


def _converted(source: object, kinds: tuple[_Kind, ...]) -> Any:
    for kind in kinds:
        module = sys.modules.get(kind.module)
        classes = tuple(filter(None, (getattr(module, name, None) for name in kind.classes)))
        if isinstance(source, classes):
            return kind.convert(source)
    return None
