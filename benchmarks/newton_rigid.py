"""What the filter of pairs of meshes gains in Newton's rigid pass: `python benchmarks/newton_rigid.py`.

Scenes: a pile of bunnies, and one of nuts and threaded bolts, as they fall and at rest, by the solver of the demo
``pile``; and robots that stand on hills, of which the legs are meshes and the hills one mesh, or tiles. Each pass is
timed without and with the filter, in turns, on one core; what the filter takes of it is timed within. Contacts are
compared record by record. ``touching`` is the number of pairs that have a contact: no filter could leave fewer. Rows
are kept as they are known: run again, it goes on where it stopped.
"""

import argparse
import statistics
import sys
import time
from functools import cache
from pathlib import Path

import newton
import numpy as np
import trimesh
import warp as wp
import yourdfpy
from shared import StoredRows
from solids import bolt_and_nut, height, hills

import warp_bounding as wb
from sims.arm.robots import robots
from sims.pile import Example, Scene, shapes
from sims.threads import threads_of
from warp_bounding.newton import Cull

BODIES, STEPS, GAP = 60, (60, 180, 720), 0.01  # of piles: bodies, steps after which they are asked; of a unit's size
GRID, BALLS = {"nodes": 32, "reach": 0.4, "storage": "uint8"}, 256
ROBOTS, SIDE, CELLS, TILES = 12, 16.0, 160, 4  # on hills of so many metres, and cells a side; tiles a side
HILLS = {"reach": 0.05, "storage": "float16"}
NODES, STAND = {1: 64, TILES: 16}, 0.003  # of the distance of a mesh of hills; metres of contact gap, of each
RECORDS = ("shape0", "shape1", "point0", "point1", "normal", "offset0", "offset1", "margin0", "margin1")


class Shapes:
    """A Newton model that grows, and which bounders and balls its shapes have."""

    def __init__(self):
        self.builder, self.far, self.balls, self.meshes = newton.ModelBuilder(), {}, {}, {}

    def add(self, mesh: wb.shapes.Mesh, place: np.ndarray | None, gap: float, far=None, balls=None) -> int:
        """A mesh at rest, or on a body of its own."""
        if id(mesh) not in self.meshes:
            self.meshes[id(mesh)] = newton.Mesh(mesh.vertices, mesh.faces.reshape(-1)), mesh
        config = newton.ModelBuilder.ShapeConfig(gap=gap)
        body = -1 if place is None else self.builder.add_body(xform=wp.transform(*place.tolist()), mass=1.0)
        shape = self.builder.add_shape_mesh(body=body, mesh=self.meshes[id(mesh)][0], cfg=config)
        self.far |= {} if far is None else {shape: far}
        self.balls |= {} if balls is None else {shape: balls}
        return shape


@cache
def prepared(name: str) -> tuple[Scene, list, list, float]:
    """A pile before it falls, distances and balls of its meshes, and the seconds that they took."""
    given = {"bunny": shapes()["pile-bunny"]} if name == "bunnies" else bolt_and_nut()
    scene = Scene(BODIES, device="cpu", given=given)
    start, own = time.perf_counter(), scene.shapes.values()
    far = [wb.fit(shape, "distance", "distance-grid", device="cpu", **GRID) for shape in own]
    balls = [wb.pairs.Balls.of(shape, BALLS) for shape in own]
    return scene, far, balls, time.perf_counter() - start


def pile(name: str, steps: int) -> tuple[Shapes, float]:
    """Bodies after so many steps."""
    scene, far, balls, seconds = prepared(name)
    run, found, meshes = Example(scene), Shapes(), list(scene.shapes.values())
    for _ in range(steps):
        run.step()
    for place, kind in zip(run.places.numpy(), scene.kinds, strict=True):
        found.add(meshes[kind], place, GAP / 2, far[kind], balls[kind])
    return found, seconds


def standing(tiles: int) -> tuple[Shapes, float]:
    """Robots of four legs on hills, in a square, the lowest point of each on the ground."""
    found, rng, start = Shapes(), np.random.default_rng(4), time.perf_counter()
    for mesh in hills(SIDE, CELLS, tiles):
        found.add(
            mesh, None, STAND, wb.fit(mesh, "distance", "distance-grid", nodes=NODES[tiles], device="cpu", **HILLS)
        )
    folder = robots()
    urdf = yourdfpy.URDF.load(str(folder / "solo_description/robots/solo12.urdf"), load_meshes=False)
    joints = {name: (0.0, 0.7, -1.4)[("HAA", "HFE", "KFE").index(name[3:6])] for name in urdf.actuated_joint_names}
    urdf.update_cfg(joints)
    files, links = {}, []
    for name, link in urdf.link_map.items():
        for part in link.visuals:
            file = part.geometry.mesh.filename.split("example-robot-data/robots/")[-1]
            if file not in files:
                raw = trimesh.load(folder / file, force="mesh")
                raw.merge_vertices()
                shape = wb.shapes.Mesh(raw.vertices.astype(np.float32), np.asarray(raw.faces), name=name)
                files[file] = shape, wb.pairs.Balls.of(shape, BALLS // 4)
            links.append((*files[file], urdf.get_transform(name) @ (np.eye(4) if part.origin is None else part.origin)))
    seconds = time.perf_counter() - start
    across, corners = int(np.ceil(np.sqrt(ROBOTS))), [(mesh.vertices[::7], to) for mesh, _, to in links]
    for number in range(ROBOTS):
        x, y = (np.array(divmod(number, across)) + 0.5) * SIDE / across - SIDE / 2 + rng.uniform(-0.5, 0.5, 2)
        up = np.array([height(x - 0.1, y) - height(x + 0.1, y), height(x, y - 0.1) - height(x, y + 0.1), 0.2])
        ahead = np.cross(up, rng.normal(size=3))
        axes = np.stack([ahead, np.cross(up, ahead), up], axis=1)
        pose = np.eye(4)
        pose[:3, :3], pose[:2, 3] = axes / np.linalg.norm(axes, axis=0), (x, y)
        points = np.concatenate([trimesh.transform_points(own, pose @ to) for own, to in corners])
        pose[2, 3] = (height(points[:, 0], points[:, 1]) - points[:, 2]).max()
        own = []
        for mesh, balls, to in links:
            to = pose @ to
            turn = np.roll(trimesh.transformations.quaternion_from_matrix(to), -1)
            own.append(found.add(mesh, np.concatenate([to[:3, 3], turn / np.linalg.norm(turn)]), STAND, balls=balls))
        for k, one in enumerate(own):
            for other in own[:k]:
                found.builder.add_shape_collision_filter_pair(one, other)
    return found, seconds


SCENES = {f"{name}, after {steps} steps": (pile, name, steps) for name in ("bunnies", "nuts and bolts")
          for steps in STEPS}  # fmt: skip
SCENES |= {"robots on hills, one mesh": (standing, 1), f"robots on hills, {TILES**2} tiles": (standing, TILES)}


def records(contacts: newton.Contacts) -> list[np.ndarray]:
    """Contacts in their order."""
    count = int(contacts.rigid_contact_count.numpy()[0])
    return [getattr(contacts, f"rigid_contact_{name}").numpy()[:count].copy() for name in RECORDS]


def measure(name: str, rounds: int) -> dict:
    """A row."""
    make, *which = SCENES[name]
    found, seconds = make(*which)
    model = found.builder.finalize(device="cpu")
    pipelines = [newton.CollisionPipeline(model, deterministic=True) for _ in range(2)]
    cull = Cull(pipelines[1], found.far, balls=found.balls)
    state, contacts = model.state(), [pipeline.contacts() for pipeline in pipelines]
    rigid, spent = cull._rigid, []
    own = rigid._filter

    def timed() -> None:
        begin = time.perf_counter()
        own()
        spent.append(time.perf_counter() - begin)

    rigid._filter = timed
    times: list[list[float]] = [[], []]
    with threads_of(1):
        for _ in range(rounds + 1):  # the first loads kernels
            for way, held, took in zip((pipelines[0].collide, cull.collide), contacts, times, strict=True):
                begin = time.perf_counter()
                way(state, held)
                took.append(time.perf_counter() - begin)
    there, here = (records(held) for held in contacts)
    if not all(np.array_equal(a, b) for a, b in zip(there, here, strict=True)):
        raise wb.BounderError(f"{name}: expected the contacts of all pairs, got others with the filter")
    before, left = rigid.counts()
    triangles = sum(len(model.shape_source[s].indices) // 3 for s in range(model.shape_count))
    row = {"scene": name, "shapes": model.shape_count, "triangles": triangles, "pairs": before, "left": left}
    row |= {"touching": len(np.unique(np.stack(there[:2], 1), axis=0)), "contacts": len(there[0])}
    row |= {
        "ms": [1e3 * statistics.median(took[1:]) for took in times],
        "filter_ms": 1e3 * statistics.median(spent[1:]),
    }
    row["times"] = statistics.median(a / b for a, b in list(zip(*times, strict=True))[1:])
    return row | {"prepare_seconds": seconds, "newton": newton.__version__}


def page(kept: StoredRows, command: str) -> str:
    """The page that holds the rows."""
    rows = sorted(kept.rows, key=lambda row: list(SCENES).index(row["scene"]))
    best, worst = (kind(rows, key=lambda row: row["times"]) for kind in (max, min))
    whole, tiles = (row for row in rows if row["scene"].startswith("robots"))
    verb = "gains little" if whole["times"] < 1.1 else "gains"
    on_hills = (
        f"A mesh of the ground {verb}: {whole['times']:.1f} times as fast, though of {whole['left']} pairs left only "
        f"{whole['touching']} touch, as a distance with a node every {100 * SIDE / NODES[1]:.0f} cm cannot tell a foot "
        f"from the ground. Cut into tiles it is {whole['ms'][0] / tiles['ms'][0]:.1f} times as fast without a filter, "
        f"with one {whole['ms'][0] / tiles['ms'][1]:.1f}"
    )
    lines = [
        "# What the filter of pairs of meshes gains in Newton",
        "",
        f"**Newton's rigid pass is {worst['times']:.1f} ({worst['scene']}) to {best['times']:.1f} ({best['scene']}) "
        "times as fast. Contacts are the same, record by record. In piles nearly all pairs that are left touch: their "
        f"time stays. {on_hills}.**",
        "",
        f"`{command}`",
        "",
        f"{kept.about}, of which one is used; Newton {rows[0]['newton']}.",
        "",
        f"Piles of {BODIES} bodies; {ROBOTS} robots of four legs on {SIDE:g} m of hills. *Left*: pairs that the filter "
        "leaves of those of the broad phase. *Touching*: pairs that have a contact. *Filter*: its part of the pass. "
        "*Prepare*: to fit distances and balls of all meshes. Medians.",
        "",
        "| scene | shapes | triangles | pairs | left | touching | contacts | ms, without | ms, with | filter, ms "
        "| times as fast | prepare, s |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for row in rows:
        cells = [row["scene"], *(f"{row[key]:,}" for key in ("shapes", "triangles", "pairs", "left", "touching"))]
        cells += [f"{row['contacts']:,}", *(f"{ms:.1f}" for ms in row["ms"]), f"{row['filter_ms']:.2f}"]
        lines.append("| " + " | ".join([*cells, f"**{row['times']:.2f}**", f"{row['prepare_seconds']:.0f}"]) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure what is not there yet, and make the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/newton/rigid"))
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    wp.config.log_level = max(wp.config.log_level, wp.LOG_WARNING)
    kept = StoredRows(options.out, "rigid")
    for name in SCENES:
        if not kept.have(scene=name):
            kept.add(measure(name, options.rounds))
            print(kept.rows[-1], file=sys.stderr)
    kept.write(page(kept, "python benchmarks/newton_rigid.py"))


if __name__ == "__main__":
    try:
        main()
    except wb.BoundingError as error:
        sys.exit(f"newton_rigid: {error}")
    except KeyboardInterrupt:
        sys.exit("newton_rigid: stopped; run it again, and it goes on where it was")
