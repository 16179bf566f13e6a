"""Bounders of one object as one bounder, by *and* and *or*, with what is proven of them."""

from warp_bounding.bounders.base import Bounder
from warp_bounding.bounders.cascade import Cascade
from warp_bounding.bounders.composition.composition import Composition
from warp_bounding.bounders.composition.cover import Region, check_cover
from warp_bounding.bounders.composition.tree import AND, OR, SPLIT, Tree
from warp_bounding.bounders.operators import JOINED
from warp_bounding.certificates.certificate import Certificate
from warp_bounding.certificates.claim import differing, object_of
from warp_bounding.certificates.document import conjunction, together
from warp_bounding.errors import BounderError
from warp_bounding.indicators.parts.pieces import Pieces
from warp_bounding.indicators.shape import Shape

__all__ = ["both", "cascade", "compose", "either"]

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
    whole = Cascade.of(list(bounders))
    last = bounders[-1]
    for bounder in bounders:
        if other := differing(bounder, last):
            raise BounderError(f"cascade: expected bounders of the same object, got {other}")
    whole.info = {key: last.info.get(key) for key in ABOUT}
    whole.info["training"] = {"parts": [bounder.info.get("training") for bounder in bounders]}
    certificates = [bounder.certificate for bounder in bounders]
    if all(certificates):
        _check_objects(certificates)
        whole.freeze(float(whole.threshold), conjunction(certificates))
    return whole


def either(*bounders: Bounder) -> Composition:
    """A bounder that says *maybe* iff one of these does, asked in this order: ``a | b``.

    Args:
        bounders: Bounders of the same queries of the same object; of compositions and cascades, the parts. Of points,
            some may bound the shape itself and others its cells, at resolutions of their own: what holds the cells
            holds the shape, and the whole is proven for the shape. Or bounders of pieces of a shape (``Shape.piece``): the whole is
            one of their union, of the shape itself where no piece is missing.

    Returns:
        The composition. It is proven if all parts are, statistical if one of them is, and without a certificate if one has
        none.

    Raises:
        BounderError: If they were made for different objects, margins, queries or domains; for cells of different
            resolutions, of which none bounds the shape itself; or for cells of which it is not known whose they are, as
            in older files.

    Example:
        >>> loose = wb.fit(ball, method="sphere", device="cpu") | bounder
        >>> loose.certificate.proven
        True
    """
    return _joined(OR, list(bounders))


def both(*bounders: Bounder) -> Composition:
    """``either``, for a bounder that says *maybe* iff all of these do: ``a & b`` of what ``cascade`` does not take."""
    return _joined(AND, list(bounders))


def compose(tree: Tree, parts: list[Bounder], regions: list[Region | None], shape: Shape) -> Composition:
    """Bounders put together, each proven for what its region holds of a shape.

    Args:
        tree: As of ``Composition.of``.
        parts: With certificates, each of a ``Clipped`` shape, or of all of it where there is no region.
        regions: As of ``Composition.of``.
        shape: The object.

    Raises:
        BounderError: If the regions do not cover the object, or a part has no certificate.
    """
    whole = Composition.of(tree, parts, regions)
    check_cover(shape, whole.covered(tree))
    certificates = []
    for number, (part, own) in enumerate(zip(parts, whole.owed(shape), strict=True)):
        if own is None:  # nothing of the object is there
            continue
        known = part.certificate
        if known is None or (known.indicator, known.margin) != (own.digest, own.margin):
            raise BounderError(f"{whole.method}: part {number} has no certificate for its region")
        certificates.append(known)
    return whole.freeze(0.0, together(whole, certificates, shape.digest))


def _joined(kind: str, bounders: list[Bounder]) -> Composition:
    if len(bounders) < 2:
        raise BounderError(f"expected at least 2 bounders, got {len(bounders)}")
    tree: list = [kind]
    parts: list[Bounder] = []
    regions: list[Region | None] = []
    cells: list[int | None] = []
    held: list[list[int] | None] = []
    for bounder in bounders:
        if not isinstance(bounder, Bounder):
            raise BounderError(f"expected bounders, got {type(bounder).__name__}")
        own_tree, own = _taken_apart(bounder)
        tree.append(_shifted(own_tree, len(parts)))
        parts += own
        regions += bounder.regions if isinstance(bounder, Composition) else [None] * len(own)
        cells += _resolutions(bounder, own)
        held += _held(bounder, own)
    if len({_indicator(bounder) for bounder in bounders}) > 1 and kind == OR and all(map(_pieces, bounders)):
        return _of_pieces(tree, parts, held, bounders)
    mixed = len({bounder.info.get("resolution") for bounder in bounders}) > 1
    first = _about(bounders, mixed)
    whole = Composition.of(tree, parts, regions, cells if mixed else _inner(cells), held if any(held) else None).freeze(
        0.0, None
    )
    whole.info = {key: first.info.get(key) for key in ABOUT}
    whole.info["training"] = {"parts": [bounder.info.get("training") for bounder in bounders]}
    certificates = [bounder.certificate for bounder in bounders]
    if all(certificates):
        _check_objects(certificates, ("margin", "length") if mixed else CLAIMED)
        whole.freeze(0.0, together(whole, certificates, first.certificate.indicator))
    return whole


def _of_pieces(tree: Tree, parts: list[Bounder], held: list[list[int] | None], bounders: list[Bounder]) -> Composition:
    """Bounders of pieces of one shape as one of their union."""
    union, *others = (_pieces(bounder) for bounder in bounders)
    for other in others:
        if (other.whole, other.count) != (union.whole, union.count):
            raise BounderError("expected bounders of pieces of the same shape")
        union = union.joined(other)
    for key in ("margin", "resolution"):
        found = {bounder.info.get(key) for bounder in bounders}
        if len(found) > 1:
            raise BounderError(
                f"expected bounders of pieces of the same shape, got {key} {' and '.join(map(str, found))}"
            )
    whole = Composition.of(tree, parts, None, None, held).freeze(0.0, None)
    widest = max(bounders, key=lambda bounder: bounder.ndim)
    whole.info = {key: widest.info.get(key) for key in ABOUT} | {"indicator": union.digest}
    whole.info["pieces"] = None if union.all else union.to_dict()
    whole.info["training"] = {"parts": [bounder.info.get("training") for bounder in bounders]}
    certificates = [bounder.certificate for bounder in (*(b for b in bounders if b is not widest), widest)]
    if all(certificates):
        whole.freeze(0.0, together(whole, certificates, union.digest))
    return whole


def _indicator(bounder: Bounder) -> str | None:
    return bounder.info.get("indicator")


def _pieces(bounder: Bounder) -> Pieces | None:
    """The pieces that a bounder holds; ``None`` where it is not known to hold any, or holds the shape."""
    told = bounder.info.get("pieces")
    return None if told is None else Pieces.from_dict(told)


def _held(bounder: Bounder, parts: list[Bounder]) -> list[list[int] | None]:
    """The numbers of the pieces that each part holds."""
    if isinstance(bounder, Composition):
        return bounder.held
    own = _pieces(bounder)
    return [None if own is None else list(own.held)] * len(parts)


def _about(bounders: list[Bounder], mixed: bool) -> Bounder:
    """The bounder whose object is the whole's: the first one, or where others bound cells, the first of the shape itself.

    Raises:
        BounderError: If they are about different objects.
    """
    for bounder in bounders:
        if other := differing(bounders[0], bounder, ("margin",) if mixed else ("margin", "resolution")):
            raise BounderError(f"expected bounders of the same object, got {other}")
    if not mixed:
        return bounders[0]
    if object_of(bounders[0]) is None:
        raise BounderError(
            "expected bounders of the same object; of whose cells these bound is not known, fit them anew"
        )
    found = next((bounder for bounder in bounders if bounder.info.get("resolution") is None), None)
    if found is None:
        told = " and ".join(str(bounder.info["resolution"]) for bounder in bounders)
        raise BounderError(
            f"expected one bounder of the shape itself, or cells of one resolution; got cells of resolution {told}"
        )
    return found


def _resolutions(bounder: Bounder, parts: list[Bounder]) -> list[int | None]:
    """The resolution of the cells that each part bounds."""
    own = bounder.info.get("resolution")
    return [own if own is not None else part.info.get("resolution") for part in parts]


def _inner(cells: list[int | None]) -> list[int | None] | None:
    """Resolutions of parts beside those that bound the shape itself; ``None`` where all bound the same."""
    return cells if None in cells and any(each is not None for each in cells) else None


def _taken_apart(bounder: Bounder) -> tuple[Tree, list[Bounder]]:
    """A composition's tree and parts; a cascade is one of *and*."""
    if isinstance(bounder, Composition):
        return bounder.tree, bounder.parts
    if isinstance(bounder, Cascade):
        return [AND, *range(len(bounder.parts))], bounder.parts
    return 0, [bounder]


def _shifted(tree: Tree, by: int) -> Tree:
    if isinstance(tree, int):
        return tree + by
    told = 3 if tree[0] == SPLIT else 1  # what stands before the children
    return [*tree[:told], *(_shifted(child, by) for child in tree[told:])]


def _check_objects(certificates: list[Certificate], names: tuple[str, ...] = CLAIMED) -> None:
    """Refuse certificates of different objects, margins, lengths of rays, or cells."""
    for certificate in certificates:
        for name in names:
            one, other = getattr(certificates[0], name), getattr(certificate, name)
            if None not in (one, other) and one != other:  # (older certificates do not name all of these)
                raise BounderError(f"expected certificates of the same object, got {name} {one} and {other}")


def _and(one: Bounder, other: Bounder) -> Bounder:
    mixed = one.info.get("resolution") != other.info.get("resolution")
    return both(one, other) if mixed or one.composed or other.composed else cascade(one, other)


JOINED["&"], JOINED["|"] = _and, either
