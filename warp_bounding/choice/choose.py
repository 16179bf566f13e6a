"""``choose``: fit what is plausible, measure it on the caller's own queries, and take what costs the least.

The budget is a limit for all that is done, and what there is no room for is not begun (``work``). Closed forms are fitted first. Of networks as many are trained as
can be judged in that time, and then the better ones longer (``races``); what cannot become the cheapest even if it left nothing but positives is given up. Half of the
queries are for fitting, and what is told is measured on the other half. Times are taken at the end, of all candidates in turns.
"""

import hashlib
import math
from collections.abc import Iterable, Mapping

import numpy as np

from warp_bounding.bounders import Bounder, DistanceBounder
from warp_bounding.choice.candidates import NETWORKS, candidates_of, check_methods, check_networks
from warp_bounding.choice.closed import ClosedForms
from warp_bounding.choice.kept import Kept
from warp_bounding.choice.pace import Spending
from warp_bounding.choice.races import race
from warp_bounding.choice.result import NONE, Choice
from warp_bounding.choice.verdict import chosen
from warp_bounding.choice.work import Work
from warp_bounding.coordinates.region_domain import domain_of
from warp_bounding.errors import BounderError
from warp_bounding.indicators import load_indicator
from warp_bounding.indicators.parts.complement import SIDES
from warp_bounding.indicators.recentred import own_coordinates
from warp_bounding.queries import QUERIES, check_query, oracle, sample
from warp_bounding.runtime.devices import device_of
from warp_bounding.runtime.progress import Progress, reported
from warp_bounding.training.checks import check_numbers, check_regions, is_number, warn_of_restriction
from warp_bounding.training.samples.callers import CallersQueries

__all__ = ["check_prices", "choose"]

CLOSED_SHARE = 1 / 3  # of the budget, for what is no network, where there are networks
SAMPLES = 200_000  # random queries, where the caller has none


def choose(
    shape,
    query: str = "point",
    *,
    narrow_ns: float,
    queries=None,
    memory: int | None = None,
    device: str | None = None,
    budget: float = 120.0,
    seed: int = 0,
    margin: float = 0.0,
    length: float | None = None,
    methods: Iterable[str] | None = None,
    networks: Iterable[tuple[int, ...]] = NETWORKS,
    bounders: Mapping[str, Bounder | DistanceBounder] | None = None,
    overhead_ns: float = 0.0,
    statistical: bool = False,
    folder=None,
    progress: Progress | bool | None = None,
) -> Choice:
    """Choose a broad phase: fit candidates of every method, in several sizes, measure them on your own queries, and take the cheapest.

    What counts is ``t + p * narrow_ns``: the nanoseconds that a bounder takes for a query, and the share of the queries that it
    leaves to a narrow phase of this price (paper, Eq. 6). No bounder at all is one of the answers.

    Args:
        shape: What ``load_indicator`` returns, or anything that it takes.
        query: Kind of query: ``"point"``, ``"ray"``, ``"plane"`` or ``"box"``.
        narrow_ns: What your exact test takes for one query, nanoseconds.
        queries: ``(Q, m)`` numbers, object space, as your simulation asks them, in its order; random ones if ``None``. A few thousand at least; half of them are fitted to.
        memory: Most bytes that a query may read (``Bounder.nbytes``).
        device: Warp device where it is measured, and of the bounder; the default device if ``None``.
        budget: Seconds that fits and measurements take together, up to an eighth more; what ``folder`` holds is charged with what it took. What there is no room for is not
            begun, and its row tells the budget that it would need. Compiling kernels, once for each size of network, is not counted.
        seed: Seed of everything random.
        margin: The object is dilated by this length first, object units.
        length: Length of a ray, object units; 1 if ``None``. Other queries have none.
        methods: Names of methods that are tried: those in ``METHODS``, ``"learned-kdop+mlp"``, and of distances ``"distance-grid"`` and ``"distance"``,
            a network; all of them if ``None``, only ``bounders`` for ``()``.
        networks: Hidden widths of the networks that are tried; none of them for ``()``.
        bounders: Bounders of this very shape that you have already, by name; they are measured with the others. Distances are
            asked points, rays or boxes.
        overhead_ns: What your step takes for a query if any bounder is asked, beside the bounder itself, such as for lists of what is left.
        statistical: Whether a bounder that samples attest may be chosen, too; else only proven ones are.
        folder: Where candidates are kept as they are fitted; a call with the same settings goes on there. ``None`` keeps nothing.
        progress: Called with done, total and a note. ``None`` shows a bar on standard error if that is a terminal,
            ``False`` nothing. Ctrl-C ends fitting; what was fitted is then compared.

    Returns:
        The choice, with rows of all candidates and the prices of the narrow phase at which another one is the best.

    Raises:
        IndicatorError: If the shape cannot be read or bounded.
        QueryError: For an unknown kind of query, or queries that are none of it.
        BounderError: For a price, memory or budget that makes no sense, an unknown method, or memory that holds no candidate at all.
        FileFormatError: For a folder that holds something else.

    Example:
        >>> ball = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 6
        >>> choice = wb.choose(ball, narrow_ns=1000.0, budget=5.0, networks=(), device="cpu", progress=False)
        >>> choice.rows[0].cost <= min(row.cost for row in choice.rows if not row.why_not)
        True
    """
    check_query(query)
    check_numbers(budget, seed, margin)
    check_prices(query, narrow_ns, overhead_ns, memory, length, statistical)
    wanted = check_methods(methods)
    device = str(device_of(device))
    spending = Spending(float(budget))
    shape, length = own_coordinates(load_indicator(shape), "choose"), length or 1.0
    warn_of_restriction(shape)
    bounded, rng = shape.dilated(margin) if margin else shape, np.random.default_rng(seed)
    x = sample(query, bounded, SAMPLES, rng) if queries is None else queries
    told = CallersQueries(x, bounded, domain_of(bounded, query, length), seed)
    sizes = check_networks(networks)
    learned, own = _halves(told.x, rng)
    options = {"margin": margin, "seed": int(seed)} | ({"length": length} if QUERIES[query].has_length else {})
    settings = {"shape": bounded.digest, "query": query, **options}
    settings["queries"] = hashlib.sha256(told.x.tobytes()).hexdigest() if queries is not None else None
    work = Work(
        shape=shape,
        query=query,
        options=options | {"queries": None if queries is None else learned},
        bounded=bounded,
        length=length,
        own=own,
        truth=np.asarray(oracle(query, bounded, "cpu", length)(own), dtype=bool),
        narrow_ns=float(narrow_ns),
        overhead_ns=float(overhead_ns),
        memory=memory,
        device=device,
        statistical=statistical,
        kept=Kept(folder, settings),
        spending=spending,
    )
    candidates = candidates_of(query, shape, sizes, wanted)
    closed, rivals = ([each for each in candidates if each.network == network] for network in (False, True))
    work.networks = frozenset(each.label for each in rivals)
    with reported(progress, "choose") as work.update:
        others, held = work.measured_own(bounders or {}), work.from_before(candidates)
        others += [held.pop(each.label) for each in closed if each.label in held]
        forms = ClosedForms(work, closed, {each.label for each in others})
        others += forms.fit(CLOSED_SHARE * spending.budget if rivals else math.inf)
        networks = race(work, rivals, others, held)
        others += forms.fit(math.inf)  # with what is left
        return chosen(work, [*others, *networks.values()], len(told.x))


def _halves(x: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Queries to fit to, in any order, and queries to measure with, in the caller's order; one alone is both."""
    if len(x) < 2:
        return x, x
    first = np.zeros(len(x), dtype=bool)
    first[rng.permutation(len(x))[: len(x) // 2]] = True
    return x[first], x[~first]


def check_prices(query: str, narrow_ns, overhead_ns, memory, length, statistical) -> None:
    """Refuse what makes no sense for any shape, with ``BounderError``."""
    for name, value in (("narrow_ns", narrow_ns), ("overhead_ns", overhead_ns)):
        if not is_number(value) or value < 0:
            raise BounderError(f"{name} must be a number of nanoseconds of at least 0, got {value!r}")
    whole = isinstance(memory, (int, np.integer)) and not isinstance(memory, bool)
    if memory is not None and not (whole and memory > 0):
        raise BounderError(f"memory must be a whole number of bytes of at least 1, got {memory!r}")
    check_regions(query, NONE, length, SIDES[0])
    if not isinstance(statistical, bool):
        raise BounderError(f"statistical must be True or False, got {statistical!r}")
