"""Distances of a mesh: bytes, false positives of points and segments, evaluations and time.

Points at several radii; evaluations a segment; ns a point and a segment, in lanes and one by one.

Run from the repository: ``python benchmarks/distances.py --out results/distances``. The mesh is the bunny that comes
with Warp; lengths are shares of half its longest side. All times are medians of runs that take turns. Truth is the mesh
itself. The last rows are Warp's own exact queries of the mesh, in a kernel on one core as the last column.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
import warp as wp
from shared import StoredRows, evaluations, race

import warp_bounding as wb
from sims.assets import asset_mesh, surface
from sims.threads import threads_of
from warp_bounding.shapes.shape import IN, OUT

POINTS, SEGMENTS, ROUNDS, STEPS = 200_000, 100_000, 7, 32
RADII = (0.0, 0.02, 0.05, 0.1, 0.2)
WORDS = {"resolution": "cells"}  # of options, for people
METHODS = (
    ("aabb", {}),
    ("kdop", {}),
    ("learned-kdop", {"budget": 10}),
    ("bvh", {"leaves": 64, "resolution": 192}),
    ("bvh", {"leaves": 300, "resolution": 192}),
    ("distance-grid", {"nodes": 16, "storage": "uint8"}),
    ("distance-grid", {"nodes": 24, "storage": "uint8"}),
    ("distance-grid", {"nodes": 32}),
    ("distance-grid", {"nodes": 40, "storage": "uint8"}),
    ("mlp", {"hidden": (24, 24), "budget": 120}),
    ("mlp", {"hidden": (32, 32), "budget": 120}),
)


def asking(bounder: wb.DistanceBounder) -> wp.Kernel:
    """A kernel of a user's own, that asks one point a thread."""
    distance = bounder.distance_func

    @wp.kernel(module="unique", enable_backward=False)
    def ask(first: int, data: wb.Data, x: wp.array(dtype=wp.vec3), g: wp.array(dtype=float)):
        i = first + wp.tid()
        g[i] = distance(data, x[i])

    return ask


@wp.kernel(enable_backward=False)
def closest(first: int, mesh: wp.uint64, x: wp.array(dtype=wp.vec3), d: wp.array(dtype=float)):
    i = first + wp.tid()
    query = wp.mesh_query_point_no_sign(mesh, x[i], 1.0e6)
    d[i] = wp.length(x[i] - wp.mesh_eval_position(mesh, query.face, query.u, query.v))


@wp.kernel(enable_backward=False)
def closest_signed(first: int, mesh: wp.uint64, x: wp.array(dtype=wp.vec3), d: wp.array(dtype=float)):
    i = first + wp.tid()
    query = wp.mesh_query_point_sign_parity(mesh, x[i], 1.0e6)
    d[i] = wp.length(x[i] - wp.mesh_eval_position(mesh, query.face, query.u, query.v)) * query.sign


EXACT = {"wp.mesh_query_point_no_sign": closest, "wp.mesh_query_point_sign_parity": closest_signed}


def on_one_core(kernel: wp.Kernel, inputs: list, out: wp.array) -> float:
    """Median ns an item."""
    taken = []
    with threads_of(1):
        for _ in range(ROUNDS):
            begun = time.perf_counter()
            wb.launch_on_cores(kernel, len(out), inputs, [out], "cpu")
            taken.append(time.perf_counter() - begun)
    return float(np.median(taken)) / len(out) * 1e9


class Asked:
    """The mesh, and what all bounders of its distance are asked."""

    def __init__(self):
        self.shape, rng = asset_mesh("bunny"), np.random.default_rng(0)
        self.size = float(self.shape.extent.max())
        lower, upper = self.shape.lower - 0.1 * self.size, self.shape.upper + 0.1 * self.size
        self.x = rng.uniform(lower, upper, (POINTS, 3)).astype(np.float32)
        self.away = self.shape.distances(self.x)[:, 0]
        self.a = rng.uniform(lower, upper, (SEGMENTS, 3)).astype(np.float32)
        d = rng.normal(size=self.a.shape)
        self.b = (self.a + d / np.linalg.norm(d, axis=1, keepdims=True) * self.size / 2).astype(np.float32)
        self.truth = self.shape.decide_segments(self.a.astype(np.float64), self.b.astype(np.float64))
        self.points = wp.array(self.x, dtype=wp.vec3, device="cpu")
        self.found = wp.empty(POINTS, dtype=float, device="cpu")

    def row(self, label: str, bounder: wb.DistanceBounder) -> dict:
        """What a bounder answers, and what it takes."""
        g, maybe = bounder.distance(self.x).numpy(), bounder.segments(self.a, self.b)[0].numpy()
        assert not (~maybe & (self.truth == IN)).any()
        assert (g <= self.away).all()
        half = self.size / 2
        ways = {
            "ns_point": (lambda: bounder.distance(self.x), POINTS),
            "ns_segment": (lambda: bounder.segments(self.a, self.b), SEGMENTS),
        }
        times = race({name: way for name, (way, _) in ways.items()}, ROUNDS)
        row = {"label": label, "bytes": bounder.nbytes, "certificate": bounder.certificate.kind}
        row["rates"] = [100 * float(((g <= r * half) & (self.away > r * half)).mean()) for r in RADII]
        row["segments"] = 100 * float((maybe & (self.truth == OUT)).mean())
        row["evaluations"] = float(evaluations(bounder, self.a, self.b, STEPS).mean())
        row |= {name: 1e9 * float(np.median(times[name][:, 0])) / count for name, (_, count) in ways.items()}
        row["ns_kernel"] = on_one_core(asking(bounder), [bounder.data, self.points], self.found)
        return row

    def exact(self, label: str, kernel: wp.Kernel) -> dict:
        """Warp's own query of the mesh."""
        mesh = surface(self.shape.vertices, self.shape.faces, "cpu")
        held = 12 * (len(self.shape.vertices) + len(self.shape.faces))
        ns = on_one_core(kernel, [mesh.id, self.points], self.found)
        return {"label": label, "bytes": held, "certificate": "exact", "ns_kernel": ns}


CONCLUSION = (
    "Lower bounds of a distance are a fraction of the exact query's price. A network of few kilobytes leaves "
    "few false positives at any radius; a tree of boxes of that size leaves twice as many or more, and is "
    "slower. Grids are as fast, and need more bytes to be as tight. No bound was above the distance."
)


def page(kept: StoredRows, command: str) -> str:
    """The page, in Markdown."""
    lines = ["# Distances to a mesh that are never too large", "", CONCLUSION, "", f"`{command}`", ""]
    lines += [f"{kept.about}.", ""]
    lines += [
        "The bunny. *FP % at r*: of random points in and around its box, those that may be within r, a share of half "
        "its longest side, and are not. *Segments*: of random ones of that half length, those that",
        f"are marched along in at most {STEPS} steps, not cleared, and meet nothing; *evaluations*: of the distance, a "
        "segment. Nanoseconds on all cores; *kernel*: a point in a kernel of one's own, one core.",
        "The last rows are Warp's own exact queries of the mesh, bytes without their tree. No bound was above the "
        "distance, and no segment that meets the mesh was cleared.",
        "",
        "| | bytes | "
        + " | ".join(f"FP % at {r:g}" for r in RADII)
        + " | segments % | evaluations | ns a point | ns a segment | kernel, ns | certificate |",
        "|---" * (len(RADII) + 8) + "|",
    ]
    for row in kept.rows:
        if "rates" not in row:
            lines.append(
                f"| {row['label']} | {row['bytes']:,} "
                + "| " * (len(RADII) + 4)
                + f"| {row['ns_kernel']:.0f} | {row['certificate']} |"
            )
            continue
        cells = [*(f"{rate:.2f}" for rate in row["rates"]), f"{row['segments']:.2f}", f"{row['evaluations']:.1f}"]
        cells += [f"{row[name]:.1f}" for name in ("ns_point", "ns_segment", "ns_kernel")]
        lines.append(f"| {row['label']} | {row['bytes']:,} | {' | '.join(cells)} | {row['certificate']} |")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Measure what is missing, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/distances"))
    options = parser.parse_args()
    wp.config.quiet = True
    kept, queried = StoredRows(options.out, "distances"), Asked()
    for method, own in METHODS:
        words = [
            "-".join(map(str, value)) if key == "hidden" else f"{value} {WORDS.get(key, key)}"
            for key, value in own.items()
            if key not in ("budget", "storage")
        ]
        label = " ".join([method, ", ".join(words)]).strip()
        if not kept.have(label=label):
            bounder = wb.fit(queried.shape, "distance", method, device="cpu", progress=False, **own)
            kept.add(queried.row(label, bounder))
    for label, kernel in EXACT.items():
        if not kept.have(label=label):
            kept.add(queried.exact(label, kernel))
    kept.write(page(kept, "python benchmarks/distances.py --out results/distances"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
