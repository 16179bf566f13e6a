"""Pictures of robots that plan: paths among what surrounds them, and what is proven.

In one, bounders spare an exact check; in the other every motion is proven, until something is put in the way.

``draw_robot`` and ``draw_seven`` gather the numbers; ``draw`` runs in a process of its own (``sims.drawing``).
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

import warp_bounding as wb
from sims.arm.meshes import mesh_of
from sims.arm.pictures import along
from sims.arm.robots import ROBOTS, Cell, robots
from sims.arm.seven import Seven, tool
from sims.drawing import INK, Drawn, aim, draw_with, panels, write
from sims.planning.roadmap import Roadmap

__all__ = ["draw", "draw_robot", "draw_seven", "posed"]

PANEL = (860, 740)  # pixels
DENIED, ASKED, COLLIDES = "#2f7fd1", "#f29d0c", "#c3262b"
THING, TABLE, CAN, LATE = "#bfb3a4", "#d3c9bc", "#5f9a7c", "#c98a86"
LONGEST, POSES, FINE = 10, 9, 0.02  # paths; poses drawn along one; between configurations that are checked along it
DOTS, DOT, TUBE = 1200, 0.0095, 0.009  # random configurations; metres
CAMERA, ANGLE = ((-2.3, -3.5, 2.3), (0.05, 0.0, 0.47)), 23.5  # metres: where it is, and what it looks at; degrees
CAMERA_OF_SEVEN = (-2.9, -2.9, 2.1), (0.36, -0.02, 0.46)
BRIGHTER = 0.6  # exponent of colours: the files have dark ones
ENDS = ((0.5, 255.0), (0.8, 15.0))  # start and goal: a share of this grey in their colours
LOOK = {"smooth_shading": True, "ambient": 0.25, "specular": 0.2}
COLOURED = LOOK | {"scalars": "colour", "rgb": True}


def draw_robot(run: Roadmap, folder: Path, without: int) -> Drawn:
    """``NAME.png``, of the cell: of a run's longest paths the one most checked exactly, and random configurations.

    Args:
        run: Of a robot's cell, finished.
        folder: Made if there is none.
        without: Exact checks of the run without bounders.
    """
    place, longest = run.world, np.argsort(np.where(np.isfinite(run.lengths), run.lengths, 0.0))[-LONGEST:]
    paths = [along(run.paths[k], FINE) for k in longest if run.paths[k] is not None] or [run.states[:1]]
    fine = max(paths, key=lambda path: (~run.broad.states(path)).sum())
    dots = place.draw(DOTS, np.random.default_rng(0))
    denied, hit = run.broad.states(dots), run.exact.states(dots)
    free = 100 * denied[~hit].mean()
    data = {
        **_path(0, place.cell, place.joint_values(fine), np.where(run.broad.states(fine), 0, 1)),
        "dots": tool(place.cell.arm, place.joint_values(dots)),
        "kinds": np.where(denied, 0, np.where(hit, 2, 1)),
        "text0": "A robot plans from the white pose to the black one\nPoses along its path, and the way of its tool:\n"
        "proven free by two networks\nchecked exactly",
        "text1": f"{without:,} exact checks become {run.checks:,}\nThe tool in {DOTS:,} random configurations:\n"
        f"proven free, {free:.0f} % of the free ones\nfree, but checked exactly\ncolliding",
    }
    return _drawn(place.cell.name, folder, data, place.cell.obstacles, CAMERA)


def draw_seven(seven: Seven, around: Cell, folder: Path) -> Drawn:
    """``panda.png``: the first plan, and what is proven of it with a post in its way, with the second plan."""
    old, (at, share) = _fine(seven.first), seven.spoiled.end
    spoiled = np.where(_progress(seven.first) < at + share, 0, 2)
    new, names = _fine(seven.second or seven.first), " and ".join(seven.spoiled.between or ("nothing", "nothing"))
    data = {
        **_path(0, around, old, np.zeros(len(old), dtype=int)),
        **_path(1, around, new, np.zeros(len(new), dtype=int)),
        "spoiled": tool(around.arm, old),
        "spoiled_kinds": spoiled,
        "text0": f"Seven joints, {len(seven.first.shares)} motions, each proven free\nFrom the white pose to the black "
        "one; nothing is fitted:\nno configuration on the way touches anything",
        "text1": f"A post is put in the way\nThe plan is proven up to where {names} meet;\na new plan of "
        f"{len(seven.second.shares) if seven.second else 0} motions, each proven free\n\nthe rest of the old one",
    }
    return _drawn("panda", folder, data, seven.motions.obstacles, CAMERA_OF_SEVEN, late=1)


def _progress(plan: wb.arms.Plan) -> np.ndarray:
    """Numbers of motions, and shares of them, of configurations close to each other along a plan."""
    steps = [int(np.ceil(np.abs(way).max() / FINE)) for way in np.diff(plan.waypoints, axis=0)]
    shares = [k + np.arange(count) / count for k, count in enumerate(steps)]
    return np.append(np.concatenate(shares), len(steps))


def _fine(plan: wb.arms.Plan) -> np.ndarray:
    """Configurations close to each other along a plan."""
    at = np.arange(len(plan.waypoints))
    return np.stack([np.interp(_progress(plan), at, values) for values in plan.waypoints.T], axis=1)


def _path(number: int, cell: Cell, q: np.ndarray, kinds: np.ndarray) -> dict[str, np.ndarray]:
    """What a panel shows of a path of configurations ``(N, n)`` close to each other, of these kinds."""
    shown = np.linspace(0, len(q) - 1, POSES).astype(int)
    poses, faces, colours = posed(cell, q[shown])
    own = {"poses": poses, "path": tool(cell.arm, q), "path_kinds": kinds, "poses_kinds": kinds[shown]}
    return {"faces": faces, "colours": colours} | {f"{name}{number}": array for name, array in own.items()}


def _drawn(name: str, folder: Path, data: dict, things: Sequence, camera: tuple, late: int = 0) -> Drawn:
    """Draw among bodies and cylinders, a table first; the last ``late`` of them are in the second panel only."""
    count = len(things) - late
    colours = [CAN if isinstance(thing, wb.arms.Cylinder) else THING for thing in things]
    colours = [TABLE, *colours[1:count], *[LATE] * late]
    data |= {"name": name, "things": np.array([count, len(things)]), "things_colours": np.array(colours)}
    data["camera"] = np.array(camera)
    for k, body in enumerate(things):
        mesh = mesh_of(body)
        data |= {f"vertices_of{k}": mesh.vertices, f"faces_of{k}": mesh.faces}
    return draw_with("sims.arm.robot_pictures", Path(folder), data)


def posed(cell: Cell, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A robot as it looks, in joint values ``(N, n)``: vertices ``(N, V, 3)``, faces and their colours ``(F, 3)``."""
    import yourdfpy

    folder, found = robots(), []
    model = yourdfpy.URDF.load(
        str(folder / ROBOTS[cell.robot].urdf),
        filename_handler=lambda fname: str(folder.parent / fname.removeprefix("package://example-robot-data/")),
    )
    names = [joint.name for joint in cell.arm.joints]
    held = {name: np.float64(value) for name, value in cell.held.items()}
    for values in q:
        model.update_cfg(held | dict(zip(names, values, strict=True)))
        parts = model.scene.dump()
        found.append(np.concatenate([part.vertices for part in parts]).astype(np.float32))
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, first[:-1], strict=True)])
    colours = [np.tile(part.visual.material.main_color[:3], (len(part.faces), 1)) for part in parts]
    return np.array(found), faces, 255 * (np.concatenate(colours) / 255) ** BRIGHTER


def _surface(vertices: np.ndarray, faces: np.ndarray, colours: np.ndarray | None = None):
    import pyvista

    found = pyvista.PolyData(vertices, np.insert(np.asarray(faces), 0, 3, axis=1).reshape(-1))
    if colours is not None:
        found.cell_data["colour"] = colours.astype(np.uint8)
    return found.compute_normals(split_vertices=True, feature_angle=30.0, auto_orient_normals=False)


def draw(data: dict[str, np.ndarray], folder: Path) -> None:
    """Draw a path in the first panel, and another one or random configurations in the second."""
    for number, plotter in panels(folder / f"{data['name']}.png", 2, 2 * PANEL[0], PANEL[1]):
        plotter.set_background("white")
        for k in range(int(data["things"][number])):
            thing = _surface(data[f"vertices_of{k}"], data[f"faces_of{k}"])
            plotter.add_mesh(thing, color=str(data["things_colours"][k]), ambient=0.3)
        if f"path{number}" in data:
            _draw_path(plotter, data, number)
        else:
            _draw_dots(plotter, data)
        if number and "spoiled" in data:
            _tube(plotter, data["spoiled"], data["spoiled_kinds"], (COLLIDES,), first=2)
        head, *lines = str(data[f"text{number}"]).split("\n")
        write(plotter, head, (0.03, 0.94), 15)
        shown = [pair for pair in zip(lines, (INK, DENIED, ASKED, COLLIDES), strict=False) if pair[0]]
        for k, (line, colour) in enumerate(shown):
            write(plotter, line, (0.03, 0.9 - 0.037 * k), 9, colour)
        aim(plotter, *(tuple(place) for place in data["camera"]), ANGLE, lit=(0.0, 0.0, 0.4))


def _draw_path(plotter, data: dict[str, np.ndarray], number: int) -> None:
    poses, faces = data[f"poses{number}"], data["faces"]
    plotter.enable_depth_peeling(6)
    for vertices, kind in zip(poses[1:-1], data[f"poses_kinds{number}"][1:-1], strict=True):
        ghost = _surface(vertices, faces)
        plotter.add_mesh(ghost, color=(DENIED, ASKED)[kind], opacity=0.18, culling="back", **LOOK)
    for vertices, (share, grey) in zip(poses[[0, -1]], ENDS, strict=True):
        plotter.add_mesh(_surface(vertices, faces, (1 - share) * data["colours"] + share * grey), **COLOURED)
    _tube(plotter, data[f"path{number}"], data[f"path_kinds{number}"], (DENIED, ASKED))


def _tube(plotter, path: np.ndarray, kinds: np.ndarray, colours: Sequence[str], first: int = 0) -> None:
    """The way of a tool, in a colour for each kind from the first on; a piece is of the later kind of its ends."""
    import pyvista

    kinds = np.maximum(kinds[:-1], kinds[1:])
    for kind, colour in enumerate(colours, start=first):
        if (pieces := np.flatnonzero(kinds == kind)).size:
            lines = np.stack([np.full(len(pieces), 2), pieces, pieces + 1], axis=1)
            tube = pyvista.PolyData(path, lines=lines.reshape(-1)).tube(radius=TUBE)
            plotter.add_mesh(tube, color=colour, ambient=0.4)


def _draw_dots(plotter, data: dict[str, np.ndarray]) -> None:
    import pyvista

    plotter.add_mesh(_surface(data["poses0"][0], data["faces"], data["colours"]), **COLOURED)
    ball = pyvista.Sphere(radius=DOT, theta_resolution=12, phi_resolution=10)
    for kind, colour in enumerate((DENIED, ASKED, COLLIDES)):
        dots = pyvista.PolyData(data["dots"][data["kinds"] == kind])
        if dots.n_points:
            plotter.add_mesh(dots.glyph(geom=ball, scale=False, orient=False), color=colour, ambient=0.45)
