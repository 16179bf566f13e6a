"""What a bounder claims to be about, and whether a shape, or another bounder's claim, is that.

Whatever proves, certifies, goes on from a checkpoint or puts bounders together asks here (``mismatch``, ``differing``),
so that no claim is taken for
another one. A claim is about a kind of query, coordinates with or without a time, a side, a margin, the length of rays,
cells, and times; its domain
must hold the shape. What a file says of these is compared with the shape that is given. The digest of the object is
compared between bounders only:
where there is a shape, its geometry decides, and a different digest is reported.
"""

import numpy as np

from warp_bounding.certificates.certificate import Subject
from warp_bounding.errors import IndicatorError
from warp_bounding.indicators import load_indicator
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.parts import SIDES, Complement, outside_of
from warp_bounding.indicators.recentred import Frame, own_coordinates, parted
from warp_bounding.indicators.shape import Shape
from warp_bounding.queries.distance import DISTANCE, METRICS, in_metric

__all__ = [
    "OUTSIDE",
    "as_fitted",
    "differing",
    "in_local",
    "mismatch",
    "object_of",
    "of_side",
    "other_claim",
    "outside",
]

OUTSIDE = "the shape reaches outside the domain that the bounder was made for"


# --- a bounder and a shape -------------------------------------------------------------------------------------------


def in_local(bounder: Subject, shape) -> tuple:
    """A bounder and its shape, both in local coordinates.

    Raises:
        IndicatorError: If their origins are not the same, or the shape cannot be read.
    """
    local, frame = parted(load_indicator(shape))
    if frame != bounder.frame:
        told = [_framed(each) for each in (bounder.frame, frame)]
        raise IndicatorError(f"{local.name}: expected the bounder's origin, {told[0]}, got {told[1]}")
    return bounder.local, local


def _framed(frame: Frame | None) -> str:
    return "none" if frame is None else f"{list(frame.origin)} (blur {max(frame.blur):.3g})"


def of_side(bounder: Subject, shape) -> Shape:
    """The shape that is given, in a distance's metric; its complement where the bounder is about that."""
    shape = own_coordinates(load_indicator(shape), "this")
    bounder.expect_local("this")
    if bounder.query_kind == DISTANCE.name:
        return in_metric(shape, bounder.sizes.get("metric", METRICS[0]))
    return Complement(shape) if bounder.domain.unbounded and not shape.unbounded else shape


def as_fitted(bounder: Subject, shape) -> Shape:
    """What the fit bounded: the shape dilated by the bounder's margin, or its cells where these were bounded."""
    shape, margin = of_side(bounder, shape), bounder.info.get("margin") or 0.0
    resolution = bounder.info.get("resolution")
    if isinstance(shape, Shape) and (resolution is None or isinstance(shape, IndicatorGrid)):
        return shape.dilated(margin)
    return shape.to_grid(resolution=resolution, margin=margin)


def mismatch(bounder: Subject, shape: Shape) -> str | None:
    """Why a bounder's claim cannot be about a shape, in a few words; ``None`` if it can.

    Args:
        bounder: Or a part of one. What ``info`` does not tell is not compared; it is what a fit fills in at last.
        shape: As it is to be bounded: of the bounder's side, dilated, divided into cells (``as_fitted``).

    Returns:
        ``OUTSIDE`` if all but the domain agrees: then points of the shape out there may refute the claim.
    """
    domain = bounder.domain
    if other := _other_dimension(bounder, shape):
        return other
    if shape.unbounded != domain.unbounded:
        sides = SIDES[domain.unbounded], SIDES[shape.unbounded]
        return f"the bounder holds an object from the {sides[0]}, the shape is one from the {sides[1]}"
    for name in ("margin", "resolution"):
        told, own = bounder.info.get(name), getattr(shape, name)
        if told is not None and told != own:
            return f"the bounder is for {name} {told}, the shape has {'none' if own is None else own}"
    if not isinstance(shape, IndicatorGrid):
        for part in bounder.parts if bounder.query_kind != DISTANCE.name else ():
            if part.info.get("resolution") is None and not part.takes_shapes(part.query_kind):
                what = f"{part.query_kind} queries of {part.method} are bounded over cells"
                return f"{what}, and the shape has none; give a resolution"
    if shape.joints != (known := bounder.domain.base.joints):
        if known is None:
            return "the bounder does not know the limits and turns of the shape's joints, such as one from an older file; fit it anew"
        if shape.joints is None:
            return "the bounder is for values of joints, the shape for coordinates"
        return "the shape's joints have other limits, turns or weights than those that the bounder was made for"
    if shape.time and (other := _other_times(bounder, shape)):
        return other
    return domain.fault() or (OUTSIDE if _reaches_outside(bounder, shape) else None)


def _other_dimension(bounder: Subject, shape: Shape) -> str | None:
    """How a shape's dimension, or its having a time, differs from the bounder's; ``None`` where it does not."""
    sides = ((shape.ndim, shape.time), (bounder.ndim, bounder.domain.time))
    kinds = [f"{n}D" + (", animated" if t else "") for n, t in sides]
    return None if sides[0] == sides[1] else f"the shape is {kinds[0]}, the bounder {kinds[1]}"


def _other_times(bounder: Subject, shape: Shape) -> str | None:
    """Times are denied only where the object is known, and a distance knows how fast that moves.

    Which times these are its domain's corners tell: ``fault`` holds its ``limit`` to them.
    """
    base, known = bounder.domain.base, shape.known_times
    if base.lower[0] < known[0] or base.upper[0] > known[1]:
        known, asked = (f"{first:.7g} to {last:.7g}" for first, last in (known, (base.lower[0], base.upper[0])))
        return f"the shape is known at times from {known}, the bounder denies queries from {asked}"
    if bounder.query_kind == DISTANCE.name and not (shape.speed is not None and base.speed >= shape.speed):
        moves = "by no speed that is known" if shape.speed is None else f"by up to {shape.speed:.6g} a unit of time"
        return f"the shape moves {moves}, the bounder knows {base.speed:.6g}"
    return None


def _reaches_outside(bounder: Subject, shape: Shape) -> bool:
    """Whether a shape may have points outside the bounder's domain."""
    if isinstance(shape, IndicatorGrid):
        return len(outside(bounder, shape)) > 0
    domain = bounder.domain.base
    if domain.unbounded:  # all that the domain's limit lets through is searched, and the rest is maybe
        return False
    for axis in range(shape.ndim):
        for side, beyond in ((0, shape.lower < domain.lower), (1, shape.upper > domain.upper)):
            if beyond[axis]:
                lower, upper = shape.lower[None].copy(), shape.upper[None].copy()
                if side:
                    lower[0, axis] = domain.upper[axis]
                else:
                    upper[0, axis] = domain.lower[axis]
                if not shape.empty(lower, upper)[0]:
                    return True
    return False


def outside(bounder: Subject, grid: IndicatorGrid) -> np.ndarray:
    """The occupied cells that reach outside the bounder's domain."""
    domain, cells = bounder.domain.base, grid.occupied
    lower, upper = grid.position(cells - 0.5), grid.position(cells + 0.5)
    return cells[((lower < domain.lower) | (upper > domain.upper)).any(axis=1)]


# --- a bounder and what is expected of it, or another one ------------------------------------------------------------


def other_claim(bounder: Subject, expected: dict[str, str | float | None]) -> str | None:
    """How a bounder's claim differs from what is expected of it, or ``None``; an expected ``None`` is not compared."""
    claimed = {
        "query": bounder.query_kind,
        "margin": bounder.info.get("margin") or 0.0,
        "length": bounder.domain.length,
        "resolution": bounder.info.get("resolution"),
    }
    for name, value in expected.items():
        if value is not None and value != claimed[name]:
            own = "none" if claimed[name] is None else claimed[name]
            return f"another claim than the expected one: expected {name} {value}, the bounder is for {name} {own}"
    return None


def differing(one: Subject, other: Subject, names: tuple[str, ...] = ("margin", "resolution")) -> str | None:
    """How the objects of two bounders differ, in a few words; ``None`` if both are about the same.

    Args:
        one: A bounder.
        other: Another one; or one of the complement, which is the same object from inside.
        names: What of the claims must be equal besides.
    """
    for name in names:
        told = [_told(bounder, name) for bounder in (one, other)]
        if told[0] != told[1]:
            return f"{name} {told[0]} and {told[1]}"
    if one.frame != other.frame:
        return f"origin {_framed(one.frame)} and {_framed(other.frame)}"
    objects = [object_of(bounder) for bounder in (one, other)]
    if None in objects:  # cells of a shape that an older file does not name
        objects = [_told(bounder, "indicator") for bounder in (one, other)]
    if one.domain.unbounded != other.domain.unbounded:
        if None in objects:
            return "an indicator that is not known"
        objects[int(one.domain.unbounded)] = outside_of(objects[int(one.domain.unbounded)])
    return None if objects[0] == objects[1] else f"indicator {objects[0]} and {objects[1]}"


def object_of(bounder: Subject) -> str | None:
    """The digest of the geometry that is bounded, without margin and cells; ``None`` where that is not known."""
    if told := bounder.info.get("shape"):
        return told
    in_cells = bounder.info.get("grid_shape") is not None or _told(bounder, "resolution") is not None
    undivided = not in_cells or (_told(bounder, "resolution") is None and not _told(bounder, "margin"))
    return _told(bounder, "indicator") if undivided else None


def _told(bounder: Subject, name: str):
    """What a bounder says of its object: in its ``info``, or without one in its certificate."""
    if (told := bounder.info.get(name)) is None and bounder.certificate is not None:
        told = getattr(bounder.certificate, name, None)
    return (told or 0.0) if name == "margin" else told
