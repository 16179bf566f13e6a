"""Whether a shape or another bounder's claim is what a bounder claims, and whether a certificate can be true.

Whatever proves, certifies, resumes from a checkpoint or composes bounders checks here (``mismatch``, ``differing``),
so that no claim is mistaken for another. A claim is about a kind of query, coordinates with or without a time, a side,
a margin, the length of rays, cells, and times; its domain must hold the shape. These are compared with the given shape.
Digests of objects are compared between bounders only: where there is a shape, its geometry decides, and a different
digest is reported.

A file's digest detects damage, and ``check_claims`` detects careless edits after which the digest was computed anew. An
invalid claim that contradicts nothing in the file passes; only ``certify`` finds it.
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from warp_bounding import shapes
from warp_bounding.certificates import Certificate
from warp_bounding.errors import BoundingError, FileFormatError, ShapeError
from warp_bounding.queries.distance import DISTANCE
from warp_bounding.rounding import UNIT32, round_down
from warp_bounding.shapes.complement import SIDES, Complement, outside_of
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.recentred import Frame, own_coordinates, parted
from warp_bounding.shapes.shape import Shape

if TYPE_CHECKING:
    from warp_bounding.bounders.bounder import Bounder

OUTSIDE = "the shape reaches outside the domain that the bounder was made for"


# --- a bounder and a shape -------------------------------------------------------------------------------------------


def in_local(bounder: "Bounder", shape) -> tuple:
    """A bounder and its shape, both in local coordinates.

    Raises:
        ShapeError: If their origins are not the same, or the shape cannot be read.
    """
    local, frame = parted(shapes.load_shape(shape))
    if frame != bounder.frame:
        expected, given = _framed(bounder.frame), _framed(frame)
        raise ShapeError(f"{local.name}: expected the bounder's origin, {expected}, got {given}")
    return bounder.local, local


def _framed(frame: Frame | None) -> str:
    return "none" if frame is None else f"{list(frame.origin)} (blur {max(frame.blur):.3g})"


def of_side(bounder: "Bounder", shape) -> Shape:
    """The shape that is given; its complement where the bounder is about that."""
    shape = own_coordinates(shapes.load_shape(shape), "this")
    bounder.expect_local("this")
    if bounder.query_kind == DISTANCE.name:
        return shape
    return Complement(shape) if bounder.domain.unbounded and not shape.unbounded else shape


def as_fitted(bounder: "Bounder", shape) -> Shape:
    """What the fit bounded: the shape dilated by the bounder's margin, or its cells where these were bounded."""
    shape, margin = of_side(bounder, shape), bounder.info.get("margin") or 0.0
    resolution = bounder.info.get("resolution")
    if isinstance(shape, Shape) and (resolution is None or isinstance(shape, Grid)):
        return shape.dilated(margin)
    return shape.to_grid(resolution=resolution, margin=margin)


class Claim(NamedTuple):
    """A bounder and a shape in local coordinates, and whether what the bounder says can be about that shape.

    Attributes:
        bounder: Without its origin.
        shape: As the fit bounded it (``as_fitted``); as far as it could be made, where there is a fault.
        fault: Why the claim is not about the shape, not the expected one, or none; empty if nothing is known against
            it; ``OUTSIDE`` as in ``mismatch``.
    """

    bounder: "Bounder"
    shape: Shape
    fault: str


def claim_of(bounder: "Bounder", shape, expected: dict[str, str | float | None]) -> Claim:
    """What a bounder claims of anything that ``load_shape`` takes; ``expected`` is for ``other_claim``."""
    frame, fault = bounder.frame, None
    try:
        bounder, shape = in_local(bounder, shape)
        fault = (frame.fault(bounder) if frame else None) or other_claim(bounder, expected)
        shape = as_fitted(bounder, shape)
        fault = fault or fault_of(bounder, shape)
    except BoundingError as error:
        fault = fault or str(error)
    return Claim(bounder, shape, fault if bounder.conservative else f"{bounder.method} is not conservative")


def fault_of(bounder: "Bounder", shape: Shape) -> str:
    """``mismatch``, or else ``uncovered``; empty if there is neither."""
    return mismatch(bounder, shape) or uncovered(bounder)


def mismatch(bounder: "Bounder", shape: Shape) -> str | None:
    """Why a bounder's claim cannot be about a shape, in a few words; ``None`` if it can.

    Args:
        bounder: Or a part of one. Fields that ``info`` lacks are not compared; a fit sets them at its end.
        shape: What ``as_fitted`` makes of it: of the bounder's side, dilated, divided into cells.

    Returns:
        ``OUTSIDE`` if all but the domain agrees: then points of the shape out there may refute the claim.
    """
    domain = bounder.domain
    sides = ((shape.ndim, shape.time), (bounder.ndim, domain.time))
    if sides[0] != sides[1]:
        kinds = [f"{n}D" + (", animated" if t else "") for n, t in sides]
        return f"the shape is {kinds[0]}, the bounder {kinds[1]}"
    if shape.unbounded != domain.unbounded:
        sides = SIDES[domain.unbounded], SIDES[shape.unbounded]
        return f"the bounder holds an object from the {sides[0]}, the shape is one from the {sides[1]}"
    for name in ("margin", "resolution"):
        claimed, actual = bounder.info.get(name), getattr(shape, name)
        if claimed is not None and claimed != actual:
            return f"the bounder is for {name} {claimed}, the shape has {'none' if actual is None else actual}"
    if not isinstance(shape, Grid):
        for part in bounder.parts if bounder.query_kind != DISTANCE.name else ():
            if part.info.get("resolution") is None and not part.takes_shapes(part.query_kind):
                what = f"{part.query_kind} queries of {part.method} are bounded over cells"
                return f"{what}, and the shape has none; give a resolution"
    if shape.joints != (known := bounder.domain.base.joints):
        if known is None:
            return "the bounder knows no limits and turns of the shape's joints, as in older files; fit it anew"
        if shape.joints is None:
            return "the bounder is for values of joints, the shape for coordinates"
        return "the shape's joints have other limits, turns or weights than those that the bounder was made for"
    if shape.time and (other := _other_times(bounder, shape)):
        return other
    if fault := domain.fault():
        return fault
    return OUTSIDE if shape.reaches_beyond(domain.base.lower, domain.base.upper) else None


def target(bounder: "Bounder") -> float:
    """What every lower bound of f must reach: at least the exact sum of the threshold and the rounding bound E."""
    return float(np.nextafter(float(bounder.threshold) + bounder.rounding_bound(), np.inf))


def uncovered(bounder: "Bounder") -> str:
    """A message if ``delta`` is less than the rounding on the way to v at a corner of the domain; empty if it is not.

    Three operations round: the point to float32, its difference to the centre, and the product with the scale.
    Distances have no ``delta``.
    """
    if bounder.of_distances:
        return ""
    domain = bounder.domain.base
    center, scale = np.float64(domain.center), np.float64(domain.scale)
    needed = [UNIT32 * (np.abs(x) * scale + 2 * np.abs(x - center) * scale) for x in (domain.lower, domain.upper)]
    return "the domain's delta does not cover what float32 rounds" if (np.maximum(*needed) > domain.delta).any() else ""


def _other_times(bounder: "Bounder", shape: Shape) -> str | None:
    """A message if the bounder denies times at which the shape is unknown, or its distance assumes too low a speed.

    The domain's corners are the times that it denies: ``fault`` checks ``limit`` against them.
    """
    base, known = bounder.domain.base, shape.known_times
    if base.lower[0] < known[0] or base.upper[0] > known[1]:
        known, queried = (f"{first:.7g} to {last:.7g}" for first, last in (known, (base.lower[0], base.upper[0])))
        return f"the shape is known at times from {known}, the bounder denies queries from {queried}"
    if bounder.query_kind == DISTANCE.name and not (shape.speed is not None and base.speed >= shape.speed):
        moves = "by no speed that is known" if shape.speed is None else f"by up to {shape.speed:.6g} a unit of time"
        return f"the shape moves {moves}, the bounder knows {base.speed:.6g}"
    return None


# --- a bounder and what is expected of it, or another one ------------------------------------------------------------


def other_claim(bounder: "Bounder", expected: dict[str, str | float | None]) -> str | None:
    """How a bounder's claim differs from what is expected of it, or ``None``; an expected ``None`` is not compared."""
    claimed = {
        "query": bounder.query_kind,
        "margin": bounder.info.get("margin") or 0.0,
        "length": bounder.domain.length,
        "resolution": bounder.info.get("resolution"),
    }
    for name, value in expected.items():
        if value is not None and value != claimed[name]:
            other = "none" if claimed[name] is None else claimed[name]
            return f"another claim than the expected one: expected {name} {value}, the bounder is for {name} {other}"
    return None


def differing(one: "Bounder", other: "Bounder", names: tuple[str, ...] = ("margin", "resolution")) -> str | None:
    """How the objects of two bounders differ, in a few words; ``None`` if both are about the same.

    Args:
        one: A bounder.
        other: Another one; or one of the complement, which is the same object from inside.
        names: Fields of the claims that must be equal, too.
    """
    for name in names:
        values = [_claimed(bounder, name) for bounder in (one, other)]
        if values[0] != values[1]:
            return f"{name} {values[0]} and {values[1]}"
    if one.frame != other.frame:
        return f"origin {_framed(one.frame)} and {_framed(other.frame)}"
    objects = [bounder.info.get("shape") for bounder in (one, other)]
    if None in objects:  # an older file names what was fitted only
        objects = [_claimed(bounder, "indicator") for bounder in (one, other)]
    if one.domain.unbounded != other.domain.unbounded:
        if None in objects:
            return "a shape that is not known"
        objects[int(one.domain.unbounded)] = outside_of(objects[int(one.domain.unbounded)])
    short = [str(each)[:8] for each in objects]
    return None if objects[0] == objects[1] else f"different shapes, of digests {short[0]}... and {short[1]}..."


def _claimed(bounder: "Bounder", name: str):
    """What a bounder says of its object: in its ``info``, or without one in its certificate."""
    if (value := bounder.info.get(name)) is None and bounder.certificate is not None:
        value = getattr(bounder.certificate, name, None)
    return (value or 0.0) if name == "margin" else value


# --- a stored certificate and the bounder in its file ------------------------------------------------------------


KINDS = ("proven", "statistical", "refuted", "undecided", "inapplicable")
LEAST_ERROR = 0.5  # of E as this version computes it: other versions may bound E otherwise, but not by less than half


def check_claims(bounder: "Bounder", certificate: Certificate, document: dict[str, Any]) -> None:
    """Refuse a certificate that is about something else than the file, or does not prove its threshold.

    Args:
        bounder: As it was read.
        certificate: As it was read.
        document: The file's other fields: ``threshold``, ``indicator``, ``name``, ``margin``, ``length`` and
            ``resolution``.

    Raises:
        FileFormatError: If a claim is impossible; the message names it.
    """
    threshold, kind, error = document["threshold"], certificate.kind, bounder.rounding_bound()
    if kind not in KINDS:
        _refuse(f"kind {kind!r} is not one of {', '.join(KINDS)}")
    if certificate.threshold != threshold:
        _refuse(f"it is about threshold {certificate.threshold}, the file has {threshold}")
    corners = [bounder.domain.lower.tolist(), bounder.domain.upper.tolist()]
    if certificate.query != bounder.query_kind or certificate.domain != corners:
        _refuse("it is about other queries or another domain than the file")
    if not bounder.conservative:
        _refuse(f"{bounder.method} is not conservative and cannot hold one")
    if kind not in ("proven", "statistical"):  # the others promise nothing
        return
    if certificate.counterexample is not None:
        _refuse(f"{kind}, and yet there is a counterexample")
    if document["indicator"] is not None and certificate.indicator != document["indicator"]:
        _refuse(f"it is about the shape {certificate.indicator[:16]}, the file about {document['indicator'][:16]}")
    if certificate.placement is not None:  # older files store what the claim is about next to the certificate only
        beside = {name: document[name] for name in ("margin", "length", "resolution")} | {"object": document["name"]}
        beside["margin"] = beside["margin"] or 0.0  # ``None`` if the bounder was made without ``fit``
        for name, value in beside.items():
            certified = getattr(certificate, name)
            if certified != value and not (name == "object" and value is None):
                _refuse(f"it is for {name} {certified!r}, the file for {value!r}")
    if not certificate.rounding_bound >= LEAST_ERROR * error:
        _refuse(f"rounding bound {certificate.rounding_bound:.3g}, this bounder rounds by {error:.3g}")
    rounding = error if kind == "proven" else 0.0
    if not threshold <= round_down(certificate.lower_bound - rounding) < np.inf:
        _refuse(f"threshold {threshold:.6g} exceeds bound {certificate.lower_bound:.6g} less rounding {rounding:.2g}")


def _refuse(reason: str) -> None:
    raise FileFormatError(f"the certificate does not add up: {reason}")
