"""An arm by pairs of meshes, for a cell that changes: `python benchmarks/arm_pairs.py`.

Four joints of a UR5, the others held, among a table, a shelf, a post, a bunny and a ring, all of them meshes. Which
configurations may collide, by distances of grids and balls of the meshes, link against obstacle and link against link,
in one kernel that ends at the first pair; by the library's exact check of convex hulls; by a proven network over the
configurations; and exactly by Coal on the same meshes, with Pinocchio's kinematics. Pairs and networks that miss a
collision end the run.
"""

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from by_pairs import ByPairs, cell, linked, together
from shared import StoredRows, race

import warp_bounding as wb
from sims.arm.meshes import MeshModel
from sims.arm.robots import ur5

QUERIES, CHECKED, ROUNDS = 100_000, 10_000, 5  # configurations; those that Coal checks
GRID = {"method": "distance-grid", "reach": 0.4, "storage": "uint8", "device": "cpu"}
LINKS, CELL, BALLS = {"nodes": 24}, {"nodes": 64, "reach": 0.1}, {"links": 128, "obstacles": 1024}
HIDDEN = (8, 48, 48)


def clocked(made: Callable, things: list) -> tuple[list, float]:
    """What is made of each, and the seconds."""
    start = time.perf_counter()
    return [made(thing) for thing in things], time.perf_counter() - start


class Ways:
    """All ways; each is a function of configurations, with the seconds that a new cell takes, and its bytes."""

    def __init__(self, effort: float, kept: Path):
        self.arm = arm = ur5().arm
        self.links, (self.obstacles, hulls) = linked(arm), cell()
        self.shape = wb.arms.ArmConfigurations(arm, hulls, self_collision=True, name="UR5 among meshes")
        meshes = [trimesh.Trimesh(mesh.vertices, mesh.faces, process=False) for mesh in (*self.links, *self.obstacles)]
        self.model, self.effort, self.kept = MeshModel(self.shape, meshes), effort, kept
        self.far = [wb.fit(mesh, "distance", **GRID | LINKS) for mesh in self.links]
        self.balls = [wb.pairs.Balls.of(mesh, BALLS["links"]) for mesh in self.links]
        self.triangles = 12 * sum(len(mesh.faces) + len(mesh.vertices) for mesh in meshes)

    def among(self, pair: Callable[[int, int], tuple], parts: list, seconds: float) -> tuple:
        """By pairs of parts of the cell and links, which come with the links of their two; and of links and links."""
        arm, own = self.arm, len(self.arm.bodies)
        found = []
        for one, other in self.shape.pairs:
            if one < own:
                both = wb.pairs.Pair(self.far[one], self.balls[other])
                found.append((both, arm.bodies[one].link, arm.bodies[other].link))
            elif one - own < len(parts):
                found.append(pair(one - own, other))
        return ByPairs(arm, found), seconds, sum(part.nbytes for part in (*parts, *self.far, *self.balls))

    def by_balls(self) -> tuple:
        held, seconds = clocked(lambda mesh: wb.pairs.Balls.of(mesh, BALLS["obstacles"]), self.obstacles)
        link = [body.link for body in self.arm.bodies]
        return self.among(lambda k, n: (wb.pairs.Pair(self.far[n], held[k]), link[n], -1), held, seconds)

    def by_distances(self, meshes: list[wb.shapes.Mesh] | None = None) -> tuple:
        far, seconds = clocked(lambda mesh: wb.fit(mesh, "distance", **GRID | CELL), meshes or self.obstacles)
        link = [body.link for body in self.arm.bodies]
        return self.among(lambda k, n: (wb.pairs.Pair(far[k], self.balls[n]), -1, link[n]), far, seconds)

    def by_one(self) -> tuple:
        return self.by_distances([together(self.obstacles)])

    def by_hulls(self) -> tuple:
        size = 24 * sum(len(body.points) for body in (*self.arm.bodies, *self.shape.obstacles))
        return lambda q: self.shape.contains(q.astype(np.float64)), 0.0, size

    def by_network(self) -> tuple:
        """Kept, or fitted."""
        file = self.kept / "arm-pairs.safetensors"
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            start = time.perf_counter()
            loose = wb.fit(self.shape, hidden=HIDDEN, budget=self.effort / 3, statistical=True, device="cpu")
            found = wb.proof.make_proven(loose, self.shape, budget=2 * self.effort / 3)
            found.info["training"]["wall_seconds"] = time.perf_counter() - start
            found.save(file)
        network = wb.load(file, device="cpu")
        seconds = network.info["training"]["wall_seconds"]
        return lambda q: network.query(q).numpy(), seconds, network.nbytes

    def by_coal(self) -> tuple:
        return lambda q: self.model.hits(q.astype(np.float64)), 0.0, self.triangles


WAYS = {
    "links' distances, obstacles' balls": Ways.by_balls,
    "obstacles' distances, links' balls": Ways.by_distances,
    "the cell's distance, links' balls": Ways.by_one,
    "exact check of convex hulls": Ways.by_hulls,
    "network over configurations": Ways.by_network,
    "Coal on the meshes": Ways.by_coal,
}
PAIRS, HULLS, NETWORK, COAL = list(WAYS)[:3], *list(WAYS)[3:]


def measure(ways: Ways, q: np.ndarray) -> list[dict]:
    """All rows; ways are timed in turns, on all configurations and on free ones."""
    known = q[:CHECKED]
    held = ways.model.hits(known.astype(np.float64))
    free, rows, timed = known[~held], {}, {}
    for way, made in WAYS.items():
        ask, seconds, nbytes = made(ways)
        maybe = ask(known)
        assert way in (HULLS, COAL) or not (held & ~maybe).any(), f"{way}: a collision is missed"
        left, most = known[maybe & ~held].astype(np.float64), CHECKED if way == COAL else QUERIES
        rows[way] = {"way": way, "missed": int((held & ~maybe).sum()), "prepare_seconds": seconds, "bytes": nbytes}
        rows[way] |= {"left_percent": 100 * len(left) / len(free), "colliding_percent": 100 * float(held.mean())}
        for name, some in (("us", q[:most]), ("us_free", np.resize(free, (most, q.shape[1])))):
            timed[way, name] = (lambda ask=ask, some=some: ask(some)), most
        timed[way, "us_left"] = (lambda left=left: ways.model.hits(left)), len(free)
        print(rows[way], file=sys.stderr)
    took = race({key: function for key, (function, _) in timed.items()}, ROUNDS)
    for (way, name), seconds in took.items():
        rows[way][name] = 1e6 * float(np.median(seconds[:, 0])) / timed[way, name][1]
    for way, row in rows.items():
        row["us_checked"] = row["us_free"] + (0 if way == COAL else row["us_left"])
    return list(rows.values())


def page(kept: StoredRows, command: str) -> str:
    """The page that holds the rows."""
    row = {each["way"]: each for each in kept.rows}
    pairs = min((row[way] for way in PAIRS), key=lambda each: each["us_checked"])
    best = min((row[way] for way in (pairs["way"], HULLS, NETWORK, COAL)), key=lambda each: each["us_checked"])
    quick = min((pairs, row[HULLS]), key=lambda each: each["us_checked"])
    gain = quick["us_checked"] - row[NETWORK]["us_checked"]
    verdict = f"In a cell that changes {'pairs pay' if quick is pairs else 'pairs do not pay, the check of hulls does'}"
    if gain > 0:
        million = row[NETWORK]["prepare_seconds"] / gain
        verdict += f"; a network pays where a cell is asked about more than {million:,.0f} million free configurations"
    lines = [
        "# An arm by pairs of meshes",
        "",
        f"**{verdict}. For a free configuration pairs take {pairs['us_free']:.1f} us and leave "
        f"{pairs['left_percent']:.1f} % to an exact check of meshes, the check of convex hulls "
        f"{row[HULLS]['us_free']:.1f} us and {row[HULLS]['left_percent']:.1f} %, a network "
        f"{row[NETWORK]['us_free']:.2f} us and {row[NETWORK]['left_percent']:.1f} %; Coal's check of the meshes takes "
        f"{row[COAL]['us_free']:.0f} us. Coal's check included, the least is {best['us_checked']:.1f} us, by "
        f'the way "{best["way"]}".**',
        "",
        f"`{command}`",
        "",
        f"{kept.about}. Four joints of a UR5 among a table, a shelf with its back, a post, a bunny and a ring; of "
        f"random configurations {row[COAL]['colliding_percent']:.0f} % collide. *us*: of a configuration, by the wall, "
        "two threads (Coal one), in turns, medians. *Left*: of the free ones. *With Coal*: of a free one, those left "
        "being checked by Coal. *New cell*: seconds to prepare one. An obstacle that only moves needs none, but for "
        "the cell's distance and the network.",
        "",
        "| way | us | us, free | left % | us, with Coal | missed | new cell, s | bytes |",
        "|---|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for way in WAYS:
        own = row[way]
        lines.append(
            f"| {way} | {own['us']:.2f} | {own['us_free']:.2f} | {own['left_percent']:.1f} | {own['us_checked']:.1f} | "
            f"{own['missed']} | {own['prepare_seconds']:.1f} | {own['bytes']:,} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure what is missing, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/arm-pairs"))
    parser.add_argument("--kept", type=Path, default=Path("out/robots"), help="where the fitted network lies")
    parser.add_argument("--effort", type=float, default=240.0, help="seconds of the network's fit and proof")
    options = parser.parse_args()
    kept = StoredRows(options.out, "arm-pairs")
    if not kept.rows:
        ways = Ways(options.effort, options.kept)
        low, high = ways.arm.lower, ways.arm.upper
        for row in measure(ways, np.random.default_rng(7).uniform(low, high, (QUERIES, len(low))).astype(np.float32)):
            kept.add(row)
    kept.write(page(kept, "python benchmarks/arm_pairs.py"))


if __name__ == "__main__":
    main()
