"""Do a planner's balls hold the robot, and what do proven ones cost? `python benchmarks/robot_balls.py --robots DIR`.

For each robot R, DIR has `R/R.urdf` with collision meshes near it, and `R/R_spherized.urdf` with the balls of each
link, as `resources` of https://github.com/KavrakiLab/vamp has them. How far balls stand out is sampled: points on the
balls of links with meshes, outside of these by the winding number, and their distance. So is the surface outside.
"""

import argparse
import csv
import os
from pathlib import Path
from time import perf_counter

import numpy as np
import warp as wp

from sims.versions import versions
from warp_bounding.arms.urdf import links_of, mesh_data, shape_of
from warp_bounding.pairs import RobotBalls
from warp_bounding.rigid import moved

ROBOTS, POINTS, ON_BALL = ("panda", "ur5", "fetch"), 20_000, 400  # points on the meshes of each link, and on each ball
ROUNDED = 1e-6  # metres; a point nearer to a ball than this counts as inside
PAGE = """# Balls of robots

**The balls that VAMP checks leave out {outside} % of the surface of a Panda's links, by up to {farthest} mm; as many
proven ones hold all of it, and stand out by {ours} mm at most, where VAMP's do by {theirs}.** A planner that checks
balls alone may accept configurations in which the meshes collide.

`python benchmarks/robot_balls.py --robots DIR --out results/robot-balls`

DIR: the robots of [VAMP](https://github.com/KavrakiLab/vamp)'s folder `resources`, with their collision meshes and
balls (`*_spherized.urdf`). *Not held*: links of which `RobotBalls.certify` names a point outside of all balls;
*farthest*: how far the farthest such point is outside, a proven lower bound. *Surface outside*: of {points:,} points on
the meshes of each link, links weighted by area. *Stand out*: how far balls reach out of a link's meshes, the largest of
all links and the median of the links, sampled. *Proven*: the same of `RobotBalls.of` with as many balls. Links without
balls are not held. {versions}; times on {cores} cores.

| robot | links | balls | VAMP's: not held | farthest, mm | surface outside, % | stand out, mm | refuted in, s |\
 proven: stand out, mm | made in, s | proven in, s |
|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|
{lines}"""


def meshes_of(urdf: Path) -> dict[str, np.ndarray]:
    """The triangles ``(F, 3, 3)`` of each link that has meshes, in the link's frame."""
    found = {}
    for link, element in links_of(urdf)[1].items():
        for kind, sizes, pose in map(shape_of, element.findall("collision")):
            if kind == "mesh":
                vertices, faces, _ = mesh_data(sizes["filename"], urdf, None)
                corners = moved(vertices * sizes.get("scale", 1.0), pose)[faces]
                found[link] = np.concatenate([found.get(link, corners[:0]), corners])
    return found


@wp.kernel(enable_backward=False)
def signed_distance(mesh: wp.uint64, points: wp.array(dtype=wp.vec3), found: wp.array(dtype=float)):
    """Distances from points to a mesh, negative within it."""
    i = wp.tid()
    near = wp.mesh_query_point_sign_winding_number(mesh, points[i], 10.0)
    place = wp.mesh_eval_position(mesh, near.face, near.u, near.v)
    found[i] = near.sign * wp.length(place - points[i])


def stands_out(triangles: np.ndarray, balls: np.ndarray, rng: np.random.Generator) -> float:
    """How far balls ``(K, 4)`` reach out of triangles, metres, sampled."""
    corners, indices = wp.array(triangles.reshape(-1, 3), dtype=wp.vec3), np.arange(3 * len(triangles), dtype=np.int32)
    mesh = wp.Mesh(corners, wp.array(indices, dtype=int), support_winding_number=True)
    way = rng.normal(size=(len(balls), ON_BALL, 3))
    way *= balls[:, None, 3:] / np.linalg.norm(way, axis=2, keepdims=True)
    points = wp.array((balls[:, None, :3] + way).reshape(-1, 3), dtype=wp.vec3)
    found = wp.empty(len(points), dtype=float)
    wp.launch(signed_distance, len(points), [mesh.id, points, found])
    return max(float(found.numpy().max()), 0.0)


def outside(triangles: np.ndarray, balls: np.ndarray, rng: np.random.Generator) -> tuple[float, float]:
    """The share of points on triangles that lie outside of balls, and the triangles' area."""
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1) / 2
    face = rng.choice(len(area), POINTS, p=area / area.sum())
    points = (triangles[face] * rng.dirichlet(np.ones(3), POINTS)[:, :, None]).sum(axis=1)
    away = np.linalg.norm(points[:, None] - balls[:, :3], axis=2) - balls[:, 3]
    return float((away.min(axis=1) > ROUNDED).mean()), float(area.sum())


def measured(folder: Path) -> dict[str, object]:
    """A row of the table: a robot in its folder."""
    rng, urdf = np.random.default_rng(0), folder / f"{folder.name}.urdf"
    theirs, meshes, seconds = RobotBalls.load(folder / f"{folder.name}_spherized.urdf"), meshes_of(urdf), []
    started = perf_counter()
    held = theirs.certify(urdf)
    seconds.append(perf_counter() - started)
    for link, found in held.items():
        print(f"{folder.name} {link}: {found}", flush=True)
    count = sum(found.balls for found in held.values())
    started = perf_counter()
    ours = RobotBalls.of(urdf, count)
    seconds.append(perf_counter() - started)
    started = perf_counter()
    assert all(found.proven for found in ours.certify(urdf).values())
    seconds.append(perf_counter() - started)
    both = [link for link in meshes if len(theirs.links.get(link, ()))]
    shares, areas = zip(*(outside(meshes[link], theirs.links[link], rng) for link in both), strict=True)
    far = 1000 * max(found.outside for found in held.values() if found.balls)
    out = [
        1000 * np.array([stands_out(meshes[link], balls.links[link], rng) for link in both]) for balls in (theirs, ours)
    ]
    return {
        "robot": folder.name,
        "links": len(held),
        "balls": count,
        "not_held": sum(not found.proven for found in held.values()),
        "farthest_mm": f"{far:.0f}",
        "outside_percent": f"{100 * np.average(shares, weights=areas):.1f}",
        "theirs_out_mm": f"{out[0].max():.0f} (median {np.median(out[0]):.0f})",
        "theirs_seconds": f"{seconds[0]:.1f}",
        "ours_out_mm": f"{out[1].max():.0f} (median {np.median(out[1]):.0f})",
        "made_seconds": f"{seconds[1]:.1f}",
        "ours_seconds": f"{seconds[2]:.1f}",
    }


def main() -> None:
    """Measure all robots; write the table and its page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=Path, required=True, help="with a folder for each robot")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    rows = [measured(given.robots / robot) | {"versions": versions()} for robot in ROBOTS]
    with (given.out / "balls.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    lines = "".join(f"| {' | '.join(map(str, list(row.values())[:-1]))} |\n" for row in rows)  # without versions
    largest = {name: rows[0][f"{name}_out_mm"].split()[0] for name in ("ours", "theirs")}
    about = {"outside": rows[0]["outside_percent"], "farthest": rows[0]["farthest_mm"], "points": POINTS}
    page = PAGE.format(lines=lines, versions=versions(), cores=len(os.sched_getaffinity(0)), **about, **largest)
    (given.out / "README.md").write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
