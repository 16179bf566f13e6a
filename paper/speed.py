"""The paper's Table 2 and its supplement's table of speeds: methods raced on every device.

Source: Liu, Fischer, Yoo, Ritschel, *Neural Bounding* (SIGGRAPH 2024), Table 2, Eq. 6; its supplement.

A machine's speed drifts with whatever else it does. So what is compared is taken within a round, in which every
method is asked once, and the median over rounds counts. Every race has the network among its methods: what is added to
a folder later is compared by the ratio to that.
"""

import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from paper import results
from paper.cells import Cell, about, fitted, missing, select
from paper.data import objects_in, usual
from paper.results import Rows, markdown
from paper.table import (
    COLUMNS,
    DISTANCE,
    PAPER,
    VARIANTS,
    Column,
    Variant,
    budget_text,
    budgets_in,
    column_of,
    variant_of,
)
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.queries import sample

NAME = "speed"
CSV = """dimension object query method space leaves device device_name ns ratio ratio_low ratio_high reference
    fp_rate fn positives certificate nbytes fit_seconds budget queries rounds samples seed length threads
    indicator versions""".split()
DEFAULTS = {"queries": 2_000_000, "rounds": 9, "samples": 400_000, "budget": 20.0, "budgets": "", "seed": 0}
DEFAULTS |= {"length": 1.0}
QUICK = {"budget": "2,relu-field=1,learned-kdop=1", "queries": 200_000, "rounds": 5, "samples": 50_000}
REFERENCE = Variant("mlp")
# Where no methods are named: an occupancy network has the code of the reference, and distances are asked otherwise.
RACED = [v for v in VARIANTS if v.conservative and v.leaves is None and v.method != DISTANCE and not v.parametric]
QUERY_SEED = 2  # added to the fits' for the queries of a race
DETAILED, QUERIES = Column(3, "point"), 10_000_000  # shown in milliseconds, too; what these are for


def run(line, output, data, quick=False, columns=None, methods=None, objects=None, devices=None, budget=None,
        queries=None, rounds=None, samples=None, seed=None) -> int:  # fmt: skip
    """Measure how fast every method answers, on every device, as in the paper's Table 2 and its supplement.

    One object of each dimension is timed: the bunny where the data has one, or the objects that are named. All are
    compared with a network, so queries that networks do not answer, rays and boxes, are left out.
    """
    told = {"budget": budget, "queries": queries, "rounds": rounds, "samples": samples, "seed": seed}
    given = {name: QUICK.get(name) if quick and value is None else value for name, value in told.items()}
    given |= budgets_in(given["budget"], DEFAULTS["budget"]) if given["budget"] is not None else {}
    raced = [v for v in RACED if not quick or v.method in PAPER["fp_rate"]]
    raced = raced if methods is None else [v for v in VARIANTS if not v.parametric]  # those are NumPy

    def source(dimensions: list[int]):
        there = objects_in(Path(data), dimensions)
        return usual(there) if objects is None else there

    kinds, cells = devices_named(devices), select(source, columns, methods, objects, raced)
    cells = [cell for cell in cells if REFERENCE.space_in(cell.column)]
    if not cells:
        raise QueryError(f"networks answer no such queries, and all others are compared with them: {columns}")
    folder = results.opened(Path(output), NAME, CSV, DEFAULTS, given)
    groups: dict[tuple, list[Cell]] = {}
    for cell, device in missing(cells, folder, "device", kinds):
        groups.setdefault((COLUMNS.index(cell.column), cell.thing, device), []).append(cell)
    if groups:
        folder.remember(line)

    def measure(key: tuple) -> str:
        rows = _raced(folder, groups[key], key[2])
        for row in rows:
            folder.append(row)
        folder.write(results.PAGE, page(folder))
        return ", ".join(f"{variant_of(r).label} {r['ns']:.3g} ns ({r['ratio']:.3f})" for r in rows)

    titles = {key: f"{COLUMNS[key[0]].name} {key[1].name} on {key[2]}" for key in groups}
    done = results.work(folder, sorted(groups), measure, titles.get)
    folder.write(results.PAGE, page(folder))
    missed = sum(r["fn"] for r in folder.rows if variant_of(r).conservative)
    if missed:
        results.say(f"promise broken: {missed:,} false negatives of methods that promise none")
    print(f"{len(folder.rows)} cells; the tables are {folder.path / results.PAGE}")
    return int(bool(missed or not done))


def _raced(folder: results.Folder, cells: Sequence[Cell], device: str) -> list[dict[str, Any]]:
    """Rows of the methods of a column and an object on a device, raced together with the reference."""
    import warp as wp

    from warp_bounding.evaluation import evaluate

    s, grid, reference = folder.settings, cells[0].grid, cells[0]._replace(variant=REFERENCE)
    bounders = {cell: fitted(folder, cell, s) for cell in dict.fromkeys([*cells, reference])}
    rng = np.random.default_rng(s["seed"] + QUERY_SEED)
    x = np.asarray(sample(reference.column.query, grid, s["queries"], rng), dtype=np.float32)
    times = race({cell: b.to(device) for cell, b in bounders.items()}, wp.array(x, device=device), s["rounds"])
    rows = []
    for cell in cells:
        ratios, rates = times[cell] / times[reference], evaluate(bounders[cell], grid, s["samples"], seed=s["seed"] + 1)
        row = about(cell, bounders[cell], s) | {"reference": REFERENCE.method}
        row |= {"device": device, "device_name": device_name(device)}
        row |= {"ns": float(np.median(times[cell])) / s["queries"] * 1e9, "ratio": float(np.median(ratios))}
        row |= {"ratio_low": float(ratios.min()), "ratio_high": float(ratios.max())}
        row |= {"fp_rate": float(rates.fp_rate), "fn": int(rates.fn), "positives": float(rates.positives)}
        rows.append(row)
    return rows


def race(bounders: Mapping[Any, Any], queries: Any, rounds: int) -> dict[Any, np.ndarray]:
    """Seconds of every bounder in every round, ``(rounds,)``; each is queried once before, and who begins moves on."""
    import warp as wp

    prepared = {name: bounder.prepare(queries) for name, bounder in bounders.items()}
    names, times = list(prepared), {name: np.zeros(rounds) for name in prepared}
    for each in prepared.values():  # compiled, and its memory touched
        each.launch()
    for number in range(rounds):
        first = number % len(names)
        for name in (*names[first:], *names[:first]):
            wp.synchronize_device(queries.device)
            start = time.perf_counter()
            prepared[name].launch()
            wp.synchronize_device(queries.device)
            times[name][number] = time.perf_counter() - start
    return times


def devices_named(text: str | None) -> tuple[str, ...]:
    """Aliases of Warp devices; of all that are there for ``None``."""
    import warp as wp

    there = [device.alias for device in wp.get_devices()]
    words = there if text is None else [word.strip() for word in text.split(",")]
    for word in words:
        if word not in there:
            raise BounderError(f"devices must be among {', '.join(there)}, got {word!r}")
    return tuple(dict.fromkeys(words))


def device_name(alias: str) -> str:
    """What a device is, for people; of a CPU the model, where the system tells."""
    import warp as wp

    device, info = wp.get_device(alias), Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if device.is_cpu and info.exists() else []
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), device.name)


# --- means, gains, break-evens ----------------------------------------------------------------------------------------


def break_even(time: float, rate: float, other_time: float, other_rate: float) -> tuple[float, float]:
    """Prices t between which a method pays, Eq. 6: ``time + rate t < other_time + other_rate t``."""
    if rate == other_rate:
        return 0.0, math.inf if time < other_time else 0.0
    price = max((time - other_time) / (other_rate - rate), 0.0)
    return (price, math.inf) if rate < other_rate else (0.0, price)


class Mean(NamedTuple):
    """A method in a column: means over objects of a query's time, that over ``mlp``'s, and false positives, %."""

    ns: float
    ratio: float
    fp_rate: float


def devices_of(rows: Rows) -> dict[str, dict[tuple[Variant, Column], Mean]]:
    """Means by device, method and column, in the table's order."""
    groups: dict[str, dict] = {}
    for row in sorted(rows, key=lambda r: (VARIANTS.index(variant_of(r)), COLUMNS.index(column_of(r)))):
        groups.setdefault(row["device"], {}).setdefault((variant_of(row), column_of(row)), []).append(row)
    return {device: {key: _mean(group) for key, group in own.items()} for device, own in groups.items()}


def _mean(rows: Rows) -> Mean:
    ns, ratio = (float(np.exp(np.mean(np.log([row[name] for row in rows])))) for name in ("ns", "ratio"))
    return Mean(ns, ratio, float(np.mean([row["fp_rate"] for row in rows])))


# --- the page --------------------------------------------------------------------------------------------------------


def page(folder: results.Folder) -> str:
    """The whole page."""
    lines, names = [], {r["device"]: r["device_name"] for r in folder.rows}
    for device, cells in devices_of(folder.rows).items():
        lines += [f"## {device}: {names[device]}", ""]
        if any(column == DETAILED for _, column in cells):
            lines += [f"### {DETAILED.title}s", "", *_detailed(cells), ""]
        lines += ["### Every column: time over that of `mlp`", "", *_every(cells), ""]
    objects = ", ".join(f"{name} in {n}D" for n, name in sorted({(r["dimension"], r["object"]) for r in folder.rows}))
    values = {"objects": objects or "none", "budget_text": budget_text(folder.settings)}
    return folder.page(NAME, devices=lines or ["Nothing has been measured yet."], **values)


def _detailed(cells: Mapping[tuple[Variant, Column], Mean]) -> list[str]:
    heads = "|ms for 10 million|billions a second|time / mlp|FP %|pays from, ms|pays from, × a query".split("|")
    lines, whole, mlp = [], PAPER["ms"]["mlp"][DETAILED], cells.get((REFERENCE, DETAILED))
    for variant, cell in ((v, cell) for (v, column), cell in cells.items() if column == DETAILED):
        ms, price, factor = variant.paper(DETAILED, "ms"), "–", "–"
        texts = [_ms(cell.ns * QUERIES / 1e6, 1), f"{1 / cell.ns:.3f}", f"{cell.ratio:.3f}", f"{cell.fp_rate:.2f}"]
        if mlp and variant != REFERENCE:  # prices in milliseconds for ``QUERIES`` tests
            own = mlp.ns * QUERIES / 1e6
            other = cell.ratio * own
            least, most = break_even(own, mlp.fp_rate / 100, other, cell.fp_rate / 100)
            never, always = least >= most, least == 0 and most == math.inf
            price = _ms(least, 1) if math.isinf(most) else f"below {_ms(most, 1)}"
            price = "always" if always else "never" if never else price
            factor = f"{least / other:.1f}" if least > 0 and not never else "–"
        if ms is not None:
            theirs = (f"{ms:g}", f"{QUERIES / ms / 1e6:.2f}", f"{ms / whole:.3f}", f"{variant.paper(DETAILED):g}")
            texts = [f"{a} ({b})" for a, b in zip(texts, theirs, strict=True)]
        lines.append([variant.label, *texts, price, factor])
    return markdown(heads, lines)


def _ms(ms: float, digits: int = 0) -> str:
    """With so many digits behind the point; a few milliseconds with more."""
    return f"{ms:.{digits}f}" if ms >= 3.0 else f"{ms:.2g}"


def _times(ratio: float) -> str:
    return f"{ratio:.2f}" if ratio >= 0.1 else f"{ratio:.3f}"


def _every(cells: Mapping[tuple[Variant, Column], Mean]) -> list[str]:
    def told(variant: Variant, column: Column) -> str:
        cell, ms = cells.get((variant, column)), variant.paper(column, "ms")
        if cell is None:
            return "…" if variant.space_in(column) else "–"
        theirs = "" if ms is None else f" ({_times(ms / PAPER['ms']['mlp'][column])})"
        return _times(cell.ratio) + theirs

    columns = [c for c in COLUMNS if any(c == column for _, column in cells)]
    variants = dict.fromkeys(variant for variant, _ in cells)
    return markdown([None, *(c.title for c in columns)], ([v.label, *(told(v, c) for c in columns)] for v in variants))
