"""Learning the normals of half-spaces (``learned-kdop``): few sampled negatives inside, no positive ever outside.

Every face is set to the support of what is bounded, so the positives' half of the paper's asymmetric loss is a
constraint that always holds, its weight infinite; what is left is the negatives' half, the mean of ``sigmoid(f / T)``
over them, T falling. Training starts from ``kdop``'s own half-spaces and from others; what has the fewest false
positives on the samples wins, ``kdop``'s half-spaces themselves among them, so the result is never worse than
``kdop`` there.
"""

import numpy as np
import torch

from warp_bounding.bounders.polytopes.learned_kdop import LearnedKdop, classic_normals, support_of
from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.queries import oracle, sample
from warp_bounding.training.engine.clock import Clock, TrainingProgress, geometric, interrupts
from warp_bounding.training.engine.descent import descend
from warp_bounding.training.engine.team import single_threaded_torch
from warp_bounding.training.learned_kdop.half_space_problems import HalfSpaceProblem, problem_of, tensor

__all__ = ["train_learned_kdop"]

# Queries of the protocol are sampled SAMPLES at a time, MOST_SAMPLES at most, until there are FEW * SAMPLES negatives,
# from which the normals are learned.
SAMPLES, FEW, MOST_SAMPLES = 100_000, 0.1, 1_000_000
BATCH = 4096  # negatives of a step
MOST = 128  # half-spaces at most
STARTS, STEPS = 3, 1500  # starts, and steps of each: more steps gain nothing
SOFTNESS = (0.2, 0.006)  # T, in units of v, from begin to end
RATE, RATE_END = 4e-2, 1e-3  # learning rate at the first and at the last step
JITTER = 0.02  # standard deviation of what is added to the first normals: two equal ones would stay equal
CHECK = 50  # steps between two counts of all negatives inside
REFRESH = 10  # steps between two calls of ``HalfSpaceProblem.refresh``
FINALISTS = 2  # results whose certified faces are set at the end, of which the best is taken


def train_learned_kdop(
    grid: IndicatorGrid,
    domain: Domain | RegionDomain,
    *,
    budget: float = 20.0,
    seed: int = 0,
    k: int | None = None,
    steps: int | None = None,
    device: str | None = None,
    progress: TrainingProgress | None = None,
) -> tuple[LearnedKdop, dict]:
    """Learn a ``learned-kdop``.

    Args:
        grid: The object.
        domain: ``domain_of(grid, query, length, space)``.
        budget: Seconds at most; some seconds are enough.
        seed: Of everything random.
        k: Half-spaces, ``MOST`` at most; as many as ``kdop`` has if ``None``. Beyond ``kdop``'s numbers, training
            starts from its default ones and random others.
        steps: Training steps in all instead of seconds: the result is then repeatable.
        device: Warp device of the bounder.
        progress: Called with the used fraction and a note. Ctrl-C ends training; the best so far is taken.

    Returns:
        The bounder, its threshold not set yet (``prove``), and a record of how it went.
    """
    clock = Clock(budget, steps)
    support, generator = support_of(grid, domain), torch.Generator().manual_seed(seed)
    problem, (v, share) = problem_of(domain, support), _negatives(grid, domain, seed)
    classic = _classic(domain, k)
    start = _unit(tensor(classic))
    if k is not None and k > len(start):
        start = torch.cat([start, _unit(problem.start(k - len(start), generator))])
    clock.reserved = min(0.15 * budget, 2 * clock.seconds)
    found: list[tuple[float, torch.Tensor]] = []

    def learn() -> None:
        for index in range(STARTS):
            normals = start + JITTER * torch.randn(start.shape, generator=generator)
            if index % 2 == 1:
                normals = problem.start(len(start), generator)
            part = ((index + 1) / STARTS, index / STARTS)
            found.append((np.inf, start))
            _descend(problem, v, _unit(normals), clock, part, generator, progress, found)
            if clock.fraction() >= 1:
                break

    with single_threaded_torch():
        interrupted = interrupts(learn)
    found.sort(key=lambda pair: pair[0])
    bounders = [LearnedKdop.of_normals(grid, domain, classic, support=support, device=device)]
    for _, normals in found[:FINALISTS]:
        try:
            bounders.append(
                LearnedKdop.of_normals(grid, domain, normals.double().numpy(), support=support, device=device)
            )
        except BounderError:  # half-spaces that are nearly parallel have no certain vertices
            continue
    rates = [float((b.reference(v.double().numpy()) >= 0).mean()) for b in bounders]
    best = int(np.argmin(rates))
    record = {
        "steps": clock.count,
        "interrupted": interrupted,
        "fp_rate": rates[best] * share,
        "fp_rate_kdop": rates[0] * share,
    }
    return bounders[best], record


def _classic(domain: Domain | RegionDomain, k: int | None) -> np.ndarray:
    """``kdop``'s half-spaces where it offers ``k`` of them, else its default ones.

    Raises:
        BounderError: For another ``k`` that is less than those, or more than ``MOST``.
    """
    try:
        return classic_normals(domain, k)
    except BounderError:
        usual = classic_normals(domain)
        if not isinstance(k, int) or not len(usual) < k <= MOST:
            raise BounderError(
                f"k of learned-kdop must be {len(usual)}, as many half-spaces as kdop has, or more, up to {MOST}, got {k!r}"
            ) from None
        return usual


def _descend(
    problem: HalfSpaceProblem,
    v: torch.Tensor,
    normals: torch.Tensor,
    clock: Clock,
    share: tuple[float, float],
    generator: torch.Generator,
    progress: TrainingProgress | None,
    found: list[tuple[float, torch.Tensor]],
) -> None:
    """Train from one start until the used fraction ``share[0]``, or for ``STEPS``; ``found[-1]`` keeps the best."""
    end, begin = share
    normals = normals.clone().requires_grad_(True)
    optimiser = torch.optim.Adam([normals], lr=RATE)
    for step in range(STEPS):
        used = max(step / STEPS, (clock.fraction() - begin) / (end - begin))
        last = used >= 1 or step == STEPS - 1
        with torch.enable_grad():
            unit = _unit(normals)
            if step % REFRESH == 0 or last:
                problem.refresh(unit)
            if step % CHECK == 0 or last:
                found[-1] = min(found[-1], _count(problem, v, unit.detach()), key=lambda pair: pair[0])
                if progress:
                    progress(clock.fraction(), f"{100 * found[-1][0]:.1f} % of the negatives inside")
            if last:
                break
            batch = v[torch.randint(len(v), (BATCH,), generator=generator)]
            softness = geometric(*SOFTNESS, used)
            loss = torch.sigmoid(problem.values(unit, problem.offsets(unit), batch) / softness).mean()
            descend(optimiser, loss, geometric(RATE, RATE_END, used))
        clock.count += 1


def _count(problem: HalfSpaceProblem, v: torch.Tensor, normals: torch.Tensor) -> tuple[float, torch.Tensor]:
    with torch.no_grad():
        offsets = problem.offsets(normals)
        inside = sum(int((problem.values(normals, offsets, part) >= 0).sum()) for part in v.split(16384))
    return inside / len(v), normals.clone()


def _unit(normals: torch.Tensor) -> torch.Tensor:
    return normals / normals.norm(dim=1, keepdim=True).clamp(min=1e-9)


def _negatives(grid: IndicatorGrid, domain: Domain | RegionDomain, seed: int) -> tuple[torch.Tensor, float]:
    """``v`` of sampled negatives, of other queries where there are none, and their share of all queries."""
    rng, truth = np.random.default_rng(seed), oracle(domain.query, grid, "cpu", domain.oracle_length)
    found, count, total = [], 0, 0
    while count < FEW * SAMPLES and total < MOST_SAMPLES:
        x = sample(domain.query, grid, SAMPLES, rng)
        found.append(x[~truth(x)])
        count, total = count + len(found[-1]), total + SAMPLES
    x = np.concatenate(found) if count else x[:64]
    return tensor(domain.to_local(x)), len(x) / total
