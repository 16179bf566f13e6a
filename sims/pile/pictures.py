"""``pile.png``: the pile in its box, and from above, the pairs that a broad phase leaves and those that touch.

Coordinates have z up.
"""

from pathlib import Path

import numpy as np

from sims.drawing import INK, aim, panels, write

__all__ = ["draw"]

COLOURS = (("#e9dcc9", "#d9a679", "#b9795b", "#8c6a5d"), ("#2f7fd1", "#16467a", "#39a9a0", "#e0a526"))  # by kind
FLOOR, GLASS, SEEN = "#eef1f4", "#9fb4c7", "#d5dae0"
LEFT, TOUCHING = "#d62728", "#16467a"
PANEL = 640  # pixels
FACES = 4000  # of a mesh, as it is drawn
HIGH = 3.2  # of the walls that are drawn


def _bodies(mesh, places: np.ndarray):
    """Copies of a mesh as one surface."""
    import pyvista
    from scipy.spatial.transform import Rotation

    turned = [Rotation.from_quat(x[3:]).apply(mesh.points) + x[:3] for x in places]
    faces = mesh.faces.reshape(-1, 4)[:, 1:] + mesh.n_points * np.arange(len(places))[:, None, None]
    made = pyvista.PolyData(np.concatenate(turned), np.insert(faces.reshape(-1, 3), 0, 3, axis=1).reshape(-1))
    return made.compute_normals(split_vertices=False, feature_angle=180.0)


def _box(plotter, side: float, high: float) -> None:
    """Floor, glass walls, and their edges."""
    import pyvista

    plotter.add_mesh(pyvista.Plane((0, 0, -0.02), (0, 0, 1), 2 * side, 2 * side), color=FLOOR, ambient=0.35)
    walls = pyvista.Box((-side, side, -side, side, 0, high))
    plotter.add_mesh(walls, color=GLASS, opacity=0.07)
    plotter.add_mesh(walls.extract_all_edges(), color=INK, line_width=1.5, opacity=0.6)


def draw(data: dict[str, np.ndarray], folder: Path) -> None:
    """Draw the pile, and a panel for each run."""
    import pyvista

    side, kinds, meshes = float(data["side"]), data["kinds"], []
    for kind in range(len(COLOURS)):
        faces = np.insert(data[f"faces{kind}"], 0, 3, axis=1).reshape(-1)
        meshes.append(pyvista.PolyData(data[f"vertices{kind}"].astype(float), faces))
        meshes[-1] = meshes[-1].decimate(max(0.0, 1 - FACES / meshes[-1].n_cells))
    names = [str(data[f"name{number}"]) for number in range(sum(key.startswith("name") for key in data))]
    for number, plotter in panels(folder / "pile.png", 1 + len(names), PANEL * (1 + len(names)), PANEL):
        plotter.set_background("white")
        for kind, colours in enumerate(COLOURS):
            for k, colour in enumerate(colours):
                own = data["places"][np.flatnonzero(kinds == kind)[k :: len(colours)]]
                if len(own):
                    style = {"smooth_shading": True, "ambient": 0.2, "specular": 0.2}
                    plotter.add_mesh(_bodies(meshes[kind], own), color=SEEN if number else colour, **style)
        if number == 0:
            _box(plotter, side, HIGH)
            write(plotter, f"{len(kinds)} bunnies and rings", (0.04, 0.93), 13)
            aim(plotter, (5.0, -14.8, 8.4), (0.0, 0.0, 0.95), 28.5, lit=(0.0, 0.0, 1.0))
            plotter.enable_ssao(radius=0.5, bias=0.01, kernel_size=64)
            continue
        _box(plotter, side, 0.0)
        left, touching = data[f"left{number - 1}"], {tuple(pair) for pair in data["touching"]}
        apart = np.array([pair for pair in left.tolist() if tuple(pair) not in touching]).reshape(-1, 2)
        above = data["places"][:, :3] + np.array([0.0, 0.0, 8.0])  # nothing hides a line
        for pairs, colour, width in ((apart, LEFT, 1.6), (data["touching"], TOUCHING, 2.6)):
            if len(pairs):
                lines = pyvista.line_segments_from_points(above[pairs].reshape(-1, 3))
                plotter.add_mesh(lines, color=colour, line_width=width)
        write(plotter, f"{names[number - 1]}: {len(left):,} pairs left", (0.04, 0.93), 13)
        write(plotter, f"{len(touching):,} touch (blue), {len(apart):,} do not (red)", (0.04, 0.885), 9)
        aim(plotter, (0.0, 0.4, 40.0), (0.0, 0.4, 0.0), 18, lit=(0.0, 0.0, 1.0))
        plotter.camera.up = (0, 1, 0)
        plotter.camera.parallel_projection = True
        plotter.camera.parallel_scale = 1.22 * side
