"""Running the demo ``path``: worlds, bounders, the planner with each of them, one table, one picture.

Bounders of the generated worlds come with the demo. Those of a user's world are fitted on the first run, and kept in
the output folder under a name that holds the world's digest, so that they are used again for the very same cells only.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from rich.markup import escape

import warp_bounding as wb
from sims import base
from sims.chosen import Taken, time_own_code
from sims.drawing import Drawn
from sims.path.exact import ExactWorld
from sims.path.pictures import draw
from sims.path.planner import Example
from sims.path.report import described, price, solved
from sims.path.worlds import World, generated, worlds_at
from sims.planning.broad import Boxes, BroadPhase, First, Marching, Samples, Segments, TwoSided
from sims.planning.demo import PlanningDemo
from sims.prefitted import FitSpec, bounders_of, owner, stored
from sims.report import CHOSEN, UNPROVEN, Run

__all__ = ["SPECS", "Demo", "phases", "run", "shapes", "simulate"]

HIDDEN = (50, 50)
NODES = {"nodes": 96, "storage": "uint8"}  # of `distance-grid`: of the memory of the networks, 9 kB
INSIDE = "inside"  # the bounder from the inside
SPECS: dict[str, FitSpec] = {
    "aabb": FitSpec("aabb", query="box"),
    "kdop": FitSpec("kdop", query="box"),
    "bvh": FitSpec("bvh", query="box", options={"hidden": HIDDEN}),
    "learned-kdop": FitSpec("learned-kdop", query="box", budget=5.0),
    "mlp": FitSpec("mlp", budget=30.0, options={"hidden": HIDDEN}),
    "distance": FitSpec("mlp", query="distance", budget=30.0, options={"hidden": HIDDEN}),
    "distance-grid": FitSpec("distance-grid", query="distance", options=NODES),
    INSIDE: FitSpec("mlp", budget=30.0, options={"hidden": HIDDEN, "side": INSIDE}),
    "occupancy": FitSpec("occupancy", budget=30.0, options={"hidden": HIDDEN}),
}
SIDED = ("mlp", "bvh", "distance", "distance-grid")  # what is asked together with it, too
BY_QUERY = {"point": Segments, "box": Boxes, "distance": Marching}  # how bounders with a proof clear states and edges
# boxes first, then a network's segments: bounders of different queries, so the planner puts them together
CASCADE = "aabb+mlp"
USERS_BUDGET = 20.0  # seconds a network, for a user's world
STATES, PROBLEMS = (4000, 2500), (200, 40)  # full, quick
REPEATS = (3, 1)  # of a run, for its time
WARM_UP = 300  # states of the run that loads kernels outside the timed part
WIDE = 116  # columns of a terminal, where the table has room for more than all demos' tables have


def shapes(device: str = "cpu") -> dict[str, wb.shapes.Grid]:
    """The worlds whose bounders come with the demo, by the name under which these lie."""
    return {world.scene: world.grid for world in generated()}


@dataclass
class Demo(PlanningDemo):
    """Planning in 2D worlds; see ``sims.path`` and ``sims.base.Demo``. The only step plans everything in a world.

    Attributes:
        world: A file or a folder of worlds, instead of the generated ones; bounders of these are fitted, and kept in
            ``out``.
        states: Random states of a roadmap; 4,000, or 2,500 if quick.
        problems: Problems a world; 200, or 40 if quick.
    """

    world: str | Path | None = None
    NAME = "path"
    SPECS = SPECS
    SIZES: ClassVar = {"states": STATES, "problems": PROBLEMS}

    def set_up(self) -> dict[str, wb.shapes.Grid]:
        self.choose_sizes()
        if self.budget is not None and not self.budget > 0:
            raise wb.BoundingError(f"budget must be a positive number of seconds, got {self.budget}")
        self.worlds = generated() if self.world is None else worlds_at(self.world)
        self.steps, self.shape = 1, ", ".join(world.name for world in self.worlds)
        return {world.scene: world.grid for world in self.worlds}

    def fit(self, shapes: dict[str, wb.shapes.Grid]) -> dict[str, dict[str, wb.Bounder]]:
        whose = None if self.bounder_file is None else owner(self.bounder_file, shapes, self.specs["mlp"])
        if self.bounder_file is not None and whose is None:
            expected = ", ".join(f"{world.name} ({world.grid.digest[:12]})" for world in self.worlds)
            made = str(wb.load(self.bounder_file, device="cpu").info.get("indicator"))[:12]
            raise wb.BounderError(f"{self.bounder_file}: expected a bounder of one of {expected}, got one of {made}")
        if self.world is None:
            return super().fit(shapes)
        found, options = {}, self.fits | {"budget": self.budget or USERS_BUDGET, "own": True, "device": self.device}
        for world in self.worlds:
            file = self.bounder_file if world.scene == whose else None
            kept = [n for n, spec in self.specs.items() if not spec.closed and (n != "mlp" or file is None)]
            again = [n for n in kept if stored(world.scene, n, self.out).is_file() and not self.refit]
            found[world.scene] = bounders_of(world.scene, world.grid, self.specs, file=file, **options)
            if new := ", ".join(n for n in kept if n not in again):
                text = f"{world.name}: fitted {new} for this world; kept in {self.out} for the next time."
                self.console.print(text, markup=False)
            if again:
                text = f"{world.name}: took {', '.join(again)} from {self.out}, fitted to these very cells before."
                self.console.print(text, markup=False)
        return {method: {scene: found[scene][method] for scene in shapes} for method in self.specs}

    def simulate(self) -> tuple[list[Run], str, dict[str, str]]:
        options = {"states": self.states, "problems": self.problems, "seed": self.seed, "device": self.device}
        runs, self.examples = [], []
        for world in self.worlds:
            bounders, section = self.of_shape(world.scene), world.name if len(self.worlds) > 1 else ""
            broad = phases(bounders, world)
            taken = self.taken[world.name] = self.take(world, broad)
            label = taken.choices[world.scene].label
            more = {CHOSEN: broad.get(label)}
            examples = simulate(world, bounders, more=more, repeats=REPEATS[self.quick], **options)
            own = {name: {world.scene: bounder} for name, bounder in bounders.items()}
            own[CHOSEN] = {part: bounders[part] for part in label.split("+") if part in bounders}
            rows = self.rows[world.scene]
            runs += base.compare(examples, own, rows + taken.rows(rows, world.scene), section)
            self.examples.append(examples)
        about = f"{self.states:,} random states and {examples['none'].neighbours} neighbours each"
        return runs, f"{about}: exact checks of states and edges", self.COLUMNS if self.console.width >= WIDE else {}

    def take(self, world: World, broad: dict[str, BroadPhase]) -> Taken:
        """The cheapest in a world by a run without a broad phase: its states, its edges, a check's time."""
        exact = ExactWorld(world.grid, self.device or "cpu")
        run = Example(world, exact=exact, states=self.states, problems=self.problems, seed=self.seed)
        run.step()
        queried = {name: partial(run.left_by, phase) for name, phase in broad.items() if name not in UNPROVEN}
        return Taken({world.scene: time_own_code(queried, run.checks, 1e9 * run.seconds[0][1] / run.checks)})

    def tell(self, runs: list[Run]) -> None:
        """What collides, what is saved, what is solved, and whether it pays."""
        for run in runs:
            if not run.conservative:
                paths = f"{run.extra['collisions']:,} of its {run.extra['solved']:,} paths"
                self.console.print(f"[red]{run.bounder}[/] in {escape(run.extra['world'])}: {paths} collide.")
        for examples in self.examples:
            self.console.print(solved(examples), markup=False)
        self.console.print(price(runs))

    def draw(self) -> Drawn:
        names = ("mlp", "occupancy")
        pairs = [tuple(examples[name] for name in names) for examples in self.examples]
        queried = [tuple(self.of_shape(world.scene)[name] for name in names) for world in self.worlds]
        return Drawn([draw(self.out, pairs, queried, names)])

    def more(self) -> dict[str, Any]:
        """``worlds``, and ``bounders``: a row a world and bounder."""
        rows = [{"world": world.name, **row} for world in self.worlds for row in self.rows[world.scene]]
        return {"worlds": [described(examples["none"]) for examples in self.examples], "bounders": rows}


run = Demo.run


def phases(bounders: dict[str, wb.Bounder], world: World) -> dict[str, BroadPhase]:
    """The broad phases of a world's bounders, their cascade, and both sides together."""
    made: dict[str, BroadPhase] = {}
    for name, bounder in bounders.items():
        if name == INSIDE:
            continue  # by itself it clears nothing
        if not bounder.conservative:
            made[name] = Samples(bounder, world.grid.cells_per_unit)
        else:
            made[name] = BY_QUERY[bounder.query_kind](bounder)
    if {"aabb", "mlp"} <= made.keys():
        made[CASCADE] = First(made["aabb"], made["mlp"])
    if INSIDE in bounders:
        outer = [name for name in SIDED if name in made]
        made |= {f"{name}+{INSIDE}": TwoSided(made[name], bounders[INSIDE]) for name in outer}
    if "occupancy" in made:
        made["occupancy"] = made.pop("occupancy")  # what has no proof comes last
    return made


def simulate(
    world: World,
    bounders: dict[str, wb.Bounder],
    *,
    more: dict[str, BroadPhase | None] | None = None,
    repeats: int = 1,
    device: str = "cpu",
    **options,
) -> dict[str, Example]:
    """The same problems without a broad phase and with each; see ``sims.base.simulate``.

    Args:
        world: Where.
        bounders: By name.
        more: Broad phases beside these.
        repeats: How often each run is done, for its time.
        device: Warp device.
        options: Of ``Example``.
    """
    exact, broad = ExactWorld(world.grid, device), phases(bounders, world) | (more or {})
    broad = dict(sorted(broad.items(), key=lambda run: run[0] in UNPROVEN))  # what has no proof comes last

    def planned(phase: BroadPhase | None, small: bool) -> Example:
        return Example(world, phase, exact=exact, **options | ({"states": WARM_UP, "problems": 1} if small else {}))

    return base.simulate(f"planning in {world.name}", broad, planned, repeats)
