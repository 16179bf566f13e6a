"""Running the demo ``arm``: cells, bounders, the planner with each of them, one table, one picture.

Bounders of the planar arms come with the demo. Of each cell the rounded hulls are the narrow phase; of the one of four
joints, where Coal and Pinocchio are installed, triangle meshes too, by the same bounders.
"""

from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

import warp_bounding as wb
from sims import base
from sims.arm.exact import STEP, Hulls, Meshes, Stepped
from sims.arm.pictures import draw, draw_one
from sims.arm.robots import CELLS
from sims.arm.workplace import Workplace
from sims.drawing import Drawn
from sims.planning.broad import BroadPhase, First, Points, Samples, Segments
from sims.planning.demo import PlanningDemo
from sims.planning.roadmap import Roadmap
from sims.planning.rrt_connect import RrtConnect
from sims.prefitted import FitSpec, bounders_of, owner
from sims.report import Run

__all__ = [
    "SCENE_SPECS",
    "SPECS",
    "Demo",
    "Example",
    "Trees",
    "phases",
    "places",
    "run",
    "shapes",
    "simulate",
    "specs_of",
]

HIDDEN = (50, 50)
# Of the proven network of four joints on: hidden layers behind one of the joints' angles; parts with thresholds of
# their own.
BEHIND_ANGLES, PARTS = (44, 44), 2048
FEW_JOINTS = 3  # up to so many, two layers and one threshold are tighter in the same time, since their proof ends
PROVEN_JOINTS, OF_MANY = 4, (66, 66)  # up to so many a proof is tight; hidden layers of arms of more
CELLS_OF_BOXES = (64, 32)  # a side, of the grid that a hierarchy of boxes is made of; of few joints and of more
BUDGETS = (240.0, 420.0)  # seconds a network, of few joints and of more
SPECS: dict[str, FitSpec] = {
    "aabb": FitSpec("aabb", kept=True),
    "bvh": FitSpec("bvh", options={"hidden": HIDDEN}, resolution=CELLS_OF_BOXES[0], kept=True),
    "learned-kdop": FitSpec("learned-kdop", budget=10.0),
    "mlp": FitSpec("mlp", budget=BUDGETS[0], options={"hidden": HIDDEN}),
    "occupancy": FitSpec("occupancy", budget=60.0, options={"hidden": HIDDEN}),
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
    angles = {"hidden": (waves, *BEHIND_ANGLES), "parts": PARTS}
    if shape.ndim > PROVEN_JOINTS:
        angles = {"hidden": (waves, *OF_MANY), "statistical": True}
    boxes = {"bvh": replace(specs["bvh"], resolution=CELLS_OF_BOXES[1])}
    return specs | boxes | {"mlp": replace(specs["mlp"], budget=BUDGETS[1], options=specs["mlp"].options | angles)}


def places(names: tuple[str, ...] = SHOWN) -> list[Workplace]:
    """The cells that the demo plans in."""
    return [Workplace(CELLS[name]) for name in names]


def shapes() -> dict[str, wb.arms.ArmConfigurations]:
    """Their colliding configurations, by the name under which bounders lie."""
    return {place.scene: place.shape for place in places()}


SCENE_SPECS = {scene: specs_of(shape) for scene, shape in shapes().items()}


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
        self.places = places()
        self.steps, self.shape = 1, ", ".join(place.name for place in self.places)
        return {place.scene: place.shape for place in self.places}

    def fit(self, shapes: dict[str, wb.arms.ArmConfigurations]) -> dict[str, dict[str, wb.Bounder]]:
        """See ``sims.base.Demo``; each arm has specs of its own."""
        whose = (
            None
            if self.bounder_file is None
            else owner(self.bounder_file, shapes, self.specs["mlp"]) or next(iter(shapes))
        )
        found = {
            scene: bounders_of(
                scene,
                shape,
                specs_of(shape, self.specs),
                file=self.bounder_file if scene == whose else None,
                device=self.device,
                **self.fits,
            )
            for scene, shape in shapes.items()
        }
        return {method: {scene: found[scene][method] for scene in shapes} for method in self.specs}

    def simulate(self) -> tuple[list[Run], str, dict[str, str]]:
        runs, self.examples = [], {}
        for place in self.places:
            bounders = self.of_shape(place.scene)
            kinds = [(place.name, Hulls, Example, {"states": self.states})]
            if place.cell.name == MESHED:
                meshes = all(find_spec(name) for name in ("coal", "pinocchio"))
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
        if not any("meshes" in section for section in self.examples):
            self.console.print(
                "Planning with meshes too needs Coal and Pinocchio: pip install 'warp-bounding[arms]'", markup=False
            )

    def draw(self) -> Drawn:
        names = ("mlp", "occupancy")
        pairs = [tuple(self.examples[place.name][name] for name in names) for place in self.places]
        return Drawn([draw(self.out, pairs, [self.of_shape(place.scene) for place in self.places], names)])

    def more(self) -> dict[str, Any]:
        """``cells`` and ``bounders``: a row a cell and bounder."""
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
        return {"cells": reported, "bounders": rows}


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
        place: Where.
        exact: The narrow phase.
        bounders: By name.
        planner: What plans.
        repeats: How often each run is done, for its time.
        options: The planner's own.
    """

    def planned(phase: BroadPhase | None, small: bool) -> Example:
        return planner(place, exact, phase, **options | (planner.SMALL if small else {}))

    made = phases(bounders, few=planner.FEW)
    return base.simulate(f"planning, {place.name}", made, planned, repeats)
