"""When a cull of Newton's passes over whole soft surfaces pays: `python benchmarks/newton_surfaces.py`.

A cloth comes down on bunnies and stars that stand in a square: in each of some states it is a plane, or lies where the
meshes, and their neighbourhood, hold it up. A round goes through the states, and times ``collide`` of each without a
cull, with one that has no bounders, and with bounders of distances that come with the demos, in turns. Shares of the
time without are taken within a state; the row keeps their medians, and those of sums over all states. Contacts are
compared record by record. The pipeline has room for twice as many contacts as there are; by default Newton makes room
for millions, which is timed, too. Everything runs on one core of a CPU. Rows are kept as they are known.
"""

import argparse
import statistics
import sys
import time
from pathlib import Path

import newton
import numpy as np
import warp as wp
from newton_map import SPACING, scene
from shared import StoredRows

import warp_bounding as wb
from sims.cloth.scene import RADIUS, SHAPES
from sims.prefitted import stored
from sims.threads import threads_of
from warp_bounding.newton import Cull

SIDES, MESHES, GAP = (36, 71, 142), (4, 16), 0.02  # of the cloth, in squares of two triangles; metres
STATES, ABOVE, BELOW = 8, 0.1, 1.2  # of the fall; metres above the highest point, and below it at the end
SLACK = 0.004  # metres a cloth may hang below its neighbours
RECORDS = ("particle", "shape", "body_pos", "normal", "indices", "barycentric", "rigid_indices")
WAYS = ("none", "boxes", "distance")


def cloth(side: int, meshes: int, device: str = "cpu") -> tuple[newton.Model, dict[int, str], list[np.ndarray]]:
    """The model, the names of the meshes by their shapes, and the cloth's particles in each state."""
    builder, named = scene(0, meshes)
    width = SPACING * int(np.ceil(np.sqrt(meshes)))
    builder.add_cloth_grid(
        pos=wp.vec3(-SPACING / 2, 0.0, -SPACING / 2), rot=wp.quat_from_axis_angle(wp.vec3(1.0, 0.0, 0.0), wp.pi / 2),
        vel=wp.vec3(0.0), dim_x=side, dim_y=side, cell_x=width / side, cell_y=width / side, mass=0.01,
        particle_radius=RADIUS,
    )  # fmt: skip
    model = builder.finalize(device=device)
    flat, heights = model.particle_q.numpy(), np.full((side + 1, side + 1), -np.inf)
    state = model.state()
    for shape in named:
        mesh, body = model.shape_source[shape], int(model.shape_body.numpy()[shape])
        place = model.shape_transform.numpy()[shape] if body < 0 else state.body_q.numpy()[body]
        points = np.array([wp.transform_point(wp.transform(*place), wp.vec3(*x)) for x in mesh.vertices])
        cells = np.clip(((points[:, [0, 2]] + SPACING / 2) / width * side).astype(int), 0, side - 1)
        for corner in np.ndindex(2, 2):
            np.maximum.at(heights, tuple((cells + corner).T), points[:, 1] + 1.5 * RADIUS)
    top = heights.max()
    at = np.rint((flat[:, [0, 2]] + SPACING / 2) / width * side).astype(int)
    found = []
    for level in np.linspace(top + ABOVE, top - BELOW, STATES):
        held = np.maximum(heights, level)
        for _ in range(4 * side):
            sides = np.pad(held, 1, mode="edge")
            around = sides[2:, 1:-1] + sides[:-2, 1:-1] + sides[1:-1, 2:] + sides[1:-1, :-2]
            held = np.maximum(held, around / 4 - SLACK)
        q = flat.copy()
        q[:, 1] = held[tuple(at.T)]
        found.append(q.astype(np.float32))
    return model, named, found


def pipeline_of(model: newton.Model, **options) -> newton.CollisionPipeline:
    return newton.CollisionPipeline(model, soft_contact_gap=GAP, enable_rigid_soft_full_surface_contact=True, **options)


def records(contacts: newton.Contacts) -> list[np.ndarray]:
    """Contacts in their order."""
    count = int(contacts.soft_contact_count.numpy()[0])
    return [getattr(contacts, f"soft_contact_{name}").numpy()[:count].copy() for name in RECORDS]


def measure(side: int, meshes: int, rounds: int) -> dict:
    """A row."""
    model, named, states = cloth(side, meshes)
    state, roomy, counts = model.state(), pipeline_of(model), []
    contacts = roomy.contacts()
    for q in states:
        state.particle_q.assign(q)
        roomy.collide(state, contacts)
        counts.append(int(contacts.soft_contact_count.numpy()[0]))
    files = {name: wb.load(stored("cloth", f"{name}-distance"), device="cpu") for name in SHAPES}
    own = {shape: files[name] for shape, name in named.items()}
    pipelines = [pipeline_of(model, soft_contact_max=2 * max(counts) + 1000) for _ in WAYS]
    culls = [Cull(pipelines[1]), Cull(pipelines[2], own)]
    ways = dict(zip(WAYS, (pipelines[0].collide, culls[0].collide, culls[1].collide), strict=True))
    contacts = pipelines[0].contacts()
    tallies = []
    for q in states:
        state.particle_q.assign(q)
        found = []
        for collide in ways.values():
            collide(state, contacts)
            found.append(records(contacts))
        if not all(np.array_equal(a, b) for other in found[1:] for a, b in zip(found[0], other, strict=True)):
            raise wb.BounderError("expected the contacts of all pairs, got others with a cull")
        tallies.append({name: [t.pairs, t.culled] for name, t in culls[1].tally().items()})
    ways["roomy"] = roomy.collide
    wide, times = roomy.contacts(), []
    with threads_of(1):
        for _ in range(rounds):
            for number, q in enumerate(states):
                state.particle_q.assign(q)
                turn = {"state": number}
                for name, collide in ways.items():
                    begin = time.perf_counter()
                    collide(state, wide if name == "roomy" else contacts)
                    turn[name] = time.perf_counter() - begin
                times.append(turn)
    row = {"triangles": 2 * side**2, "meshes": meshes, "contacts": counts, "tally": tallies}
    middle = lambda name, k: statistics.median(t[name] for t in times if t["state"] == k)  # noqa: E731
    row["ms"] = {name: [1e3 * middle(name, k) for k in range(STATES)] for name in ways}
    row["times"] = {
        name: [statistics.median(t["none"] / t[name] for t in times if t["state"] == k) for k in range(STATES)]
        for name in WAYS[1:]
    }
    return row


def page(kept: StoredRows, command: str) -> str:
    """The page that holds the rows."""
    whole = {name: [sum(r["ms"]["none"]) / sum(r["ms"][name]) for r in kept.rows] for name in WAYS[1:]}
    lines = [
        "# When a cull of Newton's passes over soft surfaces pays",
        "",
        f"**Over a whole fall Newton's passes are {min(whole['boxes']):.1f} to {max(whole['boxes']):.1f} times as fast "
        f"with a cull that has no bounders, {min(whole['distance']):.1f} to {max(whole['distance']):.1f} with bounders "
        "of distances.** Contacts are the same, record by record; what is left are true contacts.",
        "",
        f"`{command}`",
        "",
        f"{kept.about}, of which one is used; Newton {newton.__version__}.",
        "",
        f"A cloth comes down on bunnies and stars in {STATES} states, contact gap {GAP:g} m. *First*, *last*: of the "
        "first and the last state. *By default*: without a cull, with the room for contacts that Newton makes by "
        "itself. A row's medians; times of one core.",
        "",
        "| triangles | meshes | contacts, last | ms, none: first, last | by default | times as fast, boxes: first, "
        "last, whole fall | with bounders |",
        "|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for row in sorted(kept.rows, key=lambda r: (r["meshes"], r["triangles"])):
        ms, times = row["ms"], row["times"]
        cells = [f"{row['triangles']:,}", row["meshes"], f"{row['contacts'][-1]:,}"]
        cells += [f"{ms['none'][0]:.1f}, {ms['none'][-1]:.1f}", f"{ms['roomy'][0]:.0f}, {ms['roomy'][-1]:.0f}"]
        cells += [
            f"{times[name][0]:.2f}, {times[name][-1]:.2f}, **{sum(ms['none']) / sum(ms[name]):.2f}**"
            for name in WAYS[1:]
        ]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure what is not there yet, and make the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/newton/surfaces"))
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    wp.config.log_level = max(wp.config.log_level, wp.LOG_WARNING)
    kept = StoredRows(options.out, "surfaces")
    for meshes in MESHES:
        for side in SIDES:
            if not kept.have(triangles=2 * side**2, meshes=meshes):
                kept.add(measure(side, meshes, options.rounds))
                print(kept.rows[-1]["triangles"], meshes, kept.rows[-1]["times"], file=sys.stderr)
    kept.write(page(kept, "python benchmarks/newton_surfaces.py"))


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("newton_surfaces: stopped; run it again, and it goes on where it was")
