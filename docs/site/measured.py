"""Tables and lists of the README and the pages, made from files in ``results``.

``python docs/site/measured.py`` writes them anew, ``--check`` fails if that would change a page. Each function of
``MEASURED`` reads what a benchmark or a demo has written and returns Markdown. A page names one with the comment
``<!-- measured: NAME -->`` on a line by itself; what it returns follows, up to ``<!-- end -->``.
"""

import argparse
import csv
import json
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from statistics import mean, median

__all__ = ["MEASURED", "ROOT", "bold_least", "changed", "rendered", "table"]

ROOT = Path(__file__).resolve().parents[2]
PRICES = (10, 100, 1_000)  # nanoseconds of a narrow phase
COLUMNS = [(n, query) for n in "234" for query in ("point", "ray", "plane", "box")]


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown; the first column is text, the others are numbers."""
    lines = [" | ".join(head), *(" | ".join(row) for row in rows)]
    lines = [f"| {line} |\n" for line in lines]
    return "".join([lines[0], f"|---|{'---:|' * (len(head) - 1)}\n", *lines[1:]])


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


SOME = (
    *("aabb", "learned-kdop", "mlp 16-16", "mlp 24-24", "mlp 50-50", "bvh 64", "bvh 300", "voxels 192"),
)  # methods of the tables; results/meshes has them all


def meshes(results: Path) -> str:
    """False positives of methods on every mesh, by bytes."""
    return _of_meshes(results, SOME)


def _of_meshes(results: Path, only: Sequence[str]) -> str:
    rows = _lines(results / "meshes/meshes.jsonl")
    names, found = list(dict.fromkeys(row["mesh"] for row in rows)), {}
    for row in rows:
        if row["certificate"] == "proven" and row["label"] in only:
            found.setdefault(row["label"], {})[row["mesh"]] = row
    labels = sorted(found, key=lambda label: max(row["bytes"] for row in found[label].values()))
    numbers = [[found[label][name]["fp_rate"] if name in found[label] else None for name in names] for label in labels]
    cells = bold_least([["" if n is None else f"{n:.2f}" for n in row] for row in numbers], numbers)
    sizes = [_size([row["bytes"] for row in found[label].values()]) for label in labels]
    shown = zip(labels, sizes, cells, strict=True)
    return table(["false positives, %", "bytes", *names], [[f"`{label}`", size, *row] for label, size, row in shown])


PRICED = ("aabb", "learned-kdop", "mlp 16-16", "mlp 24-24", "bvh 300", "voxels 192")


def prices(results: Path) -> str:
    """The cost of a query, with the narrow phase of what the bounder leaves, at several prices of that."""
    rows = [r for r in _lines(results / "meshes/meshes.jsonl") if r["mesh"] == "bunny" and r["label"] in PRICED]
    left = [(row["fp_rate"] + row["positives"]) / 100 for row in rows]
    costs = [[row["nanoseconds"] + share * price for price in PRICES] for row, share in zip(rows, left, strict=True)]
    labels, shares = [f"`{row['label']}`" for row in rows] + ["*none*"], [*left, 1.0]
    own = [row["nanoseconds"] for row in rows] + [0.0]
    costs.append([float(price) for price in PRICES])
    cells = bold_least([[f"{cost:,.1f}" if cost < 100 else f"{cost:,.0f}" for cost in row] for row in costs], costs)
    order = sorted(range(len(labels)), key=lambda i: costs[i][2])
    head = ["method", "ns a query", "left, %", *(f"narrow phase {price:,} ns" for price in PRICES)]
    return table(head, [[labels[i], f"{own[i]:.1f}", f"{100 * shares[i]:.1f}", *cells[i]] for i in order])


def functions(results: Path) -> str:
    """Nanoseconds of a query in a batch and in a kernel, with and without Warp's loop."""
    about, *rows = _lines(results / "predicted/predicted.jsonl")
    shown = [(row["label"], row["batch"]["ns"], row["function"]["ns"]) for row in rows]
    cells = [[f"`{name}`", f"{batch:.1f}", f"{own:.1f}", f"{own / batch:.1f}"] for name, batch, own in shown]
    loop = f"function, on one core; {about['loop_ns']:.1f} of them are Warp's loop"
    return table(["method", "batch, with the list of what is left", loop, "times"], cells) + _load(about)


def predicted(results: Path) -> str:
    """How many times as fast a bounder makes a query of the torus knot: two predictions, and what was measured."""
    about, *rows = _lines(results / "predicted/predicted.jsonl")
    names = ("one_price", "predicted", "measured")
    cells = [
        [f"`{row['label']}`", f"{100 * row['share']:.1f}", *(f"{row['batch'][name]:.2f}" for name in names)]
        for row in rows
    ]
    return table(["method", "left, %", "one price", "the test itself", "measured"], cells) + _load(about)


def _load(about: dict) -> str:
    """A line where others used the machine as it was measured."""
    busy = "\nMeasured on a machine that had other work too: compare them only with each other.\n"
    return busy if about["load"] > 1.5 * about["threads"] else ""


AS_TRAINED = "the paper's form of a network, not proven"  # over the numbers of queries, its threshold from samples
THEIRS = "the paper's best network, not proven"


def _label(row: dict[str, str]) -> str:
    """What a row of Table 1 is of; empty for what the short table leaves out, and what this version has no more."""
    from warp_bounding.bounders import METHODS, supports
    from warp_bounding.evaluation import ASKED

    method, query = row["method"], row["query"]
    if row["leaves"] or row["space"] == "parametric":
        return AS_TRAINED if method == "mlp" else ""
    of_method = all(name in METHODS for name in method.split("+"))
    known = supports(method, query, int(row["dimension"])) if of_method else query in ASKED  # else of distances
    return f"`{method}`" if known else ""


def table1(results: Path) -> str:
    """The paper's Table 1 in short: mean false positives over objects, exact truth above and the paper's below."""
    found: dict[tuple, list[float]] = {}
    for row in _rows(results / "table1/table1.csv"):
        cell = _label(row), row["protocol"], row["dimension"], row["query"]
        found.setdefault(cell, []).append(float(row["fp_rate"]))
    theirs = [
        row
        for row in _rows(results.parent / "paper/paper.csv")
        if row["method"] in ("mlp", "mlp-early") and row["what"] == "fp_rate"
    ]
    found |= {(THEIRS, "sampled", n, q): [min(float(row[f"{n}d-{q}"]) for row in theirs)] for n, q in COLUMNS}
    networks, lines = ("`mlp`", "`learned-kdop+mlp`", "`distance`", AS_TRAINED), []
    for protocol, heading, labels in (
        ("exact", "exact truth", ("`aabb`", "`learned-kdop`", *networks, "`bvh`")),
        ("sampled", "the paper's, sampled truth", (*networks, THEIRS, "`bvh`")),
    ):
        digits = {label: 1 if label == THEIRS else 2 for label in labels}  # the paper's numbers have one
        own = {label: [found.get((label, protocol, *column)) for column in COLUMNS] for label in labels}
        means = {label: [cell and sum(cell) / len(cell) for cell in row] for label, row in own.items() if any(row)}
        cells = [["" if n is None else f"{n:.{digits[label]}f}" for n in row] for label, row in means.items()]
        compared = [[None] * len(row) if label in (AS_TRAINED, "`bvh`") else row for label, row in means.items()]
        lines.append([f"**{heading}**", *[""] * len(COLUMNS)])
        lines += [[label, *row] for label, row in zip(means, bold_least(cells, compared), strict=True)]
    return table(["", *(f"{n}D {query}" for n, query in COLUMNS)], lines)


# Rows of ``results/gpu``: what is asked, its part, and how it is called there, in float32 and on tensor cores.
GPU = {
    "points, `mlp` 24-24": ("points", "24 float32", "24 tensor"),
    "points, `mlp` 50-50": ("points", "50 float32", "50 tensor"),
    "points, `bvh` of 64 boxes": ("points", "bvh", None),
    "points, `kdop`": ("points", "kdop", None),
    "rays, `bvh` of 64 boxes": ("rays", "bvh", None),
}


def gpu(results: Path) -> str:
    """Nanoseconds of a query on an H100, in float32 and on tensor cores."""
    lines = []
    for label, (part, *ways) in GPU.items():
        found = json.loads((results / f"gpu/h100/{part}.json").read_text(encoding="utf-8"))["found"]
        lines.append([label, *(f"{found[way][0]:.3g}" if way in found else "" for way in ways)])
    return table(["H100", "float32", "tensor cores"], lines)


CLOSEST = (
    *("bunny-distance-24, function", "bunny-distance-24, batch", "bunny-distance-50, batch"),
    *("wp.mesh_query_point, no limit", "wp.mesh_query_point within 0.1", "NanoVDB volume of 64"),
    *("Newton's texture of 64, interpolation of the card", "bunny-distance-grid-32, function"),
)  # rows of the table; results/gpu has them all


def gpu_closest(results: Path) -> str:
    """What distances cost on an H100, who promises never to overestimate, and how often the others do."""
    lines = []
    for part in ("closest", "grids"):
        reported = json.loads((results / f"gpu/h100/{part}.json").read_text(encoding="utf-8"))
        for name, row in reported["found"].items():
            if name not in CLOSEST:
                continue
            exact = name.startswith("wp.mesh")
            over = "exact" if exact else f"{row['over'] / reported['count']:.1%}"
            cells = ["", ""] if exact else [f"{row['most']:.2g}", f"{row['less']:.2g}"]
            lines.append([name, f"{row['ns'][0]:.3g}", f"{row['bytes'] / 1000:,.0f} kB", over, *cells])
    return table(["H100", "ns a point", "size", "too large", "by at most", "too small, on average"], lines)


def gpu_counted(results: Path) -> str:
    """What a query of a network costs in float32: measured with one a thread, and counted in machine code of today."""
    counted, lines = json.loads((results / "gpu/counted.json").read_text(encoding="utf-8")), []
    for name, found in counted.items():
        if name.startswith("point") and name.endswith(", float32"):
            query, widths = name.removesuffix(", float32").split()
            part = json.loads((results / f"gpu/h100/{query}s.json").read_text(encoding="utf-8"))["found"]
            before = part[f"{widths[:2]} float32"][0]
            costs = [str(found[each]) for each in ("queries a thread", "loads", "issued")]
            times = [f"{found[f'ns to {each}']:.3g}" for each in ("load", "issue")]
            lines.append([f"{query}s, `mlp` {widths}", f"{before:.3g}", *costs, *times])
    head = ["H100, float32", "measured, one query a thread: ns", "queries a thread now", "loads", "instructions"]
    return table([*head, "ns to load", "ns to issue"], lines)


def gpu_cull(results: Path) -> str:
    """Milliseconds of Newton's pass in a graph on an H100, with the layout that the library takes."""
    from warp_bounding.newton.sieve import SORTED

    found, lines = json.loads((results / "gpu/h100/cull.json").read_text(encoding="utf-8"))["found"], []
    for cell, row in found.items():
        layout = ", by place" if row["pairs"] >= SORTED else ""
        ways = {"without": "none", "boxes": f"boxes, 16 warps{layout}", "bounders": f"distance, 16 warps{layout}"}
        times = [min(row[f"{way}, ms, turn {turn}"][0] for turn in (0, 1)) for way in ways.values()]
        cells = [f"{times[0]:.3f}", *(f"{each:.3f} ({times[0] / each:.2f})" for each in times[1:])]
        lines.append([re.sub(r"^\d+", lambda m: f"{int(m[0]):,}", cell).replace(" 1 meshes", " one mesh"), *cells])
    return table(["H100, ms", "without a cull", "boxes (times as fast)", "bounders (times as fast)"], lines)


# --- the README and *Is it for me?* -----------------------------------------------------------------------------------


def _demo(results: Path, name: str) -> dict[tuple[str, str], dict]:
    """Runs of a demo, by bounder and section."""
    report = json.loads((results / f"demos/{name}.json").read_text(encoding="utf-8"))
    return {(run["bounder"], run["section"]): run for run in report["runs"]}


def _bytes(results: Path, name: str, bounder: str) -> str:
    """The size of a demo's bounder."""
    report = json.loads((results / f"demos/{name}.json").read_text(encoding="utf-8"))
    return _size([row["bytes"] for row in report["bounders"] if row["bounder"] == bounder])


def _share(runs: dict[tuple[str, str], dict], bounder: str, section: str = "") -> str:
    """The time of a whole step with a bounder, in % of that without one."""
    return f"{100 * runs[bounder, section]['ms_step'] / runs['none', section]['ms_step']:.0f} %"


def _fastest(runs: dict[tuple[str, str], dict], query: str, ndim: int) -> str:
    """The method with the shortest step of those that are proven and answer such queries themselves."""
    from warp_bounding.bounders import supports

    able = [run for run in runs.values() if run["certificate"] == "proven" and supports(run["bounder"], query, ndim)]
    return min(able, key=lambda run: run["ms_step"])["bounder"]


def _card(results: Path, part: str, way: str, card: str = "h100") -> str:
    """Nanoseconds of a query on a card."""
    found = json.loads((results / f"gpu/{card}/{part}.json").read_text(encoding="utf-8"))["found"][way]
    return f"{(found['ns'] if isinstance(found, dict) else found)[0]:.2g} ns"


def _cull(results: Path, cell: str, what: str = "distance") -> str:
    """How many times as fast Newton's pass is on an H100, with bounders or with ``"boxes"`` alone."""
    row = json.loads((results / "gpu/h100/cull.json").read_text(encoding="utf-8"))["found"][cell]
    from warp_bounding.newton.sieve import SORTED

    with_it = f"{what}, 16 warps{', by place' if row['pairs'] >= SORTED else ''}"
    times = [min(row[f"{way}, ms, turn {turn}"][0] for turn in (0, 1)) for way in ("none", with_it)]
    return f"{times[0] / times[1]:.2f}"


def _pass(row: dict, bounder: str) -> str:
    """How many times as fast Newton's pass over many meshes is on a CPU."""
    return f"{next(entry['ratio'] for entry in row['bounders'] if entry['bounder'] == bounder):.1f}"


def pays(results: Path) -> str:
    """Where a bounder pays, a line each."""
    rain, arm = _demo(results, "particles"), _demo(results, "arm")
    near, *_, far = json.loads((results / "demos/cloth.json").read_text(encoding="utf-8"))["field"]
    million = "1000000 particles, 1 meshes"
    moved = _lines(results / "motions/motions.jsonl")
    edges, proven, proof, samples = (
        sum(row.get(k, 0) for row in moved) for k in ("edges", "proven", "proof_s", "samples_s")
    )
    whole = "all" if proven == edges else f"{100 * proven / edges:.2f} %"
    plans = _lines(results / "planners/planners.jsonl")
    ours = [row["motions"]["s"] for row in plans if "motions" in row]
    theirs = [row["roboplan"] for row in plans if row.get("roboplan", {}).get("solved")]
    hit = sum(each["hits"] > 0 for each in theirs)
    lines = {
        "Whole motions of robots": f"of {edges:,} motions of three robots that 320 samples a radian accept, "
        f"{whole} are proven free all along, with nothing fitted, for "
        f"{100 * proof / samples:.0f} % of the time of 32 samples a radian ([guide](docs/guide/motions.md)). A plan "
        f"takes {1e3 * median(ours):.0f} ms, every motion proven. One of roboplan, which samples with Coal, takes "
        f"{1e3 * median(each['s'] for each in theirs):.0f} ms, and {hit} of its {len(theirs)} collide on the way "
        "([plans](results/planners/README.md)).",
        "Expensive checks, many coordinates": "planning with checks of meshes takes "
        f"{_share(arm, 'mlp', 'Planar arm, 4 joints, meshes')} (an arm of four joints) and "
        f"{_share(arm, 'mlp', 'UR5, meshes')} (four of a UR5's six), with a tree of boxes "
        f"{_share(arm, 'bvh', 'Planar arm, 4 joints, meshes')} and {_share(arm, 'bvh', 'UR5, meshes')}. With our own "
        f"checks of convex hulls, which are fast, the first takes {_share(arm, 'mlp', 'Planar arm, 4 joints')}.",
        "Moving shapes": "rain on a turning bunny takes "
        f"{_share(rain, 'mlp', 'containment')} with a network of {_bytes(results, 'particles', 'mlp')}, "
        f"{_share(rain, 'voxels', 'containment')} with `voxels` of {_bytes(results, 'particles', 'voxels')}, "
        f"{_share(rain, 'moving aabb', 'containment')} with a box refitted every step.",
        "Distances, swept queries": f"a lower bound from a proven grid takes "
        f"{_card(results, 'grids', 'bunny-distance-grid-32, function')} a point on an H100; `wp.mesh_query_point`, "
        f"which is exact, {_card(results, 'closest', 'wp.mesh_query_point within 0.1')} within 0.1 of the mesh and "
        f"{_card(results, 'closest', 'wp.mesh_query_point, no limit')} without a limit.",
        "Newton, many particles": f"its contact pass is {_pass(near, 'distance')} times as fast on a CPU "
        f"({near['pairs']:,} pairs, contact gap {near['gap']:g}), {_cull(results, million)} times on an H100 (a "
        f"million particles). Boxes alone reach {_pass(near, 'aabb')} and {_cull(results, million, 'boxes')}. A gap of "
        f"{far['gap']:g} leaves {_pass(far, 'distance')} on the CPU, {_pass(far, 'aabb')} with boxes alone.",
        "Smooth meshes": "tight in few kilobytes, below.",
    }
    return "".join(f"* **{what}**: {how}\n" for what, how in lines.items())


def pays_not(results: Path) -> str:
    """Where a network gains little or loses, a line each, with what is better."""
    rain, cloth, path = (_demo(results, name) for name in ("particles", "cloth", "path"))
    shadows, sections = _demo(results, "shadows"), ("rooms", "maze")
    grids = [_share(path, "distance-grid", section) for section in sections]
    nets = [_share(path, "mlp", section) for section in sections]
    near = 1e6 * rain["none", "contact"]["ms_narrow"] / 100_000
    volume = _fastest(shadows, "ray", 3)
    lines = {
        "Cheap exact tests": f"that rain, tested for contacts only ({near:.0f} ns a drop), takes "
        f"{_share(rain, 'mlp', 'contact')}, with `voxels` {_share(rain, 'voxels', 'contact')}.",
        "One cloth on two meshes, in Newton": f"{_share(cloth, 'mlp')}, with `voxels` {_share(cloth, 'voxels')}.",
        "Paths in a 2D grid": f"{' and '.join(nets)}, with a grid of distances {' and '.join(grids)}.",
        "Shadow rays": f"a march along each by a network of distances takes {_share(shadows, 'distance')}, `{volume}` "
        f"{_share(shadows, volume)}.",
        "Static meshes on a GPU": f"a network in your own kernel takes {_card(results, 'points', '24 float32')} a "
        f"point on an H100, a tree of boxes {_card(results, 'points', 'bvh')}.",
        "Few particles": "with ten thousand, Newton's pass on an H100 is "
        f"{_cull(results, '10000 particles, 1 meshes')} times as fast.",
    }
    return "".join(f"* **{what}**: {how}\n" for what, how in lines.items())


def robot_balls(results: Path) -> str:
    """How much of robots lies outside of the balls that a planner checks."""
    names = {"panda": "Panda", "ur5": "UR5 with gripper", "fetch": "Fetch"}
    rows = _rows(results / "robot-balls/balls.csv")
    cells = [[names[row["robot"]], row["balls"], row["outside_percent"], row["farthest_mm"]] for row in rows]
    return table(["VAMP's balls", "balls", "surface outside, %", "farthest, mm"], cells)


def arms(results: Path) -> str:
    """Planning times of the arms, whole cells."""
    runs = _demo(results, "arm")
    sections = list(dict.fromkeys(section for _, section in runs))
    methods = ("none", "aabb", "bvh", "mlp")
    ms = [[runs[m, section]["ms_step"] if (m, section) in runs else None for m in methods] for section in sections]
    names = [section.removeprefix("Planar arm, ") for section in sections]
    rows = [["–" if n is None else f"{n:,.0f}" for n in row] for row in ms]
    rows = [
        [f"**{cell}**" if n == min(filter(None, times)) else cell for cell, n in zip(row, times, strict=True)]
        for row, times in zip(rows, ms, strict=True)
    ]
    heads = ["planning time, ms", "no bounder", *(f"`{method}`" for method in methods[1:])]
    return table(heads, [[name, *row] for name, row in zip(names, rows, strict=True)])


SHORT = ("mlp 24-24", "bvh 300", "mlp 50-50")


PARTS = ("ur5 shoulder", "ur5 wrist2", "panda hand", "panda link5", "gear", "bracket", "spring")  # of the table


def parts(results: Path) -> str:
    """Parts that people have: what ``fit`` returns, the best classic of no more bytes, and over all parts."""
    rows = _lines(results / "parts/parts.jsonl")
    ours: dict[str, list[dict]] = {}
    for row in rows:
        if row["kind"] == "fit" and (row["size"], row["budget"]) == ("2.9 kB", 60.0):
            ours.setdefault(row["part"], []).append(row)
    fitted, best = {part: mean(row["fp"] for row in own) for part, own in ours.items()}, {}
    for part, own in ours.items():
        known = [row for row in rows if (row["kind"], row["part"]) == ("classic", part)]
        best[part] = min(row["fp"] for row in known if row["bytes"] <= min(each["bytes"] for each in own))
    shown, shares = [part for part in PARTS if part in ours], [fitted[part] / best[part] for part in ours]
    lines = [
        ["`fit(mesh, hidden=(24, 24))`", *(f"**{fitted[part]:.2f}**" for part in shown)],
        ["the best classic of its bytes", *(f"{best[part]:.2f}" for part in shown)],
    ]
    few = sum(share <= 0.25 for share in shares)
    seeds = len({row["seed"] for own in ours.values() for row in own})
    words = f"\nMeans of {seeds} fits. Of {len(shares)} such parts {few} have at most a quarter of the best classic's "
    words += f"false positives; the median has {median(shares):.2f} of it, the worst {max(shares):.2f}.\n"
    return table(["false positives, %", *shown], lines) + words


def tightness(results: Path) -> str:
    """False positives of few methods on every mesh, by bytes."""
    return _of_meshes(results, SHORT)


MEASURED: dict[str, Callable[[Path], str]] = {
    "meshes": meshes,
    "parts": parts,
    "prices": prices,
    "functions": functions,
    "predicted": predicted,
    "table1": table1,
    "gpu": gpu,
    "gpu-closest": gpu_closest,
    "gpu-counted": gpu_counted,
    "gpu-cull": gpu_cull,
    "pays": pays,
    "pays-not": pays_not,
    "arms": arms,
    "tightness": tightness,
    "robot-balls": robot_balls,
}
MARK = re.compile(
    r"^<!--measured:([\w-]+)-->$(?:\n((?!<!--).*\n)*<!--end-->$)?", re.MULTILINE
)  # with what was measured, if that is there


def rendered(page: Path) -> str:
    """A page's text with everything measured written anew."""

    def made(found: re.Match) -> str:
        if found[1] not in MEASURED:
            raise ValueError(f"{page}: expected one of {', '.join(MEASURED)}, got {found[1]}")
        return f"<!--measured:{found[1]}-->\n\n{MEASURED[found[1]](ROOT / 'results')}\n<!--end-->"

    return MARK.sub(made, page.read_text(encoding="utf-8"))


def changed() -> dict[Path, str]:
    """Pages that differ from what is measured, with the text that they should have."""
    pages = [ROOT / "README.md", ROOT / "results/gpu/README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return {page: text for page in pages if (text := rendered(page)) != page.read_text(encoding="utf-8")}


def main() -> int:
    """Write the pages anew, or check them: then 1 if one would change."""
    parser = argparse.ArgumentParser(description="Write what was measured into the pages.")
    parser.add_argument("--check", action="store_true", help="change nothing; exit status 1 if a page would change")
    check = parser.parse_args().check
    for page, text in (found := changed()).items():
        print(f"{page.relative_to(ROOT)}: {'differs from results/' if check else 'written'}")
        if not check:
            page.write_text(text, encoding="utf-8")
    return int(check and bool(found))


if __name__ == "__main__":
    sys.exit(main())
