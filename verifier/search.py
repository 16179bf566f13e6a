"""Boxes of v that are halved until each is decided; a box's triangles, which it may meet, go to its halves."""

import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from verifier import network
from verifier.bounders import Claim
from verifier.mesh import AGAIN, Mesh, spread

CHUNK = 2048  # boxes that are looked at together
SECONDS = 10.0  # from one report, and one state that is saved, to the next
NARROWEST = 2.0**-20  # a box with no longer side ends the search: what must be shown of it is false, or too close


class Boxes(NamedTuple):
    """Boxes of v: corners, and how many of ``items`` (triangles) each has."""

    lower: np.ndarray
    upper: np.ndarray
    count: np.ndarray
    items: np.ndarray

    def part(self, rows: np.ndarray) -> "Boxes":
        items = self.items[spread((np.cumsum(self.count) - self.count)[rows], self.count[rows])]
        return Boxes(self.lower[rows], self.upper[rows], self.count[rows], items)

    def halves(self, axis: np.ndarray) -> "Boxes":
        row, one, two = np.arange(len(axis)), self.upper.copy(), self.lower.copy()
        one[row, axis] = two[row, axis] = (self.lower[row, axis] + self.upper[row, axis]) / 2
        corners = np.concatenate([self.lower, two]), np.concatenate([one, self.upper])
        return Boxes(*corners, np.tile(self.count, 2), np.tile(self.items, 2))


def search(look, root: Boxes, saved: Path, key: str) -> int:
    """Look at boxes and at the halves of those that are left, until none is; returns how many were looked at.

    Every few seconds the file ``saved`` is written, which has what is open of the search of this ``key``; it is
    removed at the end. A search that was stopped, or killed, goes on from there.
    """
    stack, looked, due = [root], 0, time.monotonic() + SECONDS
    if saved.exists():
        with np.load(saved) as kept:
            if kept["key"].item() != key:
                raise ValueError(f"{saved}: of another search; remove it to begin anew")
            stack, looked = [Boxes(*(kept[name] for name in Boxes._fields))], int(kept["looked"])
    while stack:
        boxes = stack[-1]
        if (more := len(boxes.count) - CHUNK) > 0:
            stack[-1:] = [boxes.part(np.arange(more)), boxes.part(np.arange(more, len(boxes.count)))]
        try:
            left, looked = look(stack[-1]), looked + len(stack[-1].count)
        except ArithmeticError:
            saved.unlink(missing_ok=True)
            raise
        stack[-1:] = [left] if len(left.count) else []
        if stack and time.monotonic() >= due:
            rest, new = Boxes(*map(np.concatenate, zip(*stack, strict=True))), saved.with_suffix(".new.npz")
            np.savez(new, key=key, looked=looked, **rest._asdict())
            new.replace(saved)
            volume, due = float((rest.upper - rest.lower).prod(axis=1).sum()), time.monotonic() + SECONDS
            print(f"{looked:,} boxes, {volume:.6f} of v's volume is open", file=sys.stderr, flush=True)
    saved.unlink(missing_ok=True)
    return looked


class Points:
    """Looks whether ``f >= target`` all over a box of v, or no point within the margin of the solid gives a v in it."""

    def __init__(self, claim: Claim, mesh: Mesh, margin: float):
        self.claim, self.mesh, self.margin, self.reached = claim, mesh, margin, 0

    def __call__(self, boxes: Boxes) -> Boxes:
        (low, high), side = self.claim.origins(boxes.lower, boxes.upper), boxes.upper - boxes.lower
        axis, open_, least = side.argmax(axis=1), np.ones(len(side), bool), np.full(len(side), -np.inf)
        if self.claim.layers:
            least, best = self.bounded(boxes.lower, boxes.upper)
            flat = side[np.arange(len(side)), best] * 4 < side.max(axis=1)
            axis, open_ = np.where(flat, axis, best), ~(least >= self.claim.target)
        owner = np.repeat(np.arange(len(axis)), boxes.count)
        gaps, nearest = self.mesh.gaps(low, high, owner, boxes.items), np.full(len(axis), np.inf)
        near = gaps <= self.margin * self.margin
        owner, items, gaps = owner[near], boxes.items[near], gaps[near]
        np.minimum.at(nearest, owner, gaps)
        asked, met, first = open_.copy(), np.ones(len(owner), bool), gaps == nearest[owner]
        for some in (first, ~first):  # where the nearest triangle is not apart the others do not matter
            pair = np.flatnonzero(some & asked[owner])
            met[pair] = ~self.mesh.apart(low, high, owner[pair], items[pair], self.margin)
            asked[owner[met & some]] = False
        free = np.flatnonzero(asked)
        open_[free[self.mesh.outside((low[free] + high[free]) / 2)]] = False
        for i in np.flatnonzero(open_ & (side.max(axis=1) <= NARROWEST)):
            why = f"f may be {least[i]:.9g}, {self.claim.target:.9g} is needed, and the object may be there"
            raise ArithmeticError(
                f"box {boxes.lower[i].tolist()} of v, from {low[i].tolist()} to {high[i].tolist()}: {why}"
            )
        left = Boxes(boxes.lower, boxes.upper, np.bincount(owner[met], minlength=len(axis)), items[met])
        return left.part(np.flatnonzero(open_)).halves(axis[open_])

    def bounded(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lower bounds of f over boxes, and along which axis f varies most; one in a thousand is proven by Arb, too."""
        of = self.claim.layers, self.claim.activation
        least, taken = network.lowest(*of, lower, upper)
        reached = np.flatnonzero(least >= self.claim.target)
        for i in reached[-self.reached % AGAIN :: AGAIN]:
            if not network.confirms(*of, lower[i], upper[i], self.claim.target):
                raise ArithmeticError(f"Arb does not confirm f >= {self.claim.target} at {lower[i].tolist()} of v")
        self.reached += len(reached)
        return least, taken.argmax(axis=0)
