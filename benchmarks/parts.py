"""Fit robots' links and machine parts, and compare with the best classic volume: `python benchmarks/parts.py`.

Thirty collision meshes of robots (package ``example-robot-data``) and ten parts that are made here: closed meshes with
flat faces, edges and holes. Each is dilated by a two-hundredth of its longest side. What ``fit`` returns by default is
compared with the tightest of ``aabb``, ``obb``, ``kdop`` and ``bvh`` that takes no more bytes. False positives are
judged by a million random points against the mesh. A row is written as it is known; the same command goes on.
"""

import argparse
import tempfile
import warnings
from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
import shapely
import trimesh
from shared import StoredRows

import warp_bounding as wb
from sims.arm.robots import robots

LINKS = {  # robot's folder: collision meshes in it
    "ur_description/meshes/ur5/collision": "base shoulder upperarm forearm wrist1 wrist2 wrist3",
    "ur_description/meshes/ur10/collision": "upperarm",
    "panda_description/meshes/collision": "finger hand link0 link1 link5 link7",
    "talos_data/meshes/arm": "arm_1_collision arm_3_collision arm_5_collision",
    "talos_data/meshes/gripper": "base_link_collision",
    "talos_data/meshes/torso": "torso_2_collision",
    "talos_data/meshes/head": "head_2_collision",
    "talos_data/meshes/v2": "hip_y_collision knee_collision",
    "tiago_pro_description/meshes/arm_tiago_pro": "arm_2_link_collision",
    "tiago_pro_description/meshes/head": "head_2_link_collision",
    "tiago_description/meshes/hey5": "palm_collision",
    "centauro_description/meshes/v2/collision": "knee",
    "romeo_description/meshes/V1/collision": "LToePitch",
    "go2_description/collisions": "thigh_convex",
    "z1_description/meshes/collision": "z1_Link02 z1_Link04",
}
MARGIN = 0.005  # of the longest side
SIZES = {"1.5 kB": (16, 16), "2.9 kB": (24, 24), "11 kB": (50, 50)}
SAMPLES = 1_000_000
# Leaves of the trees of boxes: the most that fit a network's bytes, or those of a cascade; a leaf more is never looser.
LEAVES = (37, 55, 76, 94, 300, 317)
HALF_SPACES = (14, 18, 26)  # of a kdop
DISTANCES, DISTANCE_METHODS = 200_000, ("mlp", "distance-grid")  # points, and methods
NODES, MOST_OF_GRIDS = range(28, 7, -1), 2924  # along the longest side, and bytes, those of a network of 24-24


def joined(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    """Their union."""
    return trimesh.boolean.union(list(parts), engine="manifold")


def less(body: trimesh.Trimesh, *holes: trimesh.Trimesh) -> trimesh.Trimesh:
    """A body without some holes."""
    return trimesh.boolean.difference([body, *holes], engine="manifold")


def prism(outline: shapely.Polygon, height: float) -> trimesh.Trimesh:
    """An outline made solid along z."""
    return trimesh.creation.extrude_polygon(outline, height)


def rod(radius: float, height: float, at=(0, 0, 0), axis=(0, 0, 1)) -> trimesh.Trimesh:
    """A cylinder around a place."""
    found = trimesh.creation.cylinder(radius, height, sections=64)
    found.apply_transform(trimesh.geometry.align_vectors((0, 0, 1), axis))
    return found.apply_translation(at)


def block(*size: float, at=(0, 0, 0)) -> trimesh.Trimesh:
    """A box around a place."""
    return trimesh.creation.box(size).apply_translation(at)


def gear() -> trimesh.Trimesh:
    """Twenty teeth and a bore."""
    turn = np.linspace(0, 2 * np.pi, 80, endpoint=False)
    radius = np.tile([0.42, 0.5, 0.5, 0.42], 20)
    outline = shapely.Polygon(np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1))
    return prism(outline.difference(shapely.Point(0, 0).buffer(0.15)), 0.2)


def bracket() -> trimesh.Trimesh:
    """An angle of two plates with a rib, two holes in each."""
    body = joined(block(1, 0.8, 0.1), block(0.1, 0.8, 0.9, at=(-0.45, 0, 0.45)))
    rib = prism(shapely.Polygon([(0, 0), (0.5, 0), (0, 0.5)]), 0.08)
    rib.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    body = joined(body, rib.apply_translation((-0.42, 0.04, 0.03)))
    return less(
        body,
        *[rod(0.07, 1, (0.25, y, 0)) for y in (-0.25, 0.25)],
        *[rod(0.07, 1, (-0.45, y, 0.65), (1, 0, 0)) for y in (-0.25, 0.25)],
    )


def elbow() -> trimesh.Trimesh:
    """A quarter of a pipe."""
    ring = shapely.Point(0.6, 0).buffer(0.2).difference(shapely.Point(0.6, 0).buffer(0.14))
    outer, inner = (np.array(each.coords)[::-1] for each in (ring.exterior, *ring.interiors))
    whole = [trimesh.creation.revolve(each, angle=np.pi / 2, sections=24, cap=True) for each in (outer, inner[::-1])]
    longer = trimesh.creation.revolve(inner[::-1], angle=np.pi / 2 + 0.2, sections=24, cap=True)
    longer.apply_transform(trimesh.transformations.rotation_matrix(-0.1, (0, 0, 1)))
    return less(whole[0], longer)


def bearing() -> trimesh.Trimesh:
    """Two rings and twelve balls."""
    rings = [
        trimesh.creation.annulus(r_min=low, r_max=high, height=0.24, sections=64)
        for low, high in ((0.22, 0.3), (0.42, 0.5))
    ]
    turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    balls = [
        trimesh.creation.icosphere(2, 0.07).apply_translation((0.36 * np.cos(a), 0.36 * np.sin(a), 0)) for a in turn
    ]
    return joined(*rings, *balls)


def nut() -> trimesh.Trimesh:
    """A hexagon with a bore."""
    turn = np.arange(6) * np.pi / 3
    outline = shapely.Polygon(np.stack([np.cos(turn), np.sin(turn)], axis=1) / 2)
    return prism(outline.difference(shapely.Point(0, 0).buffer(0.25)), 0.4)


def beam() -> trimesh.Trimesh:
    """An I-beam."""
    flange, web = shapely.box(-0.25, 0, 0.25, 0.06), shapely.box(-0.03, 0, 0.03, 0.5)
    return prism(flange.union(web).union(shapely.box(-0.25, 0.44, 0.25, 0.5)), 2.0)


def plate() -> trimesh.Trimesh:
    """A plate with fifteen holes."""
    outline = shapely.box(0, 0, 1, 0.6)
    for x in np.linspace(0.1, 0.9, 5):
        for y in (0.1, 0.3, 0.5):
            outline = outline.difference(shapely.Point(x, y).buffer(0.06))
    return prism(outline, 0.06)


def heat_sink() -> trimesh.Trimesh:
    """A base and nine fins."""
    outline = shapely.box(0, 0, 1, 0.1)
    for x in np.linspace(0.02, 0.98, 9):
        outline = outline.union(shapely.box(x - 0.02, 0.05, x + 0.02, 0.5))
    return prism(outline, 0.8)


def spring() -> trimesh.Trimesh:
    """Four coils of a round wire."""
    turn = np.linspace(0, 8 * np.pi, 160)
    path = np.stack([0.3 * np.cos(turn), 0.3 * np.sin(turn), 0.9 * turn / turn[-1]], axis=1)
    return trimesh.creation.sweep_polygon(shapely.Point(0, 0).buffer(0.05, quad_segs=4), path)


def enclosure() -> trimesh.Trimesh:
    """A case with a lid that stands open by a tenth, and a hole for a cable."""
    case = less(block(1, 0.7, 0.4), block(0.94, 0.64, 0.4, at=(0, 0, 0.05)), rod(0.06, 0.4, (0.5, 0, 0), (1, 0, 0)))
    return joined(case, block(1, 0.7, 0.04, at=(0, 0, 0.32)))


MADE: dict[str, Callable[[], trimesh.Trimesh]] = {
    each.__name__: each for each in (gear, bracket, elbow, bearing, nut, beam, plate, heat_sink, spring, enclosure)
}


def link(folder: str, name: str) -> wb.shapes.Mesh:
    """A collision mesh of ``example-robot-data``."""
    stems = {file.stem: file for file in sorted((robots() / folder).iterdir(), reverse=True)}
    return wb.load_shape(stems[name])


def made(name: str) -> wb.shapes.Mesh:
    """A part that is made here."""
    mesh = MADE[name]()
    return wb.shapes.Mesh(np.asarray(mesh.vertices, dtype=np.float32), np.asarray(mesh.faces), name=name)


def parts() -> dict[str, Callable[[], wb.shapes.Mesh]]:
    """Name and mesh of each part."""
    links = {
        f"{folder.split('_')[0] if 'ur_' not in folder else folder.split('/')[2]} {name.removesuffix('_collision')}": (
            lambda folder=folder, name=name: link(folder, name)
        )
        for folder, names in LINKS.items()
        for name in names.split()
    }
    return links | {name: (lambda name=name: made(name)) for name in MADE}


def judged(bounder: wb.Bounder, mesh: wb.shapes.Mesh) -> dict:
    """Bytes, false positives in per cent, and false negatives."""
    rates = wb.evaluate(bounder, mesh, SAMPLES)
    return {"bytes": bounder.nbytes, "fp": round(rates.fp_rate, 4), "fn": rates.fn}


def classics() -> list[dict]:
    """Options of every classic volume."""
    found = [{"method": "aabb"}, {"method": "obb"}, *({"method": "kdop", "k": k} for k in HALF_SPACES)]
    return found + [{"method": "bvh", "leaves": n, "resolution": 192, "budget": 600.0} for n in LEAVES]


def classic(mesh: wb.shapes.Mesh, options: dict) -> dict:
    """A classic volume of a part, with its bytes and false positives."""
    margin = MARGIN * float(mesh.extent.max())
    return judged(wb.fit(mesh, margin=margin, device="cpu", progress=False, **options), mesh)


def fitted(mesh: wb.shapes.Mesh, size: str, budget: float, seed: int, options: dict) -> dict:
    """What ``fit`` returns, its default unless ``options`` say else."""
    margin = MARGIN * float(mesh.extent.max())
    bounder = wb.fit(
        mesh, margin=margin, budget=budget, seed=seed, device="cpu", progress=False, hidden=SIZES[size], **options
    )
    with tempfile.TemporaryDirectory() as folder:
        bounder.save(Path(folder) / "part.safetensors")
        proof = wb.certify(wb.load(Path(folder) / "part.safetensors", device="cpu"), mesh, margin=margin)
    training = bounder.info["training"]
    recipe = "+".join(getattr(part, "activation", part.method) for part in bounder.parts)
    seconds = training["seconds"] - training["compile_seconds"]
    return judged(bounder, mesh) | {"recipe": recipe, "certificate": proof.kind, "seconds": round(seconds, 1)}


def near(mesh: wb.shapes.Mesh) -> np.ndarray:
    """Points in and around the box of a part."""
    room = 0.1 * float(mesh.extent.max())
    return np.random.default_rng(0).uniform(mesh.lower - room, mesh.upper + room, (DISTANCES, 3)).astype(np.float32)


def distance(mesh: wb.shapes.Mesh, method: str, budget: float) -> dict:
    """How far a part's distance is above its bound, of a network or of the largest grid of no more bytes."""
    margin, size, x = MARGIN * float(mesh.extent.max()), "2.9 kB", near(mesh)
    own = {"margin": margin, "device": "cpu", "progress": False, "budget": budget}
    if method == "mlp":
        bounder = wb.fit(mesh, "distance", method, hidden=SIZES[size], **own)
    else:
        grids = (wb.fit(mesh, "distance", method, nodes=n, storage="uint8", **own) for n in NODES)
        bounder = next(grid for grid in grids if grid.nbytes <= MOST_OF_GRIDS)
    truth, bound = mesh.dilated(margin).distances(x)[:, 0], bounder.distance(x).numpy()
    short = 100 * (truth - bound) / float(mesh.extent.max())
    row = {"bytes": bounder.nbytes, "short": round(float(short.mean()), 4), "above": int((bound > truth).sum())}
    row |= {"short_95": round(float(np.quantile(short, 0.95)), 4)}
    return row | {"certificate": wb.certify(bounder, mesh, margin=margin).kind}


def of_distances(rows: list[dict]) -> list[str]:
    """The page's table of them."""
    known = {(row["part"], row["method"]): row for row in rows}
    lines = [
        "",
        "Distances: how far the bound is below the distance, in % of the longest side, mean / 95 % of points in and "
        f"around the box: `python benchmarks/parts.py --distances --budgets {rows[0]['budget']:g}`",
    ]
    lines += ["", "| part | " + " | ".join(DISTANCE_METHODS) + " |", "|---|" + "--:|" * len(DISTANCE_METHODS)]
    for part in dict.fromkeys(row["part"] for row in rows):
        own = [known.get((part, method)) for method in DISTANCE_METHODS]
        cells = [f"{row['short']:.2f} / {row['short_95']:.2f}, {row['bytes']:,} B" if row else "-" for row in own]
        lines.append(f"| {part} | {' | '.join(cells)} |")
    proven, above = sum(row["certificate"] == "proven" for row in rows), sum(row["above"] for row in rows)
    return [*lines, "", f"Proven: {proven} of {len(rows)}; bounds above the distance: {above}."]


def page(rows: list[dict], folder: Path, about: str) -> str:
    """Writes the picture of all rows so far, and returns the page; ``about`` has versions and threads."""
    fits = [row for row in rows if row["kind"] == "fit"]
    known: dict[str, list[dict]] = {}
    for row in rows:
        if row["kind"] == "classic":
            known.setdefault(row["part"], []).append(row)
    for row in fits:
        row["best"] = min((each for each in known[row["part"]] if each["bytes"] <= row["bytes"]), key=lambda e: e["fp"])
        row["share"] = row["fp"] / row["best"]["fp"]
    asked = " ".join(
        f'--{key}s "{",".join(dict.fromkeys(str(row[key]).removesuffix(".0") for row in fits))}"'
        for key in ("size", "budget", "seed")
    )
    lines = [
        "# Parts: robots' links and machine parts",
        "",
        f"`python benchmarks/parts.py {asked} --out results/parts`",
        "",
        f"{about}. Times are those of the wall, so other work on the machine makes fits worse.",
        "",
        f"Margin: {MARGIN:g} of the longest side; {SAMPLES:,} random points. The best classic is the tightest of "
        "`aabb`, `obb`, `kdop` and `bvh` that takes no more bytes. A size is that of the network; the half-spaces in "
        f"front of it add bytes, {max(row['bytes'] for row in fits):,} in all at most.",
        "",
        "| size | budget, s | seeds | parts | at most a quarter of the best classic | at most half | share: median "
        "| worst | proven | false negatives | seconds: most |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for size, budget in product(SIZES, sorted({row["budget"] for row in fits})):
        if own := [row for row in fits if (row["size"], row["budget"]) == (size, budget)]:
            share, seeds = np.array([row["share"] for row in own]), {row["seed"] for row in own}
            proven = sum(row["certificate"] == "proven" for row in own)
            lines.append(
                f"| {size} | {budget:g} | {len(seeds)} | {len({row['part'] for row in own})} "
                f"| {100 * (share <= 0.25).mean():.0f} % | {100 * (share <= 0.5).mean():.0f} % "
                f"| {np.median(share):.2f} | {share.max():.2f} | {proven} of {len(own)} "
                f"| {sum(row['fn'] for row in own)} | {max(row['seconds'] for row in own):.0f} |"
            )
    lines += ["", "![Share of the best classic's false positives, a dot a part](parts.png)", ""]
    lines += [f"False positives in %, mean of the seeds / the best classic. Budget: {max_budget(fits):g} s.", ""]
    lines += [f"| part | {' | '.join(SIZES)} |", "|---|" + "--:|" * len(SIZES)]
    for part in known:
        cells = []
        for size in SIZES:
            own = [r for r in fits if (r["part"], r["size"], r["budget"]) == (part, size, max_budget(fits))]
            best = own[0]["best"] if own else None
            recipes = ", ".join(sorted({r["recipe"] for r in own}))
            ours = f"{np.mean([r['fp'] for r in own]):.2f} {recipes}" if own else ""
            cells.append(f"{ours} / {best['fp']:.2f} {best['method']}" if own else "-")
        lines.append(f"| {part} | {' | '.join(cells)} |")
    if distances := [row for row in rows if row["kind"] == "distance"]:
        lines += of_distances(distances)
    draw(fits, folder / "parts.png")
    return "\n".join(lines) + "\n"


def max_budget(fits: list[dict]) -> float:
    """The largest budget that was measured."""
    return max((row["budget"] for row in fits), default=0.0)


def draw(fits: list[dict], file: Path) -> None:
    """Ours over the best classic, a dot a part; and false positives over bytes."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator

    figure = Figure(figsize=(11, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    sizes = [size for size in SIZES if any(row["size"] == size for row in fits)]
    for place, size in enumerate(sizes):
        own = [row for row in fits if row["size"] == size and row["budget"] == max_budget(fits)]
        share = np.sort([row["share"] for row in own])
        left.plot(place + np.linspace(-0.3, 0.3, len(share)), share, ".", label=size)
        for row in own:
            right.plot(
                [row["bytes"], row["best"]["bytes"]], [row["fp"], row["best"]["fp"]], color="0.9", lw=0.5, zorder=0
            )
        right.plot([row["bytes"] for row in own], [row["fp"] for row in own], ".", color="tab:red", ms=4)
        right.plot([r["best"]["bytes"] for r in own], [r["best"]["fp"] for r in own], ".", color="tab:blue", ms=4)
    left.axhline(0.25, color="0.5", lw=0.8)
    left.set(yscale="log", ylabel="false positives, share of the best classic's", xlabel="size of the network")
    left.set_xticks(range(len(sizes)), sizes)
    left.set_xlim(-0.6, len(sizes) - 0.4)
    right.set(xscale="log", yscale="log", xlabel="bytes", ylabel="false positives, %")
    right.set_title("what fit returns (red), the best classic of no more bytes (blue)", fontsize=9)
    left.yaxis.set_major_locator(LogLocator(subs=(1, 2.5, 5)))
    right.set_xticks([1000, 2000, 5000, 10000])
    for axis in (left.yaxis, right.xaxis, right.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")
    figure.savefig(file, dpi=110)


def main() -> None:
    """Measure what is missing, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("results/parts"))
    parser.add_argument("--parts", default=",".join(parts()), help="some of them, by name")
    parser.add_argument("--sizes", default=",".join(SIZES))
    parser.add_argument("--budgets", default="60,20", help="seconds of a fit")
    parser.add_argument("--seeds", default="0,1,2")
    parser.add_argument("--option", action="append", default=[], help="of fit, as in --option activation=relu")
    parser.add_argument("--classics", action="store_true", help="these alone")
    parser.add_argument("--distances", action="store_true", help="these alone, of 2.9 kB, with the first budget")
    options = parser.parse_args()
    kept, more = StoredRows(options.out, "parts"), dict(each.split("=") for each in options.option)
    for name in options.parts.split(","):
        mesh = parts()[name]()
        for method in DISTANCE_METHODS if options.distances else ():
            budget = float(options.budgets.split(",")[0])
            row = {"kind": "distance", "part": name, "method": method, "budget": budget}
            if not kept.have(**row):
                kept.add(row | distance(mesh, method, budget))
                print(kept.rows[-1], flush=True)
        for own in () if options.distances else classics():
            row = {"kind": "classic", "part": name, **own}
            if not kept.have(**row):
                kept.add(row | classic(mesh, own))
        for size in () if options.classics or options.distances else options.sizes.split(","):
            for budget in map(float, options.budgets.split(",")):
                for seed in map(int, options.seeds.split(",")):
                    row = {"kind": "fit", "part": name, "size": size, "budget": budget, "seed": seed}
                    if not kept.have(**row):
                        with warnings.catch_warnings():
                            warnings.simplefilter("ignore", wb.BoundingWarning)
                            kept.add(row | fitted(mesh, size, budget, seed, more))
                        print({key: kept.rows[-1][key] for key in ("part", "size", "budget", "seed", "fp")}, flush=True)
        if any(row["kind"] == "fit" for row in kept.rows):
            kept.write(page(kept.rows, options.out, kept.about))


if __name__ == "__main__":
    main()
