"""Running the demo ``arm``: cells, bounders, the planner with each of them, one table, pictures.

Bounders come with the demo. Of each cell of a planar arm the rounded hulls are the narrow phase; of the one of four
joints, where Coal and Pinocchio are installed, triangle meshes too, by the same bounders.

A Panda, where its files are installed, moves all of its seven joints: nothing is fitted, and each motion of a plan is
proven (``seven``).

A UR5, where its files are installed, must not touch itself either. Two proven bounders are asked about it: of its cell,
and of the robot alone, which serves in every cell. What both deny is free.
"""

from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

import warp_bounding as wb
from sims import base
from sims.arm.exact import STEP, Hulls, Meshes, Stepped
from sims.arm.pictures import draw, draw_one
from sims.arm.robot_pictures import draw_robot, draw_seven
from sims.arm.robots import CELLS, KEPT, ROBOTS, ur5
from sims.arm.seven import cell, planned
from sims.arm.workplace import Workplace
from sims.drawing import Drawn
from sims.planning.broad import BroadPhase, Elsewhere, Every, First, Points, Samples, Segments
from sims.planning.demo import PlanningDemo
from sims.planning.roadmap import Roadmap
from sims.planning.rrt_connect import RrtConnect
from sims.prefitted import FitSpec, bounder_from, bounders_of, owner
from sims.report import Run

__all__ = [
    "SCENE_SPECS",
    "SPECS",
    "Demo",
    "Example",
    "Trees",
    "of_itself",
    "phases",
    "places",
    "robot_places",
    "run",
    "shapes",
    "simulate",
    "specs_of",
]

HIDDEN = (50, 50)
BEHIND_ANGLES = (44, 44)  # of the proven network of four joints on: hidden layers behind one of the joints' angles
FEW_JOINTS = 3  # up to so many, two layers are tighter in the same time, since their proof ends
PROVEN_JOINTS, OF_MANY = 4, (66, 66)  # up to so many a proof is tight; hidden layers of arms of more
CELLS_OF_BOXES = (64, 32)  # a side, of the grid that a hierarchy of boxes is made of; of few joints and of more
BUDGETS = (240.0, 400.0)  # seconds a network, of few joints and of more
SPECS: dict[str, FitSpec] = {
    "aabb": FitSpec("aabb", kept=True),
    "bvh": FitSpec("bvh", options={"hidden": HIDDEN}, resolution=CELLS_OF_BOXES[0], kept=True),
    "learned-kdop": FitSpec("learned-kdop", budget=10.0),
    "mlp": FitSpec("mlp", budget=BUDGETS[0], options={"hidden": HIDDEN}),
    "occupancy": FitSpec("occupancy", budget=60.0, options={"hidden": HIDDEN}),
}
# A network of a robot's cell is trained in a third of its time; in the rest two processes prove it.
OF_ROBOTS: dict[str, FitSpec] = {
    "bvh": replace(SPECS["bvh"], resolution=CELLS_OF_BOXES[1]),
    "mlp": FitSpec("mlp", budget=BUDGETS[1], options={"hidden": (8, 48, 48), "scheduler": 2}),
}
SHOWN = ("planar-3", "planar-4")  # cells whose bounders come with the demo
MESHED = "planar-4"  # the one that is planned with meshes, too
MARCHED = 5  # the logarithm of the steps that a march along an edge may take
STATES, PROBLEMS = (4000, 250), (100, 8)  # full, quick
MESH_STATES = (1500, 120)  # of the roadmap with meshes
REPEATS = (2, 1)
WARM_UP = 50


def specs_of(shape: wb.arms.ArmConfigurations, specs: dict[str, FitSpec] = SPECS) -> dict[str, FitSpec]:
    """Specs for one arm.

    With many joints the network begins with sines and cosines of the angles; with too many for a proof, samples attest
    it.
    """
    if shape.ndim <= FEW_JOINTS:
        return specs
    waves = 2 * len(shape.arm.angles)
    angles = {"hidden": (waves, *BEHIND_ANGLES), "scheduler": 2}
    if shape.ndim > PROVEN_JOINTS:
        angles = {"hidden": (waves, *OF_MANY), "statistical": True}
    boxes = {"bvh": replace(specs["bvh"], resolution=CELLS_OF_BOXES[1])}
    return specs | boxes | {"mlp": replace(specs["mlp"], budget=BUDGETS[1], options=specs["mlp"].options | angles)}


def places(names: tuple[str, ...] = SHOWN) -> list[Workplace]:
    """The cells that the demo plans in."""
    return [Workplace(CELLS[name]) for name in names]


def robot_places() -> tuple[list[Workplace], str]:
    """The cell of a robot, and why there is none where its files are not installed."""
    try:
        return [Workplace(ur5(), itself=True)], ""
    except wb.BoundingError as error:
        return [], str(error)


def shapes() -> dict[str, wb.arms.ArmConfigurations]:
    """The configurations that collide with each cell, by the name under which bounders lie."""
    return {place.scene: place.around for place in (*places(), *robot_places()[0])}


def specs_in(place: Workplace, specs: dict[str, FitSpec] = SPECS) -> dict[str, FitSpec]:
    """Specs for one cell."""
    return OF_ROBOTS if place.itself else specs_of(place.around, specs)


SCENE_SPECS = {place.scene: specs_in(place) for place in places()} | {"arm-ur5": OF_ROBOTS}


class Example(Roadmap):
    """All problems of one cell, planned at once; lengths are metres that the arm moves at most."""

    SMALL: ClassVar = {"states": WARM_UP, "problems": 1}
    FEW = False

    def render(self, folder: Path) -> list[Path]:
        """Draw the arm along its longest path."""
        return [draw_one(self, Path(folder))]


class Trees(RrtConnect):
    """The same problems, each planned by itself."""

    SMALL: ClassVar = {"samples": WARM_UP, "problems": 1}
    FEW = True  # states are queried at a time

    def render(self, folder: Path) -> list[Path]:
        """Draw the arm along its longest path."""
        return [draw_one(self, Path(folder))]


@dataclass
class Demo(PlanningDemo):
    """Planning for arms; see ``sims.arm`` and ``sims.base.Demo``. The only step plans everything in a cell.

    Attributes:
        states: Random configurations of a roadmap; 4,000, or 250 if quick. With meshes 1,500, or 120.
        problems: Problems a cell; 100, or 8 if quick.
    """

    NAME = "arm"
    SPECS = SPECS
    SIZES: ClassVar = {"states": STATES, "problems": PROBLEMS}

    def set_up(self) -> dict[str, wb.arms.ArmConfigurations]:
        self.mesh_states = MESH_STATES[self.quick] if self.states is None else self.states
        self.choose_sizes()
        self.flat = places()
        self.robots, self.lacking = robot_places()
        self.places = [*self.flat, *self.robots]
        self.whole = None if self.lacking else cell()
        self.seven = None if self.whole is None else planned(self.whole)
        self.steps, self.shape = 1, ", ".join(place.name for place in self.places)
        return {place.scene: place.around for place in self.places}

    def fit(self, shapes: dict[str, wb.arms.ArmConfigurations]) -> dict[str, dict[str, wb.Bounder]]:
        """See ``sims.base.Demo``; each arm has specs of its own."""
        whose = (
            None
            if self.bounder_file is None
            else owner(self.bounder_file, shapes, self.specs["mlp"]) or next(iter(shapes))
        )
        found = {
            place.scene: bounders_of(
                place.scene,
                shapes[place.scene],
                specs_in(place, self.specs),
                file=self.bounder_file if place.scene == whose else None,
                device=self.device,
                **self.fits,
            )
            for place in self.places
        }
        return {method: {scene: own[method] for scene, own in found.items() if method in own} for method in self.specs}

    def simulate(self) -> tuple[list[Run], str, dict[str, str]]:
        runs, self.examples = [], {}
        for place in self.places:
            bounders = self.of_shape(place.scene)
            meshes = all(find_spec(name) for name in ("coal", "pinocchio"))
            kinds = [(place.name, Hulls, Example, {"states": self.states})]
            if place.itself:
                own = Meshes if meshes else Hulls
                kinds = [(f"{place.name}{', meshes' * meshes}", own, Example, {"states": self.mesh_states})]
            if place.cell.name == MESHED:
                if meshes:
                    kinds.append((f"{place.name}, meshes", Meshes, Example, {"states": self.mesh_states}))
                name = f"{place.name}, {'meshes, ' * meshes}RRT-Connect"
                kinds.append((name, Meshes if meshes else Hulls, Trees, {}))
            for section, exact, planner, own in kinds:
                options = own | {"problems": self.problems, "seed": self.seed}
                repeats = REPEATS[self.quick]
                examples = simulate(place, exact(place), bounders, planner=planner, repeats=repeats, **options)
                own = {name: {place.scene: bounder} for name, bounder in bounders.items()}
                runs += base.compare(examples, own, self.rows[place.scene], section)
                self.examples[section] = examples
        title = f"exact checks of configurations, at most {100 * STEP:g} cm apart along edges"
        return runs, title, self.COLUMNS

    def tell(self, runs: list[Run]) -> None:
        """What is saved, what is solved, and what a check costs."""
        for section, examples in self.examples.items():
            none = examples["none"]
            price = 1e3 * none.milliseconds()[1] / max(none.checks, 1)
            unsolved = len(none.problems) - none.solved
            self.console.print(
                f"{section}: {none.solved} of {len(none.problems)} problems solved, {none.mean_length:.2f} m on "
                f"average, {unsolved} without a path; "
                f"an exact check takes {price:.2g} us.",
                markup=False,
            )
        for run in runs:
            if not run.conservative and run.extra["collisions"]:
                self.console.print(
                    f"[red]{run.bounder}[/] in {run.section}: {run.extra['collisions']} of its "
                    f"{run.extra['solved']} paths collide."
                )
        for place in self.robots:
            self.console.print(
                f"{place.name}: a network of the robot's collisions with itself is asked too; it serves in every cell.",
                markup=False,
            )
        if self.seven:
            self.console.print(self.seven.sentence(), markup=False)
        if self.lacking:
            self.console.print(f"No robot is shown: {self.lacking}", markup=False)
        if not any("meshes" in section for section in self.examples):
            self.console.print(
                "Planning with meshes too needs Coal and Pinocchio: pip install 'warp-bounding[arms]'", markup=False
            )

    def draw(self) -> Drawn:
        names = ("mlp", "occupancy")
        pairs = [tuple(self.examples[place.name][name] for name in names) for place in self.flat]
        drawn = Drawn([draw(self.out, pairs, [self.of_shape(place.scene) for place in self.flat], names)])
        for place in self.robots:
            runs = next(runs for section, runs in self.examples.items() if section.startswith(place.name))
            paths, problem = draw_robot(runs["mlp"], self.out, runs["none"].checks)
            drawn = Drawn([*drawn.paths, *paths], problem or drawn.problem)
        if self.seven:
            paths, problem = draw_seven(self.seven, self.whole, self.out)
            drawn = Drawn([*drawn.paths, *paths], problem or drawn.problem)
        return drawn

    def more(self) -> dict[str, Any]:
        """``cells`` and ``bounders``: a row a cell and bounder; ``seven``: what is known of plans of seven joints."""
        rows = [{"cell": place.name, **row} for place in self.places for row in self.rows[place.scene]]
        reported = [
            {
                "cell": section,
                "problems": len(examples["none"].problems),
                "solved": examples["none"].solved,
                "us_per_check": 1e3 * examples["none"].milliseconds()[1] / max(examples["none"].checks, 1),
            }
            for section, examples in self.examples.items()
        ]
        plans = (self.seven.first, self.seven.spoiled, self.seven.second) if self.seven else ()
        seven = [plan.statement for plan in plans if plan]
        return {"cells": reported, "bounders": rows, "seven": seven}


run = Demo.run


def phases(bounders: dict[str, wb.Bounder], *, few: bool = False) -> dict[str, BroadPhase]:
    """The broad phases of a cell's bounders, and the cascade of boxes and the network.

    A planner that asks about few states at a time gets no whole edges cleared: a call for one of them takes longer than
    to ask about all that would be checked.

    Along edges volumes march by their distance. Edges that one bound of a network does not clear are not halved: to ask
    the network at the configurations that would be checked is cheaper, and clears more.
    """
    made: dict[str, BroadPhase] = {}
    for name, bounder in bounders.items():
        if not bounder.conservative:
            made[name] = Samples(bounder, [1 / STEP] * bounder.ndim, 1.0)
        elif few:
            made[name] = Points(bounder)
        else:
            made[name] = Segments(bounder, halvings=0 if name == "mlp" else MARCHED)
    if {"learned-kdop", "mlp"} <= made.keys():
        made["learned-kdop+mlp"] = First(made["learned-kdop"], made["mlp"])
    if "occupancy" in made:
        made["occupancy"] = made.pop("occupancy")  # what has no proof comes last
    return made


def of_itself(place: Workplace) -> BroadPhase:
    """The broad phase of a robot's collisions with itself, by the bounders that come with the demo.

    Raises:
        BounderError: If these are not of the robot as it is installed.
    """
    robot = ROBOTS[place.cell.robot]
    arm = robot.arm()
    names = [arm.joints[i].name for i in arm.free]
    standing = np.array([place.cell.held.get(name, 0.0) for name in names])
    moving = [names.index(joint.name) for joint in place.cell.arm.joints]

    def phase(name: str, shape: wb.arms.ArmConfigurations) -> BroadPhase:
        bounder = bounder_from(KEPT / f"{name}.safetensors", shape, FitSpec("mlp"), device="cpu")

        def coordinates(x: np.ndarray) -> np.ndarray:
            q = np.tile(standing, (len(x), 1))
            q[:, moving] = place.joint_values(x)
            return q[:, shape.columns]

        return Elsewhere(Segments(bounder, halvings=0), coordinates)

    return Every(*(phase(name, shape) for name, shape in robot.shapes().items()))


def simulate(
    place: Workplace,
    exact: Stepped,
    bounders: dict[str, wb.Bounder],
    *,
    planner: type[Example] | type[Trees] = Example,
    repeats: int = 1,
    **options,
) -> dict[str, Example]:
    """The same problems without a broad phase and with each; see ``sims.base.simulate``.

    Args:
        place: Where; a robot that must not touch itself has a bounder of its own in ``KEPT``.
        exact: The narrow phase.
        bounders: By name.
        planner: What plans.
        repeats: How often each run is done, for its time.
        options: The planner's own.
    """

    def planned(phase: BroadPhase | None, small: bool) -> Example:
        return planner(place, exact, phase, **options | (planner.SMALL if small else {}))

    made = phases(bounders, few=planner.FEW)
    if place.itself:
        itself = of_itself(place)
        made = {name: Every(phase, itself) for name, phase in made.items()}
    return base.simulate(f"planning, {place.name}", made, planned, repeats)
