"""Level sets of a distance around a mesh, cut open to show the nesting; ``sims.drawing`` draws in a process."""

from pathlib import Path

import numpy as np

from sims.drawing import STONE, aim, panels, polygons, upright

__all__ = ["LEVEL_COLOURS", "draw"]

LEVEL_COLOURS = ("#0b3c8c", "#1f7fd0", "#39b8d9", "#9adfd3")  # of shells, from the inside out
PICTURE, SIZE = "levels.png", (780, 700)  # pixels
AWAY, RAISED, ANGLE = (2.1, -5.6, 2.3), 0.03, 25.5  # of the camera from the mesh, how far above it it aims; degrees


def draw(data: dict[str, np.ndarray], folder: Path) -> None:
    """Draw a mesh, and the part of the shells around it that lies behind the plane through its middle.

    Args:
        data: ``vertices`` ``(V, 3)`` and ``faces`` ``(F, 3)``, y up; ``value`` ``(X, Y, Z)``, a distance's values at
            nodes with ``origin`` and ``step``; and the ``levels``, from the inside out.
        folder: Where ``levels.png`` goes.
    """
    import pyvista

    value, mesh = data["value"], polygons(data["vertices"], data["faces"])
    grid = pyvista.ImageData(dimensions=value.shape, spacing=data["step"], origin=data["origin"])
    grid["value"] = value.reshape(-1, order="F")
    middle = np.array(mesh.center)
    for _, plotter in panels(folder / PICTURE, 1, *SIZE):
        plotter.set_background("white")
        plotter.add_mesh(mesh, color=STONE, smooth_shading=True, ambient=0.25, specular=0.1)
        for level, colour in zip(data["levels"], LEVEL_COLOURS, strict=True):
            shell = grid.contour([float(level)], scalars="value", method="contour").triangulate()
            shell.points = upright(shell.points)
            shell = shell.flip_faces().compute_normals(split_vertices=False)
            behind = shell.clip("y", origin=middle, invert=False)
            if behind.n_cells:
                plotter.add_mesh(behind, color=colour, smooth_shading=True, ambient=0.3, specular=0.1)
        aim(plotter, middle + np.array(AWAY), middle + np.array([0.0, 0.0, RAISED]), ANGLE)
