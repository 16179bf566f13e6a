"""Bounders of one object as one bounder: all must say *maybe* (``cascade``), or any may (``union``); with what is proven of them."""

from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.cascade import Cascade
from warp_bounding.bounders.cover import Region, check_cover
from warp_bounding.bounders.union import Union
from warp_bounding.certificates.certificate import Certificate
from warp_bounding.certificates.claim import differing
from warp_bounding.certificates.document import conjunction, together
from warp_bounding.errors import BounderError
from warp_bounding.indicators.parts.pieces import Pieces
from warp_bounding.indicators.shape import Shape

__all__ = ["cascade", "union", "united"]

# Entries of ``info`` that the whole has of one of its parts.
ABOUT = ("indicator", "margin", "resolution", "shape", "name", "grid_shape", "seed", "note", "pieces")

CLAIMED = ("margin", "length", "resolution")  # fields of certificates, beside the object (``differing``)


def cascade(*bounders: Bounder) -> Cascade:
    """A bounder that says *maybe* iff all of these do, asked in this order.

    Args:
        bounders: Bounders of the same queries of the same object, such as an ``aabb`` and an ``mlp``. A query costs no
            more than the bounders up to the first one that denies it.

    Returns:
        The cascade. It is proven if all parts are, statistical if one of them is, and without a certificate if one has
        none.

    Raises:
        BounderError: If they were made for different objects, margins, queries or domains, or cannot be put together
            (``Cascade.of``).

    Example:
        >>> both = wb.cascade(wb.fit(ball, method="sphere", device="cpu"), bounder)
        >>> both.method, both.certificate.proven
        ('cascade', True)
    """
    last = bounders[-1]
    whole = Cascade.of([bounder.local for bounder in bounders])
    whole.frame = last.frame
    for bounder in bounders:
        if other := differing(bounder, last):
            raise BounderError(f"cascade: expected bounders of the same object, got {other}")
    whole.info = {key: last.info.get(key) for key in ABOUT}
    whole.info["training"] = {"parts": [bounder.info.get("training") for bounder in bounders]}
    certificates = [bounder.certificate for bounder in bounders]
    if all(certificates):
        _check_objects(certificates, (*CLAIMED, "indicator"))
        whole.freeze(float(whole.threshold), conjunction(certificates))
    return whole


def union(*bounders: Bounder) -> Union:
    """A bounder that says *maybe* iff one of these does, asked in this order.

    Args:
        bounders: Bounders of the same queries of the same object, or of pieces of one shape (``Shape.piece``), which may have fewer
            coordinates, the first ones: the whole is one of their union, of the shape itself where no piece is missing.

    Returns:
        The union. It is proven if all parts are, statistical if one of them is, and without a certificate if one has none.

    Raises:
        BounderError: If they were made for different objects, margins, queries or domains.

    Example:
        >>> loose = wb.union(wb.fit(ball, method="obb", device="cpu"), bounder)
        >>> loose.certificate.proven
        True
    """
    if len(bounders) < 2:
        raise BounderError(f"union: expected at least 2 bounders, got {len(bounders)}")
    for bounder in bounders:
        if not isinstance(bounder, Bounder):
            raise BounderError(f"union: expected bounders, got {type(bounder).__name__}")
    parts, held = [], []
    for bounder in bounders:
        parts += bounder.parts if isinstance(bounder, Union) else [bounder.local]
        held += bounder.held if isinstance(bounder, Union) else [_pieces(bounder) and list(_pieces(bounder).held)]
    whole = Union.of(parts, held).freeze(0.0, None)
    widest = max(bounders, key=lambda bounder: bounder.ndim)
    whole.frame = widest.frame
    pieces, indicator = [_pieces(bounder) for bounder in bounders], widest.info.get("indicator")
    for bounder in bounders:
        if other := None if all(pieces) else differing(bounders[0], bounder):
            raise BounderError(f"union: expected bounders of the same object, got {other}")
    if all(pieces):
        if any(bounder.frame for bounder in bounders):
            raise BounderError("union: expected pieces of a shape without an origin")
        joined = pieces[0]
        for other, bounder in zip(pieces, bounders, strict=True):
            same = all(bounder.info.get(name) == widest.info.get(name) for name in ("margin", "resolution"))
            if not same or (other.whole, other.count) != (joined.whole, joined.count):
                raise BounderError("union: expected bounders of pieces of the same shape, of one margin")
            joined = joined.joined(other)
        indicator = joined.digest
    whole.info = {key: widest.info.get(key) for key in ABOUT} | {"indicator": indicator}
    whole.info["shape"] = None if all(pieces) else whole.info["shape"]
    whole.info["pieces"] = joined.to_dict() if all(pieces) and not joined.all else None
    whole.info["training"] = {"parts": [bounder.info.get("training") for bounder in bounders]}
    certificates = [bounder.certificate for bounder in (*(b for b in bounders if b is not widest), widest)]
    if all(certificates):
        _check_objects(certificates)
        whole.freeze(0.0, together(whole, certificates, indicator))
    return whole


def united(parts: list[Bounder], regions: list[Region], shape: Shape) -> Union:
    """Bounders put together, each proven for what its region holds of a shape.

    Args:
        parts: With certificates, each of the part of the shape in its region (``part_of``).
        regions: Boxes, object space, float32 numbers.
        shape: The object.

    Raises:
        BounderError: If the regions do not cover the object, or a part has no certificate.
    """
    whole = Union.of(parts, regions)
    check_cover(shape, regions)
    certificates = []
    for number, (part, region) in enumerate(zip(parts, regions, strict=True)):
        own, known = whole.owed(shape, region), part.certificate
        if own is None:  # nothing of the object is there
            continue
        if known is None or (known.indicator, known.margin) != (own.digest, own.margin):
            raise BounderError(f"{whole.method}: part {number} has no certificate for its region")
        certificates.append(known)
    return whole.freeze(0.0, together(whole, certificates, shape.digest))


def _pieces(bounder: Bounder) -> Pieces | None:
    """The pieces that a bounder holds; ``None`` where it is not known to hold any, or holds the shape."""
    told = bounder.info.get("pieces")
    return None if told is None else Pieces.from_dict(told)


def _check_objects(certificates: list[Certificate], names: tuple[str, ...] = CLAIMED) -> None:
    """Refuse certificates of different objects, margins, lengths of rays, or cells."""
    for certificate in certificates:
        for name in names:
            one, other = getattr(certificates[0], name), getattr(certificate, name)
            if None not in (one, other) and one != other:  # (older certificates do not name all of these)
                raise BounderError(f"expected certificates of the same object, got {name} {one} and {other}")
