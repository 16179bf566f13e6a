"""How much of a robot is outside of a planner's balls? `python benchmarks/planner_balls.py FOLDER --out OUT`.

For each robot R, FOLDER has `R/R.urdf` with collision meshes below `R/meshes`, and `R/R_spherized.urdf` with the balls
of each link, as `resources` of https://github.com/KavrakiLab/vamp has them. Points are spread evenly over the collision
meshes of each link that has both, and links count by their area.
"""

import argparse
import csv
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import trimesh

ROBOTS, POINTS = ("panda", "ur5", "fetch"), 20_000  # points on each link
ROUNDED = 1e-6  # metres; a point nearer to a ball than this counts as inside
FIELDS = ("robot", "links", "balls", "outside_percent", "farthest_mm")
PAGE = """# Balls that planners check

**{outside} % of the surface of a Panda's links lies outside of the balls that VAMP checks.** A planner that checks
balls alone may accept configurations in which the meshes collide.

`python benchmarks/planner_balls.py FOLDER --out results/planner-balls`

FOLDER: the robots of [VAMP](https://github.com/KavrakiLab/vamp)'s folder `resources`, with their collision meshes and
balls (`*_spherized.urdf`). 20,000 points on the meshes of each link, links weighted by area; *farthest*: the largest
distance from a point to its nearest ball. Base and gripper are among the links.

| robot | links | balls | surface outside, % | farthest, mm |
|---|---:|---:|---:|---:|
{lines}"""


def placed(collision: ElementTree.Element) -> np.ndarray:
    """The 4x4 transform of a collision element, in the frame of its link."""
    origin = collision.find("origin")
    if origin is None:
        return np.eye(4)
    turns, place = ([float(x) for x in origin.get(key, "0 0 0").split()] for key in ("rpy", "xyz"))
    matrix = trimesh.transformations.euler_matrix(*turns, axes="sxyz")
    matrix[:3, 3] = place
    return matrix


def meshes_of(link: ElementTree.Element, folder: Path) -> list[trimesh.Trimesh]:
    """The collision meshes of a link, in its frame."""
    found = []
    for collision in link.findall("collision"):
        if (mesh := collision.find("geometry/mesh")) is not None:
            file = folder / "meshes" / mesh.get("filename").split("meshes/")[-1]
            part = trimesh.load(file, force="mesh")
            part.apply_scale([float(x) for x in mesh.get("scale", "1 1 1").split()])
            part.apply_transform(placed(collision))
            found.append(part)
    return found


def balls_of(link: ElementTree.Element) -> np.ndarray:
    """``(K, 4)``: centers and radii of the balls of a link, in its frame."""
    found = [(c, c.find("geometry/sphere")) for c in link.findall("collision")]
    return np.array([[*placed(c)[:3, 3], float(ball.get("radius"))] for c, ball in found if ball is not None])


def measured(folder: Path) -> dict:
    """A row of the table: a robot in its folder."""
    robot, rng = folder.name, np.random.default_rng(0)
    links, balls = (
        {link.get("name"): link for link in ElementTree.parse(folder / f"{robot}{end}.urdf").getroot().findall("link")}
        for end in ("", "_spherized")
    )
    away, areas, count = [], [], 0
    for name, link in links.items():
        meshes, own = meshes_of(link, folder), balls_of(balls[name]) if name in balls else []
        if meshes and len(own):
            seed = int(rng.integers(1 << 31))
            whole = trimesh.util.concatenate(meshes)
            x, _ = trimesh.sample.sample_surface(whole, POINTS, seed=seed)
            areas.append(whole.area)
            away.append((np.linalg.norm(x[:, None] - own[:, :3], axis=2) - own[:, 3]).min(axis=1))
            count += len(own)
    away = np.stack(away)
    outside = f"{100 * np.average((away > ROUNDED).mean(axis=1), weights=areas):.1f}"
    return dict(zip(FIELDS, (robot, len(away), count, outside, f"{1000 * away.max():.0f}"), strict=True))


def main() -> None:
    """Measure all robots; write the table and its page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="with a folder for each robot")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    rows = [measured(given.folder / robot) for robot in ROBOTS]
    with (given.out / "balls.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, FIELDS)
        writer.writeheader()
        writer.writerows(rows)
    lines = "".join("| " + " | ".join(str(value) for value in row.values()) + " |\n" for row in rows)
    (given.out / "README.md").write_text(PAGE.format(outside=rows[0]["outside_percent"], lines=lines), encoding="utf-8")


if __name__ == "__main__":
    main()
