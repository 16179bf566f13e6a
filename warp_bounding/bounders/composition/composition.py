"""``composition``: bounders put together by *and* and *or*, nested freely.

*And* of two conservative tests is conservative for what both are; *or* is for what either is. So each part is proven by
itself, for the object or for the part of it that lies in the part's *region*, a box, and what is left to show is that
the regions cover the object (``cover``). A part may also bound the cells of a shape that the others bound itself: the
cells hold the shape, and what the part is proven for, it is proven for in coordinates of its own (``moves``). And a part
may hold some pieces of a shape that is a union of several (``Shape.piece``); it may then have fewer coordinates, the first ones.

f is 1 where the answer is *maybe*, else ``DENIED``.
"""

from functools import cached_property, reduce
from typing import Any

import numpy as np

from warp_bounding.bounders.base import Bounder, BoxBounds
from warp_bounding.bounders.composition.cover import Region, check_cover, common, split_regions
from warp_bounding.bounders.composition.moves import Moves, common_domain, moves_of
from warp_bounding.bounders.composition.source import ROW, CompositionSource
from warp_bounding.bounders.composition.source import SPLIT as SPLIT_CODE
from warp_bounding.bounders.composition.tree import AND, OR, SPLIT, Tree, children_of, parts_of, rows_of, steps_of
from warp_bounding.bounders.members import (
    BIT_FIELDS,
    check_members,
    has_bits,
    holding,
    members_of,
    word_places,
    words_of,
)
from warp_bounding.bounders.registry import composed
from warp_bounding.certificates.certificate import Certificate
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.indicators.parts.clipped import part_of
from warp_bounding.indicators.shape import Shape
from warp_bounding.kernels.source import ALIGN, DENIED, aligned

__all__ = ["Composition"]

MOST_PARTS = 1024


@composed
class Composition(Bounder):
    """Bounders of the same queries and domain, put together; made by ``a & b``, ``a | b`` and ``warp_bounding.hierarchy``.

    Tensors: those of part i, each under ``i.`` and its role there; ``thresholds`` ``(parts,)``; ``regions`` ``(parts, 2,
    n)``, the box, object space, of what each part is proven for, largest float32 numbers where it has no end. A split
    sends a point to one of two trees, by one of its coordinates v. Sizes:
    ``parts``, a list of ``method`` and ``sizes``, ``domain`` and ``resolution`` of parts with their own, and the numbers of the
    pieces that a part ``held``, where that is not all of the shape; ``tree``.
    """

    method = "composition"
    composed = True
    exact_on_cells = False
    bit_fields = BIT_FIELDS

    @classmethod
    def supports(cls, query: str, ndim: int, space: str = "geometric") -> bool:
        return True  # whatever its parts support

    @classmethod
    def of(
        cls,
        tree: Tree,
        parts: list[Bounder],
        regions: list[Region | None] | None = None,
        resolutions: list[int | None] | None = None,
        held: list[list[int] | None] | None = None,
    ) -> "Composition":
        """Parts at their own thresholds, without a certificate.

        Args:
            tree: How they are put together; each part stands in it once, in the order of ``parts``.
            parts: The bounders.
            regions: For each part the box that it is proven in; ``None`` where that is everywhere.
            resolutions: For each part that of the cells which it bounds, where another part bounds the shape itself; the
                domain is that of the first such part, and others may have their own. ``None`` where all bound the same.
            held: For each part the numbers of the pieces that it holds, ``None`` for a part that holds the shape; the domain is that
                of a part with most coordinates. ``None`` where no part is of a piece.

        Raises:
            BounderError: If they are bounders of other queries or domains, or cannot be put together.
        """
        check_members(cls.method, parts, domains=resolutions is None and held is None)
        resolutions, held = resolutions or [None] * len(parts), held or [None] * len(parts)
        widest = max(part.domain.space_ndim for part in parts)
        whole = [
            cells is None and part.domain.space_ndim == widest for cells, part in zip(resolutions, parts, strict=True)
        ]
        first, most = parts[whole.index(True)].domain, float(np.finfo(np.float32).max)
        own = [part.domain.to_dict() != first.to_dict() for part in parts]
        domain = first
        if any(own):
            domain = common_domain(first, [part.domain for part, other in zip(parts, own, strict=True) if other])
        boxes = np.tile(np.array([[-most], [most]], np.float32), (len(parts), 1, domain.space_ndim))
        for box, region in zip(boxes, regions or [None] * len(parts), strict=True):
            if region is not None:
                box[:] = np.clip(region, -most, most)
        tensors, sizes = holding(parts)
        for entry, part, cells, own in zip(sizes["parts"], parts, resolutions, held, strict=True):
            entry |= {} if part.domain.to_dict() == domain.to_dict() else {"domain": part.domain.to_dict()}
            entry |= {} if cells is None else {"resolution": cells}
            entry |= {} if own is None else {"held": list(own)}
        tensors |= {"thresholds": np.array([part.threshold for part in parts], np.float32), "regions": boxes}
        return cls(domain, tensors, sizes | {"tree": tree}, parts[0]._device)

    def check_tensors(self) -> None:
        self.members, shapes = members_of(self, 1, MOST_PARTS, lambda kind: not kind.composed, own_domains=True)
        try:
            self.moves: Moves | None = moves_of(self.domain, [part.domain for part in self.members])
        except BounderError as error:
            raise BounderError(f"{self.method}: {error}") from error
        count, tree = len(self.members), self.sizes.get("tree")
        if list(parts_of(tree, self.domain)) != list(range(count)):
            raise BounderError(
                f"{self.method}: expected a tree with each of {count} parts once, in order, got {tree!r}"
            )
        self.expect_shapes(shapes | {"thresholds": (count,), "regions": (count, 2, self.domain.space_ndim)})
        if not (self.tensors["regions"][:, 0] <= self.tensors["regions"][:, 1]).all():
            raise BounderError(f"{self.method}: a region's lower corner is above its upper one")
        self.held = [_numbers_of(entry) for entry in self.sizes["parts"]]
        if any(own is not None for own in self.held) and np.isfinite(self.regions).any():
            raise BounderError(f"{self.method}: parts of pieces have no regions")
        for part, own in zip(self.members, self.held, strict=True):
            if own is None and part.ndim != self.ndim:
                raise BounderError(
                    f"{self.method}: a part of {part.ndim} coordinates, of {self.ndim}, that holds no pieces"
                )
        for part, threshold in zip(self.members, self.tensors["thresholds"], strict=True):
            part.freeze(threshold, None)

    @property
    def tree(self) -> Tree:
        """How the parts are put together."""
        return self.sizes["tree"]

    @cached_property
    def regions(self) -> list[Region]:
        """The box of each part, object space, float64; infinite where it has no end."""
        boxes = self.tensors["regions"].astype(np.float64)
        boxes[np.abs(boxes) >= np.finfo(np.float32).max] *= np.inf
        return [(low, high) for low, high in boxes]

    @property
    def parts(self) -> list[Bounder]:
        """See ``Bounder``: copies of the members; they are proven one by one, each in its region."""
        return [part.to(self._device) for part in self.members]

    def obligations(self, shape: Shape) -> list[tuple[Bounder, Shape]]:
        """See ``Bounder``: each part, for what its region holds of the object; regions without any are not looked at.

        Raises:
            BounderError: If the regions do not cover the object; the message names a point.
        """
        if any(own is not None for own in self.held):
            self._check_pieces(shape)
        else:
            check_cover(shape, self.covered(self.tree))
        laid: dict[int | None, Shape] = {None: shape}  # the shape, and its cells where a part bounds these
        for cells in {part.info.get("resolution") for part in self.members} - {None}:
            laid[cells] = shape if isinstance(shape, IndicatorGrid) else shape.to_grid(resolution=cells)
        held = {cells: self.owed(each) for cells, each in laid.items()}
        pairs = [(part, held[part.info.get("resolution")][number]) for number, part in enumerate(self.parts)]
        # A part may be several tests that must all pass, such as a network with exits.
        return [(each, own) for part, own in pairs if own is not None for each in part.parts]

    def _check_pieces(self, shape: Shape) -> None:
        if shape.pieces is None:
            raise BounderError(f"{shape.name}: it has no pieces, and parts of this bounder hold some each")
        if left := sorted(set(shape.pieces.held) - self.pieces_of(self.tree, set(shape.pieces.held))):
            raise BounderError(f"{shape.name}: no part holds the pieces {left}")
        for part, own in zip(self.members, self.owed(shape), strict=True):
            if own.ndim != part.ndim:
                raise BounderError(
                    f"{own.name}: {own.ndim} coordinates, and the part that is said to hold it has {part.ndim}"
                )

    def pieces_of(self, tree: Tree, every: set[int]) -> set[int]:
        """Numbers of the pieces that this part of the tree holds, if each bounder in it does what it is for.

        Args:
            tree: A part of the tree.
            every: What a part holds that is of no piece.
        """
        if isinstance(tree, int):
            return every if self.held[tree] is None else set(self.held[tree]) & every
        held = [self.pieces_of(child, every) for child in children_of(tree)]
        return set.union(*held) if tree[0] == OR else set.intersection(*held)

    def owed(self, shape: Shape) -> list[Shape | None]:
        """What each part must hold of a shape: its pieces, or what is in its region; ``None`` where the shape does not reach there."""
        if any(own is not None for own in self.held):
            return [shape if own is None else shape.piece(own) for own in self.held]
        reached = [(low <= shape.upper).all() and (high >= shape.lower).all() for low, high in self.regions]
        return [part_of(shape, box) if here else None for here, box in zip(reached, self.regions, strict=True)]

    def covered(self, tree: Tree) -> list[Region]:
        """Boxes, object space: where this part of the tree is conservative, if each bounder in it is so in its region."""
        if isinstance(tree, int):
            return [self.regions[tree]]
        if tree[0] == SPLIT:  # all that can be below must be held by one child, all that can be above by the other
            (below, above), axis = (self.covered(child) for child in tree[3:]), tree[1]
            (first, most), (least, last) = split_regions(self.domain, axis, tree[2])
            most[axis], least[axis] = np.nextafter(least[axis], -np.inf), np.nextafter(most[axis], np.inf)
            return common(below, [(first, most)]) + common(above, [(least, last)]) + common(below, above)
        held = [self.covered(child) for child in tree[1:]]
        if tree[0] == OR:
            return [region for regions in held for region in regions]
        return reduce(common, held)

    @property
    def delta_share(self) -> np.ndarray | None:
        """See ``Bounder``: what is left of the error that a part's proof covers, for parts in domains of their own."""
        if all(part.domain is self.domain for part in self.members):
            return None
        own = [part.domain for part in self.members if part.info.get("resolution") is None]
        return self.domain.delta / next(domain for domain in own if domain.space_ndim == self.ndim).delta

    @property
    def provable(self) -> bool:
        return all(part.provable for part in self.members)

    @cached_property
    def _codes(self) -> list[Any]:
        return list(dict.fromkeys(part.source for part in self.members))

    @property
    def source(self) -> CompositionSource:
        places = sum(map(has_bits, self.members)) > 1
        return self.source_of(CompositionSource, tuple(self._codes), rows_of(self.tree), places, self.moves is not None)

    def weights(self) -> np.ndarray:
        """See ``Bounder``; the layout is described in ``bounders.composition.source``."""
        count, row, fields = rows_of(self.tree), self.source.row, word_places(self.members)
        place, rows = aligned(row * (count + 2)), np.zeros((count + 2, row), np.float32)
        held = [np.zeros(place, np.float32)]
        for i, (step, yes, no) in enumerate(steps_of(self.tree, 0, count, count + 1)):
            if isinstance(step, tuple):
                rows[i, :ROW] = SPLIT_CODE, step[0], yes, no, step[1]
                continue
            part = self.members[step]
            own = part.weights()
            rows[i, :ROW] = self._codes.index(part.source), place, yes, no, part.threshold
            rows[i, ROW : ROW + self.source.places] = fields[step]
            if self.moves is not None:
                rows[i, ROW + self.source.places :] = self.moves.numbers[step]
            held.append(np.pad(own, (0, -len(own) % ALIGN)).astype(np.float32))
            place += len(held[-1])
        if max(place, *fields) >= 2**24:
            raise BounderError(f"{self.method}: {max(place, *fields)} numbers are more than float32 can count")
        held[0][: rows.size] = rows.reshape(-1)
        return np.concatenate(held)

    def words(self) -> np.ndarray:
        words = words_of(self.members)
        return super().words() if words is None else words

    @property
    def nbytes(self) -> int:
        """See ``Bounder``: domain, rows and the parts' numbers; the regions are the proof's."""
        header = 4 * (len(self.domain.header) + 1 + len(self.domain.extra))
        return 4 * self.source.row * rows_of(self.tree) + header + sum(part.nbytes - header for part in self.members)

    def reference(self, v: np.ndarray) -> np.ndarray:
        v = np.asarray(v, dtype=np.float64)
        return np.where(self._decide(self.tree, v), 1.0, DENIED)

    def _decide(self, tree: Tree, v: np.ndarray) -> np.ndarray:
        if isinstance(tree, int):
            own = v if self.moves is None else self.moves.of(tree, v)
            part = self.members[tree]
            return part.reference(own[:, : part.domain.ndim]) >= float(part.threshold)
        if tree[0] == SPLIT:
            found, below = np.zeros(len(v), dtype=bool), v[:, tree[1]] < np.float32(tree[2])
            for child, side in zip(tree[3:], (below, ~below), strict=True):
                found[side] = self._decide(child, v[side])
            return found
        found = np.full(len(v), tree[0] == AND)
        for child in tree[1:]:
            open_ = np.flatnonzero(found == (tree[0] == AND))
            found[open_] = self._decide(child, v[open_])
        return found

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        """See ``Bounder``: 1 where the parts' own bounds, less their rounding, decide for *maybe* on the whole box."""
        center = (lower + upper) / 2
        sure = self._sure(self.tree, lower, upper)
        return BoxBounds(np.where(sure, 1.0, DENIED), np.argmax(upper - lower, axis=1), center, self.reference(center))

    def _sure(self, tree: Tree, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        if isinstance(tree, int):
            part = self.members[tree]
            if self.moves is not None:
                error = self.moves.error[tree]
                lower, upper = self.moves.of(tree, lower) - error, self.moves.of(tree, upper) + error
            low, high, owner = part.cut(lower[:, : part.domain.ndim], upper[:, : part.domain.ndim])
            sure = np.ones(len(lower), dtype=bool)
            np.logical_and.at(sure, owner, part.bound(low, high).lower >= float(part.threshold) + part.rounding_bound())
            return sure
        if tree[0] == SPLIT:
            place = np.float32(tree[2])
            below, above = (self._sure(child, lower, upper) for child in tree[3:])
            return (below | (lower[:, tree[1]] >= place)) & (above | (upper[:, tree[1]] < place))
        held = [self._sure(child, lower, upper) for child in tree[1:]]
        return np.all(held, axis=0) if tree[0] == AND else np.any(held, axis=0)

    def freeze(self, threshold: float, certificate: Certificate | None) -> "Composition":
        """See ``Bounder``; the threshold is 0, its parts have theirs. Raises ``BounderError`` for another one."""
        if threshold != 0:
            raise BounderError(f"{self.method}: its parts have thresholds, its own is 0, got {threshold!r}")
        return super().freeze(threshold, certificate)

    def rounding_bound(self) -> float:
        return 0.0  # ``bound`` is about what devices compute


def _numbers_of(entry: dict[str, Any]) -> list[int] | None:
    """The numbers of pieces in a part's entry, checked; ``None`` where it has none."""
    held = entry.get("held")
    if held is not None and not (
        isinstance(held, list) and held and all(type(number) is int and number >= 0 for number in held)
    ):
        raise BounderError(f"composition: expected numbers of pieces, got {held!r}")
    return held
