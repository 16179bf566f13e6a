"""``fit``: from a shape to a bounder, in a given time.

``METHODS`` has the methods, ``TRAINERS`` how each is made; distances are below.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from warp_bounding.bounders import DISTANCES, METHODS, Bounder, cascade, method_class
from warp_bounding.bounders.bounder import STEPS, known_method, resolved
from warp_bounding.bounders.bvh import Bvh
from warp_bounding.bounders.cascade import Cascade
from warp_bounding.bounders.distance import REACH, DistanceBounder, VolumeDistance
from warp_bounding.bounders.learned_kdop import LearnedKdop
from warp_bounding.bounders.mlp import HIDDEN, Mlp
from warp_bounding.bounders.mlp_distance import MlpDistance
from warp_bounding.bounders.relu_field import ReluField
from warp_bounding.certificates.claim import as_fitted
from warp_bounding.errors import BounderError, ProofError, QueryError, warn
from warp_bounding.evaluation import quick_rates
from warp_bounding.proof import prove_or_test
from warp_bounding.proof.distances import overestimates_in
from warp_bounding.proof.prove import prove_distance
from warp_bounding.queries import QUERIES, check_query
from warp_bounding.queries.distance import DISTANCE, DistanceDomain
from warp_bounding.queries.point import POINT
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.runtime.launch import compile_seconds, device_of
from warp_bounding.runtime.progress import Progress, reported
from warp_bounding.shapes import Grid, Mesh, MovingMesh, load_shape
from warp_bounding.shapes.complement import SIDES, Complement
from warp_bounding.shapes.recentred import Frame, parted
from warp_bounding.shapes.shape import MAX_RESOLUTION, Shape, check_memory
from warp_bounding.training.distances import train_distance
from warp_bounding.training.fit_network import fit_network, tries
from warp_bounding.training.learned_kdop import train_learned_kdop
from warp_bounding.training.relu_field import train_relu_field
from warp_bounding.training.samples import CallersQueries, Problem, Trained

FRONT_SHARE = 0.1  # of the rest of the budget: for each learned part of a cascade before its networks (a prefilter)
COORDINATE_BYTES = 32  # per occupied cell and axis: its index, two corners and what is computed from them
PROOF_SECONDS = 8e-6  # per occupied cell, measured: what training leaves for a proof that is one pass over the cells
# Limits of a proof without cells of what is not trained: the gap of f, in local units, and the number of boxes.
SHAPE_EPS, SHAPE_BOXES = 1e-4, 4_000_000
# Cells along the longest side of a 3D shape for rays, planes and boxes, by default. A bvh of the bunny has
# 0.79 (boxes) and 0.87 (rays) times the false positives against the mesh that it has with 64.
REGION_NDIM, REGION_RESOLUTION = 3, 128
DEFAULTS, COMMON_NDIM = (MlpDistance, Mlp, Bvh), 3  # ``fit`` takes the first that answers the queries of a 3D shape
BEHIND_WAVES = (48, 48)  # widths of a network's layers behind that of an arm's angles
PROOF_SHARE = 0.1  # of a part's seconds: what training leaves for a proof that is a search without cells
LEAST_SHARE = 0.05  # of the budget: the least that a part of a cascade or a proof gets, however long all else took


def fit(
    shape,
    query: str = "point",
    method: str | None = None,
    *,
    budget: float = 60.0,
    seed: int = 0,
    margin: float = 0.0,
    force: bool = False,
    resolution: int | None = None,
    length: float | None = None,
    side: str = SIDES[0],
    workload=None,
    device: str | None = None,
    progress: Progress | bool | None = None,
    scheduler: str | int | None = None,
    **options,
) -> Bounder:
    """Fit a bounder to a shape, and prove it.

    What it returns is proven, unless ``statistical=True`` is given, the shape certifies no box to be empty, or the
    method, ``occupancy``, promises nothing.

    Args:
        shape: What ``load_shape`` returns, or anything that it takes. Of a mesh that is not closed only the surface
            and its margin are bounded, which raises a ``BoundingWarning``.
        query: Kind of query: ``"point"``, ``"ray"``, ``"plane"`` or ``"box"``; or ``"distance"``: a ``DistanceBounder``
            of the shape, whose distances are never too large.
        method: A name in ``METHODS``; or several, as in ``"learned-kdop+mlp"``: a cascade, queried in this order.
            ``None`` is ``"mlp"`` for points and distances, and ``"bvh"`` for rays, planes and boxes, which networks do
            not answer: the first of ``DEFAULTS`` that does. For points of a solid without cells it is
            ``"learned-kdop+mlp"``.
        budget: Seconds for training and proof, of all parts of a cascade together. A network's proof may take a tenth
            more, and compiling kernels, once for each size of network, is not counted. A bvh stops splitting boxes when
            the time is over; other closed forms are found at once, up to millions of cells. A third of an arm's time is
            for training, the rest for the proof (``proof.make_proven``).
        seed: Seed of everything random.
        margin: The object is dilated by this length first, object (world) units. A margin under the size of a mesh's
            cells raises a warning, because the cells are what is bounded.
        force: Accept a margin that is larger than the object.
        resolution: Cells along a mesh's longest axis. ``None`` is 64 for ``bvh`` (128 for rays, planes and boxes),
            ``voxels`` and ``relu-field``, and the mesh itself, without cells, for all other methods. Grids have their
            own.
        length: Length of a ray, object units; 1 if ``None``. Other queries have none.
        side: ``"outside"``: *no* means certainly not in the object. ``"inside"``: *no* means certainly in it; the
            bounder then bounds the shape's complement, and the proof is about that. For points, and methods that do
            not divide the shape into cells; with an outer bounder it makes a ``two_sided`` one.
        workload: ``(Q, m)`` numbers, object space: queries of the caller's own, as its simulation makes them. Learned
            methods (networks, a ``learned-kdop``, a ``relu-field``) then avoid false positives among these first; of
            planes only the normals count. Proofs are about all queries all the same. Some thousands are enough; of more
            than a million a part is used.
        device: Warp device of the bounder; the default device if ``None``.
        progress: Called with done, total and a note. ``None`` shows a bar on standard error if that is a terminal,
            ``False`` nothing. Ctrl-C ends training; the best network so far is then proven.
        scheduler: Of an mlp of points of a shape without cells: address of a Dask scheduler whose workers prove, as
            of an arm, or a number of processes of this machine.
        **options: The method's own (``METHODS[method].options``); an option that no part of a cascade takes is refused.
            ``hidden``: widths of an mlp's hidden layers, ``(50, 50)``; a bvh gets the memory of such a network. Of an
            arm's configurations ``(2 K, 48, 48)``: the first layer begins as sines and cosines of its K angles.
            ``activation``: ``"sin"`` or ``"relu"`` for an mlp; of points the better one of two short trainings, which
            take a fifth of the budget, if it is not given. Sines suit round and wavy shapes, ReLU flat faces and edges;
            ``info["training"]["trials"]`` has the share of false positives of both. ``statistical``: of an mlp of
            points, ``True`` for a threshold from samples, unproven, where in many dimensions a proven one denies
            nothing. ``k``: half-spaces of a kdop or learned-kdop. ``leaves``: leaf boxes of a bvh. ``steps``: training
            steps instead of seconds; the result is then repeatable to the bit on the same machine.

    Returns:
        The bounder, with ``certificate`` and ``info``. ``info["training"]`` reports how training went, with ``seconds``
        in all and, among them, ``compile_seconds`` for kernels, which no budget counts; for ``rates`` see
        ``quick_rates``.

    Raises:
        ShapeError: If the shape cannot be read or bounded.
        QueryError: For an unknown kind of query, or a ``workload`` of another kind.
        BounderError: For an unknown method, an option that makes no sense or that the method does not take, or a margin
            larger than the object without ``force``.
        ProofError: Where no proof that denies a tenth of an arm's free configurations is expected to end in time. It
            holds the network.

    Warns with ``BoundingWarning`` if less than a third of the free queries are denied.

    Example:
        >>> ball = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 6
        >>> bounder = wb.fit(ball, method="obb", device="cpu")
        >>> bounder.certificate.proven
        True
        >>> rays = wb.fit(ball, "ray", "kdop", length=0.5, k=26, device="cpu")
    """
    if query in METHODS:
        raise QueryError(f"{query!r} is a method, which comes after the query: method={query!r}")
    check_query(query, DISTANCE.name)
    by_default = method is None
    if by_default:
        method = next(cls.method for cls in DEFAULTS if cls.supports(query, COMMON_NDIM))
    if "space" in options:
        raise BounderError(
            "space is gone: volumes are fitted around the object; those around queries' numbers: python -m paper table1"
        )
    check_numbers(budget, seed, margin)
    spent = Stopwatch()
    if scheduler is not None:
        if (query, method) != (POINT.name, Mlp.method):
            raise BounderError(f"scheduler is for the proof of an mlp of points, got {query}, {method}")
        if options.get("statistical"):
            raise BounderError("scheduler is for a proof, got statistical")
    far = query == DISTANCE.name
    check_asked(query, method, length, side, workload)
    length = length or 1.0
    known = [method_class(method, query)] if far else [known_method(name) for name in method.split("+")]
    resolved(known, query, options, [fit])
    device_of(device)
    shape, frame = parted(load_shape(shape))
    check_extent(shape, margin, force)
    warn_of_restriction(shape)
    given = _Given(shape, method, by_default, options, budget, int(seed), margin, resolution, device, progress, spent)
    if far:
        bounder = _fit_distance(given, force)
    else:
        bounder = _fit_answers(given, query, length, side, workload, scheduler, frame)
    warn_of_little(bounder)
    bounder.info["training"] |= spent.seconds()
    return bounder.in_frame(frame)


@dataclass(frozen=True)
class _Given:
    """What ``fit`` was given, checked; the shape in coordinates of its own."""

    shape: Shape
    method: str
    by_default: bool  # whether no method was given
    options: dict[str, Any]
    budget: float
    seed: int
    margin: float
    resolution: int | None
    device: str | None
    progress: Progress | bool | None
    spent: "Stopwatch"


def _fit_answers(
    given: _Given, query: str, length: float, side: str, workload, scheduler: str | int | None, frame: Frame | None
) -> Bounder:
    """``fit`` of points or regions, of a shape in its own coordinates; ``fit`` has checked the arguments."""
    shape, method, spent = given.shape, given.method, given.spent
    if side == SIDES[1]:
        shape = Complement(shape)
    grid = _bounded(shape, query, method, given.resolution, given.margin)
    if scheduler is not None and (isinstance(grid, Grid) or not grid.certified):
        raise BounderError(f"scheduler is for the proof of a shape without cells, got {grid.name}")
    classes = [method_class(name, query, grid.ndim) for name in method.split("+")]
    if len(classes) > 1:
        Cascade.check(classes)
    chosen = resolved(classes, query, given.options, [fit])
    if grid.waves is not None and HIDDEN.name not in given.options:
        for cls, own in zip(classes, chosen, strict=True):
            if issubclass(cls, Mlp):
                own[HIDDEN.name] = (2 * len(grid.waves), *BEHIND_WAVES)
    plain = given.by_default and side == SIDES[0] and scheduler is None
    if plain and _has_front(grid, query, chosen[0]):
        classes = [LearnedKdop, *classes]
        chosen = [*resolved([LearnedKdop], query, {STEPS.name: chosen[0][STEPS.name]}), *chosen]
    domain, repeatable = domain_of(grid, query, length), any(each.get("steps") for each in chosen)
    callers = None if workload is None else CallersQueries(workload, grid, domain, given.seed, frame)
    more = {"callers": callers, "repeatable": repeatable, "scheduler": scheduler}
    problem = Problem(grid, domain, query, given.seed, given.device, **more)
    with reported(given.progress, f"fit {method}") as update:
        try:
            parts = _fit_parts(problem, classes, chosen, given.budget, spent, update)
        except ProofError as error:
            error.bounder.info = described(grid, given.seed, spent.seconds())
            error.bounder = error.bounder.in_frame(frame)
            raise
    bounder = parts[0] if len(parts) == 1 else cascade(*parts)
    bounder.info["rates"] = quick_rates(bounder, grid, shape)
    return bounder


def _has_front(shape: Shape, query: str, options: dict[str, Any]) -> bool:
    """Whether ``fit`` puts half-spaces in front of a network, by its options: for points of solids without cells."""
    solid = not isinstance(shape, Grid) and shape.ndim == COMMON_NDIM and not shape.time and shape.joints is None
    known = solid and query == POINT.name and options["activation"] is None and not options["statistical"]
    return known and tries(shape, options[STEPS.name])


class Stopwatch:
    """The time of a fit: ``seconds``, and among them ``compile_seconds`` for kernels, which no budget counts."""

    def __init__(self):
        self._started, self._compiled = time.perf_counter(), compile_seconds()

    def seconds(self) -> dict[str, float]:
        """What was taken so far, by name."""
        taken = {"seconds": time.perf_counter() - self._started, "compile_seconds": compile_seconds() - self._compiled}
        return {key: round(value, 3) for key, value in taken.items()}

    @property
    def working(self) -> float:
        """Seconds so far, without compiling."""
        taken = self.seconds()
        return taken["seconds"] - taken["compile_seconds"]

    def left(self, budget: float, reserved: float = 0.0) -> float:
        """Seconds that are left of a budget, some of them reserved; a little at least, however long all else took."""
        return max(budget - reserved - self.working, LEAST_SHARE * budget)


def _fit_parts(
    problem: Problem,
    classes: list[type[Bounder]],
    chosen: list[dict[str, Any]],
    budget: float,
    spent: Stopwatch,
    progress: Progress | None,
) -> list[Bounder]:
    """Bounders of the classes, which share the budget."""
    trainers, parts, grid = [trainer_of(cls) for cls in classes], [], problem.grid
    for index, cls in enumerate(classes):
        trainer, own = trainers[index], spent if index == 0 else Stopwatch()
        left = spent.left(budget)
        waiting = sum(each.proves for each in trainers[index:])
        if trainer.proves:
            seconds = left / waiting
        else:
            seconds = min(left * (FRONT_SHARE if waiting else 1.0), trainer.most_seconds)
            reserved = PROOF_SECONDS * len(grid.occupied) if isinstance(grid, Grid) else PROOF_SHARE * seconds
            seconds -= min(seconds / 2, reserved)
        part = replace(problem, front=tuple(parts), in_front=waiting > 0)
        bounder, record = trainer.train(cls, part, chosen[index], seconds, progress)
        if not trainer.proves:
            limits = {"eps": SHAPE_EPS, "boxes": SHAPE_BOXES}
            if not problem.repeatable:
                limits["budget"] = left * FRONT_SHARE if waiting else spent.left(budget)
            if progress:
                limits["progress"] = partial(_told, progress, cls.method)
            prove_or_test(bounder, grid, seed=problem.seed, **limits)
        bounder.info = described(grid, problem.seed, record | own.seconds())
        parts.append(bounder)
    return parts


def _told(progress: Progress, method: str, boxes: int, waiting: float, gap: float) -> None:
    """Show that a proof is alive (``prove``)."""
    progress(0.0, 1.0, f"{method}: proof, {boxes:,} boxes")


def described(shape: Shape, seed: int, record: dict[str, Any]) -> dict[str, Any]:
    """``info``, without ``rates``, of a bounder that was fitted to a shape, its margin included."""
    return {
        "indicator": shape.digest,
        "name": shape.name,
        "grid_shape": list(shape.shape) if isinstance(shape, Grid) else None,
        "margin": shape.margin,
        "resolution": shape.resolution,
        "shape": shape.shape_digest if isinstance(shape, Grid) else shape.geometry,
        "seed": int(seed),
        "note": shape.restriction,
        "training": record,
    }


def _bounded(shape, query: str, method: str, resolution: int | None, margin: float) -> Shape:
    """What is bounded: the dilated shape itself, or its cells where a resolution or a method requires them."""
    own = isinstance(shape, Grid)
    known = [METHODS[name] for name in method.split("+") if name in METHODS]  # other names are refused later
    if isinstance(shape, Shape) and not own and resolution is None:
        kind = QUERIES[query]
        decidable = not kind.is_region or (kind.decides(shape) and shape.corners() is not None)
        if decidable and all(cls.takes_shapes(query) for cls in known):
            shape.check()
            shape = shape.dilated(margin)
            shape.check_contents()
            return shape
        if kind.is_region and shape.ndim == REGION_NDIM:
            resolution = REGION_RESOLUTION
    grid = shape.to_grid(resolution=resolution, margin=margin)
    if not own:
        warn_of_coarse_cells(grid)
    occupied = int(grid.occupancy.sum())
    check_memory(
        occupied * grid.ndim * COORDINATE_BYTES, f"fitting {occupied:,} occupied cells", "give a coarser resolution"
    )
    return grid


# Distances. A method that has a volume is fitted as a bounder of points, whose proof carries over; the others as
# ``TRAINERS`` says. ``prove_distance`` then finds the slack.

# A cell is halved if its overestimate exceeds TOLERANCE of its side plus LOOSER times that of some of its points.
TOLERANCE, LOOSER = 0.02, 1.25
CELL_HALVINGS = 3  # of a cell, on each axis
MOST_HALVED = 3  # axes that count for this, so that there are not too many boxes in higher dimensions
# Of the budget, what training leaves for the proof of a distance; the second from LARGE dimensions on.
DISTANCE_PROOF_SHARE, LARGE_PROOF_SHARE, LARGE = 0.2, 0.15, 4


def _fit_distance(given: _Given, force: bool) -> DistanceBounder:
    """``fit`` of distances to a shape that is not dilated by the margin yet; ``fit`` has checked the arguments."""
    shape, method, seed, device, spent = given.shape, given.method, given.seed, given.device, given.spent
    cls = method_class(method, DISTANCE.name, shape.ndim)
    (chosen,) = resolved([cls], DISTANCE.name, given.options, [fit])
    if shape.joints is not None:
        raise BounderError(
            f"{method}: {shape.name}: distances of configurations are not bounded, points are; "
            "clear_segments clears whole motions"
        )
    if shape.time and not (cls.moving and shape.speed is not None):
        able = ", ".join(name for name, each in DISTANCES.items() if each.moving)
        raise BounderError(
            f"{method}: {shape.name} moves; distances to it at a time are bounded of moving meshes by {able}; in "
            "Grid(occupancy), a grid without a time, it is one more coordinate"
        )
    own = {"margin": given.margin, "resolution": given.resolution}
    if issubclass(cls, VolumeDistance):
        own |= {"budget": spent.left(given.budget), "seed": seed, "device": device, "progress": given.progress}
        volume = fit(shape, POINT.name, method, force=force, **own, **given.options)
        fitted, info = as_fitted(volume, shape), volume.info
        bounder = cls.around(volume, DistanceDomain.of(fitted), device)
        prove_distance(bounder, fitted, of_volume=volume.certificate)
    else:
        shape.check()
        fitted = shape.dilated(given.margin) if given.resolution is None else shape.to_grid(**own)
        if fitted.distances(fitted.lower[None]) is None:
            raise BounderError(
                f"{method}: {shape.name} has no distance; meshes, grids, solids and functions with distance= have one"
            )
        proving = given.budget * (DISTANCE_PROOF_SHARE if shape.ndim < LARGE else LARGE_PROOF_SHARE)
        domain = DistanceDomain.of(fitted, chosen.pop(REACH.name, 0.0))
        problem = Problem(fitted, domain, DISTANCE.name, seed, device)
        with reported(given.progress, f"fit {method}") as update:
            bounder, record = trainer_of(cls).train(cls, problem, chosen, spent.left(given.budget, proving), update)
        prove_distance(bounder, fitted, budget=spent.left(given.budget))
        info = described(fitted, seed, record)
    bounder.info = info | {"rates": None}
    bounder.info["rates"] = quick_rates(bounder, fitted)
    return bounder


def _overestimate_of_cells(bounder: DistanceBounder, shape: Shape, seconds: float) -> np.ndarray:
    """By how much F exceeds the distance in each of its pieces."""
    lower, upper = bounder.pieces()
    tolerance = TOLERANCE * float((upper - lower).max()) + LOOSER * _sampled_overestimate(bounder, shape, lower, upper)
    halvings = CELL_HALVINGS * min(bounder.ndim, MOST_HALVED)
    return overestimates_in(bounder, shape, lower, upper, tolerance=tolerance, halvings=halvings, budget=seconds)[0]


def _sampled_overestimate(bounder: DistanceBounder, shape: Shape, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """F less the distance at some points of boxes, at least 0: halving a box cannot make a bound less than that."""
    most = np.zeros(len(lower))
    for share in [np.full(bounder.ndim, 0.5), *(np.array(s) for s in product((0.25, 0.75), repeat=bounder.ndim))]:
        v = lower + share * (upper - lower)
        low = shape.distances(bounder.domain.to_object(v))[:, 0] / bounder.domain.unit
        most = np.maximum(most, bounder.reference(v) - low)
    return most


# How the bounders of a class are made from a shape: in closed form by the class itself, or as ``TRAINERS`` says.
#
# ``fit`` treats all methods alike. A learned method from outside the package adds an entry to ``TRAINERS``, which
# counts for its subclasses too.

KDOP_SECONDS = 10.0  # training longer does not make learned half-spaces tighter


@dataclass(frozen=True)
class Trainer:
    """How the bounders of a class are made.

    ``train`` is called with the class, the problem, the values of all of the class's options, the seconds that training
    may take, and a function for progress or ``None``. If it ``proves``, it sets threshold and certificate itself, and
    such parts of a cascade share the rest of the budget equally. Else ``fit`` calls ``prove`` afterwards; the part then
    gets all that is left, but only ``FRONT_SHARE`` of it before a part that proves. More than ``most_seconds`` does not
    make it tighter.
    """

    train: Callable[[type[Bounder], Problem, dict[str, Any], float, Progress | None], Trained]
    proves: bool = False
    most_seconds: float = math.inf


def _closed_form(cls: type[Bounder], problem: Problem, options: dict[str, Any], seconds: float, _) -> Trained:
    """The volume that the class computes."""
    if cls.takes_seconds:
        options = options | {"seconds": math.inf if problem.repeatable else seconds}
    return cls.fit(problem.grid, problem.domain, device=problem.device, **options), {}


def _closed_distance(
    cls: type[DistanceBounder], problem: Problem, options: dict[str, Any], seconds: float, _
) -> Trained:
    """The function F that the class computes, lowered where it exceeds the distance."""
    lowered = partial(_overestimate_of_cells, shape=problem.grid, seconds=seconds)
    return cls.fit(problem.grid, problem.domain, lowered=lowered, device=problem.device, **options), {}


TRAINERS: dict[type[Bounder], Trainer] = {
    Bounder: Trainer(_closed_form),
    DistanceBounder: Trainer(_closed_distance),
    MlpDistance: Trainer(train_distance),
    LearnedKdop: Trainer(train_learned_kdop, most_seconds=KDOP_SECONDS),
    ReluField: Trainer(train_relu_field),
    Mlp: Trainer(fit_network, proves=True),
}


def trainer_of(cls: type[Bounder]) -> Trainer:
    """How bounders of a class are made: its own entry of ``TRAINERS``, or the nearest base's."""
    return next(TRAINERS[base] for base in cls.__mro__ if base in TRAINERS)


# What ``fit`` refuses before any time is spent, each in one line.

CLOSE = ". If its inside counts, close it first: docs/guide/shapes.md has two ways, for small holes and for scans"


def check_numbers(budget: float, seed: int, margin: float) -> None:
    """Refuse a budget, a seed or a margin that makes no sense, with ``BounderError``."""
    if not is_number(budget) or budget <= 0:
        raise BounderError(f"budget must be a positive number of seconds, got {budget!r}")
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or not 0 <= seed < 2**63:
        raise BounderError(f"seed must be a whole number from 0 to 2^63 - 1, got {seed!r}")
    if not is_number(margin) or margin < 0:
        raise BounderError(f"margin must be a length of at least 0, got {margin!r}")


def is_number(value: Any) -> bool:
    """Whether it is a finite number, and no truth value."""
    return isinstance(value, (int, float, np.number)) and not isinstance(value, bool) and bool(np.isfinite(value))


def check_extent(shape: Grid | Mesh | MovingMesh, margin: float, force: bool) -> None:
    """Refuse a margin that leaves nothing of the object's form, before any time is spent on it."""
    extent = float(shape.extent.max())
    if margin > extent and not force:
        raise BounderError(
            f"margin must be at most the object's extent, {extent:.4g}, got {margin:g}; force=True (--force) takes it "
            "all "
            "the same"
        )


def warn_of_coarse_cells(grid: Grid) -> None:
    """Warn where cells reach farther beyond the object than the margin: that costs false positives."""
    size = 1 / float(grid.cells_per_unit[-1])
    if 0 < grid.margin < size:
        finer = math.ceil(grid.resolution * size / grid.margin)
        advice = (
            f"resolution={finer} has cells of the margin's size"
            if finer <= MAX_RESOLUTION
            else "give a finer resolution"
        )
        text = (
            f"margin {grid.margin:g} is under the size of a cell, {size:.3g}: the object's cells at resolution "
            f"{grid.resolution} are bounded, and they are wider than the margin; {advice}"
        )
        warn(text)


def warn_of_restriction(shape: Shape) -> None:
    """Warn if a part that a user may mean is not bounded, such as the inside of an open mesh."""
    if text := getattr(shape, "restriction", ""):  # what only has a ``to_grid`` of its own says nothing of it
        warn(f"{shape.name}: {text}{'' if getattr(shape, 'watertight', True) else CLOSE}")


LITTLE = 1 / 3  # of the free queries: of a network that denies less a user should know
HARDLY_ANY = 0.1  # the same of other methods: boxes around slender things deny few, and their users know


def warn_of_little(bounder: Bounder) -> None:
    """Warn if few free queries are denied, by ``info["rates"]``."""
    rates = bounder.info["rates"]
    denied = (rates["free"] - rates["fp_rate"]) / rates["free"] if rates["free"] else 1.0
    if denied < (LITTLE if isinstance(bounder, Mlp) else HARDLY_ANY):
        warn(
            f"{bounder.method}: denies {denied:.1%} of the free queries (of {rates['samples']:,} random ones); give a "
            "larger budget= or other options if it is learned, else another method="
        )


def check_asked(query: str, method: str, length: float | None, side: str, workload=None) -> None:
    """Refuse arguments that this kind of query does not have, with ``BounderError``."""
    if not isinstance(method, str):
        raise BounderError(f"method must be a name, or several joined by +, got {method!r}")
    if side not in SIDES:
        raise BounderError(f"side must be one of {', '.join(SIDES)}, got {side!r}")
    if query == DISTANCE.name:
        for name, given, none in (("length", length, None), ("side", side, SIDES[0])):
            if given != none:
                raise BounderError(f"{name} is not for distances, got {name}={given!r}")
        if workload is not None:
            raise BounderError("a workload is not for distances, which have no false positives of their own")
        return
    if side == SIDES[1] and QUERIES[query].is_region:
        raise BounderError(f"side={side} is for point queries, got {query} queries")
    if length is not None and not QUERIES[query].has_length:
        raise BounderError(f"length is for ray queries, got length={length} for {query} queries")
    if length is not None and (not is_number(length) or length <= 0):
        raise BounderError(f"length must be a positive number, got {length!r}")
