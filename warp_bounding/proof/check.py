"""Prove from scratch what a file claims: which claim it is, whether it can be about the shape, and what must be proven.

What is proven of a kind of query is an object (``Proof``); all have one way from a search to a verdict. Both searches
are loops of their own, which halve boxes (``halving``): of points (``covering``), and of distances (``distances``), by
other boxes than those by which the threshold was set. ``taylor`` bounds networks. A
volume has one bound, here and where its threshold is set; where F is the distance to a volume, that volume is checked.
Where the shape certifies no box, fresh positives are queried (``stress``).
"""

import os
from collections.abc import Callable

import numpy as np

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.bounders.load import bounder_of
from warp_bounding.certificates import Certificate, Verdict, conjunction, document
from warp_bounding.certificates.claim import OUTSIDE, Claim, claim_of, fault_of, target
from warp_bounding.errors import BounderError
from warp_bounding.proof.covering import Checked, check_covering, cover_cells, cover_domain
from warp_bounding.proof.distances import overestimate_within
from warp_bounding.proof.halving import Checkpoint, unfinished
from warp_bounding.proof.prove import TOUCHED
from warp_bounding.proof.stress import CONFIDENCE, POSITIVES, descend, fn_rate_bound, fresh_seed, try_positives
from warp_bounding.proof.taylor import TaylorBounds
from warp_bounding.queries import QUERIES, decision
from warp_bounding.queries.boundary import border_points
from warp_bounding.runtime.launch import working_seconds
from warp_bounding.shapes.grid import Grid
from warp_bounding.shapes.shape import IN, OUT, Shape

BORDER = 65_536  # points of a border among which some outside the domain are looked for
LEAST_SECONDS = 1.0  # of a search for a counterexample where the proof has no decision
NONE = np.empty((0, 0))  # no suspects


def certify(
    bounder: Bounder,
    shape,
    *,
    margin: float | None = None,
    length: float | None = None,
    resolution: int | None = None,
    query: str | None = None,
    budget: float = 900.0,
    progress: Callable[[int, int], None] | None = None,
    checkpoint: str | os.PathLike | None = None,
    scheduler: str | int | None = None,
) -> Certificate:
    """Prove from scratch that a bounder has no false negative on a shape, or find out why there is no proof.

    A bounder's certificate names the margin, the length of rays and the resolution of a mesh that its claim is about.
    If you rely on one of these, state it here: a bounder that claims another one is then ``"inapplicable"``.

    Args:
        bounder: Its threshold and weights are taken as they are; its own certificate is ignored.
        shape: Any shape, or anything that ``load_shape`` takes; where the bounder is one of cells, the shape is divided
            into cells with the bounder's resolution and margin.
        margin: The margin that is expected, object units; the bounder's own if ``None``.
        length: The length of rays that is expected, object units; the bounder's own if ``None``.
        resolution: The resolution of a mesh that is expected; the bounder's own if ``None``.
        query: The kind of query that is expected; the bounder's own if ``None``.
        budget: Seconds allowed for all parts together; compiling kernels is not counted. Where they do not suffice, a
            search for a counterexample takes up to a quarter more.
        progress: Called with how much is done and how much there is; counts begin anew for each part of a conjunction.
        checkpoint: A file for the state of a proof that runs out of time or is stopped; the same call goes on from
            there. It is removed when the proof has ended. For proofs of one part, and not of functions: another
            function can have the same digest, so a checkpoint could go on for the wrong one.
        scheduler: Address of a Dask scheduler whose workers search, or a number of processes of this machine (then a
            script needs ``if __name__ == "__main__":``). The result is the same.

    Returns:
        A certificate of kind ``"proven"``; ``"statistical"`` (the method has no proof; fresh positives were queried,
        and none was denied); ``"refuted"`` (with a counterexample); ``"undecided"``; or ``"inapplicable"`` (the shape
        cannot be the bounded one, the claim is not the expected one, or the method is not conservative).

    Raises:
        BounderError: For an argument out of range, or a checkpoint of a proof of several parts.
        FileFormatError: For a checkpoint of another proof, or one that cannot be read or written.
        ShapeError: For a checkpoint of the proof for a function.

    Example:
        >>> wb.certify(bounder, grid).kind, wb.certify(bounder, grid, margin=0.5).kind
        ('proven', 'inapplicable')
    """
    check_budget(budget)
    numbers = {"margin": margin, "length": length, "resolution": resolution}
    expected = {"query": query} | {name: _exactly(name, value) for name, value in numbers.items()}
    bounder = bounder_of(bounder)
    claim = claim_of(bounder, shape, expected)
    certificate = _certified(claim, budget, checkpoint, progress=progress, scheduler=scheduler)
    return bounder.frame.noted(certificate) if bounder.frame else certificate


def check_budget(budget: float) -> None:
    """Raises ``BounderError`` if it is no number of seconds."""
    if isinstance(budget, bool) or not isinstance(budget, (int, float)) or not budget >= 0:
        raise BounderError(f"budget must be a number of at least 0, got {budget!r}")


def _exactly(name: str, value: float | None) -> float | None:
    """An expected number as an int or a float, not rounded: ``np.float32(0.1)`` does not match a claim of 0.1."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise BounderError(f"{name} must be a number, got {value!r}")
    return value if isinstance(value, int) else float(value)


def _certified(claim: Claim, budget: float, checkpoint: str | os.PathLike | None, **options) -> Certificate:
    """What is known of a claim, part by part; ``options`` are for ``halving.search``."""
    started, saved = working_seconds(), None
    bounder, shape = (TaylorBounds().given_to(each) for each in (claim.bounder, claim.shape))
    parts = [bounder] if claim.fault else bounder.parts  # out of the domain the bounder answers before any part does
    if checkpoint is not None and not claim.fault:
        if parts != [bounder] or (bounder.of_distances and bounder.volume is not None):
            raise BounderError(f"{bounder.method}: a checkpoint is for a proof of one part that is searched for")
        saved = Checkpoint(checkpoint, bounder, shape)
    certificates = []
    for part in parts:
        begun = working_seconds() - (saved.seconds if saved else 0.0)
        fault = claim.fault if part is bounder else fault_of(part, shape)
        if part is bounder and fault and fault != OUTSIDE:
            verdict = Verdict("inapplicable", fault, 0.0)
        else:
            limits = {"budget": max(budget - (working_seconds() - started), 0.0), "checkpoint": saved}
            verdict = proof_of(part, shape, bounder).verdict(fault, **limits, **options)
        certificates.append(document(part, shape, verdict, working_seconds() - begun))
        if verdict.kind not in ("proven", "statistical"):
            break
    return conjunction(certificates)


# --- what is proven of a kind of query --------------------------------------------------------------------------------


def proof_of(bounder: Bounder, shape: Shape, deployed: Bounder) -> "Proof":
    """The proof of a part; arguments as in ``Proof``."""
    if bounder.of_distances:
        return (OfDistances if bounder.volume is None else OfDistancesToVolumes)(bounder, shape, deployed)
    if QUERIES[bounder.query_kind].is_region:
        return OfRegions(bounder, shape, deployed)
    return (OfPoints if shape.certified else BySamples)(bounder, shape, deployed)


class Proof:
    """The proof that a bounder, or a part of one, never errs: a search, and where it fails, a counterexample.

    Args:
        bounder: The part.
        shape: What it must be proven for.
        deployed: The whole: a query that it does not deny refutes nothing.

    Attributes:
        close: What is said where the search has no proof.
    """

    close = "f comes closer to the threshold than the proof's margins for rounding allow"

    def __init__(self, bounder: Bounder, shape: Shape, deployed: Bounder):
        self.bounder, self.shape, self.deployed, self.target = bounder, shape, deployed, target(bounder)
        kind = QUERIES.get(bounder.query_kind)
        self.proven = kind and f"every {kind.positive} is answered with maybe"
        self.refuted = f"a {bounder.query_kind} that meets the object is answered with no"

    def verdict(self, fault: str, budget: float, **options) -> Verdict:
        """The verdict, within so many seconds; ``options`` are for ``halving.search``.

        With a ``fault`` of the claim nothing is searched: points of the shape outside the domain may refute the claim.
        """
        if fault:
            x = self.first_wrong(self.outside()) if fault == OUTSIDE else None
            least = float(self.bounder.threshold)
            return Verdict("undecided" if x is None else "refuted", fault, least, counterexample=x)
        checked = self.search(budget, **options)
        if checked.complete and checked.suspects is None:
            return Verdict("proven", f"Proven from scratch: {self.proven}.", checked.least, checked.boxes)
        x = self.first_wrong(checked.suspects)
        x = self.tried(checked, budget) if x is None else x
        text = self.close if checked.complete else unfinished(f"{budget:.3g} s", options["checkpoint"])
        return self.without_proof(x, text, checked.least, checked.boxes)

    def without_proof(self, x: np.ndarray | None, text: str, least: float, boxes: int) -> Verdict:
        """Refuted by a query ``x`` that is denied; without one undecided, for the reason in ``text``."""
        if x is None:
            return Verdict("undecided", text, least, boxes)
        if self.bounder is not self.deployed and self.deployed.query(np.float32(x)[None]).numpy()[0]:
            text = "a part by itself denies a query that meets the object, and the whole does not"
            return Verdict("undecided", text, least, boxes)
        return Verdict("refuted", self.refuted, least, boxes, x)

    def search(self, budget: float, **options) -> Checked:
        """Look for a proof."""
        raise NotImplementedError

    def tried(self, checked: Checked, budget: float) -> np.ndarray | None:
        """A query that is denied, sought where no suspect is."""
        return None

    def outside(self) -> np.ndarray | None:
        """``(N, n)`` points of the object outside the domain."""
        shape, domain = self.shape, self.bounder.domain.base
        if isinstance(shape, Grid):
            return shape.position(shape.cells_beyond(domain.lower, domain.upper))
        x = border_points(shape, BORDER, np.random.default_rng(0))
        return x[((x < domain.lower) | (x > domain.upper)).any(axis=1)]

    def first_wrong(self, x: np.ndarray | None) -> np.ndarray | None:
        """The first of these queries ``(N, m)``, as float32, that the deployed bounder answers wrongly for certain."""
        if x is None or not len(x):
            return None
        x = np.asarray(x, dtype=np.float64).astype(np.float32)
        x = x[self.meets(x)]
        return next(iter(x[self.wrong(x)]), None) if len(x) else None

    def meets(self, x: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: which of these float32 queries meet the object; only those are put to the bounder."""
        return self.shape.decide(x) != OUT

    def wrong(self, x: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: which of these queries, which meet the object, are denied."""
        return ~self.deployed.query(x).numpy()


class OfPoints(Proof):
    """The proof of points of a shape that certifies boxes."""

    def search(self, budget: float, **options) -> Checked:
        bounder, shape = self.bounder, self.shape
        if isinstance(shape, Grid):
            return check_covering(cover_cells(bounder, shape), self.target, budget, **options)
        shape.check()
        if bounder.exact_on_hull(shape):
            checked = Checked(*bounder.least(shape))
            if self.target <= checked.least < np.inf:
                return checked
        return check_covering(cover_domain(bounder, shape), self.target, budget, **options)

    def tried(self, checked: Checked, budget: float) -> np.ndarray | None:
        if checked.complete:
            return None
        return next(iter(descend(self.deployed, self.shape, fresh_seed(), max(budget / 4, LEAST_SECONDS))[0]), None)


class BySamples(OfPoints):
    """What takes the place of a proof where the shape certifies nothing: fresh positives are queried."""

    def verdict(self, fault: str, budget: float, **options) -> Verdict:
        if fault:
            return super().verdict(fault, budget, **options)
        done, lowest, x = try_positives(self.bounder, self.shape, POSITIVES, fresh_seed(), budget=budget)
        threshold = float(self.bounder.threshold)
        if x is not None or not done:
            lowest = lowest if done else threshold
            return self.without_proof(x, f"no positive could be queried within {budget:g} s", lowest, 0)
        rate = fn_rate_bound(done)
        text = (
            f"Statistical, not proven: {done:,} fresh positives, none answered with no; at {CONFIDENCE:.0%} confidence "
            f"fewer than {rate:.2g} of such queries are missed."
        )
        counts = {"samples": done, "fn_rate_bound": rate, "confidence": CONFIDENCE}
        return Verdict("statistical", text, lowest, statistics=counts | {"worst_margin": lowest - threshold})


class OfRegions(Proof):
    """The proof of rays, planes and boxes."""

    def search(self, budget: float, **options) -> Checked:
        bounder, shape = self.bounder, self.shape
        try:
            checked = Checked(*bounder.least(shape))
        except BounderError as error:  # the volume does not hold the object, or numbers leave the range of the proof
            self.close, checked = str(error), Checked(-np.inf, 0)
        if checked.suspects is None and not self.target <= checked.least < np.inf:  # infinity: of no positive
            checked = checked._replace(suspects=NONE)
        return checked

    def tried(self, checked: Checked, budget: float) -> np.ndarray | None:
        return try_positives(self.bounder, self.shape, POSITIVES, fresh_seed(), budget=max(budget, LEAST_SECONDS))[2]

    def outside(self) -> None:
        """No region is known to meet the object there alone."""

    def meets(self, x: np.ndarray) -> np.ndarray:
        truth = decision(self.bounder.query_kind, self.shape, self.bounder.device, self.bounder.domain.oracle_length)
        return truth(x) == IN


class OfDistances(Proof):
    """The proof of a distance: F is bounded over boxes."""

    close = "F comes closer to the distance than the proof allows"

    def __init__(self, bounder: DistanceBounder, shape: Shape, deployed: Bounder):
        super().__init__(bounder, shape, deployed)
        self.proven = f"the distance is never overestimated{TOUCHED if shape.time else ''}"
        self.refuted = "a distance is overestimated"

    def search(self, budget: float, **options) -> Checked:
        overestimate, boxes, complete, suspects = overestimate_within(
            self.bounder, self.shape, -self.target, budget, **options
        )
        return self.reached(-overestimate, boxes, suspects, complete)

    def reached(self, least: float, boxes: int, suspects: np.ndarray, complete: bool = True) -> Checked:
        """What is known where ``d - F >= least`` holds."""
        if float(self.bounder.threshold) <= 0 and self.target <= least < np.inf:
            return Checked(least, boxes)
        return Checked(least, boxes, suspects, complete)

    def meets(self, x: np.ndarray) -> np.ndarray:
        return np.ones(len(x), dtype=bool)  # every point has a distance

    def wrong(self, x: np.ndarray) -> np.ndarray:
        """``(N,)`` bool: which float32 points have a distance that is overestimated for certain."""
        g, known = self.bounder.distance(x).numpy().astype(np.float64), self.shape.distances(x)
        above = (g > 0) & (self.shape.decide(x) == IN)
        return above if known is None else above | (g > known[:, 1])


class OfDistancesToVolumes(OfDistances):
    """The proof of a distance to a volume: it is proven that the volume holds the object."""

    def search(self, budget: float, **options) -> Checked:
        volume = self.bounder.volume.to()
        volume.info = {name: self.bounder.info.get(name) for name in ("margin", "resolution")}
        own = proof_of(volume, self.shape, volume).verdict(fault_of(volume, self.shape), budget, **options)
        if own.kind == "proven":
            self.close = "the threshold does not cover what float32 rounds"
            return self.reached(0.0, own.boxes, NONE)
        self.close = own.message
        return Checked(-np.inf, own.boxes, NONE if own.counterexample is None else own.counterexample[None])
