"""``fit``: from a shape to a proven bounder, in a given time.

Closed forms are fitted and proven at once. A network is trained with the prover in the loop: now and then branch and
bound looks for the least value of f on the object, what it finds goes into training, and the last part of the budget
is the proof itself, which sets the threshold.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from warp_bounding.bounders import METHODS, Bounder, method_class
from warp_bounding.bounders.base import checked_device
from warp_bounding.bounders.bvh import Bvh, leaves_for_bytes
from warp_bounding.bounders.domain import Domain
from warp_bounding.bounders.kdop import Kdop
from warp_bounding.bounders.mlp import Mlp, check_hidden, check_octaves
from warp_bounding.bounders.network import ACTIVATIONS
from warp_bounding.bounders.parametric import fit_parametric
from warp_bounding.bounders.regions import RegionDomain, domain_of
from warp_bounding.errors import BounderError
from warp_bounding.indicators import IndicatorGrid, load_indicator
from warp_bounding.proof import Search, attest, minimum, positive_boxes, prove
from warp_bounding.queries import check_query, oracle, sample
from warp_bounding.queries.positives import draw_positives
from warp_bounding.training.adversary import adversarial_minimum
from warp_bounding.training.clock import Clock
from warp_bounding.training.kdop import train_learned_kdop
from warp_bounding.training.loop import Trainer
from warp_bounding.training.paper import PaperTrainer
from warp_bounding.training.samples import samples_of
from warp_bounding.training.support import SupportTrainer
from warp_bounding.training.team import single_threaded_torch

__all__ = ["fit"]

SPACES = ("geometric", "parametric")
TRAINERS = {"default": Trainer, "paper": PaperTrainer}
SEARCHES = (0.5, 0.7, 0.9)  # used fractions at which the prover looks for counterexamples
SEARCH_SHARE = 0.02  # of the budget, each
PROOF_SHARE = 0.03  # of the budget, reserved for the proof before a search has told what it takes
LONG_PROOF_SHARE = 0.2  # reserved where the last search did not end in its time
SEARCH_BOXES, PROOF_BOXES = 1_000_000, 20_000_000  # what takes the place of time where the budget is in steps
PROOF_COST = 1e-4  # share of all queries that a search may cost in false positives by ending early
COST_SAMPLES = 200_000
PARAMETRIC_SAMPLES = 20_000  # as in the paper's code
SEARCH_RESERVE = 0.15  # of the budget: the adversarial search of rays and boxes, the proof of planes
ATTEST_SHARE = 0.05  # of the budget: fresh positives
SEARCH_ROUNDS = 12  # of the adversarial search where the budget is in steps
PLANE_TOLERANCE = 1e-3  # of a plane's offset, in domain half-widths
MOMENTS_UP_TO = 3  # dimensions: in 4D a ray's moments would cost more than they bring

Progress = Callable[[float, float, str], None]


def fit(
    shape,
    query: str = "point",
    method: str = "mlp",
    *,
    hidden: tuple[int, ...] = (50, 50),
    activation: str = "sin",
    budget: float = 60.0,
    seed: int = 0,
    margin: float = 0.0,
    resolution: int | None = None,
    length: float = 1.0,
    space: str = "geometric",
    octaves: int = 0,
    k: int | None = None,
    leaves: int | None = None,
    steps: int | None = None,
    recipe: str = "default",
    device: str | None = None,
    progress: Progress | None = None,
) -> Bounder:
    """Fit a bounder to a shape, and prove it where there is a proof for the method and the query.

    Networks of rays and boxes have none yet: their certificate is statistical, and says so.

    Args:
        shape: What ``load_indicator`` returns, or anything that it takes.
        query: Kind of query: ``"point"``, ``"ray"``, ``"plane"`` or ``"box"``.
        method: A name in ``METHODS``.
        hidden: Hidden widths, mlp.
        activation: ``"sin"`` or ``"relu"``, mlp.
        budget: Seconds for training and proof, mlp.
        seed: Of everything random.
        margin: The object is dilated by this length first, object (world) units.
        resolution: Cells along a mesh's longest axis; 64 if ``None``. Grids bring their own.
        length: Of a ray, object units; other queries have none.
        space: ``"geometric"``: a region is tested against the volume; ``"parametric"``, as in the paper: the volume is fitted to
            the positives' own 2 n numbers. The same for points.
        octaves: Octaves of positional encoding, mlp; 0 for none, 4 as in the paper's supplement.
        k: Half-spaces, kdop and learned-kdop; by default 4 for each number of a query.
        leaves: Leaf boxes, bvh; if ``None``, as many as have the memory of a network of these ``hidden`` widths.
        steps: Training steps instead of seconds: the result is then repeatable to the bit on the same machine.
        recipe: ``"default"``, or ``"paper"`` for the paper's schedule.
        device: Warp device of the bounder; the default device if ``None``.
        progress: Called with done, total and a note. Ctrl-C ends training; the best network so far is then proven.

    Returns:
        The bounder, with ``certificate`` and ``info``.

    Raises:
        IndicatorError: If the shape cannot be read or bounded.
        QueryError: For an unknown kind of query.
        BounderError: For an unknown method, or an option that makes no sense.
    """
    check_query(query)
    _check_options(budget, steps, seed, margin, length, space, recipe)
    checked_device(device)
    if issubclass(METHODS.get(method, Bounder), Mlp):
        hidden, octaves = check_hidden(hidden), check_octaves(octaves)
        if activation not in ACTIVATIONS:
            raise BounderError(f"activation must be one of {', '.join(ACTIVATIONS)}, got {activation!r}")
    started = time.perf_counter()
    grid = load_indicator(shape).to_grid(resolution=resolution, margin=margin)
    space = "geometric" if query == "point" else space
    kind = method_class(method, query, grid.ndim, space)
    problem = Problem(grid, domain_of(grid, query, length, space), query, int(seed), device)
    record: dict = {}
    if method == "mlp":
        bounder, record = _fit_network(problem, hidden, activation, octaves, budget, steps, recipe, progress)
    else:
        if method == "learned-kdop":
            options = {"budget": budget, "seed": int(seed), "k": k, "steps": steps, "device": device}
            bounder, record = train_learned_kdop(grid, problem.domain, **options, progress=_shown(progress))
        else:
            bounder = _fit_classic(problem, kind, k, leaves, hidden)
        prove(bounder, grid)
    bounder.info = {
        "indicator": grid.digest,
        "name": grid.name,
        "grid_shape": list(grid.shape),
        "margin": grid.margin,
        "resolution": grid.resolution,
        "seed": int(seed),
        "note": grid.note,
        "training": record | {"seconds": round(time.perf_counter() - started, 3)},
    }
    return bounder


@dataclass(frozen=True)
class Problem:
    """What is to be bounded, for which queries, where."""

    grid: IndicatorGrid
    domain: Domain | RegionDomain
    query: str
    seed: int
    device: str | None


def _check_options(budget, steps, seed, margin, length, space, recipe) -> None:
    def number(value) -> bool:
        return isinstance(value, (int, float, np.number)) and not isinstance(value, bool) and np.isfinite(value)

    if not number(budget) or budget <= 0:
        raise BounderError(f"budget must be a positive number of seconds, got {budget}")
    if steps is not None and (isinstance(steps, bool) or not isinstance(steps, (int, np.integer)) or steps < 1):
        raise BounderError(f"steps must be a whole number of at least 1, got {steps}")
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or not 0 <= seed < 2**63:
        raise BounderError(f"seed must be a whole number from 0 to 2^63 - 1, got {seed}")
    if not number(margin) or margin < 0:
        raise BounderError(f"margin must be a length of at least 0, got {margin}")
    if not number(length) or length <= 0:
        raise BounderError(f"length must be positive, got {length}")
    if space not in SPACES:
        raise BounderError(f"space must be one of {', '.join(SPACES)}, got {space!r}")
    if recipe not in TRAINERS:
        raise BounderError(f"recipe must be one of {', '.join(TRAINERS)}, got {recipe!r}")


def _fit_classic(problem: Problem, kind: type[Bounder], k: int | None, leaves: int | None, hidden) -> Bounder:
    """A closed form; in parametric space around sampled positives, as in the paper, and then around all of them."""
    grid, domain, device = problem.grid, problem.domain, problem.device
    options = {"k": k} if kind is Kdop else {}
    if domain.space == "parametric" and problem.query != "point":
        x = sample(problem.query, grid, PARAMETRIC_SAMPLES, np.random.default_rng(problem.seed))
        positive = x[oracle(problem.query, grid, device, domain.length or 1.0)(x)]
        if len(positive) < 2:
            positive = next(draw_positives(problem.query, grid, PARAMETRIC_SAMPLES, problem.seed, device, domain.length or 1.0))
        return fit_parametric(kind, grid, domain, domain.to_local(positive), device=device, **options)
    if kind is Bvh:
        options = {"leaves": leaves or leaves_for_bytes(_network_bytes(domain, hidden), grid.ndim)}
    return kind.fit(grid, domain, device=device, **options)


def _network_bytes(domain: Domain | RegionDomain, hidden) -> int:
    """Memory of the network of these widths that the same queries would have."""
    sizes = [domain.space_ndim if domain.query == "plane" else domain.ndim, *check_hidden(hidden)]
    outputs = 2 if domain.query == "plane" else 1
    numbers = sum(k * h + h for k, h in zip(sizes, [*sizes[1:], outputs], strict=True))
    return 4 * (numbers + len(domain.header) + 1 + len(domain.extra))


def _shown(progress: Progress | None) -> Callable[[float, str], None] | None:
    """A trainer's progress as the caller's."""
    return (lambda used, note: progress(min(used, 1.0), 1.0, note)) if progress else None


def _fit_network(problem: "Problem", hidden, activation, octaves, budget, steps, recipe, progress) -> tuple[Mlp, dict]:
    """Train, then set the threshold: by a proof where there is one, else by a search and statistics."""
    if problem.query == "plane":
        return _fit_supports(problem, hidden, activation, budget, steps, progress)
    grid, domain, device = problem.grid, problem.domain, problem.device
    clock, boxes, interrupted = Clock(budget, steps), 0, False
    point = problem.query == "point"
    clock.reserved = (PROOF_SHARE if point else SEARCH_RESERVE) * budget
    moments = problem.query == "ray" and grid.ndim <= MOMENTS_UP_TO and not octaves
    sizes = {"hidden": list(hidden), "activation": activation, "octaves": octaves, "moments": moments}
    samples = samples_of(grid, domain, problem.seed)
    trainer = TRAINERS[recipe](samples, hidden, activation, octaves, moments)
    waiting = list(SEARCHES) if point else []

    def build(flat: torch.Tensor | None = None) -> Mlp:
        return Mlp(domain, trainer.network.tensors(flat), sizes, device)

    def counterexamples(_, used: float) -> None:
        """Let the prover look at the network as it is; its lowest points become training samples."""
        nonlocal boxes
        if not waiting or used < waiting[0]:
            return
        waiting.pop(0)
        bounder = build()
        limit = {"seconds": SEARCH_SHARE * budget} if clock.timed else {"boxes": SEARCH_BOXES}
        search = _search(bounder, grid, trainer.worst_points(), limit)
        boxes += search.boxes
        trainer.add(search.worst)
        if clock.timed:  # the last proof will take about as long, on a network that is a little harder
            expected = 2 * search.seconds if search.complete else LONG_PROOF_SHARE * budget
            clock.reserved = min(max(expected, 0.01 * budget), LONG_PROOF_SHARE * budget)

    def report(used: float, note: str) -> None:
        if progress:
            progress(min(used, 1.0) * (0.97 if point else 0.85), 1.0, note)

    with single_threaded_torch():
        try:
            trainer.run(clock, counterexamples=counterexamples, progress=report)
        except KeyboardInterrupt:
            interrupted = True
        best = trainer.best()
    bounder = build(best)
    record = {"recipe": recipe, "steps": clock.count, "interrupted": interrupted, "boxes_in_training": boxes}
    if point:
        if progress:
            progress(0.97, 1.0, "proof")
        limit = {"seconds": max(budget - clock.seconds, 0.02 * budget)} if clock.timed else {"boxes": PROOF_BOXES}
        points = trainer.worst_points()
        search = prove(bounder, grid, eps=_tolerance(bounder, problem, points), points=points, **limit)
        return bounder, record | {"gap": float(search.upper_bound - search.lower_bound)}
    if progress:
        progress(0.87, 1.0, "adversarial search")
    trainer.network.flat.copy_(best)
    seconds = max(budget - clock.seconds - ATTEST_SHARE * budget, 0.05 * budget) if clock.timed else float("inf")
    rounds = {} if clock.timed else {"rounds": SEARCH_ROUNDS}
    found = adversarial_minimum(samples, trainer.network, seconds, states=trainer.hard_states(), **rounds)
    if progress:
        progress(0.95, 1.0, "fresh positives")
    room = _tolerance(bounder, problem, found.worst)
    attest(bounder, grid, least=found.value, room=room, seed=problem.seed)
    return bounder, record | {"gap": room, "search_seconds": round(found.seconds, 3), "search_complete": found.complete}


def _fit_supports(problem: "Problem", hidden, activation, budget, steps, progress) -> tuple[Mlp, dict]:
    """A plane's network: two support functions, and the proof that they stay above the object's."""
    grid, domain = problem.grid, problem.domain
    clock, interrupted = Clock(budget, steps), False
    clock.reserved = SEARCH_RESERVE * budget
    trainer = SupportTrainer(grid, domain, hidden, activation, problem.seed)
    with single_threaded_torch():
        try:
            trainer.run(clock, progress=lambda used, note: progress(min(used, 1.0) * 0.85, 1.0, note) if progress else None)
        except KeyboardInterrupt:
            interrupted = True
    sizes = {"hidden": list(hidden), "activation": activation, "octaves": 0, "moments": False}
    bounder = Mlp(domain, trainer.tensors(), sizes, problem.device)
    if progress:
        progress(0.87, 1.0, "proof")
    limit = {"seconds": max(budget - clock.seconds, 0.05 * budget)} if clock.timed else {"boxes": PROOF_BOXES}
    search = prove(bounder, grid, eps=PLANE_TOLERANCE, **limit)
    record = {"recipe": "default", "steps": clock.count, "interrupted": interrupted, "boxes_in_training": 0}
    return bounder, record | {"gap": float(search.upper_bound - search.lower_bound)}


def _search(bounder: Mlp, grid: IndicatorGrid, points: np.ndarray, limit: dict[str, float]) -> Search:
    """The prover's search, for its counterexamples."""
    lower, upper = positive_boxes(bounder, grid)
    problem = Problem(grid, bounder.domain, "point", 0, None)
    return minimum(bounder, lower, upper, eps=_tolerance(bounder, problem, points), points=points, **limit)


def _tolerance(bounder: Mlp, problem: "Problem", worst: np.ndarray) -> float:
    """How far below the least known value a threshold may lie before it costs ``PROOF_COST`` in false positives."""
    x = sample(problem.query, problem.grid, COST_SAMPLES, np.random.default_rng(0))
    truth = oracle(problem.query, problem.grid, bounder.device, bounder.domain.length or 1.0)(x)
    values = bounder.values(x).numpy()[~truth]
    least = float(bounder.reference(worst).min())
    below = np.sort(values[np.isfinite(values) & (values < least)])[::-1]
    count = int(PROOF_COST * COST_SAMPLES)
    return max(least - float(below[count]), 1e-6) if len(below) > count else 1e-3
