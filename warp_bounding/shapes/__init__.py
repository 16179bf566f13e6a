"""What is bounded: grids, meshes at rest and moving, functions, networks, solids, and files of them.

``load_shape`` makes a shape of a file, an array or a mesh. Solids are shapes that are put together by hand, in any
number of dimensions, with certified bounds; the operators ``|``, ``&`` and ``-`` combine them with each other, and with
meshes, grids and functions. ``READERS`` has a function for each kind of file. Importing this package needs NumPy only;
trimesh, usd-core, Pillow, SciPy and Warp are imported when a file or a mesh needs them.

Example:
    >>> plate = wb.shapes.Box([-1, -1, 0], [1, 1, 0.2]) - wb.shapes.Sphere([0, 0, 0.1], 0.5)
    >>> plate.contains(np.array([[0, 0, 0.1], [0.9, 0.9, 0.1]]))
    array([False,  True])
    >>> plate.empty(np.array([[-0.1, -0.1, 0.0]]), np.array([[0.1, 0.1, 0.2]]))
    array([ True])
"""

from importlib import import_module

__all__ = [
    "READERS",
    "Box",
    "Capsule",
    "Complement",
    "Difference",
    "Dilation",
    "Extrusion",
    "Function",
    "Grid",
    "HalfSpace",
    "Intersection",
    "Mesh",
    "MovingMesh",
    "Network",
    "ShapeLike",
    "Sphere",
    "Torus",
    "Transform",
    "Union",
]

_HOMES = {
    "warp_bounding.networks.network_shape": ("Network",),
    "warp_bounding.shapes.formats.load": (
        "READERS",
        "ShapeLike",
        "load_shape",
    ),
    "warp_bounding.shapes.function": ("Function",),
    "warp_bounding.shapes.grid": ("Grid",),
    "warp_bounding.shapes.mesh": ("Mesh",),
    "warp_bounding.shapes.motion": ("MovingMesh",),
    "warp_bounding.shapes.parts": ("Complement",),
    "warp_bounding.shapes.solids": (
        "Box",
        "Capsule",
        "Difference",
        "Dilation",
        "Extrusion",
        "HalfSpace",
        "Intersection",
        "Sphere",
        "Torus",
        "Transform",
        "Union",
    ),
}
_WHERE = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str):
    if name == "BlendShapes":
        raise AttributeError("BlendShapes is gone: bound a MovingMesh, or a Mesh at each pose")
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value = getattr(import_module(_WHERE[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
