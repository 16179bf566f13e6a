"""What `choose` predicts, and what was measured: `python benchmarks/predicted.py --out results/predicted`.

Balls around a torus knot, mostly far from it, against ``wp.mesh_query_point``, which ends early where nothing is near.
`choose` is given that test itself, and queries of one half of a simulation; the other half is then run in the two ways
in which a bounder is used: a batch that lists what is left, and the exact test of these; and one kernel that asks the
bounder's function before the exact test. Ways take turns, the median of the rounds counts; what one price for all
queries would have predicted stands there, too. Warp runs a kernel on one core of a CPU, batches run on all cores.
"""

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import warp as wp
from shared import StoredRows, race

import warp_bounding as wb

RADIUS, TUBE, ROUND, ALONG = 0.05, 0.3, 24, 400  # of a ball and of the knot's tube, its sides and rings
REACH = RADIUS + TUBE  # within which the exact test looks: no point of the tube is farther from its surface
QUERIES, BEYOND = 200_000, 0.5  # in a box larger than the knot's on each side by so much of it
FITS: dict[str, dict] = {
    "aabb": {"method": "aabb"},
    "obb": {"method": "obb"},
    "kdop": {"method": "kdop"},
    "bvh 64": {"method": "bvh", "leaves": 64},
    "bvh 256": {"method": "bvh", "leaves": 256},
    "voxels 128": {"method": "voxels", "resolution": 128},
    "mlp 24-24": {"method": "mlp", "hidden": (24, 24)},
}
NONE, WAYS = "none", ("batch", "function")


def torus_knot() -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a (2, 3) torus knot with a round tube, closed."""
    t = np.linspace(0, 2 * np.pi, ALONG, endpoint=False)

    def curve(t: np.ndarray) -> np.ndarray:
        r = 2 + np.cos(3 * t)
        return np.stack([r * np.cos(2 * t), r * np.sin(2 * t), -np.sin(3 * t)], axis=1)

    center, ahead = curve(t), curve(t + 1e-4) - curve(t - 1e-4)
    side = np.cross(ahead, [0.0, 0.0, 1.0])
    up = np.cross(side, ahead)
    side, up = (each / np.linalg.norm(each, axis=1)[:, None] for each in (side, up))
    angle = np.linspace(0, 2 * np.pi, ROUND, endpoint=False)[:, None]
    vertices = center[:, None] + TUBE * (np.cos(angle) * side[:, None] + np.sin(angle) * up[:, None])
    i, j = np.meshgrid(np.arange(ALONG), np.arange(ROUND), indexing="ij")
    a, b, c, d = ((((i + k) % ALONG) * ROUND + (j + m) % ROUND).ravel() for k, m in ((0, 0), (1, 0), (1, 1), (0, 1)))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return vertices.reshape(-1, 3).astype(np.float32), faces


@wp.func
def touches(mesh: wp.uint64, x: wp.vec3, reach: float, radius: float) -> bool:
    """Whether a ball meets the mesh: the exact test."""
    query = wp.mesh_query_point(mesh, x, reach)
    found = bool(False)  # noqa: UP018  a variable of the kernel
    if query.result:
        nearest = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
        found = query.sign * wp.length(nearest - x) <= radius
    return found


@wp.kernel(enable_backward=False)
def exact(mesh: wp.uint64, x: wp.array(dtype=wp.vec3), reach: float, radius: float, out: wp.array(dtype=wp.bool)):
    """The exact test of all queries."""
    i = wp.tid()
    out[i] = touches(mesh, x[i], reach, radius)


@wp.kernel(enable_backward=False)
def exact_of_listed(
    mesh: wp.uint64,
    x: wp.array(dtype=wp.vec3),
    listed: wp.array(dtype=wp.int32),
    reach: float,
    radius: float,
    out: wp.array(dtype=wp.bool),
):
    """The exact test of what a batch leaves."""
    i = listed[wp.tid()]
    out[i] = touches(mesh, x[i], reach, radius)


@wp.kernel(enable_backward=False)
def loop(x: wp.array(dtype=wp.vec3), out: wp.array(dtype=wp.bool)):
    """What Warp's loop over the queries takes by itself."""
    i = wp.tid()
    out[i] = x[i][0] > 1e30


def in_function(bounder: wb.Bounder) -> wp.Kernel:
    """A kernel that asks a bounder before the exact test."""

    @wp.kernel(enable_backward=False, module="unique")
    def ask(
        data: wb.Data,
        mesh: wp.uint64,
        x: wp.array(dtype=wp.vec3),
        reach: float,
        radius: float,
        out: wp.array(dtype=wp.bool),
    ):
        i = wp.tid()
        out[i] = False
        if wp.static(bounder.func)(data, x[i]):
            out[i] = touches(mesh, x[i], reach, radius)

    return ask


def ways_of(bounders: dict[str, wb.Bounder], mesh: wp.Mesh, points: np.ndarray) -> dict[tuple[str, str], Callable]:
    """Each way to answer all queries, checked against the exact test; and Warp's loop alone."""
    x = wp.array(points, dtype=wp.vec3, device="cpu")
    expected = wp.zeros(len(x), dtype=wp.bool, device="cpu")
    numbers = [REACH, RADIUS]
    plain = wp.launch(exact, len(x), [mesh.id, x, *numbers, expected], device="cpu", record_cmd=True)
    plain.launch()
    ways = {(NONE, "exact"): plain.launch}
    ways[NONE, "loop"] = wp.launch(loop, len(x), [x, wp.zeros_like(expected)], device="cpu", record_cmd=True).launch
    for label, bounder in bounders.items():
        batch, out = bounder.prepare(x, candidates=True), wp.zeros_like(expected)

        def listed(batch=batch, out=out):
            indices, count = batch.launch()
            out.zero_()
            wp.launch(exact_of_listed, int(count.numpy()[0]), [mesh.id, x, indices, *numbers, out], device="cpu")

        inputs, own = [bounder.data, mesh.id, x, *numbers], wp.zeros_like(expected)
        inside = wp.launch(in_function(bounder), len(x), [*inputs, own], device="cpu", record_cmd=True)
        ways |= {(label, "batch"): listed, (label, "function"): inside.launch}
        listed(), inside.launch()
        for answers in (out, own):
            assert (answers.numpy() == expected.numpy()).all(), f"{label} changes the answers"
    return ways


def page(kept: StoredRows, command: str) -> str:
    """The page, in Markdown."""
    about, *rows = kept.rows
    lines = ["# What `choose` predicts, and what was measured", "", f"`{command}`", "", f"{kept.about}."]
    lines += ["", " ".join(__doc__.strip().splitlines()[2:]), ""]
    lines += [
        f"{about['queries']:,} balls, {100 * about['positives']:.1f} % meet the knot. Without a bounder a query "
        f"takes {about['ns']:.0f} ns; Warp's loop over the queries is {about['loop_ns']:.1f} ns of that, and of "
        "each function. *ns*: of the bounder. Then how many times as fast as without: by one price for all queries, "
        "by `choose` with the test, and measured.",
        "",
        f"| | bytes | left, % |{''.join(f' {way}: ns | one price | `choose` | measured |' for way in WAYS)}",
        f"|---|{'---:|' * 10}",
    ]
    for row in rows:
        cells = [f"`{row['label']}`", f"{row['bytes']:,}", f"{100 * row['share']:.1f}"]
        for way in WAYS:
            own = row[way]
            cells += [f"{own['ns']:.1f}", *(f"{own[name]:.2f}" for name in ("one_price", "predicted", "measured"))]
        lines.append(f"| {' | '.join(cells)} |")
    chosen = ", ".join(f"`{about['chosen'][way]}` ({way})" for way in WAYS)
    largest = 100 * max(max(errors(row)) for row in rows)
    lines += ["", f"Chosen: {chosen}. The largest difference of `choose` and what was measured: {largest:.0f} %."]
    if about["load"] > 1.5 * about["threads"]:
        lines += ["", f"Others used the machine (a load of {about['load']:.0f}): compare ratios, no times."]
    return "\n".join(lines) + "\n"


def errors(row: dict) -> list[float]:
    """How much predictions of a bounder differ from what was measured, as shares of that, one a way."""
    return [abs(row[way]["predicted"] / row[way]["measured"] - 1) for way in WAYS]


def main() -> int:
    """Measure, and write the page; exit status 1 if a prediction of what is chosen is wrong by more than a quarter."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/predicted"))
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--budget", type=float, default=40.0, help="seconds of a network's fit")
    options = parser.parse_args()
    wp.config.quiet = True
    kept = StoredRows(options.out, "predicted")
    if len(kept):
        parser.error(f"{options.out} has rows; measure into another folder, or remove them")
    vertices, faces = torus_knot()
    shape = wb.load_shape((vertices, faces))
    mesh = wp.Mesh(
        wp.array(vertices, dtype=wp.vec3, device="cpu"), wp.array(faces.ravel(), dtype=wp.int32, device="cpu")
    )
    size, rng = shape.upper - shape.lower, np.random.default_rng(0)
    box = shape.lower - BEYOND * size, shape.upper + BEYOND * size
    given, fresh = rng.uniform(*box, (2, QUERIES, 3)).astype(np.float32)
    bounders = {}
    for label, fit in FITS.items():
        network = {"budget": options.budget, "progress": False} if "hidden" in fit else {}
        bounders[label] = wb.fit(shape, margin=RADIUS, device="cpu", **fit, **network)

    def test(x: wp.array) -> wp.array:
        out = wp.empty(len(x), dtype=wp.bool, device="cpu")
        wp.launch(exact, len(x), [mesh.id, x, REACH, RADIUS, out], device="cpu")
        return out

    same = {
        "margin": RADIUS,
        "workload": given,
        "methods": (),
        "bounders": bounders,
        "device": "cpu",
        "progress": False,
    }
    choices = {how: wb.choose(shape, narrow_ns=test, how=how, **same) for how in WAYS}
    times = {way: 1e9 * of[:, 0] / QUERIES for way, of in race(ways_of(bounders, mesh, fresh), options.rounds).items()}
    without = times[NONE, "exact"]
    about = {"queries": QUERIES, "positives": choices[WAYS[0]].positives, "ns": float(np.median(without))}
    about |= {"loop_ns": float(np.median(times[NONE, "loop"])), "load": os.getloadavg()[0]}
    kept.add(about | {"chosen": {way: choice.label for way, choice in choices.items()}})
    for label, bounder in bounders.items():
        found = {"label": label, "bytes": bounder.nbytes}
        for way, choice in choices.items():
            row, mean = next(row for row in choice.rows if row.label == label), choice.narrow_ns
            found["share"] = row.share
            own = {"ns": row.nanoseconds, "predicted": mean / row.cost}
            own["one_price"] = mean / (row.nanoseconds + row.share * mean)
            found[way] = own | {"measured": float(np.median(without / times[label, way]))}
        kept.add(found)
    for choice in choices.values():
        print(choice, end="\n\n")
    text = page(kept, f"python benchmarks/predicted.py --out {options.out}")
    kept.write(text)
    print(text)
    chosen = {choice.label for choice in choices.values()}
    return int(any(max(errors(row)) > 0.25 for row in kept.rows[1:] if row["label"] in chosen))


if __name__ == "__main__":
    sys.exit(main())
