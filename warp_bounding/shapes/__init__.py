"""What is bounded: grids, meshes at rest and moving, functions, networks, and files of them.

``load_shape`` makes a shape of a file, an array or a mesh. ``READERS`` has a function for each kind of file. Importing
this package needs NumPy only; trimesh, usd-core, Pillow, SciPy and Warp are imported when a file or a mesh needs them.

Example:
    >>> def plate_with_a_hole(x):
    ...     plate = np.abs(x / [1, 1, 0.1]).max(axis=1) - 1.0
    ...     return np.maximum(0.1 * plate, 0.5 - np.linalg.norm(x, axis=1))
    >>> plate = wb.shapes.Function(None, [-1, -1, -0.1], [1, 1, 0.1], distance=plate_with_a_hole)
    >>> plate.contains(np.array([[0, 0, 0.0], [0.9, 0.9, 0.0]]))
    array([False,  True])
    >>> plate.empty(np.array([[-0.1, -0.1, -0.1]]), np.array([[0.1, 0.1, 0.1]]))
    array([ True])
"""

from importlib import import_module

__all__ = ["READERS", "Complement", "Function", "Grid", "Mesh", "MovingMesh", "Network", "ShapeLike"]

_HOMES = {
    "warp_bounding.networks.network_shape": ("Network",),
    "warp_bounding.shapes.formats.load": ("READERS", "ShapeLike", "load_shape"),
    "warp_bounding.shapes.function": ("Function",),
    "warp_bounding.shapes.grid": ("Grid",),
    "warp_bounding.shapes.mesh": ("Mesh",),
    "warp_bounding.shapes.motion": ("MovingMesh",),
    "warp_bounding.shapes.complement": ("Complement",),
}
_WHERE = {name: home for home, names in _HOMES.items() for name in names}
_GONE = {"Box", "Capsule", "Difference", "Dilation", "Extrusion", "HalfSpace", "Intersection", "Sphere", "Torus"}
_GONE |= {"Transform", "Union"}


def __getattr__(name: str):
    if name == "BlendShapes":
        raise AttributeError("BlendShapes is gone: bound a MovingMesh, or a Mesh at each pose")
    if name in _GONE:
        raise AttributeError(
            f"wb.shapes.{name} is gone: give a Function whose distance= says it; np.minimum of distances unites, "
            "np.maximum intersects"
        )
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value = getattr(import_module(_WHERE[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
