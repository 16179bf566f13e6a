"""A UR5 that plans with OMPL: `python benchmarks/robot_planning.py --out results/robot-planning`.

RRT-Connect among a table, shelves and a post, four joints of a UR5, its last two held. States and edges are checked
exactly by Coal on meshes; with a proven network in front of that, a state that it denies is not, nor the part of an
edge of which it proves that no point of it collides. Both ways take the same decisions, so with the same seed they find
the same path, unless an edge that is proven free collides. Every run is a forked process, as OMPL's seeds are.

What the usual check of an edge at states along it misses: of the edges it accepts, how many collide at states a hundred
times as dense.
"""

import argparse
import sys
import time
from functools import cache
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from robots import store, stored

import warp_bounding as wb
from paper.results import versions
from sims.arm.meshes import MeshModel
from sims.arm.robots import ur5

FILES, HIDDEN, PARTS = Path("out/robots"), (8, 40, 40), 512
RANGE, STEP, FINER, SECONDS = 0.6, 0.05, 100, 60.0  # radians: an edge, and the usual check along it; of a problem
PROBLEMS, WAYS = 20, ("exact", "bounded")
FIELDS = (
    "way", "problem", "seconds", "states", "edges", "checks", "denied", "cleared", "accepted", "missed", "path",
    "versions",
)  # fmt: skip


@cache
def shape() -> wb.arms.ArmConfigurations:
    """Configurations in which the UR5 touches the cell or itself."""
    return wb.arms.ArmConfigurations(ur5().arm, ur5().obstacles, self_collision=True, name="UR5 in a cell")


def problems() -> list[tuple[np.ndarray, np.ndarray]]:
    """Starts and goals, free."""
    x = np.random.default_rng(3).uniform(shape().lower, shape().upper, (40 * PROBLEMS, shape().ndim))
    free = x[~shape().contains(x)]
    return list(zip(free[::2], free[1::2], strict=False))[:PROBLEMS]


@cache
def meshes() -> MeshModel:
    """What checks exactly."""
    return MeshModel(shape())


@cache
def network(effort: float) -> wb.Bounder:
    """The bounder, kept or fitted."""
    file = FILES / "ur5-cell.safetensors"
    if not file.exists():
        FILES.mkdir(parents=True, exist_ok=True)
        wb.fit(shape(), hidden=HIDDEN, parts=PARTS, budget=effort, device="cpu").save(file)
    return wb.load(file, device="cpu")


def plan(run: tuple[str, int, float]) -> dict:
    """One run: a row."""
    from ompl import base, geometric, util

    way, number, effort = run
    util.RNG.setSeed(1000 + number)
    util.setLogLevel(util.LOG_ERROR)
    model, bounder, n = meshes(), network(effort), shape().ndim
    count, accepted = dict.fromkeys(("states", "edges", "checks", "denied", "cleared"), 0), []

    def numbers(state) -> np.ndarray:
        return np.array([[state[i] for i in range(n)]], dtype=np.float32).astype(np.float64)

    def free(q: np.ndarray) -> bool:
        q = q.astype(np.float32)  # whichever way, as bounders take them
        if way == "bounded":
            q = q[bounder.query(q).numpy() == 1]
        count["denied"] += 1 - len(q)
        count["checks"] += len(q)
        return not len(q) or not model.hits(q.astype(np.float64))[0]

    class Valid(base.StateValidityChecker):
        def isValid(self, state):  # noqa: N802
            count["states"] += 1
            return free(numbers(state))

    class Motion(base.MotionValidator):
        def checkMotion(self, a, b):  # noqa: N802
            count["edges"] += 1
            a, b = numbers(a), numbers(b)
            clear = wb.proof.clear_segments(bounder, a, b, first=True)[0] if way == "bounded" else 0.0
            count["cleared"] += clear >= 1
            along = np.linspace(0, 1, int(np.ceil(np.linalg.norm(b - a) / STEP)) + 1)[1:]
            good = all(free(a + t * (b - a)) for t in along[along > clear])
            accepted.extend([(a[0], b[0])] * good)
            return good

    space, bounds = base.RealVectorStateSpace(n), base.RealVectorBounds(n)
    for i, (low, high) in enumerate(zip(shape().arm.lower, shape().arm.upper, strict=True)):
        bounds.setLow(i, low)
        bounds.setHigh(i, high)
    space.setBounds(bounds)
    info = base.SpaceInformation(space)
    valid, motion = Valid(info), Motion(info)
    info.setStateValidityChecker(valid)
    info.setMotionValidator(motion)
    info.setup()
    task, ends = base.ProblemDefinition(info), []
    for q in problems()[number]:
        ends.append(space.allocState())
        for i in range(n):
            ends[-1][i] = float(q[i])
    task.setStartAndGoalStates(*ends, 1e-3)
    planner = geometric.RRTConnect(info)
    planner.setRange(RANGE)
    planner.setProblemDefinition(task)
    planner.setup()
    free(numbers(ends[0]))
    wb.proof.clear_segments(bounder, *np.zeros((2, 1, n)), first=True)
    count.update(dict.fromkeys(count, 0))
    start = time.perf_counter()
    solved = bool(planner.solve(SECONDS))
    seconds = time.perf_counter() - start
    path = task.getSolutionPath().getStates() if solved else []
    missed = 0
    for a, b in accepted:
        t = np.linspace(0, 1, FINER * int(np.ceil(np.linalg.norm(b - a) / STEP)) + 1)[:, None]
        near = a + t * (b - a)
        near = near[shape().contains(near)]  # hulls hold the meshes
        missed += bool(model.hits(near).any()) if len(near) else 0
    found = [numbers(state)[0].tolist() for state in path]
    own = {"way": way, "problem": number, "seconds": seconds, "path": str(found), "versions": versions()}
    return own | {"missed": missed, "accepted": len(accepted)} | count


def page(rows: list[dict], command: str) -> str:
    """The page, in Markdown: its conclusion first."""
    of = {way: [row for row in rows if row["way"] == way] for way in WAYS}
    whole = {way: {f: sum(float(row[f]) for row in own) for f in FIELDS[2:10]} for way, own in of.items()}
    one, other = whole["exact"], whole["bounded"]
    same = sum(a["path"] == b["path"] for a, b in zip(*of.values(), strict=True))
    lines = [
        "# A UR5 plans with OMPL",
        "",
        f"**With a proven network planning takes {100 * other['seconds'] / one['seconds']:.0f} % of the time and "
        f"{100 * other['checks'] / one['checks']:.0f} % of the exact checks; {same} of {len(of['exact'])} paths are "
        f"the same.** Of {one['accepted']:,.0f} edges that the usual check accepts {one['missed']:.0f} collide between "
        "its states.",
        "",
        f"`{command}`",
        "",
        f"{rows[0]['versions']}. RRT-Connect, {len(of['exact'])} problems, four joints; exact checks by Coal.",
        "",
        "| | seconds | states | edges | exact checks | states denied | edges cleared whole |",
        "|---|---|---|---|---|---|---|",
    ]
    for way, own in whole.items():
        numbers = " | ".join(f"{own[field]:,.0f}" for field in FIELDS[3:8])
        lines.append(f"| {way} | {own['seconds']:.2f} | {numbers} |")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Run what is missing, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/robot-planning"))
    parser.add_argument("--effort", type=float, default=400.0, help="seconds of the network's fit")
    options = parser.parse_args()
    if find_spec("ompl") is None:
        sys.exit("planning needs OMPL: pip install 'warp-bounding[robots]'")
    ends = np.array(problems()[0], dtype=np.float32)  # what processes share is made, and kernels are loaded
    network(options.effort).query(ends), meshes().hits(ends.astype(np.float64)), shape().contains(ends)
    wb.proof.clear_segments(network(options.effort), ends[:1], ends[1:], first=True)
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "planning.csv"
    rows = stored(file)
    known = {(row["way"], int(row["problem"])) for row in rows}
    runs = [(way, k, options.effort) for k in range(PROBLEMS) for way in WAYS if (way, k) not in known]
    with get_context("fork").Pool(1, maxtasksperchild=1) as pool:
        for row in pool.imap(plan, runs, chunksize=1):
            rows.append(row)
            store(file, FIELDS, rows)
    text = page(rows, "python benchmarks/robot_planning.py --out results/robot-planning")
    (options.out / "README.md").write_text(text)
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
