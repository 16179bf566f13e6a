"""A cell that was scanned: its triangles, its points or a proven distance? `python benchmarks/scan.py --out DIR`.

The cell of seven joints (`sims/arm/seven.py`) as a scanner sees it: all surfaces in small triangles, whose corners are
off by a millimetre or so. Edges are drawn as planners ask, near two configurations and anywhere, and count where dense
samples accept them, by Coal on the robot's meshes and on all triangles. How many are proven, from how many bytes, and
how long does a proof take, compared with samples in the same run on one core? `--attack` asks Coal about so many random
samples of each proven edge. Rows are kept, and the same command goes on.
"""

import os

os.environ.setdefault("WARP_BOUNDING_THREADS", "1")

import argparse
import time
from functools import partial
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import trimesh
from motions import DENSE, USUAL, clock, drawn, samples_of
from shared import StoredRows

import warp_bounding as wb
from sims.arm.robots import ROBOTS, robots
from sims.arm.seven import GOAL, OPEN, START, cell
from warp_bounding.arms import Cylinder, Motions, Scan
from warp_bounding.arms.motions import _box_around

LONGEST, NOISE = 0.02, 0.001  # metres: of a triangle's edges, and by how much the scanner is off
ROUNDS, TIMES = 8, 10  # of edges that are drawn, and of a batch that is timed
NODES, FIT = (32, 64), 600.0  # of grids, along the longest side; seconds for a fit
FINEST = 8  # of a body's box: the share of it that balls hold, as in `native/motions.h`


def scanned(things) -> wb.shapes.Mesh:
    """Bodies in small triangles, with noise."""
    rng, parts = np.random.default_rng(0), []
    for thing in things:
        if isinstance(thing, Cylinder):
            part = trimesh.creation.cylinder(thing.radius, thing.length, transform=thing.pose)
        else:
            part = trimesh.PointCloud(thing.points).convex_hull
        part = part.subdivide_to_size(LONGEST)
        part.merge_vertices()
        part.vertices += rng.normal(size=part.vertices.shape) * NOISE
        parts.append(part)
    whole = trimesh.util.concatenate(parts)
    return wb.shapes.Mesh(whole.vertices, whole.faces, name="scan")


class Meshes:
    """Coal on the robot's meshes and on the triangles of a scan."""

    def __init__(self, mesh: wb.shapes.Mesh, arm: wb.arms.Arm):
        urdf, srdf = (str(robots() / file) for file in (ROBOTS["panda"].urdf, ROBOTS["panda"].srdf))
        self.model = pin.buildModelFromUrdf(urdf)
        folders = [str(robots().parent), str(robots().parent.parent)]
        self.geometry = pin.buildGeomFromUrdf(self.model, urdf, pin.GeometryType.COLLISION, folders)
        self.geometry.addAllCollisionPairs()
        pin.removeCollisionPairs(self.model, self.geometry, srdf)
        triangles, corners, faces = coal.BVHModelOBBRSS(), coal.StdVec_Vec3s(), coal.StdVec_Triangle()
        corners.extend(list(mesh.vertices.astype(np.float64)))
        faces.extend([coal.Triangle(*map(int, face)) for face in mesh.faces])
        triangles.beginModel(len(faces), len(corners))
        triangles.addSubModel(corners, faces)
        triangles.endModel()
        own = self.geometry.ngeoms
        number = self.geometry.addGeometryObject(pin.GeometryObject("scan", 0, 0, pin.SE3.Identity(), triangles))
        for k in range(own):
            if self.geometry.geometryObjects[k].parentJoint:
                self.geometry.addCollisionPair(pin.CollisionPair(k, number))
        self.data, self.found = self.model.createData(), pin.GeometryData(self.geometry)
        self.rest = pin.neutral(self.model)
        for joint, value in OPEN.items():
            for name in (joint, joint.replace("1", "2")):
                self.rest[self.model.joints[self.model.getJointId(name)].idx_q] = value
        names = [arm.joints[i].name for i in arm.free]
        self.columns = [self.model.joints[self.model.getJointId(name)].idx_q for name in names]

    def hits(self, q: np.ndarray) -> np.ndarray:
        """Which configurations ``(N, n)`` collide."""
        values = np.tile(self.rest, (len(q), 1))
        values[:, self.columns] = q
        given = self.model, self.data, self.geometry, self.found
        return np.array([pin.computeCollisions(*given, x, True) for x in values], dtype=bool)


def accepted(arm: wb.arms.Arm, meshes: Meshes) -> tuple[np.ndarray, np.ndarray]:
    """Starts and ends ``(N, n)`` of edges that dense samples accept."""
    kept = []
    for seed in range(ROUNDS):
        q0, q1 = drawn(np.random.default_rng(seed), np.array([START, GOAL]), arm.lower, arm.upper)
        for a, b in zip(q0, q1, strict=True):
            coarse, fine = (samples_of(a[None], b[None], rate)[0] for rate in (8, DENSE))
            if not (meshes.hits(coarse).any() or meshes.hits(fine).any()):
                kept.append((a, b))
    return np.array(kept)[:, 0], np.array(kept)[:, 1]


def main() -> None:
    """Measure what is not yet known, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("results/scan"))
    parser.add_argument("--attack", type=int, default=200, help="Samples of each proven edge that Coal is asked.")
    options = parser.parse_args()
    around = cell()
    mesh, rows = scanned(around.obstacles), StoredRows(options.out, "scan")
    meshes = Meshes(mesh, around.arm)
    q0, q1 = accepted(around.arm, meshes)
    usual, corners = samples_of(q0, q1, USUAL)[0], mesh.vertices.astype(np.float64)[mesh.faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    around_corner = sides.prod(axis=1) / (4 * area)  # radii of circles around triangles; of blunt ones half a side
    blunt = 2 * sides.max(axis=1) ** 2 > (sides**2).sum(axis=1)
    radius = float(np.where(blunt, sides.max(axis=1) / 2, around_corner).max()) * 1.001
    print(len(mesh.faces), "triangles,", len(q0), "edges, radius", radius, flush=True)
    contestants = {
        "triangles": lambda: ([Scan.of_mesh(mesh)], {"bytes": mesh.vertices.nbytes + mesh.faces.nbytes}),
        "points": lambda: ([Scan.of_points(mesh.vertices, radius)], {"bytes": mesh.vertices.nbytes}),
    }
    contestants |= {f"distance, {nodes} nodes": partial(grid_of, mesh, nodes) for nodes in NODES}
    contestants["the latter, then triangles"] = partial(grid_of, mesh, NODES[-1], Scan.of_mesh(mesh))
    if not rows.have(obstacle="Coal"):
        spent, _ = clock(lambda: meshes.hits(usual))
        spent_all = {"seconds": spent, "samples": len(usual), "edges": len(q0), "triangles": len(mesh.faces)}
        rows.add({"obstacle": "Coal", "bytes": mesh.vertices.nbytes + mesh.faces.nbytes} | spent_all)
    for name, make in contestants.items():
        if rows.have(obstacle=name):
            continue
        started = time.perf_counter()
        obstacles, about = make()
        about |= {"made_s": time.perf_counter() - started}
        ways = [Motions(around.arm, obstacle) for obstacle in obstacles]
        rows.add({"obstacle": name} | about | measured(ways, meshes, q0, q1, options.attack))
        print(rows.rows[-1], flush=True)
    if not rows.have(obstacle="network"):
        started = time.perf_counter()
        far = wb.fit(mesh, "distance", "mlp", hidden=(32, 32), budget=FIT / 4, device="cpu")
        row = {"obstacle": "network", "bytes": far.nbytes, "slack": far.slack, "edges": len(q0)}
        row["at_most"] = int(clear_at_most(around.arm, far, q0, q1).sum())
        rows.add(row | {"made_s": time.perf_counter() - started})
    rows.write(page(rows, options.out))


def grid_of(mesh: wb.shapes.Mesh, nodes: int, *others: Scan):
    """A proven distance as an obstacle, with others, its bytes and its slack."""
    far = wb.fit(mesh, "distance", "distance-grid", nodes=nodes, budget=FIT, device="cpu")
    size = far.nbytes + sum(mesh.vertices.nbytes + mesh.faces.nbytes for _ in others)
    return [far.field(), *others], {"bytes": size, "slack": far.slack}


def asked(ways: list[Motions], q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
    """Which edges ``(N,)`` are clear, by the first way or by a later one."""
    clear, _ = ways[0].segments(q0, q1)
    for motions in ways[1:]:
        rest = np.flatnonzero(~clear)
        clear[rest] = motions.segments(q0[rest], q1[rest])[0]
    return clear


def measured(ways: list[Motions], meshes: Meshes, q0: np.ndarray, q1: np.ndarray, attack: int) -> dict:
    """What is proven of edges, and how long it takes."""
    ends, usual = np.array([START, GOAL]), samples_of(q0, q1, USUAL)[0]
    clear = asked(ways, q0, q1)
    ways[-1].configurations(usual)  # compiles
    many = [np.tile(q, (TIMES, 1)) for q in (q0, q1)]
    spent, _ = clock(lambda: asked(ways, *many))
    sampled, _ = clock(lambda: ways[-1].configurations(usual))
    anywhere = ~((q0[:, None] == ends).all(axis=2) | (q1[:, None] == ends).all(axis=2)).any(axis=1)
    row = {"edges": len(q0), "proven": int(clear.sum()), "seconds": spent / TIMES}
    row |= {"anywhere": int(anywhere.sum()), "proven_anywhere": int(clear[anywhere].sum()), "samples_s": sampled}
    t = np.random.default_rng(0).uniform(size=(attack, int(clear.sum()), 1))
    dense = (q0[clear] + t * (q1[clear] - q0[clear])).reshape(-1, q0.shape[1])
    return row | {"attacked": len(dense), "refuted": int(meshes.hits(dense).sum())}


def clear_at_most(arm: wb.arms.Arm, far, q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
    """Which edges ``(N,)`` a distance could prove at most: at samples, by balls around halves of the bodies' boxes."""
    x, rows = samples_of(q0, q1, USUAL)
    frames, clear = arm.frames(x), np.ones(len(x), dtype=bool)
    for body in (body for body in arm.bodies if body.link != wb.arms.WORLD):
        frame, half = _box_around(body.points)
        least, stack = np.linalg.norm(half) / FINEST, [(np.zeros(3), half, np.flatnonzero(clear))]
        while stack:
            middle, half, left = stack.pop()
            left, pose, radius = left[clear[left]], frames[left[clear[left]], body.link], np.linalg.norm(half)
            place = frame[:9].reshape(3, 3) @ middle + frame[9:]
            away = far.distance((pose[:, :3, :3] @ place + pose[:, :3, 3]).astype(np.float32)).numpy()
            left = left[away <= radius + body.radius]
            if radius <= least:
                clear[left] = False
            elif len(left):
                step = np.where(np.arange(3) == half.argmax(), half / 2, 0.0)
                stack += [(middle + sign * step, half - step, left) for sign in (-1, 1)]
    return np.bincount(rows, ~clear, minlength=len(q0)) == 0


def page(rows: StoredRows, folder: Path) -> str:
    """The page of all rows."""
    coal_row = next(row for row in rows.rows if row["obstacle"] == "Coal")
    edges = coal_row["edges"]
    lines = [
        "# A cell that was scanned\n",
        f"`python benchmarks/scan.py --out {folder}`\n",
        f"{rows.about}. A Panda of seven joints in the cell of `python -m sims arm`, scanned: "
        f"{coal_row['triangles']:,} triangles with noise of {1000 * NOISE:g} mm. {edges:,} edges that samples at "
        f"{DENSE} a radian accept, by Coal on the robot's meshes and all triangles; a third of them end in one of two "
        "configurations that are millimetres from a can. *Points* are the triangles' corners, with a radius that holds "
        f"these. Times of an edge on one core; Coal's, and *sampled*, at {USUAL} samples a radian.\n",
        "| obstacle | kB | made in, s | edges proven | of those that end anywhere | us an edge | sampled, us "
        "| samples of proven edges that collide |",
        "|---|--:|--:|--:|--:|--:|--:|--:|",
        f"| Coal, samples only | {coal_row['bytes'] / 1000:,.0f} | | none | none | "
        f"| {1e6 * coal_row['seconds'] / edges:,.0f} | |",
    ]
    for row in (row for row in rows.rows if "proven" in row):
        lines.append(
            f"| {row['obstacle']} | {row['bytes'] / 1000:,.0f} | {row['made_s']:.1f} | "
            f"{100 * row['proven'] / edges:.1f} % | {100 * row['proven_anywhere'] / row['anywhere']:.1f} % | "
            f"{1e6 * row['seconds'] / edges:.1f} | "
            f"{1e6 * row['samples_s'] / edges:.0f} | {row['refuted']} of {row['attacked']:,} |"
        )
    network = next((row for row in rows.rows if row["obstacle"] == "network"), None)
    if network is not None:
        size, share, short = network["bytes"] / 1000, 100 * network["at_most"] / edges, 1000 * network["slack"]
        lines.append(
            f"\nA network of {size:.1f} kB could prove {share:.1f} % of these edges at most, as its distances are "
            f"{short:.0f} mm too short everywhere, and a distance of it takes several times as long as one "
            "of a grid. So `Motions` takes grids only."
        )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
