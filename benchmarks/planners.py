"""Compare plans of this library with those of other programs, for three robots.

`python benchmarks/planners.py --robots DIR --every 10`: DIR as for ``benchmarks/motions.py``. Each program gets the
same start, goal and obstacles:

* ``motions``: RRT-Connect and shortcuts of ``sims/planning/proven.py``, every motion proven;
* ``balls``: the same program, given the balls of the robot that were made by hand (``NAME_spherized.urdf``);
* ``ompl``: OMPL's RRT-Connect and its simplification; Pinocchio and Coal check samples on the meshes, 32 a radian;
* ``ompl+motions``: OMPL's RRT-Connect, which asks ``Motions`` about states and motions, and no simplification;
* ``roboplan``: its RRT-Connect and shortcuts; it checks the meshes by Coal, 32 samples a radian, all in C++.

Then each path is judged: do 320 samples a radian collide by Coal on the meshes, and is every motion proven? Drake,
roboplan and Tesseract are also asked about the same single edges (Drake takes the convex hull of a mesh). A program
that is not installed is left out (`pip install ompl roboplan drake tesseract-robotics`). Seconds are those of this
process on one core.
"""

import os

os.environ.setdefault("WARP_BOUNDING_THREADS", "1")

import argparse
import re
import tempfile
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from itertools import combinations
from pathlib import Path

import numpy as np
import pinocchio as pin
import trimesh
from motions import DENSE, ROBOTS, USUAL, Meshes, Robot, bodies_of, clock, drawn, problems, samples_of, scene_of
from shared import StoredRows

import warp_bounding as wb
from sims.planning.proven import plan
from warp_bounding.arms import Motions

PACKAGES = ("ompl", "roboplan", "drake", "tesseract-robotics", "pin", "coal")
SECONDS = 5.0  # that a program may take for a plan
EDGES = 10  # single edges of each problem


class Ompl:
    """OMPL's RRT-Connect on top of two functions: is a state free, is a motion free?"""

    def __init__(self, lower, upper, state_free, motion_free=None):
        from ompl import base, geometric, util

        util.setLogLevel(util.LOG_ERROR)
        n = self.n = len(lower)

        class Free(base.StateValidityChecker):
            def isValid(self, state):  # noqa: N802
                return state_free(np.array([state[i] for i in range(n)]))

        class Motion(base.MotionValidator):
            def checkMotion(self, one, other):  # noqa: N802
                return motion_free(*(np.array([state[i] for i in range(n)]) for state in (one, other)))

        self.space, bounds = base.RealVectorStateSpace(n), base.RealVectorBounds(n)
        for i, ends in enumerate(zip(lower, upper, strict=True)):
            bounds.setLow(i, float(ends[0]))
            bounds.setHigh(i, float(ends[1]))
        self.space.setBounds(bounds)
        information = base.SpaceInformation(self.space)
        self.kept = [Free(information)]
        information.setStateValidityChecker(self.kept[0])
        if motion_free:
            self.kept.append(Motion(information))
            information.setMotionValidator(self.kept[1])
        else:
            information.setStateValidityCheckingResolution(1 / USUAL / self.space.getMaximumExtent())
        information.setup()
        self.setup, self.simplify = geometric.SimpleSetup(information), not motion_free
        self.setup.setPlanner(geometric.RRTConnect(information))

    def plan(self, ends: np.ndarray) -> np.ndarray | None:
        """A path ``(W, n)``."""
        states = [self.space.allocState() for _ in ends]
        for state, q in zip(states, ends, strict=True):
            for i in range(self.n):
                state[i] = float(q[i])
        self.setup.setStartAndGoalStates(*states)
        self.setup.solve(SECONDS)
        if not self.setup.haveExactSolutionPath():
            return None
        if self.simplify:
            self.setup.simplifySolution(1.0)
        return np.array([[s[i] for i in range(self.n)] for s in self.setup.getSolutionPath().getStates()])


class Roboplan:
    """roboplan's planner among the obstacles of a scene."""

    def __init__(self, robot: Robot, folder: Path, scene):
        from roboplan import core, rrt

        self.core, name = core, folder.name
        description = core.loadUrdfSceneDescription(str(folder / f"{name}.urdf"), [str(folder), str(folder.parent)])
        self.scene = core.Scene(name, description)
        self.scene.importSrdf((folder / f"{name}.srdf").read_text())
        color = np.ones(4)
        for number, (kind, size, pose, _) in enumerate(scene):
            if kind == "box":
                self.scene.addBoxGeometry(str(number), "universe", core.Box(*size), pose, color)
            elif kind == "cylinder":
                self.scene.addCylinderGeometry(str(number), "universe", core.Cylinder(size[1], size[0]), pose, color)
            else:
                self.scene.addSphereGeometry(str(number), "universe", core.Sphere(size[0]), pose, color)
        pairs = [(str(i), str(j)) for i, j in combinations(range(len(scene)), 2)]
        self.scene.setCollisions(pairs, False)
        self.scene.addGroup("planned", robot.names)
        self.names, self.columns, self.neutral = robot.names, robot.columns, pin.neutral(robot.model)
        self.scene.setJointPositions(self.neutral)
        options = rrt.RRTOptions()
        options.group_name, options.rrt_connect, options.max_planning_time = "planned", True, SECONDS
        options.collision_check_step_size, options.fast_return = 1 / USUAL, True
        options.max_nodes = 1_000_000
        self.planner = rrt.RRT(self.scene, options)
        cuts = core.PathShortcuttingOptions()
        cuts.group_name, cuts.max_step_size = "planned", 1 / USUAL
        self.shortcuts = core.PathShortcutter(self.scene, cuts)

    def full(self, q: np.ndarray) -> np.ndarray:
        """All joints' values."""
        found = self.neutral.copy()
        found[[joint.idx_q for joint in self.columns]] = q
        return found

    def plan(self, ends: np.ndarray) -> np.ndarray | None:
        """A path ``(W, n)``."""
        configurations = [self.core.JointConfiguration(self.names, q) for q in ends]
        try:
            path = self.shortcuts.shortcut(self.planner.plan(*configurations))
        except RuntimeError:
            return None
        return np.array(path.positions)

    def edge(self, q0: np.ndarray, q1: np.ndarray) -> bool:
        """Whether no sample of an edge collides."""
        return not self.core.hasCollisionsAlongPath(self.scene, self.full(q0), self.full(q1), 1 / USUAL)


class Drake:
    """Drake's collision checker among the obstacles of a scene; its meshes are OBJ files in a folder of their own."""

    def __init__(self, robot: Robot, folder: Path, scene, meshes: Path):
        from pydrake.geometry import Box, Cylinder, Sphere
        from pydrake.math import RigidTransform
        from pydrake.multibody.plant import CoulombFriction
        from pydrake.planning import RobotDiagramBuilder, SceneGraphCollisionChecker

        builder = RobotDiagramBuilder()
        plant = builder.plant()
        (model,) = builder.parser().AddModels(str(self.converted(folder, meshes)))
        for number, (kind, size, pose, _) in enumerate(scene):
            solid = {"box": Box, "cylinder": lambda h, r: Cylinder(r, h), "sphere": Sphere}[kind](*size)
            friction = CoulombFriction(0.5, 0.5)
            plant.RegisterCollisionGeometry(plant.world_body(), RigidTransform(pose), solid, str(number), friction)
        plant.Finalize()
        disabled = re.findall(r'<disable_collisions link1="([^"]+)" link2="([^"]+)"', robot.srdf.read_text())
        diagram = builder.Build()
        self.checker = SceneGraphCollisionChecker(
            model=diagram,
            robot_model_instances=[model],
            edge_step_size=1 / USUAL,
            configuration_distance_function=lambda a, b: float(np.linalg.norm(b - a)),
        )
        for one, other in disabled:
            if plant.HasBodyNamed(one) and plant.HasBodyNamed(other):
                bodies = plant.GetBodyByName(one), plant.GetBodyByName(other)
                if not self.checker.IsCollisionFilteredBetween(*bodies):
                    self.checker.SetCollisionFilteredBetween(*bodies, True)
        self.columns = [plant.GetJointByName(name).position_start() for name in robot.names]
        self.neutral = plant.GetPositions(plant.CreateDefaultContext())

    @staticmethod
    def converted(folder: Path, meshes: Path) -> Path:
        """Writes the robot's file with OBJ meshes beside it, once; returns its path."""
        file = meshes / f"{folder.name}.urdf"
        if not file.exists():
            text = (folder / file.name).read_text()
            for place in set(re.findall(r'filename="([^"]+)"', text)):
                source = folder / place.removeprefix("package://")
                name = f"{len(list(meshes.iterdir()))}.obj"
                if source.exists():
                    trimesh.load(source, force="mesh").convex_hull.export(meshes / name)
                text = text.replace(f'filename="{place}"', f'filename="{name}"')
            file.write_text(re.sub(r"<visual.*?</visual>", "", text, flags=re.S))
        return file

    def edge(self, q0: np.ndarray, q1: np.ndarray) -> bool:
        """Whether no sample of an edge collides."""
        ends = []
        for q in (q0, q1):
            ends.append(self.neutral.copy())
            ends[-1][self.columns] = q
        return self.checker.CheckEdgeCollisionFree(*ends)


CONTACTS = """contact_manager_plugins:
  search_paths: [{folder}]
  search_libraries: [{library}]
  discrete_plugins:
    default: BulletDiscreteBVHManager
    plugins:
      BulletDiscreteBVHManager: {{class: BulletDiscreteBVHManagerFactory, default: true}}
"""


class Tesseract:
    """Tesseract's contact manager of Bullet among the obstacles of a scene, asked about samples from Python."""

    def __init__(self, names: list[str], folder: Path, scene, place: Path):
        import tesseract_robotics
        from tesseract_robotics import tesseract_collision as collision
        from tesseract_robotics import tesseract_environment as environment
        from tesseract_robotics import tesseract_geometry as geometry
        from tesseract_robotics import tesseract_scene_graph as graph
        from tesseract_robotics.tesseract_common import GeneralResourceLocator, Isometry3d

        libraries = Path(tesseract_robotics.__file__).parents[1] / "tesseract_robotics.libs"
        library = next(libraries.glob("libtesseract_collision_bullet_factories*")).stem.removeprefix("lib")
        (place / "contacts.yaml").write_text(CONTACTS.format(folder=libraries, library=library))
        urdf = re.sub(r"<visual.*?</visual>", "", (folder / f"{folder.name}.urdf").read_text(), flags=re.S)
        urdf = re.sub(r'filename="(?:package://)?([^"]+)"', rf'filename="file://{folder}/\1"', urdf)
        pairs = "".join(re.findall(r"<disable_collisions [^>]*/>", (folder / f"{folder.name}.srdf").read_text()))
        plugin = f'<contact_managers_plugin_config filename="file://{place}/contacts.yaml"/>'
        name = re.search(r'<robot[^>]*name="([^"]+)"', urdf)[1]
        self.world = environment.Environment()
        srdf = f'<robot name="{name}">{pairs}{plugin}</robot>'
        if not self.world.init(urdf, srdf, GeneralResourceLocator()):
            raise RuntimeError(f"tesseract does not read {folder.name}")
        for number, (kind, size, pose, _) in enumerate(scene):
            shape = {"box": geometry.Box, "cylinder": lambda h, r: geometry.Cylinder(r, h), "sphere": geometry.Sphere}
            solid, link, joint = graph.Collision(), graph.Link(f"obstacle {number}"), graph.Joint(f"joint {number}")
            solid.geometry, solid.origin = shape[kind](*size), Isometry3d(pose)
            link.collision.append(solid)
            joint.parent_link_name, joint.child_link_name = self.world.getRootLinkName(), link.getName()
            joint.type = graph.JointType_FIXED
            self.world.applyCommand(environment.AddLinkCommand(link, joint))
        self.contacts, self.found = self.world.getDiscreteContactManager(), collision.ContactResultMap
        self.contacts.setActiveCollisionObjects(self.world.getActiveLinkNames())
        self.names, self.first = names, collision.ContactRequest(collision.ContactTestType_FIRST)

    def edge(self, q0: np.ndarray, q1: np.ndarray) -> bool:
        """Whether no sample of an edge collides."""
        for q in samples_of(q0[None], q1[None], USUAL)[0]:
            state = self.world.getState(self.names, q)  # is kept while its transforms are read
            self.contacts.setCollisionObjectsTransform(state.link_transforms)
            found = self.found()
            self.contacts.contactTest(found, self.first)
            if found.size():
                return False
        return True


def balls_of(robot: Robot, folder: Path, q: np.ndarray) -> wb.arms.Arm:
    """The robot of balls; pairs of links whose balls touch in a free configuration ``(n,)`` are not checked."""
    touching = []
    while True:
        file = folder / f"{folder.name}_spherized.urdf"
        arm = wb.arms.load_urdf(file, srdf=robot.srdf, touching=touching)
        motions = Motions(arm)
        if not motions.configurations([q]).any():
            return arm
        touching += motions.culprits([q])


def judged(path: np.ndarray | None, meshes: Meshes, motions: Motions) -> dict:
    """Whether a path was found, whether dense samples of it collide on the meshes, and whether it is proven."""
    if path is None:
        return {"solved": False}
    x, _ = samples_of(path[:-1], path[1:], DENSE)
    hits, length = meshes.hits(x), float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    proven = bool(motions.segments(path[:-1], path[1:])[0].all())
    return {"solved": True, "hits": int(hits.sum()), "samples": len(x), "proven": proven, "length": length}


def one_problem(robot: Robot, balls, folder: Path, scene, ends: np.ndarray, seed: int, place: Path) -> dict:
    """Seconds and judgement of each program; ``place`` is for files of theirs."""
    arm, row = robot.arm, {}
    motions, meshes = Motions(arm, bodies_of(scene)), robot.among(scene)
    if motions.configurations(ends).any():
        return {"free": False}
    by_balls = Motions(balls, bodies_of(scene))
    known = {
        "motions": lambda: plan(motions, *ends).path,
        "balls": lambda: None if by_balls.configurations(ends).any() else plan(by_balls, *ends).path,
    }
    if find_spec("ompl"):
        known["ompl"] = lambda: Ompl(arm.lower, arm.upper, lambda q: not meshes.hits(q[None])[0]).plan(ends)

        def free(q):
            return not motions.configurations(q[None])[0]

        def proven(a, b):
            return bool(motions.segments(a[None], b[None])[0][0])

        known["ompl+motions"] = lambda: Ompl(arm.lower, arm.upper, free, proven).plan(ends)
    limited = all(joint.nq == 1 for joint in robot.columns)
    edges = {"motions": lambda a, b: bool(motions.segments(a[None], b[None])[0][0])}
    if find_spec("roboplan") and limited:
        roboplan = Roboplan(robot, folder, scene)
        known["roboplan"], edges["roboplan"] = lambda: roboplan.plan(ends), roboplan.edge
    if find_spec("pydrake"):
        edges["drake"] = Drake(robot, folder, scene, place).edge
    if find_spec("tesseract_robotics"):
        edges["tesseract"] = Tesseract(robot.names, folder, scene, place).edge
    for name, ask in known.items():
        seconds, path = clock(ask)
        row[name] = {"s": seconds} | judged(path, meshes, motions)
    q0, q1 = drawn(np.random.default_rng(seed), ends, arm.lower, arm.upper)
    x, rows = samples_of(q0, q1, DENSE)
    free_rows = np.bincount(rows, motions.configurations(x) != 0, minlength=len(q0)) == 0
    chosen = list(zip(q0[free_rows][:EDGES], q1[free_rows][:EDGES], strict=True))
    for name, ask in edges.items():
        seconds, found = clock(lambda ask=ask: [ask(a, b) for a, b in chosen])
        row[f"edges {name}"] = {"s": seconds, "edges": len(chosen), "free": sum(found)}
    return row


def page(rows: StoredRows, folder: Path, every: int) -> None:
    """The page of all rows so far."""
    programs = ", ".join(f"{name} {found}" for name in PACKAGES if (found := _of(name)))
    lines = [
        "# Plans beside other programs\n",
        "Plans of samples, and of balls made by hand, collide with the meshes between what was checked; a plan of "
        "which every motion is proven costs less time.\n",
        f"`python benchmarks/planners.py --robots DIR --every {every} --out {folder}`; times are those "
        "of the process.\n",
        f"{rows.about}; {programs}. Problems of MotionBenchMaker as in [motions](../motions/README.md); what each "
        f"program does stands in the script. At most {SECONDS:.0f} s a plan, one core.\n",
        "| robot | program | solved | ms: median / 95 % | length, median | paths that collide on the meshes "
        "| paths proven whole |",
        "|---|---|--:|--:|--:|--:|--:|",
    ]
    edges = ["", "| robot | program | single edges | called free | us an edge |", "|---|---|--:|--:|--:|"]
    for robot in ROBOTS:
        of = [row for row in rows.rows if row["robot"] == robot and row.get("free", True)]
        for name in ("motions", "balls", "ompl", "ompl+motions", "roboplan"):
            if each := [row[name] for row in of if name in row]:
                solved = [one for one in each if one["solved"]] or [{}]
                ms = np.array([one.get("s", np.nan) for one in solved]) * 1e3
                length = np.median([one.get("length", np.nan) for one in solved])
                hit, proven = sum(one.get("hits", 0) > 0 for one in solved), sum(one.get("proven", 0) for one in solved)
                lines.append(
                    f"| {robot} | {name} | {sum(one['solved'] for one in each)} of {len(each)} | {np.median(ms):.0f} / "
                    f"{np.quantile(ms, 0.95):.0f} | {length:.1f} | {hit} | {proven} |"
                )
        for name in ("motions", "roboplan", "drake", "tesseract"):
            if each := [row[f"edges {name}"] for row in of if f"edges {name}" in row]:
                total = {key: sum(one[key] for one in each) for key in ("s", "edges", "free")}
                cost = 1e6 * total["s"] / max(total["edges"], 1)
                edges.append(f"| {robot} | {name} | {total['edges']} | {total['free']} | {cost:.0f} |")
    (folder / "README.md").write_text("\n".join(lines + edges) + "\n")


def _of(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def main() -> None:
    """Measure what is not yet known, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=Path, required=True, help="Folder with panda, ur5 and fetch.")
    parser.add_argument("--out", type=Path, default=Path("results/planners"))
    parser.add_argument("--every", type=int, default=10, help="Of each scenario's problems every so many.")
    options = parser.parse_args()
    rows = StoredRows(options.out, "planners")
    for name in ROBOTS:
        folder = options.robots / name
        robot = Robot(folder)
        _, _, start, _, _ = next(problems(folder, options.every))
        first = np.array([start[joint] for joint in robot.names])
        balls = balls_of(robot, folder, np.clip(first, robot.arm.lower, robot.arm.upper))
        with tempfile.TemporaryDirectory() as place:
            for scenario, number, start, goal, scene in problems(folder, options.every):
                if rows.have(robot=name, scenario=scenario, problem=number):
                    continue
                given = np.array([[state[joint] for joint in robot.names] for state in (start, goal)])
                ends = np.clip(given, robot.arm.lower, robot.arm.upper)
                known = {"robot": name, "scenario": scenario, "problem": number}
                found = one_problem(robot, balls, folder, scene_of(scene), ends, int(number), Path(place))
                rows.add(known | found)
                print(known, {key: round(each["s"], 4) for key, each in found.items() if key != "free"}, flush=True)
        page(rows, options.out, options.every)


if __name__ == "__main__":
    main()
