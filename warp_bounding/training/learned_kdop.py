"""What learning half-spaces needs of a kind of query: the faces of given normals and f of negatives, differentiable.

Normals have length 1 in the coordinates of what is bounded. Faces are supports in float32 without any room for
rounding: they steer the search only, ``LearnedKdop.of_normals`` sets the real ones.
"""

from __future__ import annotations

import contextlib
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from warp_bounding.bounders.learned_kdop import LearnedKdop, classic_normals
from warp_bounding.errors import BounderError
from warp_bounding.queries import oracle
from warp_bounding.queries.boundary import ObjectSupport
from warp_bounding.queries.domain import Domain
from warp_bounding.queries.plane import PLANE
from warp_bounding.queries.region_domain import AnyDomain, RegionDomain
from warp_bounding.runtime.progress import Progress
from warp_bounding.training.engine import Clock, adam, geometric, interrupts, single_threaded_torch, torch
from warp_bounding.training.samples import Problem, Trained

HALVINGS = 12  # of the interval in which f is highest along a ray


class HalfSpaceProblem:
    """Half-spaces around points, for a domain and the certified support of what is bounded."""

    def __init__(self, domain: Domain | RegionDomain, support: ObjectSupport):
        self.domain, self.support = domain, support
        self.points = tensor(support.points)
        self.columns = domain.space_ndim

    def offsets(self, normals: torch.Tensor) -> torch.Tensor:
        """``(k,)`` faces of normals ``(k, m)``."""
        return (normals @ self.points.T).amax(dim=1)

    def refresh(self, normals: torch.Tensor) -> None:
        """Called now and then with the normals as they are, before faces are requested."""

    def start(self, count: int, generator: torch.Generator) -> torch.Tensor:
        """``(k, m)`` normals to begin with that are not ``kdop``'s."""
        return torch.randn(count, self.columns, generator=generator)

    def values(self, normals: torch.Tensor, offsets: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        """``(N,)``, f of ``v`` ``(N, ndim)``."""
        return (offsets - v @ normals.T).amin(dim=1)


class BoxInObject(HalfSpaceProblem):
    """Boxes against a polytope in object space."""

    def values(self, normals: torch.Tensor, offsets: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        low, high = v.chunk(2, dim=1)
        return (offsets - low @ normals.clamp(min=0).T - high @ normals.clamp(max=0).T).amin(dim=1)


class RayInObject(HalfSpaceProblem):
    """Rays against a polytope in object space: f is concave along a ray, and its highest point is found by halving."""

    def values(self, normals: torch.Tensor, offsets: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        start, slope = v.chunk(2, dim=1)
        height, fall = offsets - start @ normals.T, slope @ normals.T
        with torch.no_grad():
            low, high = torch.zeros(len(v)), torch.ones(len(v))
            for _ in range(HALVINGS):
                middle = (low + high) / 2
                active = (height - middle[:, None] * fall).argmin(dim=1, keepdim=True)
                rising = fall.gather(1, active)[:, 0] < 0
                low, high = torch.where(rising, middle, low), torch.where(rising, high, middle)
            best = (low + high) / 2
        return (height - best[:, None] * fall).amin(dim=1)


class PlaneInObject(HalfSpaceProblem):
    """Planes against a polytope in object space, by its vertices: where n faces meet and no other one cuts off."""

    def values(self, normals: torch.Tensor, offsets: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        n = normals.shape[1]
        chosen = torch.tensor(list(combinations(range(len(normals)), n)))
        with torch.no_grad():
            matrix, right = normals[chosen].double(), offsets[chosen].double()
            safe = torch.linalg.det(matrix).abs() > 1e-6
            chosen = chosen[safe]
            y = torch.linalg.solve(matrix[safe], right[safe])
            met = ((y @ normals.T.double() - offsets) <= 1e-5).all(dim=1)
            chosen = chosen[met]
        if not len(chosen):
            return (offsets.sum() * 0).expand(len(v))
        vertices = torch.linalg.solve(normals[chosen], offsets[chosen])
        at = v[:, :n] @ vertices.T
        return torch.minimum(at.amax(dim=1) - v[:, n], v[:, n] - at.amin(dim=1))


def tensor(values: np.ndarray) -> torch.Tensor:
    """As float32."""
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))


def problem_of(domain: Domain | RegionDomain, support: ObjectSupport) -> HalfSpaceProblem:
    """The problem of a kind of query."""
    kinds = {"ray": RayInObject, "plane": PlaneInObject, "box": BoxInObject}
    return kinds.get(domain.query, HalfSpaceProblem)(domain, support)


# Learning the normals of half-spaces (``learned-kdop``): few sampled negatives inside, no positive ever outside.
#
# Every face is set to the support of what is bounded, so the positives' half of the paper's asymmetric loss is a
# constraint that always holds, its weight infinite; what is left is the negatives' half, the mean of ``sigmoid(f / T)``
# over them, T falling. Training starts from ``kdop``'s own half-spaces and from others; what has the fewest false
# positives on the samples wins, ``kdop``'s half-spaces themselves among them, so the result is never worse than
# ``kdop`` there.

# Queries of the protocol are sampled SAMPLES at a time, MOST_SAMPLES at most, until there are FEW * SAMPLES negatives,
# from which the normals are learned.
SAMPLES, FEW, MOST_SAMPLES = 100_000, 0.1, 1_000_000
BATCH = 4096  # negatives of a step
MOST = 128  # half-spaces at most
FRONT_FACES = 40  # half-spaces before a network in a cascade; twice as many are hardly nearer to the convex hull
STARTS, STEPS = 3, 1500  # starts, and steps of each: more steps gain nothing
SOFTNESS = (0.2, 0.006)  # T, in units of v, from begin to end
RATE, RATE_END = 4e-2, 1e-3  # learning rate at the first and at the last step
JITTER = 0.02  # standard deviation of what is added to the first normals: two equal ones would stay equal
CHECK = 50  # steps between two counts of all negatives inside
REFRESH = 10  # steps between two calls of ``HalfSpaceProblem.refresh``
FINALISTS = 2  # results whose certified faces are set at the end, of which the best is taken


def train_learned_kdop(
    _, problem: Problem, options: dict[str, Any], seconds: float, progress: Progress | None
) -> Trained:
    """Learn a ``learned-kdop`` (``fit.Trainer``); some seconds are enough. Ctrl-C ends training, the best is taken.

    There are ``k`` half-spaces, ``MOST`` at most; as many as ``kdop`` has if ``None``. Beyond ``kdop``'s numbers,
    training starts from its default ones and random others. ``steps`` are training steps in all.
    """
    grid, domain, k = problem.grid, problem.domain, options["k"]
    if k is None and problem.in_front and problem.query != PLANE.name:
        k = FRONT_FACES
    clock = Clock(seconds, options["steps"], progress)
    support, generator = ObjectSupport(grid, domain.base), torch.Generator().manual_seed(problem.seed)
    faces, (v, share) = problem_of(domain, support), _negatives(problem)
    classic = _classic(domain, k)
    start = of_length_1(tensor(classic))
    if k is not None and k > len(start):
        start = torch.cat([start, of_length_1(faces.start(k - len(start), generator))])
    clock.reserved = min(0.15 * seconds, 2 * clock.seconds)
    found: list[tuple[float, torch.Tensor]] = []

    def learn() -> None:
        for index in range(STARTS):
            normals = start + JITTER * torch.randn(start.shape, generator=generator)
            if index % 2 == 1:
                normals = faces.start(len(start), generator)
            part = ((index + 1) / STARTS, index / STARTS)
            found.append((np.inf, start))
            descend(faces, v, of_length_1(normals), clock, part, generator, found)
            if clock.fraction() >= 1:
                break

    with single_threaded_torch():
        interrupted = interrupts(learn)
    found.sort(key=lambda pair: pair[0])
    bounder_of = partial(LearnedKdop.of_normals, grid, domain, support=support, device=problem.device)
    bounders = [bounder_of(classic)]
    for _, normals in found[:FINALISTS]:
        with contextlib.suppress(BounderError):  # half-spaces that are nearly parallel have no certain vertices
            bounders.append(bounder_of(normals.double().numpy()))
    rates = [float((b.reference(v.double().numpy()) >= 0).mean()) for b in bounders]
    best = int(np.argmin(rates))
    record = {"steps": clock.count, "interrupted": interrupted}
    return bounders[best], record | {"fp_rate": rates[best] * share, "fp_rate_kdop": rates[0] * share}


def _classic(domain: AnyDomain, k: int | None) -> np.ndarray:
    """``kdop``'s half-spaces where it offers ``k`` of them, else its default ones, of which there must be fewer."""
    try:
        return classic_normals(domain, k)
    except BounderError:
        usual = classic_normals(domain)
        if not isinstance(k, int) or not len(usual) < k <= MOST:
            raise BounderError(
                f"k of learned-kdop must be {len(usual)}, as many half-spaces as kdop has, or more, up to {MOST}, got "
                f"{k!r}"
            ) from None
        return usual


def descend(
    problem: HalfSpaceProblem,
    v: torch.Tensor,
    normals: torch.Tensor,
    clock: Clock,
    share: tuple[float, float],
    generator: torch.Generator,
    found: list[tuple[float, torch.Tensor]],
) -> None:
    """Train from one start until the used fraction ``share[0]``, or for ``STEPS``; ``found[-1]`` keeps the best."""
    end, begin = share
    normals = normals.clone().requires_grad_(True)
    optimiser = adam([normals], lr=RATE)
    for step in range(STEPS):
        used = max(step / STEPS, (clock.fraction() - begin) / (end - begin))
        last = used >= 1 or step == STEPS - 1
        with torch.enable_grad():
            unit = of_length_1(normals)
            if step % REFRESH == 0 or last:
                problem.refresh(unit)
            if step % CHECK == 0 or last:
                found[-1] = min(found[-1], _count(problem, v, unit.detach()), key=lambda pair: pair[0])
                clock.tell(clock.fraction(), f"{100 * found[-1][0]:.1f} % of the negatives inside")
            if last:
                break
            batch = v[torch.randint(len(v), (BATCH,), generator=generator)]
            softness = geometric(*SOFTNESS, used)
            loss = torch.sigmoid(problem.values(unit, problem.offsets(unit), batch) / softness).mean()
            optimiser.param_groups[0]["lr"] = geometric(RATE, RATE_END, used)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        clock.count += 1


def _count(problem: HalfSpaceProblem, v: torch.Tensor, normals: torch.Tensor) -> tuple[float, torch.Tensor]:
    with torch.no_grad():
        offsets = problem.offsets(normals)
        inside = sum(int((problem.values(normals, offsets, part) >= 0).sum()) for part in v.split(16384))
    return inside / len(v), normals.clone()


def of_length_1(normals: torch.Tensor) -> torch.Tensor:
    """Normals ``(k, m)``, each divided by its length."""
    return normals / normals.norm(dim=1, keepdim=True).clamp(min=1e-9)


def _negatives(problem: Problem) -> tuple[torch.Tensor, float]:
    """``v`` of sampled negatives, of other queries where there are none, and their share of all queries."""
    domain, rng = problem.domain, np.random.default_rng(problem.seed)
    truth = oracle(domain.query, problem.grid, "cpu", domain.oracle_length)
    found, count, total = [], 0, 0
    while count < FEW * SAMPLES and total < MOST_SAMPLES:
        x = problem.sample(SAMPLES, rng)
        found.append(x[~truth(x)])
        count, total = count + len(found[-1]), total + SAMPLES
    x = np.concatenate(found) if count else x[:64]
    return tensor(domain.to_local(x)), len(x) / total
