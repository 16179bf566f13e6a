"""Proven, tight, fast bounding volumes for simulation, as NVIDIA Warp functions.

A bounder answers *maybe* or certainly *no* to "does this query touch that object?", and never says *no* where the truth
is *yes*:

    import warp_bounding as wb

    shape = wb.load_shape("bunny.obj")
    bounder = wb.fit(shape, method="mlp", hidden=(50, 50), budget=60.0)
    print(bounder.certificate.message)
    mask = bounder.query(points)  # bool, true = maybe

In a kernel of your own, ``wp.static(bounder.func)(data, q[i])`` answers one query; ``bounder.data`` is the argument
``data: wb.Data``.

Importing this module imports neither torch nor trimesh nor pyvista; each is imported where it is needed.
"""

from importlib import import_module

from warp_bounding.version import __version__

__all__ = [
    "DISTANCES",
    "METHODS",
    "Bounder",
    "BounderError",
    "BoundingError",
    "BoundingWarning",
    "Certificate",
    "Choice",
    "Data",
    "DeviceError",
    "DistanceBounder",
    "FileFormatError",
    "Prepared",
    "ProofError",
    "QueryError",
    "Rates",
    "ShapeError",
    "TwoSided",
    "__version__",
    "arms",
    "cascade",
    "certify",
    "choose",
    "compact",
    "device_of",
    "evaluate",
    "fit",
    "launch_on_cores",
    "load",
    "load_shape",
    "pairs",
    "shapes",
    "two_sided",
]

_HOMES = {
    "warp_bounding.errors": (
        "BounderError",
        "BoundingError",
        "BoundingWarning",
        "DeviceError",
        "FileFormatError",
        "ProofError",
        "ShapeError",
        "QueryError",
    ),
    "warp_bounding.bounders": (
        "Bounder",
        "Certificate",
        "DISTANCES",
        "Data",
        "DistanceBounder",
        "METHODS",
        "Prepared",
        "cascade",
        "compact",
        "load",
    ),
    "warp_bounding.bounders.cascade": ("TwoSided", "two_sided"),
    "warp_bounding.shapes": ("load_shape",),
    "warp_bounding.proof": ("certify",),
    "warp_bounding.evaluation": ("Rates", "evaluate"),
    "warp_bounding.training": ("fit",),
    "warp_bounding.choice": ("Choice", "choose"),
    "warp_bounding.runtime.launch": ("device_of", "launch_on_cores"),
}
_MODULES = ("arms", "baking", "newton", "pairs", "proof", "shapes", "views")
_WHERE = {name: home for home, names in _HOMES.items() for name in names}
# What 0.2.0 had under other names, or has been removed since.
_GONE = {f"Indicator{name}": f"wb.shapes.{name}" for name in ("Function", "Grid", "Mesh", "Network")}
_GONE |= {name: f"wb.baking.{name}" for name in ("Baked", "BounderLibrary", "bake")}
_GONE |= dict.fromkeys(("union", "hierarchy"), "wb.fit of the whole shape, or wb.cascade of proven bounders")
_GONE |= {
    "BounderStack": "wp.array([b.data for b in bounders], dtype=wb.Data); bounders of one size share a func",
    "Complement": "wb.shapes.Complement",
    "IndicatorBlendShapes": "wb.shapes.MovingMesh, or a wb.shapes.Mesh at each pose",
    "IndicatorError": "wb.ShapeError",
    "IndicatorMotion": "wb.shapes.MovingMesh",
    "choose_among": "wb.choose(bounders=)",
    "clear_segments": "wb.proof.clear_segments",
    "load_indicator": "wb.load_shape",
    "proven_share": "wb.certify, which proves or refutes the whole",
    "solids": "wb.shapes.Function; np.minimum of distances unites, np.maximum intersects",
}


def __getattr__(name: str):
    if name in _MODULES:
        return import_module(f"{__name__}.{name}")
    if name in _GONE:
        raise AttributeError(f"wb.{name} is gone: take {_GONE[name]}")
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_WHERE[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
