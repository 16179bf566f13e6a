"""The paper's Table 1, measured: false positives of every method, kind of query and object.

The run, its page, its plot.
"""

import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from paper import parametric, regions, results
from paper import table as t
from paper.cells import Cell, about, fitted, missing, select
from paper.drawing import INK, PALE, page_of
from paper.results import Rows, markdown
from paper.table import Column, Variant, column_of, variant_of
from warp_bounding.activations import DEFAULT
from warp_bounding.errors import QueryError
from warp_bounding.runtime.launch import device_of

NAME = "table1"
CSV = """dimension object query method space leaves protocol fp_rate fn positives certificate fit_seconds
    proof_seconds nbytes hidden activation budget samples seed length device threads indicator versions""".split()
DEFAULTS = {"budget": 60.0, "budgets": "", "samples": 1_000_000, "seed": 0, "length": 1.0, "activation": DEFAULT.name}
DEFAULTS |= {"device": "cpu"}
PRESETS = {  # budgets, and random queries
    "full": (
        "16,2d=12,2d-ray=24,2d-box=14,3d-point=20,3d-ray=50,3d-box=40,4d-point=40,4d-ray=60,4d-box=60,learned-kdop=5,"
        "relu-field=12,occupancy=6,2d-ray:mlp=60,2d-box:mlp=24,3d-box:mlp=90,3d-ray:mlp=120,4d-point:mlp=150,"
        "4d-ray:mlp=180,4d-box:mlp=120,2d:distance=20,3d:distance=90,4d:distance=420",
        400_000,
    ),
    "hour": ("4,3d=6,4d=12,3d-ray=13,4d-ray=16,learned-kdop=2,relu-field=4,occupancy=2", 100_000),
}
KDOP_SECONDS, PAGE_SECONDS = 11.0, 10.0  # after which learning half-spaces has ended; between two writings of the page


def run(line, output, data=None, protocol=None, preset=None, budget=None, columns=None, methods=None, objects=None,
        seed=None, samples=None, length=None, device=None) -> int:  # fmt: skip
    """Measure the false positives of every method on every object and query, as in the paper's Table 1.

    Columns, methods, objects and protocols can be added to a folder later; budgets, samples, seed, length and device
    are those of its first run. Without ``data`` the page and the plot are written anew.
    """
    if preset is not None:
        if preset not in PRESETS:
            raise QueryError(f"preset must be one of {', '.join(PRESETS)}, got {preset!r}")
        budget, samples = budget or PRESETS[preset][0], samples or PRESETS[preset][1]
        protocol = protocol or "both"
    if protocol not in (None, "both", *t.PROTOCOLS):
        raise QueryError(f"protocol must be one of {', '.join(t.PROTOCOLS)}, both, got {protocol!r}")
    given: dict[str, Any] = {"samples": samples, "seed": seed, "length": length, "device": device}
    given |= t.budgets_in(budget, DEFAULTS["budget"]) if budget is not None else {}
    device_of(device or DEFAULTS["device"])
    kinds = t.PROTOCOLS if protocol == "both" else (protocol or t.PROTOCOLS[0],)
    cells = select(data, columns, methods, objects) if data is not None else []
    folder = results.opened(Path(output), NAME, CSV, DEFAULTS, given, create=data is not None)
    work: dict[Cell, list[str]] = {}
    for cell, kind in missing(cells, folder, "protocol", kinds):
        work.setdefault(cell, []).append(kind)
    if work:
        folder.remember(line)
    written = [time.monotonic()]

    def measure(cell: Cell) -> str:
        reported = []
        for row in list(_measured(folder.settings, cell, work[cell], folder)):
            folder.append(row)
            reported.append(f"{row['protocol']} FP {row['fp_rate']:.3f} %, FN {row['fn']}")
        if time.monotonic() - written[0] > PAGE_SECONDS:
            folder.write(results.PAGE, page(folder))
            written[0] = time.monotonic()
        return f"{'; '.join(reported)}; {row['certificate'] or 'no certificate'}"

    done = results.work(folder, list(work), measure, lambda cell: cell.title)
    drawn = not work and data is not None and (folder.path / "rank.png").exists()
    for kind, content in () if drawn else rank_plot(folder.rows).items():
        folder.write(f"rank.{kind}", content)
    folder.write(results.PAGE, page(folder))
    broken = [r for r in folder.rows if r["fn"] and variant_of(r).promises]
    for r in broken:
        reported = f"{column_of(r).name} {r['object']}: {variant_of(r).label}: {r['fn']} false negatives"
        results.say(f"promise broken: {reported}")
    print(f"{len(folder.rows):,} cells; the table is {folder.path / results.PAGE}")
    return int(bool(broken or not done))


def _measured(s: dict[str, Any], cell: Cell, kinds: Sequence[str], folder: results.Folder) -> Iterator[dict[str, Any]]:
    """Rows of a cell, one a protocol."""
    from warp_bounding.evaluation import ASKED, parts_of

    variant, column, started = cell.variant, cell.column, time.perf_counter()
    if variant.parametric:
        seconds = min(t.budget_of(s, column, variant), KDOP_SECONDS) if variant.learned else 0.0
        own = {"length": s["length"], "seed": s["seed"], "seconds": seconds}
        if variant.method in t.AS_TRAINED:
            own["seconds"] = t.budget_of(s, column, variant)
            bounder = regions.fit(cell.grid, column.query, column.hidden, **own)
        else:
            bounder = parametric.fit(cell.grid, column.query, variant.method, **own)
        spent = {"fit_seconds": round(time.perf_counter() - started, 3)}
    else:
        bounder, spent = fitted(folder, cell, s), {}
    ask = bounder.query if variant.parametric else lambda x: bounder.query(x).numpy()
    if variant.method == t.DISTANCE:
        steps = {"steps": t.DISTANCE_STEPS[column.query]} if column.query in t.DISTANCE_STEPS else {}
        of_parts = ASKED[column.query](bounder, s["length"], **steps)
        ask = lambda x: of_parts(*parts_of(column.query, x)).numpy()  # noqa: E731
    for protocol in kinds:
        own = {"seed": s["seed"] + 1, "length": s["length"] if column.kind.has_length else 1.0}
        found = parametric.rates(ask, column.query, cell.grid, s["samples"], protocol, **own)
        counts = {"fp_rate": float(found.fp_rate), "fn": int(found.fn), "positives": float(found.positives)}
        yield about(cell, bounder, s) | spent | {"protocol": protocol} | counts


# --- means and the page -----------------------------------------------------------------------------------------------

NO_METHOD, NOT_YET, SAME = "–", "…", "="
OUTSIDE = "Exact on the grid that all of them bound, at the price of memory or time: outside the ranking"
GROUPS = (
    ("Classic volumes", lambda v: v.method in t.CLASSIC),
    ("Learned", lambda v: v.learned and v.conservative),
    ("Not conservative, shown for comparison", lambda v: not v.conservative),
    (OUTSIDE, lambda v: v.method in t.EXACT),
)
HEADLINES = {
    "exact": "Truth is exact: any query that touches a cell of the object counts, however thin the touch.",
    "sampled": "Truth as the paper finds it: a query counts if one of some hundred random samples of it hits the "
    "object. Thin hits are missed, so more queries count as *no*, and false positives are more.",
}


class Means:
    """Rows of one protocol by method and column, and the means over their objects."""

    def __init__(self, rows: Rows, protocol: str):
        self.rows = [r for r in rows if r["protocol"] == protocol]
        self.groups: dict[tuple[Variant, Column], list[dict[str, Any]]] = {}
        for row in self.rows:
            self.groups.setdefault((variant_of(row), column_of(row)), []).append(row)
        objects = {c: sorted({r["object"] for r in self.rows if column_of(r) == c}) for c in t.COLUMNS}
        self.objects = {c: names for c, names in objects.items() if names}  # of each column
        self.sampled = protocol == "sampled"  # which can be compared with the paper
        self.variants = [v for v in t.VARIANTS if any(v == variant for variant, _ in self.groups)]
        if not self.sampled:
            self.variants = [v for v in self.variants if not v.parametric]

    def rate(self, variant: Variant, column: Column) -> float | None:
        """Mean false positives of a cell, per cent; ``None`` where it was not measured on all objects of its column."""
        own = self.groups.get((variant, column), ())
        return _mean(own, "fp_rate") if len(own) == len(self.objects[column]) else None

    def best(self, column: Column) -> list[Variant]:
        """The tightest methods of those that promise no false negative and have none, proven or at least bounded."""
        able = {}
        for variant in (v for v in self.variants if v.conservative and v.method not in t.EXACT):
            own, rate = self.groups.get((variant, column), ()), self.rate(variant, column)
            sound = variant.parametric or all(r["certificate"] in ("proven", "statistical") for r in own)
            if rate is not None and sound and not any(r["fn"] for r in own):
                able[variant] = rate
        return [v for v, rate in able.items() if rate == min(able.values())] if len(able) > 1 else []

    def cell(self, variant: Variant, column: Column) -> str:
        """A cell of the table."""
        own, parametric = self.groups.get((variant, column)), variant.parametric
        paper = variant.paper(column) if self.sampled else None
        if own:
            text, signs, count = f"{_mean(own, 'fp_rate'):.2f}", [], len(self.objects[column])
            text = f"**{text}**" if variant in self.best(column) else text
            unproven = [r["certificate"] for r in own if r["certificate"] != "proven"]
            if variant.conservative and unproven and not parametric:
                sign = "s" if set(unproven) == {"statistical"} else "u"
                signs.append(sign if len(unproven) == len(own) else f"{len(unproven)}{sign}")
            signs += [] if variant.space_in(column) else ["o"]
            signs += [] if len(own) == count else [f"{len(own)}/{count}"]
            text += f"<sup>{' '.join(signs)}</sup>" if signs else ""
        elif parametric and not column.kind.is_region:
            text = SAME
        else:
            text = NOT_YET if variant.space_in(column) else NO_METHOD
        return text if paper is None else f"{text} ({paper})"

    def table(self) -> list[str]:
        """All means, a row a method."""
        columns, dimensions = list(self.objects), sorted({c.ndim for c in self.objects})
        sizes = ((len(names), t.OBJECTS[c.ndim]) for c, names in self.objects.items())
        lines = [["*objects*", *(str(n) if n == all_ else f"{n} (of {all_})" for n, all_ in sizes)]]
        for heading, belongs in GROUPS:
            variants = [v for v in self.variants if belongs(v)]
            lines += [[f"*{heading}*"]] if variants else []
            for variant in variants:
                own = [r for r in self.rows if variant_of(r) == variant]
                missed, samples = sum(r["fn"] for r in own), sum(r["samples"] for r in own)
                broken = ", **promise broken**" if missed and variant.promises else ""
                reported = f"{missed:,} of {samples:,}{broken}"
                held = " / ".join(_size([r for r in own if r["dimension"] == n]) for n in dimensions)
                lines.append([variant.label, *(self.cell(variant, c) for c in columns), reported, held])
                if not variant.conservative:
                    found = [self.groups.get((variant, c), ()) for c in columns]
                    rates = [f"{100 * _mean(g, 'fn') / g[0]['samples']:.3f}" if g else NO_METHOD for g in found]
                    lines.append([f"{variant.label}, **false negatives %**", *rates])
        memory = f"memory, {' / '.join(f'{n}D' for n in dimensions)}"
        heads = [None, *(c.title for c in columns), "false negatives", memory]
        return markdown(heads, [[*line, *[None] * (len(heads) - len(line))] for line in lines])

    def against_the_paper(self) -> str:
        """Our best network of each column beside the paper's best, in one sentence; empty where there is none."""
        parts, lower = [], 0
        for column in self.objects:
            rates = ((self.rate(v, column), v.name) for v in self.variants if v.method in t.NETWORKS)
            able = [pair for pair in rates if pair[0] is not None]
            theirs = min(t.PAPER["fp_rate"][m][column] for m in ("mlp", "mlp-early"))
            if able:
                rate, name = min(able)
                lower += rate < theirs
                reported = f"**{rate:.2f}**" if rate < theirs else f"{rate:.2f}"
                parts.append(f"{column.title} {reported} ({theirs}, {name})")
        head = "columns our best network has fewer false positives than the paper's best; mean %, and in brackets the"
        text = f"In {lower} of {len(parts)} {head} paper's and the name of ours: {'; '.join(parts)}."
        return f"{text} Planes cannot be compared: most of their hits are missed by samples." if parts else ""


def _mean(rows: Rows, name: str) -> float:
    return sum(r[name] for r in rows) / len(rows) if rows else float("nan")


def _size(rows: Rows) -> str:
    mean = _mean(rows, "nbytes")
    return NO_METHOD if not rows else f"{mean:.0f} B" if mean < 1000 else f"{mean / 1000:.1f} kB"


def page(folder: results.Folder) -> str:
    """The whole page."""
    tables, compared = [], ""
    for protocol in t.PROTOCOLS:
        means = Means(folder.rows, protocol)
        if means.rows:
            tables += [f"## False positives, {protocol} protocol", "", HEADLINES[protocol], ""]
            tables += [*means.table(), ""]
            compared = means.against_the_paper() if means.sampled else compared
    names = {n: {r["object"] for r in folder.rows if r["dimension"] == n} for n in t.HIDDEN}
    values = {"objects": ", ".join(f"{len(own)} in {n}D" for n, own in names.items() if own) or "none"}
    values |= {"sizes": ", ".join(f"{n}D {hidden}" for n, hidden in t.HIDDEN.items())}
    values |= {"budget_text": t.budget_text(folder.settings), "compared": compared}
    return folder.page(NAME, tables=tables or ["Nothing has been measured yet."], **values)


# --- the rank plot ----------------------------------------------------------------------------------------------------

HIGHLIGHTED = {"mlp": "#d1420ao", "learned-kdop+mlp": "#7a2f00*", "kdop": "#00846b^", "bvh": "#4aa3dfv"}
GREYS = ("distance", "relu-field", "learned-kdop", "aabb", "obb",
    "sphere", "ellipsoid", "oriented-ellipsoid")  # fmt: skip
STYLES = dict.fromkeys(GREYS, "#c3c8cc,") | HIGHLIGHTED  # colour and marker; the highlighted ones are drawn last
AROUND = "volumes around the object", "volumes around query parameters,\nas in the paper"
CAPTIONS = dict(zip(t.SPACES, AROUND, strict=True))
TICKS = (0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30, 100)  # per cent; what is less than the first is drawn there


def rank_plot(rows: Rows) -> dict[str, bytes]:
    """The paper's rank plot: false-positive rates of every test case (object x query), sorted, a line a method.

    A panel a dimension; volumes around numbers of queries have panels of their own, with the networks in both. The
    exact protocol is drawn where there is any. Returns file content by format; nothing if there are no rows.
    """
    rows = [r for r in rows if r["method"] in STYLES and r["leaves"] is None]
    protocol = next((p for p in t.PROTOCOLS if any(r["protocol"] == p for r in rows)), None)
    rows = [r for r in rows if r["protocol"] == protocol]
    if not rows:
        return {}
    spaces = [s for s in t.SPACES if any(r["method"] in t.IN_BOTH and r["space"] == s for r in rows)] or [t.SPACES[0]]
    dimensions = sorted({r["dimension"] for r in rows})
    least = max([t for t in TICKS if t <= min(r["fp_rate"] for r in rows)], default=TICKS[0])

    def fill(figure) -> None:
        size, lines = (3.35 * len(dimensions) + 2.7, 3.25 * len(spaces) + 0.75), {}
        figure.set_size_inches(size)
        figure.set_layout_engine("constrained")
        panels = figure.subplots(len(spaces), len(dimensions), sharey=True, squeeze=False)
        for line, space in zip(panels, spaces, strict=True):
            line[0].set_ylabel(f"{CAPTIONS[space]}\nfalse positives, %", color=INK)
            for panel, ndim in zip(line, dimensions, strict=True):
                own = [r for r in rows if r["dimension"] == ndim]
                for method, style in STYLES.items():
                    both, main = method in t.IN_BOTH, method in HIGHLIGHTED
                    here = lambda r, both=both: not both or r["space"] == space  # noqa: E731, B023
                    found = [r for r in own if r["method"] == method and (here(r) or r["query"] == "point")]
                    if any(here(r) for r in found):
                        rates = np.maximum(np.sort([r["fp_rate"] for r in found]), least)
                        drawn = {"color": style[:7], "marker": style[7], "markeredgecolor": "white"}
                        drawn |= {"zorder": 3 + main, "linewidth": 2.4 if main else 1.0}
                        drawn |= {"markersize": 6, "markeredgewidth": 0.6}
                        every = max(1, -(-len(rates) // 12))
                        (lines[method],) = panel.plot(np.arange(1, len(rates) + 1), rates, markevery=every, **drawn)
                cases = len({(r["object"], r["query"]) for r in own})
                panel.set_title(f"{ndim}D", loc="left", fontweight="bold", color=INK)
                panel.set(yscale="log", ylim=(least * 0.9, TICKS[-1] * 1.1), xlim=(0.5, cases + 0.5))
                panel.set_yticks([t for t in TICKS if t >= least], [f"{t:g}" for t in TICKS if t >= least])
                panel.minorticks_off()
                panel.grid(axis="y", color=PALE, linewidth=0.8)
                panel.spines[["top", "right"]].set_visible(False)
                if space == spaces[-1]:
                    panel.set_xlabel(f"{cases} test cases (object × query),\nsorted for each method: easy to hard")
        names = [m for m in HIGHLIGHTED if m in lines]
        others = [m for m in GREYS if m in lines]
        handles = [lines[m] for m in names] + [lines[m] for m in others[:1]]
        names += [f"others: {chr(10).join(others)}".replace(": ", ":" + chr(10))] if others else []
        figure.legend(handles, names, loc="outside right upper", frameon=False)
        figure.suptitle(f"False-positive rates by method, {protocol} truth", x=0.01, ha="left", color=INK)

    return page_of(fill)
