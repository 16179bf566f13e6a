"""What a proof is worth: networks with the threshold that sampling suggests, and with the one that is proven, side by side.

For each network of a ``table1`` folder: the least f over a million fresh hard positives, as an honest practitioner would set the
threshold; the proven one; false positives at both, on the same random queries. Then the prover and a walk look for a
positive below the sampled threshold (and below 0, which is an output of 0.5): a query that the exact oracle affirms and the deployed
kernel denies, that is a false negative that sampling would have shipped. Resumable like ``run``, network by network.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from paper.plan import Job
from paper.run import Run
from paper.settings import ProofSettings
from warp_bounding.errors import BounderError
from warp_bounding.proof import prove
from warp_bounding.proof.attest.falsify import Walk, queries_at
from warp_bounding.queries import QUERIES, oracle, sample
from warp_bounding.queries.hard import draw_positives

__all__ = ["METHODS", "PROOF_COST", "ProofsRun", "Thresholds"]

METHODS = ("mlp", "monotone-mlp")
DISTANCES = ("plane",)  # queries whose networks learn distances, and no output between 0 and 1
LOWEST = 2048  # of the hard positives: where searches begin
PROOF_COST = 1e-4  # share of all queries that a proof's gap may cost in false positives
SMALLEST_GAP = 1e-6  # of a search, in units of f


@dataclass(frozen=True)
class Thresholds:
    """f over random queries, once: rates at any threshold come from it.

    Attributes:
        values: ``(N,)`` f as the device computes it; +inf where the answer is *maybe* without asking, -inf for *no*.
        truth: ``(N,)`` bool.
    """

    values: np.ndarray
    truth: np.ndarray

    @classmethod
    def of(cls, bounder: Any, grid: Any, samples: int, seed: int) -> "Thresholds":
        """Ask the queries that ``evaluate`` would ask."""
        x = sample(bounder.query_kind, grid, samples, np.random.default_rng(seed))
        truth = oracle(bounder.query_kind, grid, bounder.device, bounder.domain.oracle_length)(x)
        return cls(bounder.values(x).numpy(), truth)

    def fp(self, threshold: float) -> float:
        """False positives, per cent of all queries."""
        return 100 * float(np.mean(~(self.values < np.float32(threshold)) & ~self.truth))

    def fn(self, threshold: float) -> int:
        """False negatives, a count."""
        return int(((self.values < np.float32(threshold)) & self.truth).sum())

    @property
    def spread(self) -> float:
        """Standard deviation of f."""
        return float(np.std(self.values[np.isfinite(self.values)], dtype=np.float64))

    def room(self, least: float) -> float:
        """How far below ``least`` a threshold may lie before it costs ``PROOF_COST`` in false positives."""
        negatives = self.values[~self.truth & np.isfinite(self.values)]
        below = np.sort(negatives[negatives < least])[::-1]
        count = int(PROOF_COST * len(self.values))
        return max(float(least - below[count]), SMALLEST_GAP) if len(below) > count else 1e-3


class ProofsRun(Run):
    """Measures networks with both thresholds."""

    def __init__(self, table: Path, *inputs):
        """Find out which networks are missing.

        Args:
            table: The ``table1`` folder. Networks that it does not have are fitted and kept in the run's own folder.
            inputs: See ``Run``.
        """
        super().__init__(*inputs)
        self._table = table

    def measure(self, job: Job, grid: Any) -> None:
        path = self._table / "bounders" / f"{job.file}.safetensors"
        bounder, where = self.load(path, grid), "table"
        if bounder is None:
            bounder, where = self.load(self.folder.bounder(job.file), grid), "here"
        if bounder is None:
            bounder = self.fit(job, grid, lambda *_: None)
        measured = _measured(job, grid, bounder, self.folder.settings, self.heed)
        self.add(job, bounder, fitted=where, **measured)


def _measured(job: Job, grid, bounder, s: ProofSettings, heed: Callable[[], None]) -> dict[str, Any]:
    """The fields of a row that are measured."""
    rates = Thresholds.of(bounder, grid, s.samples, s.fits.sample_seed)
    hard, lowest = _hard_positives(bounder, grid, s.positives, s.positives_seed)
    sampled = float(hard.min())
    twin = bounder.to(str(bounder.device))
    started = time.perf_counter()
    known = _has_output(bounder) and job.variant.method == "mlp"  # others are searched over other numbers
    points = _as_asked(bounder, lowest) if known else None
    search = prove(twin, grid, seconds=s.seconds, eps=rates.room(sampled), points=points)
    spent = time.perf_counter() - started
    _check(bounder, search)
    heed()
    walk = Walk(twin, grid, s.fits.seed)
    start, _ = walk.around(queries_at(twin, grid, search.worst)) if len(search.worst) else (lowest[:0], None)
    found = {"prover": walk.down(start) if len(start) else (start, np.empty(0)), "walk": walk.down(lowest)}
    x, f, found_by = _counterexample(twin, grid, found, sampled)
    missed = x is not None
    proven, shipped = float(twin.threshold), float(bounder.threshold)
    all_found = np.concatenate([hard, *(values for _, values in found.values())])
    least = (float(values.min(initial=np.inf)) for _, values in found.values())
    upper_bound = min(float(search.upper_bound), *least)
    return {
        "search": "complete" if search.complete else "cut short",
        **_at_zero(twin, grid, rates, hard, lowest, found),
        "fp_sampled": rates.fp(sampled),
        "fn_sampled": rates.fn(sampled),
        "missed_sampled": int(missed),
        "found_by": found_by,
        "depth": sampled - f if missed else None,
        "depth_std": (sampled - f) / rates.spread if missed else None,
        "depth_fp": rates.fp(f) - rates.fp(sampled) if missed else None,
        "fp_proven": rates.fp(proven),
        "fn_proven": rates.fn(proven) + int((all_found < np.float32(proven)).sum()),
        "positives": 100 * float(rates.truth.mean()),
        "sampled": sampled,
        "proven": proven,
        "lower_bound": float(search.lower_bound),
        "upper_bound": upper_bound,
        "gap": max(upper_bound - float(search.lower_bound), 0.0),
        "rounding_bound": float(bounder.rounding_bound()),
        "boxes": int(search.boxes),
        "proof_seconds": round(spent, 3),
        "counterexample": " ".join(repr(float(value)) for value in x) if missed else "",
        "counterexample_f": f if missed else None,
        "shipped": shipped,
        "fp_shipped": rates.fp(shipped),
        "fit_seconds": (bounder.info.get("training") or {}).get("seconds"),
        "hard_positives": len(hard),
    }


def _has_output(bounder) -> bool:
    """Whether its network has an output between 0 and 1; those of planes learn distances."""
    return bounder.query_kind not in DISTANCES


def _as_asked(bounder, x: np.ndarray) -> np.ndarray:
    """``v`` of queries, without rays from outside the domain: a device moves these to where they enter it first."""
    v = bounder.domain.to_local(x)
    if not QUERIES[bounder.query_kind].has_length:
        return v
    base = bounder.domain.base
    return v[(np.abs(v[:, : base.ndim]) <= base.limit).all(axis=1)]


def _check(bounder, search) -> None:
    """Two searches cannot contradict each other: a positive lies above every bound that is proven.

    Raises:
        BounderError: If they do.
    """
    certificate = bounder.certificate
    if certificate is not None and certificate.proven and search.upper_bound < certificate.lower_bound:
        found, shown = search.upper_bound, certificate.lower_bound
        raise BounderError(f"the certificate says f >= {shown:.6g}, the prover found a positive with f = {found:.6g}")


def _hard_positives(bounder, grid, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """F of fresh hard positives, and the lowest of these, lowest first."""
    values, lowest, least = [], [], []
    for x in draw_positives(bounder.query_kind, grid, count, seed, bounder.device, bounder.domain.oracle_length):
        f = bounder.values(x).numpy()
        order = np.argsort(f, kind="stable")[:LOWEST]
        values.append(f.copy())
        lowest.append(x[order])
        least.append(f[order])
    order = np.argsort(np.concatenate(least), kind="stable")[:LOWEST]
    return np.concatenate(values), np.concatenate(lowest)[order]


def _at_zero(bounder, grid, rates: Thresholds, hard: np.ndarray, lowest: np.ndarray, found: dict) -> dict:
    """The row's fields about threshold 0; see ``ProofRow``."""
    names = ("fp_zero", "fn_zero", "hard_fn_zero", "missed_zero")
    if not _has_output(bounder):
        return dict.fromkeys(names)
    found = found | {"samples": (lowest, np.sort(hard)[: len(lowest)])}
    missed = _counterexample(bounder, grid, found, 0.0)[0] is not None
    return dict(zip(names, (rates.fp(0.0), rates.fn(0.0), int((hard < 0).sum()), int(missed)), strict=True))


def _counterexample(bounder, grid, found: dict, threshold: float) -> tuple[np.ndarray | None, float, str]:
    """The deepest query found below a threshold, its f and who found one, once oracle and kernel have been asked again.

    Args:
        bounder: Its own threshold plays no part.
        grid: The object.
        found: Queries and f, lowest first, by who found them.
        threshold: That would be shipped.
    """
    below = [w for w in found if len(found[w][0]) and found[w][1].min() < np.float32(threshold)]
    if not below:
        return None, 0.0, ""
    x = found[min(below, key=lambda w: float(found[w][1].min()))][0][:1]
    truth = oracle(bounder.query_kind, grid, bounder.device, bounder.domain.oracle_length)(x)
    shipped = bounder.to(str(bounder.device)).freeze(threshold, None)
    if not truth[0] or shipped.query(x).numpy()[0] != 0:
        return None, 0.0, ""
    return x[0], float(bounder.values(x).numpy()[0]), "prover" if "prover" in below else "walk"
