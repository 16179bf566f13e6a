"""``fit``: from a shape to a bounder, in a given time.

Closed forms are fitted and proven at once, networks in ``networks``. What can be asked for stands in ``bounders.METHODS``.
"""

import math
import time
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from warp_bounding.bounders import Bounder, method_class
from warp_bounding.bounders.activations import ACTIVATIONS, check_activation
from warp_bounding.bounders.base import checked_device
from warp_bounding.bounders.bvh import Bvh, leaves_for_bytes
from warp_bounding.bounders.cascade import Cascade
from warp_bounding.bounders.domain import Domain
from warp_bounding.bounders.kdop import Kdop
from warp_bounding.bounders.learned_kdop import LearnedKdop
from warp_bounding.bounders.mlp import Mlp, check_hidden, check_octaves
from warp_bounding.bounders.monotone_mlp import MonotoneMlp
from warp_bounding.bounders.parametric import fit_parametric
from warp_bounding.bounders.regions import RegionDomain, domain_of
from warp_bounding.bounders.relu_field import ReluField
from warp_bounding.errors import BounderError, BoundingWarning
from warp_bounding.indicators import IndicatorGrid, IndicatorMesh, IndicatorMotion, load_indicator
from warp_bounding.indicators.mesh import MAX_RESOLUTION
from warp_bounding.proof import cascade, prove
from warp_bounding.queries import check_query, oracle, sample
from warp_bounding.queries.positives import draw_positives
from warp_bounding.training.field import train_relu_field
from warp_bounding.training.kdop import train_learned_kdop
from warp_bounding.training.networks import TRAINERS, NetworkOptions, fit_network
from warp_bounding.training.problem import Problem

__all__ = ["fit"]

SPACES = ("geometric", "parametric")
PARAMETRIC_SAMPLES = 20_000  # as in the paper's code
KDOP_SECONDS = 10.0  # more does not make learned half-spaces tighter
FRONT_FACES = 40  # of a learned-kdop before a network; twice as many are hardly nearer to the convex hull
FRONT_SHARE = 0.1  # of what is left of the budget: for each learned part of a cascade before its networks
LEAST_SHARE = 0.05  # of the budget, that is left for a part

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
    force: bool = False,
    resolution: int | None = None,
    length: float = 1.0,
    space: str = "geometric",
    octaves: int = 0,
    k: int | None = None,
    leaves: int | None = None,
    last: Bounder | None = None,
    steps: int | None = None,
    recipe: str = "default",
    device: str | None = None,
    progress: Progress | None = None,
) -> Bounder:
    """Fit a bounder to a shape, and prove it where there is a proof for the method and the query.

    A proof of an mlp's rays or boxes can take longer than the budget leaves for it; its certificate is then statistical, and says so.

    Args:
        shape: What ``load_indicator`` returns, or anything that it takes.
        query: Kind of query: ``"point"``, ``"ray"``, ``"plane"`` or ``"box"``.
        method: A name in ``METHODS``; or several, as in ``"learned-kdop+mlp"``: a cascade, asked in this order; what the proof of a network
            may cost is counted behind the parts before it.
        hidden: Hidden widths, mlp.
        activation: A name in ``ACTIVATIONS``, ``"sin"``, ``"relu"`` or ``"tanh"``, mlp; monotone-mlp takes tanh in place of sin, which is
            not monotone.
        budget: Seconds for training and proof, mlp; a proof that is late may take a tenth more. Of all parts of a cascade together.
        seed: Of everything random.
        margin: The object is dilated by this length first, object (world) units. Under the size of a mesh's cells it is warned of: the
            cells are what is bounded.
        force: Take a margin that is larger than the object, too.
        resolution: Cells along a mesh's longest axis; 64 if ``None``. Grids bring their own.
        length: Of a ray, object units; other queries have none.
        space: ``"geometric"``: a region is tested against the volume; ``"parametric"``, as in the paper: the volume is fitted to
            the positives' own 2 n numbers. The same for points.
        octaves: Octaves of positional encoding, mlp; 0 for none, 4 as in the paper's supplement.
        k: Half-spaces, kdop and learned-kdop; by default 4 for each number of a query, and 40 for a learned-kdop before a network.
        leaves: Leaf boxes, bvh; if ``None``, as many as have the memory of a network of these ``hidden`` widths.
        last: The last part of a cascade, where it is fitted already; then only those before it are.
        steps: Training steps instead of seconds: the result is then repeatable to the bit on the same machine.
        recipe: ``"default"``, or ``"paper"`` for the paper's schedule.
        device: Warp device of the bounder; the default device if ``None``.
        progress: Called with done, total and a note. Ctrl-C ends training; the best network so far is then proven.

    Returns:
        The bounder, with ``certificate`` and ``info``.

    Raises:
        IndicatorError: If the shape cannot be read or bounded.
        QueryError: For an unknown kind of query.
        BounderError: For an unknown method, an option that makes no sense, or a margin larger than the object that is not forced.
    """
    check_query(query)
    _check_options(budget, steps, seed, margin, length, space, recipe)
    checked_device(device)
    started = time.perf_counter()
    shape = load_indicator(shape)
    _check_extent(shape, margin, force)
    grid = shape.to_grid(resolution=resolution, margin=margin)
    if not isinstance(shape, IndicatorGrid):
        _warn_of_coarse_cells(grid)
    space = "geometric" if query == "point" else space
    kinds = [method_class(name, query, grid.ndim, space) for name in method.split("+")]
    if len(kinds) > 1:
        Cascade.check(kinds)
    if last is not None and (len(kinds) < 2 or type(last) is not kinds[-1]):
        raise BounderError(f"last must be the last of several methods, {method!r}, got {last!r}")
    networks = [issubclass(kind, Mlp) for kind in kinds]
    options = [_network_options(kind, hidden, activation, octaves, steps, recipe) for kind in kinds]
    problem = Problem(grid, domain_of(grid, query, length, space), query, int(seed), device)
    parts: list[Bounder] = []
    for index, kind in enumerate(kinds if last is None else kinds[:-1]):
        begun, waiting = time.perf_counter(), sum(networks[index:])
        left = max(budget - (begun - started), LEAST_SHARE * budget) if parts else budget
        part = replace(problem, front=tuple(parts))
        if networks[index]:
            bounder, record = fit_network(kind, part, replace(options[index], budget=left / waiting), progress)
        else:
            seconds = min(left * (FRONT_SHARE if waiting else 1.0), KDOP_SECONDS if kind is LearnedKdop else left)
            faces = FRONT_FACES if k is None and waiting and kind is LearnedKdop and query != "plane" else k
            bounder, record = _fit_other(part, kind, faces, leaves, hidden, seconds, steps, progress)
            prove(bounder, grid)
        bounder.info = {
            "indicator": grid.digest,
            "name": grid.name,
            "grid_shape": list(grid.shape),
            "margin": grid.margin,
            "resolution": grid.resolution,
            "seed": int(seed),
            "note": grid.note,
            "training": record | {"seconds": round(time.perf_counter() - (begun if index else started), 3)},
        }
        parts.append(bounder)
    if len(kinds) == 1:
        return parts[0]
    whole = cascade(*parts) if last is None else cascade(*parts, last.to(str(parts[0].device)))
    before = 0.0 if last is None else (last.info.get("training") or {}).get("seconds", 0.0)
    whole.info["training"]["seconds"] = round(time.perf_counter() - started + before, 3)
    return whole


def _check_extent(shape: IndicatorGrid | IndicatorMesh | IndicatorMotion, margin: float, force: bool) -> None:
    """Refuse a margin that leaves nothing of the object's form, before it is spent time on."""
    extent = float(shape.extent.max())
    if margin > extent and not force:
        raise BounderError(
            f"margin must be at most the object's extent, {extent:.4g}, got {margin:g}; force=True (--force) takes it all the same"
        )


def _warn_of_coarse_cells(grid: IndicatorGrid) -> None:
    """Warn where cells cover the object by more than the margin asks for: rates are those of the cells."""
    size = 1 / float(grid.cells_per_unit[-1])
    if 0 < grid.margin < size:
        finer = math.ceil(grid.resolution * size / grid.margin)
        advice = (
            f"resolution={finer} has cells of the margin's size"
            if finer <= MAX_RESOLUTION
            else "give a finer resolution"
        )
        text = (
            f"margin {grid.margin:g} is under the size of a cell, {size:.3g}: false positives are counted against the "
            f"object's cells at resolution {grid.resolution}, which are wider than the margin; {advice}"
        )
        warnings.warn(text, BoundingWarning, stacklevel=3)


def _network_options(kind, hidden, activation, octaves, steps, recipe) -> NetworkOptions | None:
    """The options of a network, checked; its budget is set later. ``None`` for other bounders."""
    if not issubclass(kind, Mlp):
        return None
    hidden, octaves = check_hidden(hidden), check_octaves(octaves)
    check_activation(activation)
    if issubclass(kind, MonotoneMlp):
        if octaves or recipe != "default":
            raise BounderError(
                f"{kind.method} takes no octaves and the default recipe only, got {octaves} and {recipe}"
            )
        activation = ACTIVATIONS[activation].monotone
    return NetworkOptions(hidden, activation, octaves, 0.0, steps, recipe)


def _fit_other(
    problem: Problem,
    kind: type[Bounder],
    k,
    leaves,
    hidden,
    seconds: float,
    steps: int | None,
    progress: Progress | None,
) -> tuple[Bounder, dict]:
    """A bounder that is no network, and a record of how it went."""
    grid, domain = problem.grid, problem.domain
    options = {"seed": problem.seed, "steps": steps, "device": problem.device, "progress": _shown(progress)}
    if kind is LearnedKdop:
        return train_learned_kdop(grid, domain, budget=seconds, k=k, **options)
    if kind is ReluField:
        return train_relu_field(grid, domain, budget=seconds, **options)
    return _fit_classic(problem, kind, k, leaves, hidden), {}


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
            length = domain.length or 1.0
            drawn = draw_positives(problem.query, grid, PARAMETRIC_SAMPLES, problem.seed, device, length, outside=False)
            positive = next(drawn)
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
