"""Whole motions of three robots among tables, shelves and boxes: `python benchmarks/motions.py --robots DIR --out DIR`.

DIR has a folder for each robot, with its URDF, SRDF and meshes, and folders ``problems/SCENARIO`` of MotionBenchMaker's
``requestNNNN.yaml`` and ``sceneNNNN.yaml`` (as in the public repository KavrakiLab/vamp, resources, unpacked). For each
problem the program counts four things. Are start and goal free, by ``Motions`` and by Coal on the meshes? How many of
the edges that dense samples accept are proven? How long does a proof take, compared with sampling in the same run on
one core? Is there a plan whose every motion is proven? Rows are kept, and the same command goes on. ``--attack`` asks
Coal on the meshes about many samples of each proven edge of every sixth problem.
"""

import os

os.environ.setdefault("WARP_BOUNDING_THREADS", "1")

import argparse
import time
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import yaml
from shared import StoredRows

import warp_bounding as wb
from sims.planning.proven import plan
from warp_bounding.arms import Body, Cylinder, Motions
from warp_bounding.rigid import lengths

ROBOTS, PIECES = ("panda", "ur5", "fetch"), 4
BATCH = 10  # times that a problem's edges are asked in one batch, to be timed
ATTACKED = 6  # of so many problems one is attacked
EDGES, DENSE, USUAL = 60, 320, 32  # edges of a problem; samples a radian that accept, and that planners take
CLEARANCE = 1e-3  # metres: of starts and goals that count
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def pose_of(position, orientation) -> np.ndarray:
    """``(4, 4)`` of a place and a quaternion x, y, z, w."""
    pose = np.eye(4)
    pose[:3, :3] = pin.Quaternion(np.array(orientation, dtype=float)).normalized().matrix()
    pose[:3, 3] = position
    return pose


def scene_of(file: Path) -> list[tuple[str, list[float], np.ndarray, str]]:
    """Kind, sizes, pose and name of each primitive of a planning scene."""
    world = yaml.load(file.read_text(), LOADER)["world"]["collision_objects"]
    return [
        (each["type"], each["dimensions"], pose_of(at["position"], at["orientation"]), thing["id"])
        for thing in world
        for each, at in zip(thing.get("primitives", []), thing.get("primitive_poses", []), strict=True)
    ]


def bodies_of(scene) -> list[Body | Cylinder]:
    """As ``Motions`` takes them."""
    found = []
    for kind, size, pose, name in scene:
        if kind == "box":
            found.append(Body.box(-np.array(size) / 2, np.array(size) / 2, pose=pose, name=name))
        elif kind == "cylinder":
            found.append(Cylinder(size[1], size[0], pose, name))
        else:
            found.append(Body.sphere(pose[:3, 3], size[0], name=name))
    return found


class Robot:
    """A robot of a folder, as ``Motions`` and as Coal on its meshes."""

    def __init__(self, folder: Path):
        name = folder.name
        urdf, srdf = folder / f"{name}.urdf", folder / f"{name}.srdf"
        self.srdf = srdf
        self.arm = wb.arms.load_urdf(urdf, srdf=srdf, pieces=PIECES)
        self.names = [self.arm.joints[i].name for i in self.arm.free]
        self.model = pin.buildModelFromUrdf(str(urdf))
        kind = pin.GeometryType.COLLISION
        self.geometry = pin.buildGeomFromUrdf(self.model, str(urdf), kind, [str(folder), str(folder.parent)])
        self.geometry.addAllCollisionPairs()
        pin.removeCollisionPairs(self.model, self.geometry, str(srdf))
        self.own, self.data = self.geometry.ngeoms, self.model.createData()
        self.columns = [self.model.joints[self.model.getJointId(each)] for each in self.names]

    def among(self, scene) -> "Meshes":
        """Coal's checks among obstacles."""
        return Meshes(self, scene)


class Meshes:
    """Coal on the robot's meshes, among boxes, cylinders and balls."""

    def __init__(self, robot: Robot, scene):
        self.robot, self.geometry = robot, robot.geometry.copy()
        for kind, size, pose, name in scene:
            solid = {"box": coal.Box, "cylinder": lambda h, r: coal.Cylinder(r, h), "sphere": coal.Sphere}[kind](*size)
            number = self.geometry.addGeometryObject(
                pin.GeometryObject(f"{self.geometry.ngeoms} {name}", 0, 0, pin.SE3(pose), solid)
            )
            for k in range(robot.own):
                if self.geometry.geometryObjects[k].parentJoint:
                    self.geometry.addCollisionPair(pin.CollisionPair(k, number))
        self.found = pin.GeometryData(self.geometry)

    def _values(self, q: np.ndarray) -> np.ndarray:
        """Configurations as Pinocchio takes them: of a joint without limits its cosine and sine."""
        found = np.tile(pin.neutral(self.robot.model), (len(q), 1))
        for column, joint in enumerate(self.robot.columns):
            if joint.nq == 1:
                found[:, joint.idx_q] = q[:, column]
            else:
                found[:, joint.idx_q], found[:, joint.idx_q + 1] = np.cos(q[:, column]), np.sin(q[:, column])
        return found

    def hits(self, q: np.ndarray) -> np.ndarray:
        """Which configurations ``(N, n)`` collide."""
        model, data, geometry, found = self.robot.model, self.robot.data, self.geometry, self.found
        return np.array(
            [pin.computeCollisions(model, data, geometry, found, x, True) for x in self._values(q)], dtype=bool
        )

    def clearance(self, q: np.ndarray) -> float:
        """The least distance of a configuration ``(n,)``, metres."""
        pin.computeDistances(self.robot.model, self.robot.data, self.geometry, self.found, self._values(q[None])[0])
        return min(each.min_distance for each in self.found.distanceResults)


def problems(folder: Path, every: int):
    """Scenario, number, start, goal and scene file of each problem."""
    for scenario in sorted(path for path in (folder / "problems").iterdir() if path.is_dir()):
        for file in sorted(scenario.glob("request*.yaml"))[::every]:
            request = yaml.load(file.read_text(), LOADER)
            state = request["start_state"]["joint_state"]
            goal = {
                each["joint_name"]: each["position"] for each in request["goal_constraints"][0]["joint_constraints"]
            }
            number = file.stem.removeprefix("request")
            yield (
                scenario.name,
                number,
                dict(zip(state["name"], state["position"], strict=True)),
                goal,
                (scenario / f"scene{number}.yaml"),
            )


def samples_of(q0: np.ndarray, q1: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Configurations along edges, so many a radian, and of which edge each is."""
    counts = np.maximum(1, np.ceil(lengths(q1 - q0) * rate)).astype(int) + 1
    rows = np.repeat(np.arange(len(q0)), counts)
    t = np.concatenate([np.linspace(0, 1, count) for count in counts])[:, None]
    return q0[rows] + t * (q1[rows] - q0[rows]), rows


def drawn(rng, ends: np.ndarray, lower, upper) -> tuple[np.ndarray, np.ndarray]:
    """Edges as planners ask: near the start, near the goal and anywhere; a third of them end in one of the two."""
    n = len(lower)
    near = [ends[0], ends[1], rng.uniform(lower, upper)]
    q0 = np.clip([near[k] + rng.normal(size=n) * 0.2 for k in rng.integers(3, size=EDGES)], lower, upper)
    way = rng.normal(size=q0.shape)
    q1 = np.clip(q0 + way / lengths(way)[:, None] * rng.uniform(0.3, 1.5, (EDGES, 1)), lower, upper)
    third = EDGES // 3
    q1[:third] = ends[rng.integers(2, size=third)]
    way = rng.normal(size=(third, n))
    q0[:third] = np.clip(q1[:third] + way / lengths(way)[:, None] * rng.uniform(0.05, 0.4, (third, 1)), lower, upper)
    return q0, q1


def clock(ask) -> tuple[float, object]:
    """Seconds of this process, and what came of it."""
    begun = time.process_time()
    found = ask()
    return time.process_time() - begun, found


def one_problem(robot: Robot, scene, ends: np.ndarray, seed: int, attack: int) -> dict:
    """What is measured of a problem."""
    motions, meshes, arm = Motions(robot.arm, bodies_of(scene)), robot.among(scene), robot.arm
    rng, row = np.random.default_rng(seed), {}
    states = motions.configurations(ends)
    row["free"] = [bool(state == 0) for state in states]
    row["free_meshes"] = [not hit for hit in meshes.hits(ends).tolist()]
    row["clear_meshes"] = [meshes.clearance(end) > CLEARANCE for end in ends]
    q0, q1 = drawn(rng, ends, arm.lower, arm.upper)
    x, rows = samples_of(q0, q1, DENSE)
    free = np.bincount(rows, motions.configurations(x) != 0, minlength=EDGES) == 0
    to_ends = np.arange(EDGES) < EDGES // 3
    q0, q1, to_ends = q0[free], q1[free], to_ends[free]
    row |= {"edges": len(q0), "to_ends": int(to_ends.sum())}
    if len(q0):
        x, _ = samples_of(q0, q1, USUAL)
        (clear, _), batch, many = (
            motions.segments(q0, q1),
            [np.tile(q, (BATCH, 1)) for q in (q0, q1)],
            np.tile(x, (BATCH, 1)),
        )
        row["proof_s"], row["samples_s"] = (
            clock(ask)[0] / BATCH for ask in (lambda: motions.segments(*batch), lambda: motions.configurations(many))
        )
        row["coal_s"], _ = clock(lambda: meshes.hits(x))
        row["single_s"], _ = clock(
            lambda: [motions.segments(a[None], b[None]) for a, b in zip(q0[:10], q1[:10], strict=True)]
        )
        row |= {"proven": int(clear.sum()), "proven_to_ends": int(clear[to_ends].sum()), "samples": len(x)}
        row["singles"] = min(10, len(q0))
        if attack and clear.any():
            t = rng.uniform(size=(attack, int(clear.sum()), 1))
            dense = (q0[clear] + t * (q1[clear] - q0[clear])).reshape(-1, arm.lower.size)
            row |= {"attacked": len(dense), "refuted": int(meshes.hits(dense).sum())}
    if not states.any():
        row["plan_s"], found = clock(lambda: plan(motions, *ends, seed=0))
        row["solved"] = found.path is not None and motions.path(found.path).proven
        row["asked"] = found.asked
    return row


def page(rows: StoredRows, folder: Path) -> None:
    """The page of all rows so far."""
    lines = [
        "# Whole motions, proven\n",
        f"`python benchmarks/motions.py --robots DIR --attack 2000 --out {folder}`; times are those of the process.\n",
        f"{rows.about}. Problems of MotionBenchMaker (KavrakiLab/vamp, resources), {EDGES} edges each: near the start, "
        f"near the goal, anywhere, and a third that end in one of the two. Meshes are cut into up to {PIECES} hulls. "
        "Nothing is fitted.\n",
        "| robot | problems | start and goal free: ours / Coal on meshes | edges free at 320 a radian | proven | to "
        "starts and goals | proven | proof, us | samples at 32 a radian, us: ours / Coal | single call, us | solved "
        "| plan, ms: median / 95 % |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for robot in ROBOTS:
        of = [row for row in rows.rows if row["robot"] == robot]
        if not of:
            continue
        total = {key: sum(row.get(key, 0) for row in of) for key in NUMBERS}
        edges, both = max(total["edges"], 1), [sum(all(row[key]) for row in of) for key in ("free", "free_meshes")]
        plans = [row for row in of if "solved" in row]
        seconds = np.array([row["plan_s"] for row in plans if row["solved"]] or [np.nan]) * 1e3
        lines.append(
            f"| {robot} | {len(of)} | {both[0]} / {both[1]} "
            f"| {total['edges']:,} | {100 * total['proven'] / edges:.2f} % "
            f"| {total['to_ends']:,} | {100 * total['proven_to_ends'] / max(total['to_ends'], 1):.2f} % "
            f"| {1e6 * total['proof_s'] / edges:.1f} | {1e6 * total['samples_s'] / edges:.0f} / "
            f"{1e6 * total['coal_s'] / edges:.0f} | {1e6 * total['single_s'] / max(total['singles'], 1):.0f} "
            f"| {sum(row['solved'] for row in plans)} of {len(of)} | {np.median(seconds):.0f} / "
            f"{np.quantile(seconds, 0.95):.0f} |"
        )
    attacked, refuted = (sum(row.get(key, 0) for row in rows.rows) for key in ("attacked", "refuted"))
    if attacked:
        lines.append(f"\n{attacked:,} random samples of proven edges, asked of Coal on the meshes: {refuted} collide.")
    (folder / "README.md").write_text("\n".join(lines) + "\n")


NUMBERS = ("edges", "to_ends", "proven", "proven_to_ends", "proof_s", "samples_s", "coal_s", "single_s", "singles")


def main() -> None:
    """Measure what is not yet known, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=Path, required=True, help="Folder with panda, ur5 and fetch.")
    parser.add_argument("--out", type=Path, default=Path("results/motions"))
    parser.add_argument("--every", type=int, default=1, help="Of each scenario's problems every so many.")
    parser.add_argument("--attack", type=int, default=0, help="Samples of a proven edge that Coal is asked.")
    options = parser.parse_args()
    rows = StoredRows(options.out, "motions")
    for name in ROBOTS:
        robot = Robot(options.robots / name)
        chosen = problems(options.robots / name, options.every)
        for count, (scenario, number, start, goal, scene) in enumerate(chosen):
            if rows.have(robot=name, scenario=scenario, problem=number):
                continue
            given = np.array([[state[joint] for joint in robot.names] for state in (start, goal)])
            ends = np.clip(given, robot.arm.lower, robot.arm.upper)
            known = {"robot": name, "scenario": scenario, "problem": number}
            attack = 0 if count % ATTACKED else options.attack
            rows.add(known | one_problem(robot, scene_of(scene), ends, int(number), attack))
            print(known, {key: rows.rows[-1].get(key) for key in ("edges", "proven", "solved", "plan_s")}, flush=True)
        page(rows, options.out)


if __name__ == "__main__":
    main()
