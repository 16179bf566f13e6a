"""Proven, tight, fast bounding volumes for simulation, as NVIDIA Warp functions.

A bounder answers *maybe* or certainly *no* to "does this query touch that object?", and never says *no* where the truth
is *yes*:

    import warp_bounding as wb

    shape = wb.load_indicator("bunny.obj")
    bounder = wb.fit(shape, method="mlp", hidden=(50, 50), budget=60.0)
    print(bounder.certificate.message)
    mask = bounder.query(points)  # uint8, 1 = maybe

In a kernel of your own, ``wp.static(bounder.func)(data, q[i])`` answers one query; ``bounder.data`` is the argument
``data: wb.Data``.

Importing this module imports neither torch nor trimesh nor pyvista; each is imported where it is needed.
"""

from importlib import import_module

from warp_bounding.version import __version__

__all__ = [
    "DISTANCES",
    "METHODS",
    "Baked",
    "Bounder",
    "BounderError",
    "BounderLibrary",
    "BounderStack",
    "BoundingError",
    "BoundingWarning",
    "Certificate",
    "Choice",
    "Complement",
    "Data",
    "DeviceError",
    "DistanceBounder",
    "FileFormatError",
    "IndicatorBlendShapes",
    "IndicatorError",
    "IndicatorFunction",
    "IndicatorGrid",
    "IndicatorMesh",
    "IndicatorMotion",
    "IndicatorNetwork",
    "Prepared",
    "QueryError",
    "Rates",
    "TwoSided",
    "__version__",
    "arms",
    "bake",
    "cascade",
    "certify",
    "choose",
    "choose_among",
    "clear_segments",
    "compact",
    "device_of",
    "evaluate",
    "fit",
    "hierarchy",
    "launch_on_cores",
    "load",
    "load_indicator",
    "proven_share",
    "solids",
    "two_sided",
    "union",
]

_HOMES = {
    "warp_bounding.errors": (
        "BounderError",
        "BoundingError",
        "BoundingWarning",
        "DeviceError",
        "FileFormatError",
        "IndicatorError",
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
        "union",
    ),
    "warp_bounding.bounders.two_sided": ("TwoSided", "two_sided"),
    "warp_bounding.indicators": (
        "Complement",
        "IndicatorFunction",
        "IndicatorGrid",
        "IndicatorMesh",
        "IndicatorMotion",
        "load_indicator",
    ),
    "warp_bounding.indicators.blend_shapes": ("IndicatorBlendShapes",),
    "warp_bounding.networks.indicator_network": ("IndicatorNetwork",),
    "warp_bounding.proof": ("certify", "clear_segments", "proven_share"),
    "warp_bounding.evaluation": ("Rates", "evaluate"),
    "warp_bounding.training": ("fit", "hierarchy"),
    "warp_bounding.baking.bake": ("Baked", "bake"),
    "warp_bounding.baking.library": ("BounderLibrary", "BounderStack"),
    "warp_bounding.choice": ("Choice", "choose", "choose_among"),
    "warp_bounding.runtime.launch": ("device_of", "launch_on_cores"),
}
_MODULES = ("arms", "solids")
_WHERE = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str):
    if name in _MODULES:
        return import_module(f"{__name__}.{name}")
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_WHERE[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
