"""Tables of the pages, made from files in ``results``: ``python docs/site/measured.py`` writes them anew.

Each function of ``MEASURED`` reads what a benchmark or a demo has written and returns a table in Markdown. A page
asks for one by its name, with the comment ``<!-- measured: NAME -->`` on a line by itself; the table follows, up to
``<!-- end -->``. Readers of the plain page see neither.
"""

import csv
import json
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

__all__ = ["MARK", "MEASURED", "bold_least", "table"]

PRICES = (10, 100, 1_000, 10_000)  # nanoseconds of a narrow phase
DEMOS = ("particles", "cloth", "path", "shadows", "arm")
COLUMNS = [(n, query) for n in "234" for query in ("point", "ray", "plane", "box")]


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown; the first column is text, the others are numbers."""
    lines = [" | ".join(head), "|".join(["---", *["---:"] * (len(head) - 1)]), *(" | ".join(row) for row in rows)]
    return "".join(f"| {line} |\n" for line in lines)


def bold_least(rows: list[list[str]], numbers: list[list[float | None]]) -> list[list[str]]:
    """Cells with the least number of every column in bold.

    Args:
        rows: Cells as they are shown.
        numbers: What they are compared by, ``None`` where a cell is not compared.
    """
    least = [min((n for n in column if n is not None), default=None) for column in zip(*numbers, strict=True)]
    return [
        [
            f"**{cell}**" if n is not None and n == best else cell
            for cell, n, best in zip(row, found, least, strict=True)
        ]
        for row, found in zip(rows, numbers, strict=True)
    ]


def _lines(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _size(sizes: list[int]) -> str:
    """Bytes, of the smallest to the largest."""
    said = [f"{size} B" if size < 1000 else f"{size / 1000:.1f} kB" for size in (min(sizes), max(sizes))]
    return said[0] if said[0] == said[1] else f"{said[0]} to {said[1]}"


def meshes(results: Path) -> str:
    """False positives of every method on every mesh, by bytes."""
    rows = _lines(results / "meshes/meshes.jsonl")
    names, found = list(dict.fromkeys(row["mesh"] for row in rows)), {}
    for row in rows:
        if row["certificate"] == "proven":
            found.setdefault(row["label"], {})[row["mesh"]] = row
    labels = sorted(found, key=lambda label: max(row["bytes"] for row in found[label].values()))
    numbers = [[found[label][name]["fp_rate"] if name in found[label] else None for name in names] for label in labels]
    cells = bold_least([["" if n is None else f"{n:.2f}" for n in row] for row in numbers], numbers)
    sizes = [_size([row["bytes"] for row in found[label].values()]) for label in labels]
    shown = zip(labels, sizes, cells, strict=True)
    return table(["method", "bytes", *names], [[f"`{label}`", size, *row] for label, size, row in shown])


def prices(results: Path) -> str:
    """The cost of a query, with the narrow phase of what the bounder leaves, at several prices of that."""
    rows = [r for r in _lines(results / "meshes/meshes.jsonl") if r["mesh"] == "bunny" and r["certificate"] == "proven"]
    left = [(row["fp_rate"] + row["positives"]) / 100 for row in rows]
    costs = [[row["nanoseconds"] + share * price for price in PRICES] for row, share in zip(rows, left, strict=True)]
    labels, shares = [f"`{row['label']}`" for row in rows] + ["*none*"], [*left, 1.0]
    own = [row["nanoseconds"] for row in rows] + [0.0]
    costs.append([float(price) for price in PRICES])
    cells = bold_least([[f"{cost:,.1f}" if cost < 100 else f"{cost:,.0f}" for cost in row] for row in costs], costs)
    order = sorted(range(len(labels)), key=lambda i: costs[i][2])
    head = ["method", "ns a query", "left, %", *(f"narrow phase {price:,} ns" for price in PRICES)]
    return table(head, [[labels[i], f"{own[i]:.1f}", f"{100 * shares[i]:.1f}", *cells[i]] for i in order])


def distances(results: Path) -> str:
    """False positives of distances at several radii and of segments, with what a question costs."""
    rows = [row for row in _lines(results / "distances/distances.jsonl") if row["certificate"] == "proven"]
    numbers = [[*row["rates"], row["segments"], row["ns_point"], row["ns_segment"]] for row in rows]
    cells = bold_least([[f"{n:.2f}" for n in row[:6]] + [f"{n:.1f}" for n in row[6:]] for row in numbers], numbers)
    head = [
        "distance",
        "bytes",
        *(f"within {r}" for r in (0, 0.02, 0.05, 0.1, 0.2)),
        "segments",
        "ns a point",
        "a segment",
    ]
    return table(head, [[f"`{row['label']}`", _size([row["bytes"]]), *c] for row, c in zip(rows, cells, strict=True)])


def demos(results: Path) -> str:
    """A table of every demo: narrow-phase calls and time that each bounder leaves of the run without a broad phase."""
    tables = []
    for demo in DEMOS:
        report = json.loads((results / f"demos/{demo}.json").read_text(encoding="utf-8"))
        sections = list(dict.fromkeys(run["section"] for run in report["runs"]))
        runs = {(run["bounder"], run["section"]): run for run in report["runs"]}
        labels = [
            x for x in dict.fromkeys(run["bounder"] for run in report["runs"]) if x != "none" and "cores" not in x
        ]
        rows = [[f"`{x}`", *(_left(runs.get((x, s)), runs["none", s]) for s in sections)] for x in labels]
        tables.append(table([f"{demo}: calls / time, %", *(section or "all" for section in sections)], rows))
    return "\n".join(tables)


def _left(run: dict | None, none: dict) -> str:
    """What a run leaves of the calls and of the time of the one without a broad phase, in %; and what it missed."""
    if run is None:
        return ""
    time = (run["ms_broad"] + run["ms_narrow"]) / (none["ms_broad"] + none["ms_narrow"])
    lost = f", **{run['missed']:,} missed**" if run["missed"] or not run["identical"] else ""
    return f"{100 * run['narrow_calls'] / none['narrow_calls']:.1f} / {100 * time:.0f}{lost}"


def table1(results: Path) -> str:
    """The paper's Table 1 in short: mean false positives over objects, exact truth above and the paper's below."""
    found: dict[tuple, list[dict]] = {}
    for row in _rows(results / "table1/table1.csv"):
        if row["space"] == "geometric" and not row["leaves"]:
            found.setdefault((row["method"], row["protocol"], row["dimension"], row["query"]), []).append(row)
    theirs = [
        row
        for row in _rows(results.parent / "paper/paper.csv")
        if row["method"] in ("mlp", "mlp-early") and row["what"] == "fp_rate"
    ]
    lines = []
    for protocol, heading, methods in (
        ("exact", "exact truth", ("aabb", "kdop", "learned-kdop", "mlp", "monotone-mlp", "learned-kdop+mlp", "distance",
            "bvh")),
        ("sampled", "the paper's, sampled truth", ("mlp", "learned-kdop+mlp", "distance", "bvh")),
    ):  # fmt: skip
        own = [[found.get((method, protocol, *column)) for column in COLUMNS] for method in methods]
        means = [
            [sum(float(r["fp_rate"]) for r in cell) / len(cell) if cell else None for cell in line] for line in own
        ]
        cells = [["" if mean is None else f"{mean:.2f}" for mean in line] for line in means]
        labels, means[-1] = [f"`{method}`" for method in methods], [None] * len(COLUMNS)  # a bvh is not compared
        if protocol == "sampled":
            best = [min(float(row[f"{n}d-{query}"]) for row in theirs) for n, query in COLUMNS]
            labels.insert(-1, "the paper's best network, not proven")
            cells.insert(-1, [f"{rate:.1f}" for rate in best])
            means.insert(-1, best)
            own.insert(-1, [[]] * len(COLUMNS))
        unproven = [[any(r["certificate"] != "proven" for r in cell or ()) for cell in line] for line in own]
        shown = [
            [f"{c}¹" if u else c for c, u in zip(*pair, strict=True)]
            for pair in zip(bold_least(cells, means), unproven, strict=True)
        ]
        lines += [[f"**{heading}**", *[""] * len(COLUMNS)]]
        lines += [[label, *line] for label, line in zip(labels, shown, strict=True)]
    return table(["", *(f"{n}D {query}" for n, query in COLUMNS)], lines)


def raced(results: Path) -> str:
    """Nanoseconds of methods in the 3D columns, and how many times as long as ``mlp`` in the same round."""
    own = (r for r in _rows(results / "speed/speed.csv") if r["dimension"] == "3" and r["device"] == "cpu")
    rows = {(r["method"], r["query"]): r for r in own if r["space"] == "geometric" and not r["leaves"]}
    methods, lines = ("aabb", "kdop", "learned-kdop", "bvh", "mlp-early", "mlp"), []
    for query in ("point", "ray", "plane", "box"):
        own = [rows[method, query] for method in methods]
        cells = [f"{float(r['ns']):.1f} ({float(r['ratio']):.2f})" for r in own]
        lines.append([query, *cells[:-1], f"{float(own[-1]['ns']):.1f}"])
    return table(["", *(f"`{method}`, {_size([int(rows[method, 'point']['nbytes'])])}" for method in methods)], lines)


def speed(results: Path) -> str:
    """Nanoseconds and false positives of every method in every column of the paper."""
    rows = [r for r in _rows(results / "speed/speed.csv") if r["device"] == "cpu" and r["space"] == "geometric"]
    found = {(row["method"], row["dimension"], row["query"]): row for row in rows}
    shown = []
    for method in dict.fromkeys(row["method"] for row in rows):
        of = [found.get((method, *column)) for column in COLUMNS]
        shown.append([f"`{method}`", *(f"{float(r['ns']):.1f} ({float(r['fp_rate']):.2f})" if r else "" for r in of)])
    return table(["method", *(f"{n}D {query}" for n, query in COLUMNS)], shown)


# Rows of ``results/gpu``: what is asked, its part, and how it is called there, in float32 and on tensor cores.
GPU = {
    "points, `mlp` 24-24": ("points", "24 float32", "24 tensor"),
    "points, `mlp` 32-32": ("points", "32 float32", "32 tensor"),
    "points, `mlp` 50-50": ("points", "50 float32", "50 tensor"),
    "points, `bvh` of 64 boxes": ("points", "bvh", None),
    "points, `kdop`": ("points", "kdop", None),
    "points, `wp.mesh_query_point` within the margin": ("distances", "wp.mesh_query_point, within margin", None),
    "rays, `mlp` 50-50": ("rays", "50 float32", "50 tensor"),
    "rays, `bvh` of 64 boxes": ("rays", "bvh", None),
    "rays, `wp.mesh_query_ray_anyhit`": ("distances", "wp.mesh_query_ray_anyhit", None),
    "distances, a network of 24-24": ("distances", "24 float32", "24 tensor"),
    "distances, a network of 50-50": ("distances", "50 float32", "50 tensor"),
    "distances, `wp.mesh_query_point` within 0.1": ("distances", "wp.mesh_query_point, distance within 0.1", None),
    "distances, `wp.mesh_query_point`": ("distances", "wp.mesh_query_point, distance, no limit", None),
}


def gpu(results: Path) -> str:
    """Nanoseconds of a query on each card, in float32 and on tensor cores."""
    cards, lines = sorted(path.name for path in (results / "gpu").iterdir() if path.is_dir()), []
    for label, (part, *ways) in GPU.items():
        cells = []
        for card in cards:
            file = results / f"gpu/{card}/{part}.json"
            found = json.loads(file.read_text(encoding="utf-8"))["found"] if file.exists() else {}
            cells += [f"{found[way][0]:.3g}" if way in found else "" for way in ways]
        lines.append([label, *cells])
    return table(["", *(f"{card.upper()}, {way}" for card in cards for way in ("float32", "tensor cores"))], lines)


def gpu_closest(results: Path) -> str:
    """What distances cost on an H100, who promises never to overestimate, and how often the others do."""
    lines = []
    for part in ("closest", "grids"):
        reported = json.loads((results / f"gpu/h100/{part}.json").read_text(encoding="utf-8"))
        for name, row in reported["found"].items():
            exact = name.startswith("wp.mesh")
            over = "exact" if exact else f"{row['over'] / reported['count']:.1%}"
            cells = ["", ""] if exact else [f"{row['most']:.2g}", f"{row['less']:.2g}"]
            lines.append([name, f"{row['ns'][0]:.3g}", f"{row['bytes'] / 1000:,.0f} kB", over, *cells])
    return table(["H100", "ns a point", "size", "too large", "by at most", "too small, on average"], lines)


def gpu_cull(results: Path) -> str:
    """Milliseconds of Newton's pass in a graph on an H100, with the layout that the library takes."""
    from warp_bounding.newton.cull import SORTED

    found, lines = json.loads((results / "gpu/h100/cull.json").read_text(encoding="utf-8"))["found"], []
    for cell, row in found.items():
        layout = ", by place" if row["pairs"] >= SORTED else ""
        ways = {"without": "none", "boxes": f"boxes, 16 warps{layout}", "bounders": f"distance, 16 warps{layout}"}
        times = [min(row[f"{way}, ms, turn {turn}"][0] for turn in (0, 1)) for way in ways.values()]
        cells = [f"{times[0]:.3f}", *(f"{each:.3f} ({times[0] / each:.2f})" for each in times[1:])]
        lines.append([re.sub(r"^\d+", lambda m: f"{int(m[0]):,}", cell).replace(" 1 meshes", " one mesh"), *cells])
    return table(["H100, ms", "without a cull", "boxes (times as fast)", "bounders (times as fast)"], lines)


MEASURED: dict[str, Callable[[Path], str]] = {
    "meshes": meshes,
    "prices": prices,
    "distances": distances,
    "demos": demos,
    "speed": speed,
    "table1": table1,
    "raced": raced,
    "gpu": gpu,
    "gpu-closest": gpu_closest,
    "gpu-cull": gpu_cull,
}
MARK = re.compile(
    r"^<!-- measured: ([\w-]+) -->$(?:\n((?!<!-- ).*\n)*<!-- end -->$)?", re.MULTILINE
)  # with its table, if that is there


def main() -> None:
    """Write the tables of all pages anew, each behind its mark."""
    root = Path(__file__).resolve().parents[2]
    for page in sorted((root / "docs").rglob("*.md")):
        text = page.read_text(encoding="utf-8")
        made = MARK.sub(
            lambda m: f"<!-- measured: {m[1]} -->\n\n{MEASURED[m[1]](root / 'results')}\n<!-- end -->", text
        )
        if made != text:
            page.write_text(made, encoding="utf-8")


if __name__ == "__main__":
    main()
