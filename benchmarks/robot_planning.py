"""A UR5, a Panda and an xArm7 plan with OMPL: `python benchmarks/robot_planning.py --out results/robot-planning`.

RRT-Connect, and roadmaps of a fixed number of states (PRM), among a table, a shelf and a post; four joints of each
robot, the others held. States and edges are checked exactly by Coal on meshes. With a bounder in front of that, a state
that it denies is not checked, nor the part of an edge of which it proves that no point of it collides: a proven
network, a hierarchy of boxes in the same memory, or, of states alone and without a fit, the library's own check of
convex hulls, also behind the network. All ways take the same decisions, so with the same seed they find the same path,
or roadmap, unless an edge that is proven free collides. Every run is a forked process, as OMPL's seeds are.
The planner calls Python for every state and edge, which is part of all times.

What the usual check of an edge at states along it misses: of the edges it accepts, how many collide at states a hundred
times as dense.
"""

import argparse
import hashlib
import sys
import time
from functools import cache
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import warp as wp
from robots import store, stored

import warp_bounding as wb
from sims.arm.meshes import MeshModel
from sims.arm.robots import Cell, panda, ur5, xarm7
from sims.versions import versions
from warp_bounding.runtime.launch import cpu_threads

CELLS = {"UR5": ur5, "Panda": panda, "xArm7": xarm7}
HIDDEN, SIDE = (8, 48, 48), 32  # cells a side, of which boxes are made
RANGE, STEP, FINER, SECONDS = 0.6, 0.05, 100, 60.0  # radians: an edge, and the usual check along it; of a problem
PROBLEMS, ROADMAPS, STATES = 20, 3, 2000  # of a roadmap: states that are drawn
MANY = 64  # configurations that a bounder is asked about at once
EDGES, ROUNDS = 32_768, 5  # of a batch, and how often it is asked
WAYS = {
    "exact": "exact checks alone",
    "hulls": "our check of convex hulls first",
    "boxes": "hierarchy of boxes first",
    "network": "proven network first",
    "both": "proven network, then hulls",
}
BOUNDED = {"boxes": "boxes", "network": "network", "both": "network"}  # whose bounder they ask
FIELDS = (
    "robot", "planner", "way", "problem", "seconds", "states", "edges", "checks", "denied", "cleared", "accepted",
    "missed", "found", "versions",
)  # fmt: skip


@cache
def shape(robot: str) -> wb.arms.ArmConfigurations:
    """Configurations in which a robot touches its cell or itself; coordinates are joint values."""
    cell: Cell = CELLS[robot]()
    return wb.arms.ArmConfigurations(cell.arm, cell.obstacles, self_collision=True, name=f"{robot} in a cell")


@cache
def problems(robot: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Starts and goals, free."""
    held = shape(robot)
    x = np.random.default_rng(3).uniform(held.arm.lower, held.arm.upper, (40 * PROBLEMS, held.ndim))
    free = x[~held.contains(x)]
    return list(zip(free[::2], free[1::2], strict=False))[:PROBLEMS]


@cache
def meshes(robot: str) -> MeshModel:
    """What checks exactly."""
    return MeshModel(shape(robot))


@cache
def bounder(robot: str, way: str, kept: Path, effort: float) -> wb.Bounder:
    """The bounder, kept or fitted; of exact checks alone that of boxes, which is not asked."""
    kind = BOUNDED.get(way, "boxes")
    file = kept / f"{robot}-{kind}.safetensors"
    if not file.exists():
        kept.mkdir(parents=True, exist_ok=True)
        if kind == "network":
            loose = wb.fit(shape(robot), hidden=HIDDEN, budget=effort / 3, statistical=True, device="cpu")
            wb.proof.make_proven(loose, shape(robot), budget=2 * effort / 3).save(file)
        else:
            wb.fit(shape(robot), method="bvh", hidden=HIDDEN, resolution=SIDE, device="cpu").save(file)
    return wb.load(file, device="cpu")


def batch(robot: str, found: wb.Bounder) -> str:
    """What an edge of a batch takes, on all cores."""
    held, rng, times = shape(robot), np.random.default_rng(4), []
    x = rng.uniform(held.lower, held.upper, (4 * EDGES, held.ndim))
    a = x[~held.contains(x)][:EDGES]
    way = rng.normal(size=a.shape)
    b = np.clip(a + RANGE * way / np.linalg.norm(way, axis=1, keepdims=True), held.lower, held.upper)
    ask = wb.proof.Segments(found, depth=3)
    for _ in range(ROUNDS):
        start = time.perf_counter()
        cleared, _ = ask(a, b)
        times.append(time.perf_counter() - start)
    return f"{robot} {1e6 * min(times) / EDGES:.1f} µs an edge, {100 * cleared.mean():.0f} % cleared"


def plan(run: tuple[str, str, str, int, Path, float]) -> dict:
    """One run: a row."""
    from ompl import base, geometric, util

    robot, planner, way, number, kept, effort = run
    util.RNG.setSeed(1000 + number)
    util.setLogLevel(util.LOG_ERROR)
    model, asked, n, bounded = meshes(robot), bounder(robot, way, kept, effort), shape(robot).ndim, way in BOUNDED
    count, accepted = dict.fromkeys(("states", "edges", "checks", "denied", "cleared"), 0), []

    some, found = wp.zeros((MANY, n), dtype=float, device="cpu"), wp.zeros(MANY, dtype=wp.bool, device="cpu")
    rows, maybe, query = some.numpy(), found.numpy(), asked.prepare(some, out=found).launch
    edge = wb.proof.Segments(asked, depth=3)  # lanes of a network share an edge, so that more clears hardly more

    def hulls(q: np.ndarray) -> np.ndarray:
        return q[shape(robot).contains(q.astype(np.float64))]

    def asked_of(q: np.ndarray) -> np.ndarray:
        """Those of configurations that the bounder, or the check of hulls, does not deny."""
        if not bounded:
            return hulls(q)
        left = []
        for at in range(0, len(q), MANY):
            count = len(q[at : at + MANY])
            rows[:count] = q[at : at + MANY]
            query()
            left.append(q[at : at + MANY][maybe[:count]])
        left = np.concatenate(left)
        return hulls(left) if way == "both" and len(left) else left

    def numbers(state) -> np.ndarray:
        return np.array([[state[i] for i in range(n)]], dtype=np.float32).astype(np.float64)

    def free(q: np.ndarray) -> bool:
        """Whether all of these are; the first that is not ends the checks."""
        q = q.astype(np.float32)  # whichever way, as bounders take them
        if way != "exact" and len(q):
            left = asked_of(q)
            count["denied"] += len(q) - len(left)
            q = left
        for row in q.astype(np.float64):
            count["checks"] += 1
            if model.hits(row[None])[0]:
                return False
        return True

    class Valid(base.StateValidityChecker):
        def isValid(self, state):  # noqa: N802
            count["states"] += 1
            return free(numbers(state))

    class Motion(base.MotionValidator):
        def checkMotion(self, a, b):  # noqa: N802
            count["edges"] += 1
            a, b = numbers(a), numbers(b)
            clear = edge(a, b)[1][0] if bounded else 0.0
            count["cleared"] += int(clear >= 1)
            along = np.linspace(0, 1, int(np.ceil(np.linalg.norm(b - a) / STEP)) + 1)[1:]
            good = free(a + along[along > clear, None] * (b - a))
            accepted.extend([(a[0], b[0])] * good)
            return good

    space, bounds = base.RealVectorStateSpace(n), base.RealVectorBounds(n)
    for i, (low, high) in enumerate(zip(shape(robot).arm.lower, shape(robot).arm.upper, strict=True)):
        bounds.setLow(i, low)
        bounds.setHigh(i, high)
    space.setBounds(bounds)
    info = base.SpaceInformation(space)
    valid, motion = Valid(info), Motion(info)
    info.setStateValidityChecker(valid)
    info.setMotionValidator(motion)
    info.setup()
    model.hits(np.zeros((1, n))), free(np.zeros((1, n)))
    edge(*np.zeros((2, 1, n)))
    count.update(dict.fromkeys(count, 0))
    if planner == "PRM":
        searcher, done = geometric.PRM(info), base.PlannerTerminationCondition(lambda: count["states"] >= STATES)
        searcher.setProblemDefinition(base.ProblemDefinition(info))
        searcher.setup()
        start = time.perf_counter()
        searcher.growRoadmapPtc(done)
        seconds = time.perf_counter() - start
        result = f"{searcher.milestoneCount()} states, {searcher.edgeCount()} edges, {accepted}"
    else:
        task, ends = base.ProblemDefinition(info), []
        for q in problems(robot)[number]:
            ends.append(space.allocState())
            for i in range(n):
                ends[-1][i] = float(q[i])
        task.setStartAndGoalStates(*ends, 1e-3)
        searcher = geometric.RRTConnect(info)
        searcher.setRange(RANGE)
        searcher.setProblemDefinition(task)
        searcher.setup()
        start = time.perf_counter()
        solved = bool(searcher.solve(SECONDS))
        seconds = time.perf_counter() - start
        result = str([numbers(state)[0].tolist() for state in task.getSolutionPath().getStates()] if solved else [])
    missed = 0
    for a, b in accepted if way == "exact" else ():  # the same edges, if the result is the same
        t = np.linspace(0, 1, FINER * int(np.ceil(np.linalg.norm(b - a) / STEP)) + 1)[:, None]
        near = a + t * (b - a)
        near = near[shape(robot).contains(near)]  # hulls hold the meshes
        missed += bool(model.hits(near).any()) if len(near) else 0
    own = {"robot": robot, "planner": planner, "way": way, "problem": number, "seconds": seconds, "missed": missed}
    own |= {"found": hashlib.sha256(result.encode()).hexdigest()[:16], "versions": versions()}
    return own | {"accepted": len(accepted)} | count


def page(rows: list[dict], sizes: dict[str, str], edges: list[str], command: str) -> str:
    """The page, in Markdown: its conclusion first."""
    whole, lines = {}, []
    for robot, planner in dict.fromkeys((row["robot"], row["planner"]) for row in rows):
        of = {way: [r for r in rows if (r["robot"], r["planner"], r["way"]) == (robot, planner, way)] for way in WAYS}
        same = sum(len({own[k]["found"] for own in of.values()}) == 1 for k in range(len(of["exact"])))
        for way, own in of.items():
            whole[robot, planner, way] = {f: sum(float(row[f]) for row in own) for f in FIELDS[4:12]}
        first = whole[robot, planner, "exact"]
        for way in WAYS:
            own = whole[robot, planner, way]
            numbers = " | ".join(f"{own[field]:,.0f}" for field in FIELDS[5:10])
            lines.append(
                f"| {robot} | {planner} | {WAYS[way]} | {own['seconds']:.2f} | "
                f"{100 * own['seconds'] / first['seconds']:.0f} % | {numbers} | {same} of {len(of['exact'])} |"
            )

    def share(field: str, planner: str) -> str:
        """Per cent of what exact checks alone take, with a network."""
        shares = [100 * whole[r, planner, "network"][field] / whole[r, planner, "exact"][field] for r in CELLS]
        return f"{min(shares):.0f} to {max(shares):.0f} %"

    once = [own for (_, _, way), own in whole.items() if way == "exact"]
    accepted, missed = (sum(own[field] for own in once) for field in ("accepted", "missed"))
    return "\n".join(
        [
            "# Robots plan with OMPL",
            "",
            f"**Behind a proven network roadmaps take {share('seconds', 'PRM')} of the time and "
            f"{share('checks', 'PRM')} of the exact checks, short searches by RRT-Connect "
            f"{share('seconds', 'RRT-Connect')} and {share('checks', 'RRT-Connect')}.** OMPL asks Python about one "
            "state and one edge at a time; planners that ask about many edges at once [gain more](../demos/README.md). "
            f"Of {accepted:,.0f} edges that the usual check accepts {missed:,.0f} collide between its states.",
            "",
            f"`{command}`",
            "",
            f"{rows[0]['versions']}. One core; four joints of each robot; exact checks by Coal. {PROBLEMS} problems of "
            f"RRT-Connect, {ROADMAPS} roadmaps of {STATES:,} states. Bounders: "
            + "; ".join(f"{name}, {size}" for name, size in sizes.items())
            + ".",
            "",
            "| robot | planner | checks | seconds | of exact | states | edges | exact checks | states denied | "
            "edges cleared whole | same result |",
            "|---|---|---|--:|--:|--:|--:|--:|--:|--:|--:|",
            *lines,
            "",
            f"A batch of {EDGES:,} edges of {RANGE} radians from free states, on {cpu_threads()} cores, each with the "
            "share of the way that is proven to be clear: " + "; ".join(edges) + ".",
            "",
            "Results with the check of hulls may differ: Coal counts meshes that are less than about 1e-6 m apart as "
            "colliding.",
            "",
            "[VAMP](https://github.com/KavrakiLab/vamp) checks a robot's balls in vector instructions, without a proof "
            "between states; [Drake](https://drake.mit.edu) certifies regions of configurations by optimization. "
            "Neither was measured.",
            "",
        ]
    )


def main() -> int:
    """Run what is missing, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/robot-planning"))
    parser.add_argument("--kept", type=Path, default=Path("out/robots"), help="where fitted bounders lie")
    parser.add_argument("--effort", type=float, default=400.0, help="seconds of a network's fit and proof")
    options = parser.parse_args()
    if find_spec("ompl") is None:
        sys.exit("planning needs OMPL: pip install 'warp-bounding[robots]'")
    sizes, edges = {}, []
    for robot in CELLS:  # what processes share is made, and kernels are loaded
        ends = np.array(problems(robot)[0], dtype=np.float32)
        meshes(robot).hits(ends.astype(np.float64)), shape(robot).contains(ends)
        for way in dict.fromkeys(BOUNDED.values()):
            found = bounder(robot, way, options.kept, options.effort)
            found.query(ends)
            wb.proof.Segments(found)(ends[:1], ends[1:])
            rate = wb.evaluate(found, shape(robot), samples=200_000).fp_rate
            if way == "network":
                edges.append(batch(robot, found))
            sizes[f"{robot}, {way}"] = f"{found.nbytes:,} bytes, {rate:.1f} % false positives"
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "planning.csv"
    rows = stored(file)
    known = {(row["robot"], row["planner"], row["way"], int(row["problem"])) for row in rows}
    runs = [(r, p, w, k) for r in CELLS for p, n in (("RRT-Connect", PROBLEMS), ("PRM", ROADMAPS)) for k in range(n)
            for w in WAYS]  # fmt: skip
    runs = [(*run, options.kept, options.effort) for run in runs if run not in known]
    with get_context("fork").Pool(1, maxtasksperchild=1) as pool:
        for row in pool.imap(plan, runs, chunksize=1):
            rows.append(row)
            store(file, FIELDS, rows)
    text = page(stored(file), sizes, edges, "python benchmarks/robot_planning.py --out results/robot-planning")
    (options.out / "README.md").write_text(text)
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
