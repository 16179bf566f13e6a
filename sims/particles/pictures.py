"""Pictures of the moving bunny's bounds at one time, and of the rain; ``sims.drawing`` draws in a process."""

from pathlib import Path

import numpy as np

from sims.drawing import STONE, aim, panels, polygons, upright, write

__all__ = ["draw"]

BOUNDS_PICTURE, RAIN_PICTURE = "bounds.png", "rain.png"
BOUND, FREE = "#2f7fd1", "#8fb4d6"
PALETTE = ["#0b3c8c", "#1f7fd0", "#39b8d9", "#a5e3d8"]
NIGHT, PAPER, AROUND, WRONG = ("#0d1620", "#2b3e50"), "#c9d6e2", "#9cc8f5", "#ff3b2f"
RADIUS, WRONG_RADIUS = 0.006, 0.014  # of a drop; of one that lost a contact
DRAWN = 12  # of so many free drops one has a line
BOUNDS_PANEL, RAIN_PANEL, HEAD = (533, 680), (800, 800), 112  # pixels; those at the top are for text


def draw(data: dict[str, np.ndarray], folder: Path) -> None:
    """Draw all pictures that there are data for."""
    if "bound0_value" in data:
        _draw_bounds(data, folder / BOUNDS_PICTURE)
    if "rain0_positions" in data:
        _draw_rain(data, folder / RAIN_PICTURE)


def _add_bound(plotter, data: dict[str, np.ndarray], name: str, color: str, opacity: float) -> None:
    """The surface where a bounder's answer changes, if it says *maybe* at all."""
    import pyvista

    value = data[f"{name}_value"]
    grid = pyvista.ImageData(dimensions=value.shape, spacing=data[f"{name}_step"], origin=data[f"{name}_origin"])
    grid["value"] = value.reshape(-1, order="F")
    surface = grid.contour([0.0], scalars="value", method="contour").triangulate()
    if not surface.n_cells:
        return
    surface.points = upright(surface.points)
    surface.flip_faces(inplace=True)
    surface = surface.compute_normals(split_vertices=True, feature_angle=35.0)
    plotter.add_mesh(surface, color=color, opacity=opacity, smooth_shading=True, specular=0.6, specular_power=30)


def _look(plotter, center: np.ndarray, away: tuple[float, float, float], raised: float, angle: float) -> None:
    """Lights, and the camera: how far from the bunny's middle, how far above it aimed, how wide (degrees)."""
    plotter.enable_depth_peeling(8)
    aim(plotter, center + np.array(away), center + np.array([0.0, 0.0, raised]), angle)


def _draw_bounds(data: dict[str, np.ndarray], path: Path) -> None:
    count = sum(key.startswith("bound") and key.endswith("_value") for key in data)
    bunny = polygons(data["vertices"], data["faces"])
    for number, plotter in panels(path, count, BOUNDS_PANEL[0] * count, BOUNDS_PANEL[1]):
        plotter.set_background("white")
        plotter.add_mesh(bunny, color=STONE, smooth_shading=True, ambient=0.25, specular=0.1)
        _add_bound(plotter, data, f"bound{number}", BOUND, 0.27)
        method, figures, apart = str(data[f"bound{number}_caption"]).split("\n")
        write(plotter, method, (0.05, 0.93), 13)
        write(plotter, figures, (0.05, 0.885), 9)
        write(plotter, apart, (0.05, 0.015), 9)
        _look(plotter, np.array(bunny.center), (-0.9, -5.4, 1.5), 0.1, 28)


def _draw_rain(data: dict[str, np.ndarray], path: Path) -> None:
    import pyvista

    count = sum(key.endswith("_positions") for key in data)
    bunny = polygons(data["vertices"], data["faces"])
    for number, plotter in panels(path, count, RAIN_PANEL[0] * count, RAIN_PANEL[1]):
        plotter.set_background(NIGHT[0], top=NIGHT[1])
        plotter.add_mesh(bunny, color=STONE, smooth_shading=True, ambient=0.18, specular=0.15)
        if f"around{number}_value" in data:
            _add_bound(plotter, data, f"around{number}", AROUND, 0.3)
        x, v = upright(data[f"rain{number}_positions"]), upright(data[f"rain{number}_velocities"])
        _add_drops(plotter, x, v, data[f"rain{number}_balls"])
        lost = data.get(f"rain{number}_lost", np.zeros(0, dtype=bool))
        if lost.any():
            drops = pyvista.PolyData(x[lost]).glyph(geom=_ball(WRONG_RADIUS), scale=False, orient=False)
            plotter.add_mesh(drops, color=WRONG, ambient=0.5)
        _look(plotter, np.array(bunny.center), (-1.3, -6.2, 1.6), 0.12, 22)
    _label(path, [str(data[f"rain{number}_caption"]).split("\n") for number in range(count)])


def _label(path: Path, captions: list[list[str]]) -> None:
    """Put captions into a strip above a picture's panels, where no drop falls."""
    from matplotlib import font_manager
    from PIL import Image, ImageDraw, ImageFont

    fonts = [ImageFont.truetype(font_manager.findfont("DejaVu Sans"), size) for size in (24, 17)]
    drawn = Image.open(path).convert("RGB")
    whole = Image.new("RGB", (drawn.width, drawn.height + HEAD), NIGHT[0])
    whole.paste(drawn, (0, HEAD))
    pen = ImageDraw.Draw(whole)
    for number, (head, *lines) in enumerate(captions):
        left = drawn.width * number // len(captions) + 24
        pen.text((left, 10), head, font=fonts[0], fill=PAPER)
        pen.text((left, 42), "\n".join(lines), font=fonts[1], fill=PAPER, spacing=4)
    whole.save(path)


def _ball(radius: float):
    """A drop."""
    import pyvista

    return pyvista.Sphere(radius=radius, theta_resolution=10, phi_resolution=8)


def _add_drops(plotter, x: np.ndarray, v: np.ndarray, balls: np.ndarray) -> None:
    """Some drops as balls, the darker the slower; of the others, a line for a few."""
    import pyvista
    from matplotlib.colors import LinearSegmentedColormap

    if balls.any():
        drops = pyvista.PolyData(x[balls])
        drops["speed"] = np.linalg.norm(v[balls], axis=1)
        plotter.add_mesh(
            drops.glyph(geom=_ball(RADIUS), scale=False, orient=False),
            scalars="speed",
            cmap=LinearSegmentedColormap.from_list("water", PALETTE),
            clim=(0.0, 3.0),
            smooth_shading=True,
            specular=0.6,
            show_scalar_bar=False,
        )
    free = np.flatnonzero(~balls)[::DRAWN]
    if len(free):
        ends = np.stack([x[free], x[free] - 0.02 * v[free]], axis=1).reshape(-1, 3)
        lines = pyvista.line_segments_from_points(ends)
        plotter.add_mesh(lines, color=FREE, opacity=0.35, line_width=1.2)
