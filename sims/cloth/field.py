"""Many meshes, many particles: one contact pass of Newton, timed with and without bounders, at three contact gaps.

Bunnies and stars, turned, scaled and some of them on moving bodies, among particles. Newton tests every particle
against every shape; before it searches a mesh, it rejects particles outside of the mesh's bounding box, as it lies in
the world, widened by the gap. That is a broad phase of its own, and a good one: a bounder has to earn its cost on what
is left, the particles in the box but not near the mesh.

A round moves bodies and particles, then lets Newton's own pass and each bounder's handle that very state, one after
another, so that their ratios are paired; contacts are compared record by record. All have one thread, but for the rows
that say otherwise. What no bounder can save is the search of the meshes for true contacts, and at wide gaps that is
most of the pass.

Closed forms are fitted for each gap. Of networks of points there are two a mesh, those of the cloth, for the narrowest
gap, and wider ones that serve the others; a bounder that is wider than it need be is looser. A network of the distance
(``distance``) is one a mesh, the same for all gaps: it is asked whether the mesh is farther away than the gap.
"""

import time
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property

import newton
import numpy as np
import warp as wp
from rich import box
from rich.table import Table

import warp_bounding as wb
from sims.cloth.example import contact_keys, contact_records
from sims.cloth.scene import CELLS, GAP, RADIUS, SHAPES, dilated, newton_mesh
from sims.prefitted import FitSpec, fitted
from sims.report import shown
from sims.threads import threads_of
from warp_bounding.newton import Cull

__all__ = ["FIELD_SPECS", "GAPS", "Field", "bounders_for", "field_table", "measure", "sentences"]

GAPS = (GAP, 0.05, 0.2)
SPACING = 2.4  # from one mesh to the next, world units
SCALES = (1.0, 1.1, 1.2)  # at least 1: margins are in a mesh's own units
SHAKEN = 0.05  # how far bodies and particles move from round to round, world units
EVERY = 3  # each third mesh is on a body
ALL_CORES = "voxels"
HIDDEN = (25, 25)
WARM_UP = 2  # rounds that load kernels

CLOSED = {"aabb": FitSpec("aabb"), "kdop": FitSpec("kdop"), "bvh": FitSpec("bvh", options={"hidden": HIDDEN}, **CELLS)}
CLOSED["voxels"] = FitSpec("voxels", **CELLS)
FIELD_SPECS = {"mlp": FitSpec("mlp", budget=90.0, options={"hidden": HIDDEN})}


def bounders_for(
    gap: float,
    networks: dict[str, wb.Bounder],
    wide: dict[str, wb.Bounder],
    distances: dict[str, wb.DistanceBounder] | None = None,
) -> dict[str, dict[str, wb.Bounder]]:
    """The bounders of a gap.

    Args:
        gap: Soft contact gap, world units.
        networks: By shape, those of the cloth.
        wide: By shape, those of the widest gap.
        distances: By shape, those of the cloth, which serve all gaps; ``None`` for none.

    Returns:
        By name of the method, then by name of the shape.
    """
    closed = fitted({name: dilated(name, gap) for name in SHAPES}, CLOSED)
    return closed | {"mlp": networks if gap <= GAP else wide} | ({"distance": distances} if distances else {})


@dataclass(frozen=True, eq=False)
class Field:
    """The scene.

    Attributes:
        rows: Meshes along a side; there are their square.
        particles: How many.
        seed: Of all places and turns.
    """

    rows: int = 6
    particles: int = 20_000
    seed: int = 0

    @cached_property
    def shapes(self) -> dict[int, str]:
        """By index of the shape its name."""
        return {index: SHAPES[(index + index // self.rows) % 2] for index in range(self.rows**2)}

    @cached_property
    def model(self) -> newton.Model:
        """Meshes in rows, turned and scaled, and particles among them; meshes do not meet each other."""
        rng = np.random.default_rng(self.seed)
        builder = newton.ModelBuilder(up_axis=newton.Axis.Y)
        surface = newton.ModelBuilder.ShapeConfig(margin=0.0, density=100.0, has_shape_collision=False)
        reach = SPACING * (self.rows - 1) / 2
        for index, name in self.shapes.items():
            row, column = divmod(index, self.rows)
            turn = wp.quat_from_axis_angle(wp.normalize(wp.vec3(*rng.normal(size=3))), float(rng.uniform(0.0, np.pi)))
            place = wp.transform(wp.vec3(SPACING * column - reach, 0.0, SPACING * row - reach), turn)
            carried = index % EVERY == 0
            builder.add_shape_mesh(
                body=builder.add_body(xform=place) if carried else -1,
                xform=wp.transform_identity() if carried else place,
                mesh=newton_mesh(name),
                scale=wp.vec3(*rng.choice(SCALES, size=3).tolist()),
                cfg=surface,
            )
        half = reach + SPACING / 2
        x = rng.uniform([-half, -SPACING / 2, -half], [half, SPACING / 2, half], (self.particles, 3))
        zero = [wp.vec3(0.0)] * self.particles
        builder.add_particles(
            [wp.vec3(*p) for p in x.tolist()], zero, [0.01] * self.particles, [RADIUS] * self.particles
        )
        return builder.finalize(device="cpu")

    def shake(self, state: newton.State, rng: np.random.Generator) -> None:
        """Move particles and bodies a little."""
        q = state.particle_q.numpy()
        state.particle_q.assign(q + rng.uniform(-SHAKEN, SHAKEN, q.shape).astype(np.float32))
        if self.model.body_count:
            place = state.body_q.numpy()
            place[:, :3] += rng.uniform(-SHAKEN, SHAKEN, (len(place), 3)).astype(np.float32)
            state.body_q.assign(place)


def measure(field: Field, gap: float, bounders: dict[str, dict[str, wb.Bounder]], *, rounds: int) -> dict:
    """Time one contact pass, with and without bounders.

    Args:
        field: The scene.
        gap: Soft contact gap, world units.
        bounders: From ``bounders_for``.
        rounds: Repeats; medians are taken over them.

    Returns:
        JSON-ready: ``gap``, ``newton_ms``, ``pairs``, ``contacts``, ``bounders``: per bounder ``bounder``, ``ms``,
        ``ratio`` (median over the rounds of Newton's time by this one's: over 1 is faster), ``survivors`` (pairs left,
        of the last round), ``missed`` (contacts, in all rounds), ``identical`` (in all rounds, record by record).

    Raises:
        BounderError: For a bounder that does not fit.
    """
    pipeline = newton.CollisionPipeline(field.model, soft_contact_gap=gap)
    contacts, state = pipeline.contacts(), field.model.state()
    culls = {
        name: Cull(pipeline, {index: of_shape[shape] for index, shape in field.shapes.items()})
        for name, of_shape in bounders.items()
    }
    if ALL_CORES in culls:
        culls[f"{ALL_CORES}, all cores"] = culls[ALL_CORES]
    rng, shapes = np.random.default_rng(field.seed + 1), field.model.shape_count
    spent: dict[str, list[float]] = {name: [] for name in ("newton", *culls)}
    missed, same, survivors = dict.fromkeys(culls, 0), dict.fromkeys(culls, True), {}
    for number in range(WARM_UP + rounds):
        field.shake(state, rng)
        for name in spent:
            with nullcontext() if name.endswith("all cores") else threads_of(1):
                begin = time.perf_counter()
                (pipeline if name == "newton" else culls[name]).collide(state, contacts)
                took = time.perf_counter() - begin
            if number >= WARM_UP:
                spent[name].append(took)
            if name == "newton":
                records = [array.copy() for array in contact_records(contacts)]
                keys = contact_keys(contacts, shapes).copy()
                continue
            missed[name] += len(np.setdiff1d(keys, contact_keys(contacts, shapes)))
            here = contact_records(contacts)
            same[name] &= all(a.tobytes() == b.tobytes() for a, b in zip(records, here, strict=True))
            survivors[name] = culls[name].survivors
    times = {name: np.array(values) for name, values in spent.items()}
    rows = [
        {
            "bounder": name,
            "ms": 1e3 * float(np.median(times[name])),
            "ratio": float(np.median(times["newton"] / times[name])),
            "survivors": survivors[name],
            "missed": missed[name],
            "identical": same[name],
        }
        for name in culls
    ]
    head = {
        "gap": gap,
        "newton_ms": 1e3 * float(np.median(times["newton"])),
        "pairs": len(pipeline.soft_rigid_contact_pairs),
    }
    return head | {"contacts": len(keys), "bounders": rows}


def run_field(
    field: Field,
    networks: dict[str, wb.Bounder],
    distances: dict[str, wb.DistanceBounder] | None = None,
    *,
    rounds: int,
    **options,
) -> list[dict]:
    """Measure all gaps.

    Args:
        field: The scene.
        networks: By shape, those of the cloth.
        distances: By shape, those of the cloth; ``None`` for none.
        rounds: Repeats.
        options: Of ``sims.prefitted.bounders_of``, for the networks of the wider gaps.

    Returns:
        Per gap what ``measure`` returns.
    """
    shapes = {name: dilated(name, max(GAPS)) for name in SHAPES}
    wide = fitted(shapes, FIELD_SPECS, scenes="field-", **options)["mlp"]
    gaps = shown(GAPS, "many meshes")
    return [measure(field, gap, bounders_for(gap, networks, wide, distances), rounds=rounds) for gap in gaps]


def field_table(field: Field, rows: list[dict]) -> Table:
    """The measurements for people."""
    title = f"One contact pass: {field.rows**2} meshes, {field.particles:,} particles"
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("contact gap", justify="right")
    table.add_column("broad phase", no_wrap=True)
    for head in ("pairs", "pass ms", "times faster", "missed"):
        table.add_column(head, justify="right")
    table.add_column("contacts")
    for row in rows:
        newtons = (f"{row['pairs']:,}", f"{row['newton_ms']:.1f}", "", "", f"{row['contacts']:,}")
        table.add_row(f"{row['gap']:g}", "Newton's own", *newtons)
        for place, entry in enumerate(row["bounders"]):
            outcome = "identical" if entry["identical"] else "[bold red]differ[/]"
            numbers = (f"{entry['survivors']:,}", f"{entry['ms']:.1f}", f"{entry['ratio']:.2f}", f"{entry['missed']}")
            table.add_row("", entry["bounder"], *numbers, outcome, end_section=place == len(row["bounders"]) - 1)
    return table


def sentences(rows: list[dict]) -> str:
    """Who wins at each gap, on one thread; where Newton's own early reject does, it is said."""
    lines = []
    for row in rows:
        single = [entry for entry in row["bounders"] if "all cores" not in entry["bounder"]]
        best = max(single, key=lambda entry: entry["ratio"])
        slower = [entry["bounder"] for entry in single if entry["ratio"] < 1.0]
        line = f"Gap {row['gap']:g}: {best['bounder']} is {best['ratio']:.2f} times as fast as Newton's own pass"
        if best["ratio"] < 1.0:
            line = (
                f"Gap {row['gap']:g}: Newton's own early reject wins; {best['bounder']} comes closest, "
                f"{best['ratio']:.2f} times as fast"
            )
        elif slower:
            line += f"; its early reject beats {', '.join(slower)}"
        more = [f"{e['bounder']}: {e['ratio']:.2f}" for e in row["bounders"] if e not in single]
        lines.append("; ".join([line, *more]) + ".")
    return "\n".join(lines)
