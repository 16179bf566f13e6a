"""What is no network, what takes the least time first: in a share of the budget, and at the end in what the networks have left.

How long a fit and its proof take depends on the shape. What the first ones took tells what others will; a fit that takes longer than is left for it is stopped.
"""

from collections.abc import Set

from warp_bounding.choice.candidates import TIMES_SMALLER, Candidate
from warp_bounding.choice.work import NOT_TRIED, Tried, Work

__all__ = ["ClosedForms"]

PART = 1 / 20  # of the budget: what a fit is given that learns, and what one may take of which nothing is known
LONGER = 2.0  # times what it is expected to take: when a fit is stopped, though there be time
AFTER_STOP = 2.0  # times the seconds after which a fit was stopped: what it would take, for all that is known


class ClosedForms:
    """Candidates that are no networks.

    Args:
        work: The choice.
        candidates: All of them.
        held: Labels of those that were fitted before.
    """

    def __init__(self, work: Work, candidates: list[Candidate], held: Set[str]):
        self.work, self.part = work, PART * work.spending.budget
        self._waiting = [each for each in candidates if each.label not in held]
        self._largest: dict[str, float] = {}  # what the largest size of a method took, seconds
        self._unit: float | None = None  # seconds that an aabb takes here
        self.used = 0.0
        for each in candidates:
            taken = work.kept.of(each.label).taken
            self.used += taken
            if each.label in held and taken:
                self._learn(each, taken)

    def fit(self, pot: float) -> list[Tried]:
        """Fit those that are not fitted yet, as long as all of them together have taken no more than so many seconds."""
        found, waiting, self._waiting = [], self._waiting, []
        while waiting and not self.work.interrupted:
            each = min(waiting, key=self._order)
            waiting.remove(each)
            if one := self._tried(each, pot):
                found.append(one)
        self._waiting += waiting
        return found

    def _tried(self, each: Candidate, pot: float) -> Tried | None:
        work, attempts = self.work, self.work.kept.of(each.label)
        left, needs = min(pot - self.used, work.left), max(self._expected(each), AFTER_STOP * attempts.limit)
        if attempts.error:
            work.pass_over(each.label, attempts.error)
            return None
        if left <= 0 or needs > left:
            self._leave(each, needs or self.part, left)
            return None
        first = each.times_aabb == 1 and self._unit is None  # it tells what others take
        limit = left if first else min(left, max(self.part, LONGER * needs))
        before = work.spending.now
        one = work.fitted(each, self.part, limit)
        taken = work.spending.now - before
        self.used += taken
        self._learn(each, taken)
        if one is None and not attempts.error and not work.interrupted:
            self._leave(each, AFTER_STOP * attempts.limit, pot - self.used)
        return one

    def _leave(self, each: Candidate, needs: float, left: float) -> None:
        self._waiting.append(each)
        stopped = self.work.kept.of(each.label).limit
        begun = f"stopped after {stopped:.0f} s: " if stopped else NOT_TRIED
        self.work.not_tried(each, needs, self.work.spending.budget + needs - max(min(left, self.work.left), 0.0), begun)

    def _learn(self, each: Candidate, taken: float) -> None:
        self._largest[each.method] = taken
        if each.times_aabb == 1:
            self._unit = taken

    def _expected(self, each: Candidate) -> float:
        """Seconds that a fit will take, as far as that can be told; 0 where nothing is known."""
        if each.method in self._largest:
            return TIMES_SMALLER * self._largest[each.method]
        return each.times_aabb * (self._unit or 0.0) + self.part * each.learns

    def _order(self, each: Candidate) -> tuple[float, float]:
        """The least time first; as long as no aabb has told how long it takes, as if it had taken a part."""
        known = each.method in self._largest or self._unit is not None
        return self._expected(each) if known else each.times_aabb * self.part, each.times_aabb
