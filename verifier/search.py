"""Boxes of v that are halved until each is decided; a box's triangles, which it may meet, go to its halves."""

import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from verifier import network
from verifier.bounders import ROOM, Claim
from verifier.mesh import AGAIN, Mesh

ITEMS = 2**19  # triangles of all boxes that are looked at together, of which a box itself counts as 256
SECONDS = 10.0  # from one report, and one state that is saved, to the next
NARROWEST = 2.0**-20  # a box with no longer side ends the search: what must be shown of it is false, or too close


class Boxes(NamedTuple):
    """Boxes of v: corners, and how many of ``items`` (triangles) each has."""

    lower: np.ndarray
    upper: np.ndarray
    count: np.ndarray
    items: np.ndarray

    def part(self, rows: np.ndarray) -> "Boxes":
        return Boxes(self.lower[rows], self.upper[rows], self.count[rows], self.items[np.repeat(rows, self.count)])

    def halves(self, axis: np.ndarray) -> "Boxes":
        row, one, two, at = np.arange(len(axis)), self.upper.copy(), self.lower.copy(), (self.lower + self.upper) / 2
        at = np.where(self.upper - self.lower >= 2, np.rint(at), at)  # of places in a grid: where its nodes are
        one[row, axis] = two[row, axis] = at[row, axis]
        corners = np.concatenate([self.lower, two]), np.concatenate([one, self.upper])
        return Boxes(*corners, np.tile(self.count, 2), np.tile(self.items, 2))


def search(look, root: Boxes, saved: Path) -> int:
    """Look at boxes and at the halves of those that are left, until none is; returns how many were looked at.

    What is open is written to ``saved`` now and then, from where the same search goes on, believing it.
    """
    rest, looked, due = root, 0, time.monotonic() + SECONDS
    if saved.exists():
        with np.load(saved) as kept:
            rest, looked = Boxes(*(kept[name] for name in Boxes._fields)), int(kept["looked"])
    while len(rest.count):
        cost = rest.count + 256
        last = np.cumsum(cost[::-1])[::-1] - cost < ITEMS
        left, looked = look(rest.part(last)), looked + last.sum()
        rest = Boxes(*map(np.concatenate, zip(rest.part(~last), left, strict=True)))
        if len(rest.count) and time.monotonic() >= due:
            new = saved.with_suffix(".new.npz")
            np.savez(new, looked=looked, **rest._asdict())
            new.replace(saved)
            volume, due = float((rest.upper - rest.lower).prod(axis=1).sum()), time.monotonic() + SECONDS
            print(f"{looked:,} boxes, a volume of {volume:.6f} is open", file=sys.stderr, flush=True)
    saved.unlink(missing_ok=True)
    return looked


class Look:
    """Looks whether ``f >= target`` all over a box, or the claim holds because of where the triangles are.

    Of points: none within the margin of the solid comes to lie in it. Of distances: what is claimed and the margin are
    together less than the distance; as f is affine at least, that is affine at most, and meets each triangle so.
    """

    def __init__(self, claim: Claim, mesh: Mesh, margin: float):
        self.claim, self.mesh, self.margin = claim, mesh, margin

    def __call__(self, boxes: Boxes) -> Boxes:
        claim, side = self.claim, boxes.upper - boxes.lower
        low, high = claim.origins(boxes.lower, boxes.upper)
        least, base, tangent, bent = claim.f.lowest(*claim.numbers, boxes.lower, boxes.upper)
        slope, open_ = -tangent * claim.per * claim.unit, ~(least >= claim.target)
        most = (self.margin + claim.unit * np.maximum(claim.target - least, 0)) * ROOM  # of the distance needed
        gap = self.margin + claim.unit * (claim.target - base) + 2 * np.abs(slope) @ claim.room
        gap += (ROOM - 1) * (self.margin + claim.unit * (np.abs(base) + abs(claim.target)))
        owner = np.repeat(np.arange(len(side)), boxes.count)
        gaps, nearest = self.mesh.gaps(low, high, owner, boxes.items), np.full(len(side), np.inf)
        near = ~(gaps > most[owner] ** 2)
        owner, items, gaps = owner[near], boxes.items[near], gaps[near]
        np.minimum.at(nearest, owner, gaps)
        asked, met, first = open_.copy(), np.ones(len(owner), bool), gaps == nearest[owner]
        for some in (first, ~first):  # where the nearest triangle is not apart the others do not matter
            pair = np.flatnonzero(some & asked[owner])
            met[pair] = ~self.mesh.apart(low, high, owner[pair], items[pair], gap, slope)
            asked[owner[met & some]] = False
        met |= (gaps == 0) & (claim.unit > 0)  # what the box touches is asked again with the slopes of its halves
        top = np.where(slope > 0, high, np.where(slope < 0, low, (low + high) / 2))  # where most distance is needed
        open_[asked] = ~self.mesh.outside(top[asked])
        used = ~open_ & ((least >= claim.target) | (claim.unit > 0)) & (claim.f is network)  # where f is what proves
        for i in np.flatnonzero(used)[::AGAIN]:
            box = boxes.lower[i], boxes.upper[i]
            if not network.confirms(*claim.numbers, *box, sum(box) / 2, base[i], tangent[i]):
                raise ArithmeticError(f"Arb does not confirm f >= {base[i]} + {tangent[i]} h in the box {box} of v")
        for i in np.flatnonzero(open_ & (side.max(axis=1) <= NARROWEST)):
            why = f"f may be {least[i]:.9g}, {claim.target:.9g} is needed, and the object may be there"
            raise ArithmeticError(f"box {boxes.lower[i].tolist()}, at {low[i].tolist()}: {why}")
        fall = side if claim.unit else np.abs(tangent) * side + 2 * bent + 1e-9 * side  # no cut makes a box flat
        axis = np.where(side * 4 < side.max(axis=1, keepdims=True), 0, fall).argmax(axis=1)
        left = Boxes(boxes.lower, boxes.upper, np.bincount(owner[met], minlength=len(side)), items[met])
        return left.part(open_).halves(axis[open_])
