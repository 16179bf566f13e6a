"""The picture of a robot that plans: its path among what surrounds it, and what its bounders spare the exact check.

``draw_robot`` gathers the numbers; ``draw`` runs in a process of its own (``sims.drawing``).
"""

from pathlib import Path

import numpy as np

from sims.arm.meshes import mesh_of
from sims.arm.pictures import along
from sims.arm.robots import ROBOTS, robots
from sims.arm.workplace import Workplace
from sims.drawing import INK, Drawn, aim, draw_with, panels, write
from sims.planning.roadmap import Roadmap

__all__ = ["draw", "draw_robot", "posed"]

PANEL = (860, 740)  # pixels
DENIED, ASKED, COLLIDES = "#2f7fd1", "#f29d0c", "#c3262b"
THING, TABLE = "#bfb3a4", "#d3c9bc"
LONGEST, POSES, FINE = 10, 9, 0.02  # paths; poses drawn along one; between configurations that are checked along it
DOTS, DOT, TUBE = 1200, 0.0095, 0.009  # random configurations; metres
CAMERA, AIM, ANGLE = (-2.3, -3.5, 2.3), (0.05, 0.0, 0.47), 23.5  # metres, metres, degrees
BRIGHTER = 0.6  # exponent of colours: the files have dark ones
ENDS = ((0.5, 255.0), (0.8, 15.0))  # start and goal: a share of this grey in their colours


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
    poses, faces, colours = posed(place, fine[np.linspace(0, len(fine) - 1, POSES).astype(int)])
    free = 100 * denied[~hit].mean()
    data = {
        "name": place.cell.name,
        "poses": poses,
        "faces": faces,
        "colours": colours,
        "path": _tool(place, fine),
        "denied_on_path": run.broad.states(fine),
        "dots": _tool(place, dots),
        "kinds": np.where(denied, 0, np.where(hit, 2, 1)),
        "things": len(place.cell.obstacles),
        "text0": "A robot plans from the white pose to the black one\nPoses along its path, and the way of its tool:\n"
        "proven free by two networks\nchecked exactly",
        "text1": f"{without:,} exact checks become {run.checks:,}\nThe tool in {DOTS:,} random configurations:\n"
        f"proven free, {free:.0f} % of the free ones\nfree, but checked exactly\ncolliding",
    }
    for k, body in enumerate(place.cell.obstacles):
        mesh = mesh_of(body)
        data |= {f"vertices{k}": mesh.vertices, f"faces{k}": mesh.faces}
    return draw_with("sims.arm.robot_pictures", Path(folder), data)


def posed(place: Workplace, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A robot as it looks, in states ``(N, n)``: vertices ``(N, V, 3)``, faces ``(F, 3)``, their colours ``(F, 3)``."""
    import yourdfpy

    folder, found = robots(), []
    model = yourdfpy.URDF.load(
        str(folder / ROBOTS[place.cell.robot].urdf),
        filename_handler=lambda fname: str(folder.parent / fname.removeprefix("package://example-robot-data/")),
    )
    names = [joint.name for joint in place.cell.arm.joints]
    held = {name: np.float64(value) for name, value in place.cell.held.items()}
    for q in place.joint_values(x):
        model.update_cfg(held | dict(zip(names, q, strict=True)))
        parts = model.scene.dump()
        found.append(np.concatenate([part.vertices for part in parts]).astype(np.float32))
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, first[:-1], strict=True)])
    colours = [np.tile(part.visual.material.main_color[:3], (len(part.faces), 1)) for part in parts]
    return np.array(found), faces, 255 * (np.concatenate(colours) / 255) ** BRIGHTER


def _tool(place: Workplace, x: np.ndarray) -> np.ndarray:
    """Where the last body is, ``(N, 3)``, metres."""
    body = place.cell.arm.bodies[-1]
    frames = place.cell.arm.frames(place.joint_values(x))[:, body.link]
    return frames[:, :3, :3] @ body.points.mean(axis=0) + frames[:, :3, 3]


def _surface(vertices: np.ndarray, faces: np.ndarray, colours: np.ndarray | None = None):
    import pyvista

    found = pyvista.PolyData(vertices, np.insert(np.asarray(faces), 0, 3, axis=1).reshape(-1))
    if colours is not None:
        found.cell_data["colour"] = colours.astype(np.uint8)
    return found.compute_normals(split_vertices=True, feature_angle=30.0, auto_orient_normals=False)


def draw(data: dict[str, np.ndarray], folder: Path) -> None:
    """Draw the path in the first panel, and the random configurations in the second."""
    import pyvista

    look = {"smooth_shading": True, "ambient": 0.25, "specular": 0.2}
    coloured = look | {"scalars": "colour", "rgb": True}
    ends = [(1 - share) * data["colours"] + share * grey for share, grey in ENDS]
    for number, plotter in panels(folder / f"{data['name']}.png", 2, 2 * PANEL[0], PANEL[1]):
        plotter.set_background("white")
        for k in range(int(data["things"])):
            box = _surface(data[f"vertices{k}"], data[f"faces{k}"])
            plotter.add_mesh(box, color=THING if k else TABLE, ambient=0.3)
        if number:
            plotter.add_mesh(_surface(data["poses"][0], data["faces"], data["colours"]), **coloured)
            ball = pyvista.Sphere(radius=DOT, theta_resolution=12, phi_resolution=10)
            for kind, colour in enumerate((DENIED, ASKED, COLLIDES)):
                dots = pyvista.PolyData(data["dots"][data["kinds"] == kind])
                if dots.n_points:
                    plotter.add_mesh(dots.glyph(geom=ball, scale=False, orient=False), color=colour, ambient=0.45)
        else:
            plotter.enable_depth_peeling(6)
            between = np.linspace(0, len(data["path"]) - 1, len(data["poses"])).astype(int)
            for k, vertices in enumerate(data["poses"][1:-1], start=1):
                colour = DENIED if data["denied_on_path"][between[k]] else ASKED
                ghost = _surface(vertices, data["faces"])
                plotter.add_mesh(ghost, color=colour, opacity=0.18, culling="back", **look)
            for vertices, colours in zip(data["poses"][[0, -1]], ends, strict=True):
                plotter.add_mesh(_surface(vertices, data["faces"], colours), **coloured)
            known = data["denied_on_path"][:-1] & data["denied_on_path"][1:]
            for chosen, colour in ((known, DENIED), (~known, ASKED)):
                if chosen.any():
                    pieces = np.flatnonzero(chosen)
                    lines = np.stack([np.full(len(pieces), 2), pieces, pieces + 1], axis=1)
                    tube = pyvista.PolyData(data["path"], lines=lines.reshape(-1)).tube(radius=TUBE)
                    plotter.add_mesh(tube, color=colour, ambient=0.4)
        head, *lines = str(data[f"text{number}"]).split("\n")
        write(plotter, head, (0.03, 0.94), 15)
        for k, line in enumerate(lines):
            write(plotter, line, (0.03, 0.9 - 0.037 * k), 9, (INK, DENIED, ASKED, COLLIDES)[k])
        aim(plotter, CAMERA, AIM, ANGLE, lit=(0.0, 0.0, 0.4))
