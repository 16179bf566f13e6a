"""What a proof is worth: networks with the threshold that sampling suggests, and with the proven one.

For each network of a ``table1`` folder: the least f over a million fresh hard positives, as an honest practitioner
would set the threshold; the proven one; false positives at both, on the same random queries. Then the prover and a
walk look for a positive below the sampled threshold (and below 0, which is an output of 0.5): a query that the exact
oracle affirms and the deployed kernel denies, that is a false negative that sampling would have shipped.
"""

import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from paper import results, table1
from paper.cells import Cell, about, fitted, load, missing, select
from paper.results import Rows, markdown
from paper.table import COLUMNS, Variant, budget_text, column_of
from warp_bounding.errors import BounderError
from warp_bounding.proof import prove
from warp_bounding.proof.stress import Walk
from warp_bounding.queries import oracle, sample
from warp_bounding.queries.boundary import draw_positives

NAME = "proofs"
CSV = """dimension object query method search fp_zero fn_zero hard_fn_zero missed_zero fp_sampled fn_sampled
    missed_sampled found_by depth depth_std depth_fp fp_proven fn_proven positives sampled proven lower_bound
    upper_bound gap rounding_bound boxes proof_seconds counterexample counterexample_f shipped certificate
    fp_shipped fit_seconds samples hard_positives seconds budget fitted seed threads indicator versions""".split()
DEFAULTS = {"positives": 1_000_000, "samples": 400_000, "seconds": 60.0, "table": None}
METHODS = [Variant("mlp")]
LOWEST = 2048  # of the hard positives: where searches begin
PROOF_COST, SMALLEST_GAP = 1e-4, 1e-6  # share of all queries that a proof's gap may cost; its least, in units of f


def run(
    line, data, table, output, columns=None, methods=None, objects=None, positives=None, samples=None, seconds=None
) -> int:
    """Find what networks thresholded by sampling would have missed, and what a proof costs instead."""
    fits = table1.DEFAULTS | results.read_settings(Path(table))[0]
    given = {"positives": positives, "samples": samples, "seconds": seconds}
    cells = select(data, columns, methods, objects, METHODS)
    folder = results.opened(Path(output), NAME, CSV, DEFAULTS, given | {"table": fits})
    left = [cell for cell, _ in missing(cells, folder)]
    if left:
        folder.remember(line)

    def measure(cell: Cell) -> str:
        bounder, where = load(Path(table) / results.BOUNDERS / f"{cell.file}.safetensors", cell, fits), "table"
        if bounder is None:
            bounder, where = fitted(folder, cell, fits), "here"
        row = about(cell, bounder, fits) | measured(bounder, cell, folder.settings, fits["seed"]) | {"fitted": where}
        folder.append(row)
        folder.write(results.PAGE, page(folder))
        rates = f"{row['fp_sampled']:.3f} -> {row['fp_proven']:.3f} % false positives"
        missed = f"a false negative by the {row['found_by']}" if row["missed_sampled"] else "none found"
        return f"proof {row['search']} in {row['proof_seconds']:.1f} s, {rates}; at the sampled minimum: {missed}"

    done = results.work(folder, left, measure, lambda cell: cell.title)
    folder.write(results.PAGE, page(folder))
    print(told(folder.rows))
    print(f"{len(folder.rows)} networks; the tables are {folder.path / results.PAGE}")
    return int(not done or any(r["fn_proven"] for r in folder.rows))


class Thresholds(NamedTuple):
    """f of random queries, as the device computes it, and their truth: rates at any threshold come from it."""

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

    def room(self, least: float) -> float:
        """How far below ``least`` a threshold may lie before it costs ``PROOF_COST`` in false positives."""
        negatives = self.values[~self.truth & np.isfinite(self.values)]
        below, count = np.sort(negatives[negatives < least])[::-1], int(PROOF_COST * len(self.values))
        return max(float(least - below[count]), SMALLEST_GAP) if len(below) > count else 1e-3


def measured(bounder: Any, cell: Cell, s: dict[str, Any], seed: int) -> dict[str, Any]:
    """The measured columns of a row."""
    grid = cell.grid
    rates = Thresholds.of(bounder, grid, s["samples"], seed + 1)
    hard, lowest = hard_positives(bounder, grid, s["positives"], seed + 424_243)  # no fit has this seed
    sampled, copy, started = float(hard.min()), bounder.to(str(bounder.device)), time.perf_counter()
    points = bounder.domain.to_local(lowest) if cell.variant.method == "mlp" else None
    search = prove(copy, grid, budget=s["seconds"], eps=rates.room(sampled), points=points)
    spent = time.perf_counter() - started
    certificate = bounder.certificate
    if certificate is not None and certificate.proven and search.upper_bound < certificate.lower_bound:
        shown = f"f >= {certificate.lower_bound:.6g}, the prover found a positive with f = {search.upper_bound:.6g}"
        raise BounderError(f"the certificate says {shown}")
    walk = Walk(copy, grid, seed)
    start = walk.around(copy.domain.to_object(search.worst))[0] if len(search.worst) else lowest[:0]
    found = {"prover": walk.down(start) if len(start) else (start, np.empty(0)), "walk": walk.down(lowest)}
    x, f, found_by = counterexample(copy, grid, found, sampled)
    missed, proven, shipped = x is not None, float(copy.threshold), float(bounder.threshold)
    upper_bound = min(float(search.upper_bound), *(float(values.min(initial=np.inf)) for _, values in found.values()))
    all_found = np.concatenate([hard, *(values for _, values in found.values())])
    everything = found | {"samples": (lowest, np.sort(hard)[: len(lowest)])}
    missed_zero = counterexample(copy, grid, everything, 0.0)[0] is not None
    zero = [rates.fp(0.0), rates.fn(0.0), int((hard < 0).sum()), int(missed_zero)]
    spread = float(np.std(rates.values[np.isfinite(rates.values)], dtype=np.float64))
    return {
        **dict(zip(("fp_zero", "fn_zero", "hard_fn_zero", "missed_zero"), zero, strict=True)),
        "search": "complete" if search.complete else "cut short",
        "fp_sampled": rates.fp(sampled),
        "fn_sampled": rates.fn(sampled),
        "missed_sampled": int(missed),
        "found_by": found_by,
        "depth": sampled - f if missed else None,
        "depth_std": (sampled - f) / spread if missed else None,
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
        "hard_positives": len(hard),
        "samples": s["samples"],
        "seconds": s["seconds"],
    }


def hard_positives(bounder: Any, grid: Any, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
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


def counterexample(bounder: Any, grid: Any, found: dict, threshold: float) -> tuple[np.ndarray | None, float, str]:
    """The deepest query found below a threshold, its f and who found one, once oracle and kernel were asked again.

    ``found`` are queries and f, lowest first, by who found them.
    """
    below = [w for w in found if len(found[w][0]) and found[w][1].min() < np.float32(threshold)]
    if not below:
        return None, 0.0, ""
    x = found[min(below, key=lambda w: float(found[w][1].min()))][0][:1]
    truth = oracle(bounder.query_kind, grid, bounder.device, bounder.domain.oracle_length)(x)
    shipped = bounder.to(str(bounder.device)).freeze(threshold, None)
    if not truth[0] or shipped.query(x).numpy()[0]:
        return None, 0.0, ""
    return x[0], float(bounder.values(x).numpy()[0]), "prover" if "prover" in below else "walk"


# --- the page ---------------------------------------------------------------------------------------------------------


def told(rows: Rows) -> str:
    """What was found, in one sentence."""
    if not rows:
        return "No network has been measured yet."
    missed, zero = [r for r in rows if r["missed_sampled"]], [r["missed_zero"] for r in rows]
    least, by_prover = min(r["hard_positives"] for r in rows), sum(r["found_by"] == "prover" for r in missed)
    return (
        f"Of {len(rows)} networks thresholded at their minimum over at least {least:,} hard positives, {len(missed)} "
        f"had a false negative that the search found ({by_prover} from the prover's own lowest points); of the "
        f"{sum(z is not None for z in zero)} with an output between 0 and 1, {sum(map(bool, zero))} had one when "
        f"thresholded at 0.5; at the proven threshold, {sum(r['fn_proven'] > 0 for r in rows)}."
    )


def _mean(values: Iterable[float | None], digits: int = 3, worst: bool = False) -> str:
    """Mean of what is known, and the largest where wanted."""
    known = [v for v in values if v is not None]
    text = f"{sum(known) / len(known):,.{digits}f}" if known else "–"
    return f"{text} ({max(known):,.{digits}f})" if known and worst else text


def _share(group: Rows, count: str, total: str) -> str:
    """Mean of counts in per cent of their totals."""
    return _mean((None if r[count] is None else 100 * r[count] / r[total] for r in group), 4)


Cells = dict[str, Callable[[Any], str]]
SHIPPED: Cells = {
    "networks": lambda g: str(len(g)),
    "with a FN at output 0.5": lambda g: _of(r["missed_zero"] for r in g),
    "FN rate there, uniform, %": lambda g: _share(g, "fn_zero", "samples"),
    "FN rate there, hard positives, %": lambda g: _share(g, "hard_fn_zero", "hard_positives"),
    "with a FN at the sampled minimum": lambda g: f"**{sum(r['missed_sampled'] for r in g)}** of {len(g)}",
    "found from the prover's points": lambda g: str(sum(r["found_by"] == "prover" for r in g)),
    "depth, std of f, mean (worst)": lambda g: _mean((r["depth_std"] for r in g), worst=True),
    "depth, FP %, mean (worst)": lambda g: _mean((r["depth_fp"] for r in g), worst=True),
}
COSTS: Cells = {
    "searches complete": lambda g: f"{sum(r['search'] == 'complete' for r in g)} of {len(g)}",
    "FP % at output 0.5": lambda g: _mean(r["fp_zero"] for r in g),
    "FP % sampled": lambda g: _mean(r["fp_sampled"] for r in g),
    "FP % proven": lambda g: f"**{_mean(r['fp_proven'] for r in g)}**",
    "cost of the proof, FP %, mean (worst)": lambda g: _mean((r["fp_proven"] - r["fp_sampled"] for r in g), worst=True),
    "FN found at the proven threshold": lambda g: str(sum(r["fn_proven"] for r in g)),
    "gap, worst": lambda g: f"{max(r['gap'] for r in g):.2g}",
    "boxes, mean": lambda g: _mean((r["boxes"] for r in g), 0),
    "seconds, mean (worst)": lambda g: _mean((r["proof_seconds"] for r in g), 2, worst=True),
}


def _of(counts: Iterable[int | None]) -> str:
    known = [c for c in counts if c is not None]
    return f"{sum(known)} of {len(known)}" if known else "–"


def page(folder: results.Folder) -> str:
    """The whole page."""
    rows, lines = folder.rows, []
    for method in sorted({r["method"] for r in rows}):
        own = [r for r in rows if r["method"] == method]
        groups = {c.title: group for c in COLUMNS if (group := [r for r in own if column_of(r) == c])}
        groups |= {"*all*": own} if len(groups) > 1 else {}
        for title, cells in (("what sampling would have shipped", SHIPPED), ("what the proof costs", COSTS)):
            body = ([name, *(cell(group) for cell in cells.values())] for name, group in groups.items())
            lines += [f"## {method}: {title}", "", *markdown([None, *cells], body), ""]
    lines += ["Every network: [proofs.csv](proofs.csv)."] if rows else []
    return folder.page(NAME, told=told(rows), tables=lines, budget_text=budget_text(folder.settings["table"]))
