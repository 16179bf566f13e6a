"""Pairs of placed meshes, and what else culls them: `python benchmarks/pairs.py --out results/pairs` (extra: arms).

Two bunnies, and a bunny and a thin bowl, at random placements around touching, gap 1 % of the size. Of each way: which
share it leaves, against the share that is truly within the gap (by Coal, on the triangles), microseconds a pair on all
cores, and bytes. Then hard placements, which touch by construction, of which none may be denied. One row of a CSV file
each, written as it is known; run again, it goes on where it stopped.
"""

import argparse
import csv
import sys
import time
from pathlib import Path

import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation
from shared import clock

import warp_bounding as wb
from sims.prefitted import FOLDER
from sims.versions import versions
from warp_bounding.pairs import Balls, Pair
from warp_bounding.shapes import Mesh

KEPT = FOLDER / "pairs"
GAP = 0.01  # of the size
FIT = {"hidden": (48, 48), "reach": 0.4}
NODES = (24, 32)
BALLS = (64, 256, 512, 2048)
ROUNDS, BOXED, HARD = 9, 300, 250_000
FIELDS = ("pair", "way", "left", "within", "ratio", "missed", "microseconds", "bytes", "placements", "versions")


def bunny() -> Mesh:
    """Warp's bunny."""
    import warp.examples

    return wb.load_shape(Path(warp.examples.get_asset_directory()) / "bunny.usd")


def bowl(rings: int = 24, sides: int = 64, thickness: float = 0.02) -> Mesh:
    """A thin bowl, closed: a cap of a sphere of radius 0.8, outside and inside."""
    points, faces = [], []
    for radius in (0.8, 0.8 - thickness):
        a, b = np.meshgrid(np.linspace(0, 1.1, rings + 1)[1:], np.arange(sides) * 2 * np.pi / sides, indexing="ij")
        ring = np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), -np.cos(a)], -1).reshape(-1, 3)
        points.append(radius * np.concatenate([[[0, 0, -1]], ring]))
    count = len(points[0])

    def at(side: int, ring: int, k: int) -> int:
        return side * count + (0 if ring == 0 else 1 + (ring - 1) * sides + k % sides)

    for side, turn in ((0, 1), (1, -1)):
        for ring in range(rings):
            for k in range(sides):
                a, b, c, d = at(side, ring, k), at(side, ring + 1, k), at(side, ring + 1, k + 1), at(side, ring, k + 1)
                faces += [[b, a, c][::turn]] + ([[a, d, c][::-turn]] if ring else [])
    for k in range(sides):
        a, b, c, d = at(0, rings, k), at(0, rings, k + 1), at(1, rings, k + 1), at(1, rings, k)
        faces += [[a, c, b], [a, d, c]]
    return Mesh(np.concatenate(points).astype(np.float32), np.array(faces), name="bowl")


def model(mesh: Mesh):
    """The triangles, as Coal takes them."""
    import coal

    made = coal.BVHModelOBBRSS()
    made.beginModel(len(mesh.faces), len(mesh.vertices))
    vertices, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for vertex in mesh.vertices.astype(np.float64):
        vertices.append(vertex)
    for face in mesh.faces:
        faces.append(coal.Triangle(*map(int, face)))
    made.addSubModel(vertices, faces)
    made.endModel()
    return made


def by_coal(a: Mesh, b: Mesh, places: np.ndarray, gap: float) -> tuple[np.ndarray, float, float]:
    """Which pairs are within the gap, ``(N,)``; and seconds a pair of ``collide`` and of ``distance``."""
    import coal

    at_a, at_b, still = model(a), model(b), coal.Transform3s.Identity()
    moved = [coal.Transform3s(Rotation.from_quat(x[3:].astype(float)).as_matrix(), x[:3].astype(float)) for x in places]
    request = coal.CollisionRequest()
    request.security_margin = gap
    start = time.perf_counter()
    within = np.array([coal.collide(at_a, still, at_b, x, request, coal.CollisionResult()) > 0 for x in moved])
    collide = (time.perf_counter() - start) / len(moved)
    some = moved[:BOXED]
    start = time.perf_counter()
    for x in some:
        coal.distance(at_a, still, at_b, x, coal.DistanceRequest(), coal.DistanceResult())
    return within, collide, (time.perf_counter() - start) / len(some)


def apart(centers_a, halves_a, turn, shift, centers_b, halves_b) -> np.ndarray:
    """Which boxes are apart by one of fifteen axes: boxes along A's axes, ``(P, 3)``, and along B's, ``(Q, 3)``.

    ``turn`` and ``shift`` are from B to A. Returns ``(P, Q)``.
    """
    size = np.abs(turn)
    t = centers_b @ turn.T + shift - centers_a[:, None]
    out = (np.abs(t) > halves_a[:, None] + halves_b @ size.T).any(axis=2)
    out |= (np.abs(t @ turn) > halves_a[:, None] @ size + halves_b).any(axis=2)
    for i in range(3):
        for j in range(3):
            axis = np.cross(np.eye(3)[i], turn[:, j])
            if (length := np.linalg.norm(axis)) < 1e-9:
                continue
            axis /= length
            reach = (halves_a @ np.abs(axis))[:, None] + halves_b @ np.abs(turn.T @ axis)
            out |= np.abs(t @ axis) > reach
    return out


def boxes_of(mesh: Mesh, leaves: int) -> tuple[np.ndarray, np.ndarray]:
    """Centres and half widths of so many boxes that hold a mesh: the leaves of a hierarchy."""
    if leaves == 1:
        return (mesh.lower + mesh.upper)[None] / 2, (mesh.upper - mesh.lower)[None] / 2
    bounder = wb.fit(mesh, method="bvh", leaves=leaves, resolution=192, device="cpu")
    own = bounder.tensors["past"] == np.arange(len(bounder.tensors["past"])) + 1
    low, high = (bounder.domain.to_object(bounder.tensors[name][own].astype(np.float64)) for name in ("low", "high"))
    return (low + high) / 2, (high - low) / 2


def left_by_boxes(a, b, places: np.ndarray, gap: float) -> np.ndarray:
    """Which pairs boxes leave; those of A are made larger by the gap."""
    left = []
    for x in places:
        turn = Rotation.from_quat(x[3:].astype(float)).as_matrix()
        left.append(not apart(a[0], a[1] + gap, turn, x[:3].astype(float), *b).all())
    return np.array(left)


def around_touching(a: Mesh, b: Mesh, count: int, rng: np.random.Generator) -> np.ndarray:
    """Random placements of B, at 0.5 to 1.4 sizes from A."""
    size, middle = float((a.upper - a.lower).max()), [(mesh.lower + mesh.upper) / 2 for mesh in (a, b)]
    turns, way = Rotation.random(count, random_state=rng), rng.normal(size=(count, 3))
    way *= rng.uniform(0.5, 1.4, (count, 1)) * size / np.linalg.norm(way, axis=1, keepdims=True)
    places = np.concatenate([way + middle[0] - turns.apply(middle[1]), turns.as_quat()], axis=1).astype(np.float32)
    places[:, 3:] /= np.linalg.norm(places[:, 3:], axis=1, keepdims=True)
    return places


def hard(a: Mesh, b: Mesh, gap: float, count: int, rng: np.random.Generator):
    """Placements and scales of pairs that are within the gap by construction.

    A point of B's surface lies at a point of A's, on it, in it, or at just less than the gap from it.
    """
    xa, xb = (around_touching(a, b, count, rng).astype(np.float64) for _ in range(2))
    scales = []
    for _ in range(2):
        scale = np.exp2(rng.uniform(-2, 2, (count, 1))) * np.ones(3) * (1 - 2.0 * (rng.random((count, 3)) < 0.2))
        scales.append(np.where(rng.random((count, 1)) < 0.5, 1.0, scale).astype(np.float32))
    at = [mesh.points(count, rng) for mesh in (a, b)]
    inner = a.lower + rng.random((4 * count, 3)) * (a.upper - a.lower)
    inner = inner[a.decide(inner) == wb.shapes.shape.IN][: count // 4]
    at[0][: len(inner)] = inner
    corner = rng.random(count) < 0.5
    at[1][corner] = b.corners()[rng.integers(len(b.corners()), size=int(corner.sum()))]
    turns = [Rotation.from_quat(x[:, 3:].astype(np.float32).astype(np.float64)) for x in (xa, xb)]
    away = rng.normal(size=(count, 3))
    away *= rng.choice([0.0, 0.5, 1 - 1e-5], (count, 1)) * gap / np.linalg.norm(away, axis=1, keepdims=True)
    from_a = turns[0].apply(scales[0] * at[0]) + xa[:, :3].astype(np.float32)
    xb[:, :3] = from_a - turns[1].apply(scales[1] * at[1]) + away
    return xa.astype(np.float32), xb.astype(np.float32), *scales


def kept(mesh: Mesh, name: str, effort: float) -> wb.DistanceBounder:
    """The network's distance of a mesh, from its file, or fitted."""
    file = KEPT / f"{name}-distance.safetensors"
    if not file.exists():
        file.parent.mkdir(exist_ok=True)
        wb.fit(mesh, "distance", "mlp", budget=effort, device="cpu", **FIT).save(file)
    return wb.load(file, device="cpu")


def held(mesh: Mesh, name: str, count: int) -> Balls:
    """Balls that hold a mesh, from their file, or made."""
    file = KEPT / f"{name}-{count}-balls.safetensors"
    if not file.exists():
        Balls.of(mesh, count).save(file)
    return Balls.load(file)


PAGE = """# Pairs of placed meshes

A proven distance of one mesh against balls that hold the other leaves {least} % more pairs of bunnies than are truly
within the gap with {most} balls, {few} % with {fewest}, and takes {quick} to {slow} µs a pair; Coal's `collide` takes
{coal} µs. No pair within the gap was missed, in a million hard placements for each row of balls. What that gains in
Newton, [another page](../newton/rigid/README.md) measures.

`python benchmarks/pairs.py --out results/pairs`

{versions}. The [CSV file](pairs.csv) has all rows.

Warp's bunny (12,200 triangles) against itself, and against a thin bowl (6,144 triangles, thickness 1.4 % of its width),
at {placements} random placements ({boxed} for the boxes), gap 1 % of the bunny's size. *Left*: share of the pairs that
is not denied, over the share that is truly within the gap ({within} %, by Coal on the triangles). *µs*: of the
processor. A hierarchy of boxes is asked for its leaves only, all against all, and not timed.

| | bytes | bunny, left | µs a pair | bowl, left | µs a pair |
|---|--:|--:|--:|--:|--:|
{lines}
"""


def page(rows: list[dict]) -> str:
    """The page, in Markdown."""
    known = {(row["pair"].split()[-1], row["way"]): row for row in rows}
    first = [row for row in rows if row["ratio"]]
    ways = sorted(dict.fromkeys(row["way"] for row in first), key=lambda way: (way[0].isupper(), way[0] == "b"))
    lines = []
    for way in ways:
        own = [known[name, way] for name in ("bunny", "bowl")]
        size, *_ = dict.fromkeys(row["bytes"] for row in own)
        numbers = (f"{float(row['ratio']):.2f} | {row['microseconds']}" for row in own)
        lines.append(f"| {way} | {size} | {' | '.join(numbers)} |")
    more = {n: [100 * float(known["bunny", way]["ratio"]) - 100 for way in ways if way.endswith(f" {n} balls")]
            for n in (BALLS[0], BALLS[-1])}  # fmt: skip
    said = {n: f"{min(each):.0f} to {max(each):.0f}" for n, each in more.items()}
    times = [float(row["microseconds"]) for row in first if row["way"].endswith(" balls")]
    told = {"least": said[BALLS[-1]], "most": BALLS[-1], "few": said[BALLS[0]], "fewest": BALLS[0]}
    told |= {"quick": f"{min(times):.1f}", "slow": f"{max(times):.1f}"}
    told |= {"coal": " and ".join(known[name, "Coal, collide"]["microseconds"] for name in ("bunny", "bowl"))}
    told |= {"within": " and ".join(known[name, ways[0]]["within"] for name in ("bunny", "bowl"))}
    told |= {"placements": known["bunny", ways[0]]["placements"], "boxed": 2 * BOXED}
    return PAGE.format(lines="\n".join(lines), versions="; ".join(dict.fromkeys(r["versions"] for r in rows)), **told)


def main() -> None:
    """Measure what is not in the file yet, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/pairs"))
    parser.add_argument("--count", type=int, default=20_000, help="random placements of a pair")
    parser.add_argument("--effort", type=float, default=300.0, help="seconds for a network that has no file")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / "pairs.csv"
    rows = list(csv.DictReader(file.open())) if file.exists() else []

    def write(row: dict) -> None:
        rows.append({name: str(row.get(name, "")) for name in FIELDS} | {"versions": versions()})
        with file.open("w", newline="") as out:
            writer = csv.DictWriter(out, FIELDS)
            writer.writeheader()
            writer.writerows(rows)
        print(*(f"{key} {value}" for key, value in rows[-1].items() if value != "" and key != "versions"), flush=True)

    a = bunny()
    far = kept(a, "bunny", args.effort)
    distances = {"network": far}
    for nodes in NODES:
        made = wb.fit(a, "distance", "distance-grid", nodes=nodes, reach=FIT["reach"], budget=60.0, device="cpu")
        distances[f"grid of {nodes} nodes"] = made
    gap = GAP * float((a.upper - a.lower).max())
    for name, b in (("bunny", a), ("bowl", bowl())):
        title, done = f"bunny and {name}", {row["way"] for row in rows if row["pair"] == f"bunny and {name}"}
        rng = np.random.default_rng(2)
        places = around_touching(a, b, args.count, rng)
        here = np.array([[0, 0, 0, 0, 0, 0, 1]], np.float32)
        queries = [wp.array(x, dtype=wp.transform, device="cpu") for x in (here, places)]
        within, collide, distance = by_coal(a, b, places, gap)

        def row(way: str, left: np.ndarray, seconds: float | None, size: int | str, truth=within, title=title) -> None:
            told = {"pair": title, "way": way, "left": round(100 * left.mean(), 2), "bytes": size}
            told |= {"within": round(100 * truth.mean(), 2), "ratio": round(left.mean() / truth.mean(), 3)}
            told |= {"missed": int((truth & ~left).sum()), "placements": len(truth)}
            write(told | {"microseconds": "" if seconds is None else f"{1e6 * seconds:.3g}"})

        asked = [(f"{kind} and {count} balls", own, count) for kind, own in distances.items() for count in BALLS]
        for way, own, count in asked:
            balls = held(b, name, count)
            pair = Pair(own, balls)
            if way not in done:
                out = wp.empty(len(places), dtype=wp.bool, device="cpu")
                pair.query(*queries, gap, out=out)
                seconds = min(clock(lambda: pair.query(*queries, gap, out=out))[1] for _ in range(ROUNDS))  # noqa: B023
                row(way, out.numpy(), seconds / len(places), own.nbytes + balls.nbytes)
            if (way := f"hard, {way}") not in done:
                missed = 0
                for seed in range(4):
                    xa, xb, *scales = hard(a, b, gap, HARD, np.random.default_rng([seed, count]))
                    maybe = pair.query(xa, xb, gap, scale_a=scales[0], scale_b=scales[1]).numpy()
                    missed += int((~maybe).sum())
                write({"pair": title, "way": way, "missed": missed, "placements": 4 * HARD})
        some = places[: BOXED * 2]
        leaves = (far.nbytes + held(b, name, BALLS[-1]).nbytes) // 2 // (2 * 32)  # nodes of six numbers and two links
        for way, count in (("boxes that turn", 1), ("hierarchies of boxes, same bytes", leaves)):
            if way not in done:
                boxes = [boxes_of(mesh, count) for mesh in (a, b)]
                left = left_by_boxes(*boxes, some, gap)
                row(way, left, None, 48 if count == 1 else 4 * 32 * count, within[: len(some)])
        triangles = 12 * sum(len(mesh.vertices) + len(mesh.faces) for mesh in (a, b))
        for way, seconds in (("Coal, collide", collide), ("Coal, distance", distance)):
            if way not in done:
                row(way, within, seconds, f"over {triangles}")
    (args.out / "README.md").write_text(page(rows), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
