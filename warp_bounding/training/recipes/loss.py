"""The asymmetric loss of the default recipe and its constants, the batches that it is taken on, and its gradient.

A positive's weight grows geometrically against a negative's (the paper's schedule grows it linearly and waits for
zero false negatives); the negatives' loss turns into a ramp, which gives up on what cannot be separated instead of
bending everything for it; half of a batch is drawn from samples that carry gradient, with weights that keep the mean
unbiased. All schedules are functions of the used fraction of the budget.
"""

from dataclasses import dataclass, replace

import torch

from warp_bounding.queries import QUERIES
from warp_bounding.training.engine.clock import geometric
from warp_bounding.training.engine.team import Team
from warp_bounding.training.engine.trainable_network import Evaluator

__all__ = ["NEGATIVES", "Batches", "Recipe", "accumulate", "plan", "recipe_of", "schedule", "summed", "weights_of"]


@dataclass(frozen=True)
class Recipe:
    """Constants of the default recipe, found on the paper's shapes; some depend on the kind of query.

    A schedule "a -> b over [s, e]" goes geometrically from a to b while the used fraction goes from s to e.
    """

    batch: int = 2048  # negatives, and as many positives, a step
    active: float = 0.75  # share of a batch that is drawn from the samples that carry gradient
    refresh: int = 100  # steps between two refreshes of the samples, and batches that are planned at each
    pool: int = 32768  # fresh negatives, and fresh positives, at a refresh
    vertices: int = 131072  # corners of boundary cells at a refresh, all of them where possible
    hard: int = 4096  # the worst positives, kept from refresh to refresh
    moves: int = 2  # steps down f that these take at a refresh
    explore: int = 16384  # fresh positives that walk down before they compete for the hard pool
    explore_moves: int = 4  # the number of these steps
    saturation: float = 4.0  # |f| beyond which a softplus carries almost no gradient
    weight: float = 3000.0  # of positives against negatives, 1 -> weight over [0, ramp]
    ramp: float = 0.83
    sharpness: float = 0.5  # width of the positives' softplus, 1 -> sharpness over [0, ramp]
    boost: float = 10.0  # weight of the worst positives, 1 -> boost over [0.6, 0.95]
    boosted: int = 1024  # number of the worst positives that are boosted
    give_up: float = 3.0  # width of the negatives' ramp, 40 -> give_up over [0.3, 0.95]
    rate: float = 2e-2  # highest learning rate (``cosine``)
    rate_end: float = 1e-3  # learning rate at the end, relative to the highest
    warm_up: float = 0.01  # used fraction at which the learning rate is highest
    beta1: float = 0.95  # of ``Soap``
    beta2: float = 0.95
    first_gain: float = 20.0  # initial weights of the first layer: uniform in +-gain / sqrt(inputs)
    later_gain: float = 3.0  # the same, of later hidden layers
    first_gain_plain: float = 3.0  # the same two where the activation is no wave, or behind an encoding
    later_gain_plain: float = 1.7


RECIPES = {
    # of ten pairs of fits around grids, meshes and a motion eight are tighter than with 3000; 8 % in the mean
    "point": Recipe(weight=1000.0),
    "ray": Recipe(first_gain=1.5, sharpness=0.3),  # a ray sweeps over many cells: its truth is smoother than a point's
    "box": Recipe(first_gain=5.0, sharpness=0.3),
}
# What is different for rays and boxes of 4D objects, from so many coordinates on. Networks of the paper's sizes are far
# from the truth there, so that most samples need gradient, and f is low at many places.
MANY_COORDINATES, FAR_FROM_TRUTH = 8, {"sharpness": 1.0, "hard": 16384, "explore": 32768}


# Share of uniform samples that are negatives a network must deny, usually. Of callers' queries most lie far away or touch, so few are; with this
# their loss weighs against the positives' as that of others does.
NEGATIVES = 0.75


def recipe_of(query: str, inputs: int) -> Recipe:
    """The default recipe for a kind of query of so many coordinates."""
    many = QUERIES[query].is_region and inputs >= MANY_COORDINATES
    return replace(RECIPES[query], **(FAR_FROM_TRUTH if many else {}))


def schedule(end: float, used: float, start: float, stop: float, begin: float = 1.0) -> float:
    """Geometric from ``begin`` to ``end`` while ``used`` goes from ``start`` to ``stop``."""
    return geometric(begin, end, min(1.0, max(0.0, (used - start) / (stop - start))))


@dataclass(frozen=True)
class Batches:
    """The batches until the next refresh, of negatives or of positives."""

    x: torch.Tensor  # ``(features + 1, N)``, encoded samples
    rows: torch.Tensor  # ``(refresh, batch)`` indices into them
    weight: torch.Tensor  # ``(batch,)``
    boost: torch.Tensor | None = None  # ``(N,)``, of the worst positives' weights; 1 of others
    offset: torch.Tensor | None = None  # ``(N,)``, what f is taken relative to; ``None`` for 0

    def relative(self, f: torch.Tensor, columns: torch.Tensor) -> torch.Tensor:
        """F of some columns, in place, less their offset."""
        return f if self.offset is None else f.sub_(self.offset.index_select(0, columns))


def plan(
    recipe: Recipe,
    used: float,
    generator: torch.Generator,
    negatives: tuple[torch.Tensor, torch.Tensor],
    positives: tuple[torch.Tensor, torch.Tensor],
) -> tuple[Batches, Batches]:
    """Draw batches of encoded samples whose values are known: ``(x, f)`` of negatives and of positives."""
    (negative, below), (positive, above) = negatives, positives
    chosen, weights = _stratified(below > -recipe.saturation, recipe, generator)
    planned = Batches(negative, chosen, weights * (NEGATIVES / len(below)))
    level = above.kthvalue(min(recipe.boosted, len(above)))[0]
    boost = 1 + (schedule(recipe.boost, used, 0.6, 0.95) - 1) * (above <= level).float()
    chosen, weights = _stratified(above <= torch.clamp(level, min=recipe.saturation), recipe, generator)
    return planned, Batches(positive, chosen, weights / len(above), boost)  # a mean


def weights_of(recipe: Recipe, used: float) -> tuple[float, float, float]:
    """Weight of positives against negatives, width of the positives' softplus, width of the negatives' ramp."""
    weight = schedule(recipe.weight, used, 0.0, recipe.ramp)
    width = schedule(recipe.sharpness, used, 0.0, recipe.ramp)
    return weight, width, schedule(recipe.give_up, used, 0.3, 0.95, begin=40.0)


def accumulate(
    batches: tuple[Batches, Batches], recipe: Recipe, team: Team, workers: list[Evaluator], row: int, used: float
) -> None:
    """Gradient of the loss on one batch that ``plan`` has drawn, the one with number ``row`` since the last refresh.

    The workers, one for each thread, are of one network; each one's share is in its ``gradient``.
    """
    (weight, width, ramp), (negatives, positives) = weights_of(recipe, used), batches
    for worker in workers:
        worker.gradient.zero_()

    def job(index: int, part: slice) -> None:
        worker = workers[index]
        columns = negatives.rows[row, part]
        x = negatives.x.index_select(1, columns)
        f = negatives.relative(worker.forward(x, keep=True), columns)
        signal = torch.sigmoid(f)
        if ramp < 30:
            signal -= torch.sigmoid(f - ramp)
        worker.backward(x, signal.mul_(negatives.weight[part]).mul_(weight**-0.5))
        columns = positives.rows[row, part]
        x = positives.x.index_select(1, columns)
        f = positives.relative(worker.forward(x, keep=True), columns)
        signal = torch.sigmoid(f.div_(-width)).mul_(positives.weight[part]).mul_(positives.boost[columns])
        worker.backward(x, signal.mul_(-(weight**0.5)))

    team.over(len(negatives.weight), job)


def summed(workers: list[Evaluator]) -> list[torch.Tensor]:
    """The workers' gradients, one matrix a layer; they are the first one's own."""
    for worker in workers[1:]:
        workers[0].gradient.add_(worker.gradient)
    return workers[0].gradients


def _stratified(active: torch.Tensor, recipe: Recipe, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Batches drawn from two strata: the samples that carry gradient, ``active`` ``(N,)`` bool, and the others.

    Returns:
        ``(refresh, batch)`` indices, and ``(batch,)`` weights under which a batch's sum estimates the sum over all
        samples.
    """
    strata = [active.nonzero()[:, 0], (~active).nonzero()[:, 0]]
    counts = [int(recipe.batch * recipe.active), recipe.batch - int(recipe.batch * recipe.active)]
    if len(strata[0]) <= 16 or not len(strata[1]):  # one stratum is (almost) empty: draw from all
        strata, counts = [torch.arange(len(active))], [recipe.batch]
    columns, weights = [], []
    for indices, count in zip(strata, counts, strict=True):
        columns.append(indices[torch.randint(len(indices), (recipe.refresh, count), generator=generator)])
        weights.append(torch.full((count,), len(indices) / count))
    return torch.cat(columns, 1), torch.cat(weights)
