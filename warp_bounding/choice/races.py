"""The race of networks: as many as there is time to train until each can be judged, then the better ones longer.

How long that takes is asked of the pace, as far as anything is known of it; before, the first of them is given what a race of all would give it, and is stopped
after a round or two, and begun anew, where that is too little. Those for which there is no time are not begun.
"""

import math
from collections.abc import Mapping

from warp_bounding.choice.candidates import Candidate
from warp_bounding.choice.pace import LEAST_SECONDS
from warp_bounding.choice.work import OVERDRAWN, Tried, Work

__all__ = ["race"]

LONGER = 1.5  # times the seconds before: with less a network is not trained again
DOUBTS = 0.8  # of the seconds that it needs: with so many it is judged all the same


def race(work: Work, rivals: list[Candidate], others: list[Tried], held: Mapping[str, Tried]) -> dict[str, Tried]:
    """Train and measure networks.

    Args:
        work: The choice.
        rivals: Networks.
        others: What is no network.
        held: Networks that were trained before, by label.

    Returns:
        The cheapest of each network's fits, by label.
    """
    found = dict(held)
    able = [each for each in rivals if work.fits(each)]
    rounds = math.ceil(math.log2(len(able))) + 1 if able else 0  # in the last one, one is left
    share = work.pace.given(work.left / rounds / len(able)) if able else 0.0
    waiting = [each for each in able if each.label not in held or _starved_before(work, each)]
    while (waiting := [each for each in waiting if _may_win(work, None, others, found)]) and not work.interrupted:
        each = _next(work, waiting, found)
        waiting.remove(each)
        _judge(work, each, share, found)
    if not work.interrupted:
        _longer(work, able, others, found, rounds)
    return found


def _judge(work: Work, each: Candidate, share: float, found: dict[str, Tried]) -> None:
    """Train a network until it can be judged, or say that there is no time for it."""
    for _ in range(2):  # the second time with the pace that the first one has told
        needed = _needed(work, each)
        seconds = max(share, needed or LEAST_SECONDS)
        if work.pace.whole(seconds) > work.left:
            seconds = work.pace.given(work.left)
        if seconds < DOUBTS * (needed or LEAST_SECONDS) or work.kept.of(each.label).error:
            break
        if _train(work, each, seconds, found) or work.interrupted or work.kept.of(each.label).error:
            return
    if each.label not in found and not work.kept.of(each.label).error:
        whole = work.pace.whole(_needed(work, each) or LEAST_SECONDS)
        work.not_tried(each, whole, work.spending.budget + whole - max(work.left, 0.0))


def _needed(work: Work, each: Candidate) -> float | None:
    """Seconds that it must be trained: more than what has left it starved before, or was not enough to end."""
    attempts, front = work.kept.of(each.label), work.front_seconds(each)
    needed = work.pace.needed(each, front)
    if attempts.starved and attempts.given:
        needed = max(needed or 0.0, LONGER * max(attempts.given))
    return needed


def _starved_before(work: Work, each: Candidate) -> bool:
    return bool(work.kept.of(each.label).starved)


def _train(work: Work, each: Candidate, seconds: float, found: dict[str, Tried]) -> bool:
    """Train a network once; whether it came to an end."""
    limit = work.left + OVERDRAWN * work.spending.budget
    one = work.fitted(each, seconds, limit)
    if one is None:
        return False
    before = found.get(each.label)
    if before is None or one.row.cost <= before.row.cost:
        found[each.label] = one
    return True


def _longer(work: Work, able: list[Candidate], others: list[Tried], found: dict[str, Tried], rounds: int) -> None:
    """Train the better half of the networks that there are again, then the better half of these, with all that is left."""
    count = sum(each.label in found for each in able)
    for number in range(1, rounds):
        count = math.ceil(count / 2)
        alive = [each for each in able if each.label in found and _may_win(work, found[each.label], others, found)]
        alive = sorted(alive, key=lambda each: found[each.label].row.cost)[:count]
        while alive:
            seconds = work.pace.given(work.left / (rounds - number) / len(alive))
            if seconds >= LONGER * max(_longest(work, each) for each in alive):
                break
            if len(alive) == 1:
                seconds = work.pace.given(work.left)  # the last one has all that is left
                if seconds < LONGER * _longest(work, alive[0]):
                    return
                break
            alive = alive[: len(alive) // 2]
        for each in alive:
            if work.interrupted:
                return
            _train(work, each, seconds, found)
        count = max(len(alive), 1)


def _longest(work: Work, each: Candidate) -> float:
    return max(work.kept.of(each.label).given, default=LEAST_SECONDS)


def _next(work: Work, waiting: list[Candidate], found: Mapping[str, Tried]) -> Candidate:
    """Which network is most promising: one of middle size first, and then larger ones as long as what is left in vain costs more than asking."""
    plain = [each for each in waiting if not each.front]
    pool = plain or waiting
    if not found:
        sizes = sorted(each.numbers for each in pool)
        return min(pool, key=lambda each: abs(each.numbers - sizes[(len(sizes) - 1) // 2]))
    best = min(found.values(), key=lambda one: one.row.cost).row
    larger = (best.share - work.positives) * work.narrow_ns > best.nanoseconds
    return (max if larger else min)(
        waiting, key=lambda each: (not each.front, each.numbers) if larger else (bool(each.front), each.numbers)
    )


def _may_win(work: Work, one: Tried | None, others: list[Tried], found: Mapping[str, Tried]) -> bool:
    """Whether a network could become the cheapest if it left nothing but the positives."""
    if one is not None and work.memory is not None and one.bounder.nbytes > work.memory:
        return False
    nanoseconds = 0.0 if one is None else one.row.nanoseconds
    return nanoseconds + work.positives * work.narrow_ns < work.best([*others, *found.values()]) or (
        one is not None and one.row.cost <= work.best([*others, *found.values()])
    )
