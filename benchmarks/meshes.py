"""Every method on meshes themselves: `python benchmarks/meshes.py --out results/meshes`.

Six meshes of installed packages, thin and open ones among them, dilated by a two-hundredth of their longest side. Every
bounder is fitted, proven, certified from its file, attacked with hard points, and judged by a million random points of
the box around the mesh (a tenth of its longest side wider on every side) against the mesh itself. One JSON row a
bounder, written as it is known; run again after an interruption, it goes on where it stopped. The page and its picture
are made at the end, and by ``--page`` alone.
"""

import argparse
import sys
import tempfile
import warnings
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from shared import StoredRows, nanoseconds

import warp_bounding as wb
from warp_bounding.proof import stress_test

MESHES = {  # by name: the package that brings the file along, and where in it
    "bunny": ("warp", "examples/assets/bunny.usd"),
    "bear": ("warp", "examples/assets/bear.usd"),
    "rocks": ("warp", "examples/assets/rocks.usd"),
    "shirt": ("newton", "examples/assets/unisex_shirt.usd"),
    "crazyflie": ("newton", "examples/assets/crazyflie.usd"),
    "airplane": ("pyvista", "examples/airplane.ply"),
}
MARGIN = 0.005  # of the longest side
METHODS = {
    **{name: {} for name in ("aabb", "sphere", "obb", "ellipsoid", "oriented-ellipsoid", "kdop", "learned-kdop")},
    "bvh 64": {"leaves": 64, "resolution": 192},
    "bvh 300": {"leaves": 300, "resolution": 192},
    "bvh 1500": {"leaves": 1500, "resolution": 192},
    "voxels 64": {"resolution": 64},
    "voxels 192": {"resolution": 192},
    "relu-field 32": {"resolution": 32},
    "mlp 16-16": {"hidden": (16, 16)},
    "mlp 24-24": {"hidden": (24, 24)},
    "mlp 32-32": {"hidden": (32, 32)},
    "mlp 50-50": {"hidden": (50, 50)},
}
SAMPLES, TIMED, ROUNDS = 1_000_000, 1_000_000, 9  # random points; points of a timed batch, and how often it is asked
DASH = "-"
# of the picture: marker and colour by the first word of a label; those of one size stand by their marker alone
MARKS = {
    "mlp": ("o", "tab:red"),
    "bvh": ("o", "tab:blue"),
    "voxels": ("o", "tab:cyan"),
    "relu-field": ("X", "tab:brown"),
    "aabb": ("s", "0.3"),
    "obb": ("D", "0.3"),
    "sphere": ("^", "tab:green"),
    "ellipsoid": ("v", "tab:green"),
    "oriented-ellipsoid": (">", "tab:green"),
    "kdop": ("P", "0.55"),
    "learned-kdop": ("*", "0.55"),
}


def mesh_of(name: str) -> wb.shapes.Mesh:
    """One of ``MESHES``; raises ``ShapeError`` where its package is not installed."""
    package, path = MESHES[name]
    spec = find_spec(package)
    if spec is None:
        raise wb.ShapeError(f"{name}: comes with the package {package}, which is not installed")
    return wb.load_shape(Path(spec.submodule_search_locations[0]) / path)


def aligned_area(mesh: wb.shapes.Mesh) -> float:
    """The part of the area, in per cent, whose faces lie in planes across an axis: what boxes bound without loss."""
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    return float(100 * area[np.abs(normals).max(axis=1) > 0.999999 * area].sum() / area.sum())


def measure(mesh: wb.shapes.Mesh, label: str, budget: float, seed: int, attacked: int) -> dict:
    """One row."""
    margin = MARGIN * float(mesh.extent.max())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", wb.BoundingWarning)  # of cells that are wider than the margin: the page says so
        method = label.split()[0]
        reported = {"margin": margin, "budget": budget, "seed": seed, "device": "cpu", **METHODS[label]}
        fitted = wb.fit(mesh, method=method, **reported)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "bounder.safetensors"
        fitted.save(file)
        bounder = wb.load(file, device="cpu")
    rates, proof = wb.evaluate(bounder, mesh, SAMPLES), wb.certify(bounder, mesh, margin=margin)
    attack, wide = stress_test(bounder, mesh, attacked, seed=1), mesh.dilated(margin)
    timed = np.random.default_rng(5).uniform(wide.sample_lower, wide.sample_upper, (TIMED, 3)).astype(np.float32)
    return {
        "label": label,
        "bytes": bounder.nbytes,
        "fp_rate": round(rates.fp_rate, 4),
        "fp_rate_cells": rates.fp_rate_cells,
        "fn": rates.fn,
        "positives": round(rates.positives, 4),
        "undecided": rates.undecided,
        "attacked": attack.done,
        "missed": attack.missed,
        "certificate": proof.kind,
        "nanoseconds": round(nanoseconds(bounder, timed, ROUNDS), 2),
        "fit_seconds": round(fitted.info["training"]["seconds"] - fitted.info["training"]["compile_seconds"], 1),
        "proof_seconds": fitted.certificate.seconds,
        "certify_seconds": proof.seconds,
        "resolution": fitted.info["resolution"],
        "budget": budget,
        "seed": seed,
    }


def tightest(rows: list[dict], prefix: str, most: float) -> dict | None:
    """The row of a method with the fewest false positives, among those of at most so many bytes."""
    fitting = [row for row in rows if row["label"].startswith(prefix + " ") and row["bytes"] <= most]
    return min(fitting, key=lambda row: row["fp_rate"], default=None)


def page(rows: list[dict], folder: Path, command: str) -> str:
    """The page, in Markdown; the picture is written beside it."""
    lines = [
        "# Meshes: every method against the mesh itself",
        "",
        "",  # the first sentence, of the rows below
        "",
        f"`{command}`",
        "",
        f"{'; '.join(dict.fromkeys(row['versions'] for row in rows))}; {rows[0]['threads']} threads of a CPU. Margin: "
        f"{MARGIN:g} of the longest side. Rates are per cent",
        f"of {SAMPLES:,} uniform points of the box around the dilated mesh, a tenth of its longest side wider on every "
        "side;",
        "the truth is the mesh's own (`Mesh.decide`). Networks and volumes are fitted and proven without cells; `bvh`,",
        "`voxels` and `relu-field` are made of cells.",
        "",
        "![False positives against memory, by mesh](meshes.png)",
        "",
        "## At the memory of a network",
        "",
        "The network 24-24 compared with the tightest tree of boxes of at most its memory, and with the smallest one "
        "that is as tight.",
        "",
        "| mesh | network 24-24 | bytes | bvh of at most its memory | bytes | smallest bvh that is as tight | area "
        "across an axis |",
        "|---|---|---|---|---|---|---|",
    ]
    by_mesh = {name: [row for row in rows if row["mesh"] == name] for name in MESHES}
    by_mesh, behind = {name: own for name, own in by_mesh.items() if own}, []
    for name, own in by_mesh.items():
        network = next((row for row in own if row["label"] == "mlp 24-24"), None)
        if network is None:
            continue
        level = tightest(own, "bvh", network["bytes"])
        as_tight = [r for r in own if r["label"].startswith("bvh") and r["fp_rate"] <= network["fp_rate"]]
        small = min(as_tight, key=lambda row: row["bytes"], default=None)
        beside = f"{level['fp_rate']:.2f} % | {level['bytes']:,}" if level else f"{DASH} | {DASH}"
        last = f"{small['bytes']:,} bytes, {small['fp_rate']:.2f} %" if small else "none measured"
        lines.append(
            f"| {name} | {network['fp_rate']:.2f} % | {network['bytes']:,} | {beside} | {last} | "
            f"{own[0]['aligned_area']:.0f} % |"
        )
        if level and level["fp_rate"] < network["fp_rate"]:
            behind.append((name, own[0]["aligned_area"]))
    but = f" but {', '.join(name for name, _ in behind)}" if behind else ""
    lines[2] = f"The network 24-24 is tighter than a tree of boxes of its memory on every mesh{but}."
    for name, aligned in behind:
        lines += ["", f"Where the network is behind: {name}, {aligned:.0f} % of whose area lies across an axis."]
        if aligned > 90:
            lines += [
                "It is built of boxes, so a hierarchy of boxes has nothing to lose but the margin's rounded edges."
            ]
    lines += [
        "",
        "## Every method",
        "",
        "False positives in %, and the range of nanoseconds a point and seconds of fit and proof over all meshes.",
    ]
    lines += ["Proof, hard points and rates against cells: [meshes.jsonl](meshes.jsonl).", ""]
    lines += [f"| method | bytes | {' | '.join(by_mesh)} | ns | s |", "|---|---|" + "---|" * (len(by_mesh) + 2)]
    for label in METHODS:
        own = {row["mesh"]: row for row in rows if row["label"] == label}
        if own:
            rates = (f"{own[name]['fp_rate']:.2f}" if name in own else DASH for name in by_mesh)
            times = [
                [r["nanoseconds"] for r in own.values()],
                [r["fit_seconds"] + r["proof_seconds"] for r in own.values()],
            ]
            spans = (f"{min(each):.1f} to {max(each):.1f}" for each in times)
            sizes = " to ".join(dict.fromkeys(f"{f(r['bytes'] for r in own.values()):,}" for f in (min, max)))
            lines.append(f"| {label} | {sizes} | {' | '.join(rates)} | {' | '.join(spans)} |")
    missed = sum(row["fn"] + (row["missed"] is not None) for row in rows)
    asked = sum(row["attacked"] for row in rows) / 1e6
    lines += ["", f"False negatives: {missed}, in {asked:,.0f} million hard points of all bounders."]
    draw(by_mesh, folder / "meshes.png")
    return "\n".join(lines) + "\n"


def draw(by_mesh: dict[str, list[dict]], file: Path) -> None:
    """False positives against memory, one panel a mesh."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    figure, handles = Figure(figsize=(13, 8), layout="constrained"), {}
    for place, (name, own) in enumerate(by_mesh.items()):
        axes = figure.add_subplot(2, 3, place + 1)
        for family, (marker, color) in MARKS.items():
            points = sorted((r["bytes"], r["fp_rate"]) for r in own if r["label"].split()[0] == family)
            if points:
                sizes = points[-1][0] > 1.2 * points[0][0]  # one method in several sizes: a line
                style = {"marker": marker, "color": color, "ms": 5.5, "alpha": 0.85, "lw": 1.4 * sizes}
                (handles[family],) = axes.plot(*zip(*points, strict=True), **style)
        axes.set(xscale="log", yscale="log", title=name)
        for axis, text in (
            (axes.xaxis, lambda x, _: f"{x:g} B" if x < 1000 else f"{x / 1000:g} kB"),
            (axes.yaxis, "{x:g}"),
        ):
            axis.set_major_formatter(text)
            axis.set_minor_formatter(NullFormatter())
        axes.set_yticks(
            [t for t in (0.2, 0.5, 1, 2, 5, 10, 20, 50, 100) if axes.get_ylim()[0] <= t <= axes.get_ylim()[1]]
        )
        axes.grid(alpha=0.3, which="both", lw=0.4)
        if place % 3 == 0:
            axes.set_ylabel("false positives, % of points")
        if place >= 3:
            axes.set_xlabel("memory")
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=6, fontsize=9, frameon=False)
    figure.savefig(file, dpi=110)


def main() -> int:
    """Measure what is missing, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/meshes"))
    parser.add_argument("--meshes", default=",".join(MESHES), help="some of them, by name")
    parser.add_argument("--methods", default=",".join(METHODS), help="some of them, by label")
    parser.add_argument("--budget", type=float, default=60.0, help="seconds for each learned fit")
    parser.add_argument("--attacked", type=int, default=1_000_000, help="hard points that each bounder is asked")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--page", action="store_true", help="only make the page of the rows that are there")
    options = parser.parse_args()
    kept = StoredRows(options.out, "meshes")
    for name in () if options.page else options.meshes.split(","):
        mesh = mesh_of(name)
        for label in options.methods.split(","):
            if kept.have(mesh=name, label=label):
                continue
            row = {
                "mesh": name,
                "shape": repr(mesh).strip("<>"),
                "aligned_area": round(aligned_area(mesh), 2),
            } | measure(mesh, label, options.budget, options.seed, options.attacked)
            kept.add(row)
            print(
                {key: row[key] for key in ("mesh", "label", "bytes", "fp_rate", "fn", "missed", "certificate")},
                flush=True,
            )
    if len(kept):
        kept.write(page(kept.rows, options.out, "python benchmarks/meshes.py --out results/meshes"))
    return int(any(row["missed"] is not None or row["fn"] for row in kept.rows))


if __name__ == "__main__":
    sys.exit(main())
