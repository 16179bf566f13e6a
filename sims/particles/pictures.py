"""Pictures of the moving bunny's bounds at one time, and of the rain; drawn by ``sims.drawing`` in a process of its own."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import label

import warp_bounding as wb
from sims.drawing import CAPTIONS, INK, STONE, light, polygons, upright

if TYPE_CHECKING:
    from sims.particles.example import Example
    from sims.particles.scene import Scene

__all__ = ["bounds_data", "draw", "rain_data"]

BOUNDS_PICTURE, RAIN_PICTURE = "bounds.png", "rain.png"
CELLS = 96  # along each side of the domain, where a bound's surface is looked for
BOUND, FREE = "#2f7fd1", "#8fb4d6"
PALETTE = ["#0b3c8c", "#1f7fd0", "#39b8d9", "#a5e3d8"]
NIGHT, PAPER, AROUND, WRONG = ("#0d1620", "#2b3e50"), "#c9d6e2", "#9cc8f5", "#ff3b2f"
RADIUS, WRONG_RADIUS, DRAWN = (
    0.006,
    0.014,
    12,
)  # of a drop; of one that lost a contact; of so many free drops one has a line
COLUMNS_OF_BOUNDS, BOUNDS_SIZE, RAIN_PANEL = 3, (1600, 680), (800, 800)
APART = "Islands off the bunny: false positives, too"


def bounds_data(scene: "Scene", time: float, bounders: dict[str, tuple[wb.Bounder, float]]) -> dict[str, np.ndarray]:
    """What the picture of the bounds needs.

    Args:
        scene: The moving mesh.
        time: At which it is shown.
        bounders: Per method: a bounder of the motion and its false positives in per cent.

    Returns:
        Arrays by name: for each bound, its decision function on a grid over its domain, one point beyond it included.
    """
    data = {"vertices": scene.motion.vertices_at(time), "faces": scene.motion.faces}
    for number, (method, (bounder, rate)) in enumerate(bounders.items()):
        data |= _decisions(f"bound{number}", bounder, time)
        figures = f"{rate:.1f} % false positives, {_size(bounder.nbytes)}"
        pieces = label(data[f"bound{number}_value"] > 0)[1]
        data[f"bound{number}_caption"] = np.array(f"{method}\n{figures}\n{APART if pieces > 1 else ''}")
    return data


def _decisions(name: str, bounder: wb.Bounder, time: float) -> dict[str, np.ndarray]:
    """A bounder's decision function at a time, on a grid over its domain, one point beyond it included."""
    lower, upper = bounder.domain.lower[1:], bounder.domain.upper[1:]
    step = (upper - lower) / CELLS
    axes = [np.linspace(lo - s, hi + s, CELLS + 3) for lo, hi, s in zip(lower, upper, step, strict=True)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    points = np.insert(places, 0, time, axis=1).astype(np.float32)
    value = bounder.values(points).numpy().astype(np.float64) - float(bounder.threshold)
    value[np.isneginf(value)] = -np.median(np.abs(value[np.isfinite(value)]))  # outside the domain: no
    return {f"{name}_value": value.reshape([CELLS + 3] * 3), f"{name}_origin": lower - step, f"{name}_step": step}


def rain_data(
    examples: "dict[str, Example]",
    bounders: dict[str, wb.Bounder] | None = None,
    reference: "Example | None" = None,
) -> dict[str, np.ndarray]:
    """What the picture of the rain needs.

    Args:
        examples: Runs of one scene and length, by name; a panel each.
        bounders: Theirs, by the same names, where the bound is to be shown.
        reference: The run without a broad phase, to say what a run lost against it.

    Returns:
        Arrays by name.
    """
    data, bounders = {}, bounders or {}
    for number, (name, example) in enumerate(examples.items()):
        data["vertices"], data["faces"] = example.scene.motion.vertices_at(example.time), example.scene.motion.faces
        positions = example.positions.numpy()
        data[f"rain{number}_positions"], data[f"rain{number}_velocities"] = positions, example.velocities.numpy()
        lines = [CAPTIONS.get(name, name)]
        if name in bounders:
            data |= _decisions(f"around{number}", bounders[name], example.time)
            queries = np.insert(positions, 0, example.time, axis=1)
            balls = bounders[name].query(queries).numpy().astype(bool)
            lines.append(f"balls: drops in its bound (pale), {balls.sum():,} of {example.particles:,} now")
        else:
            balls = example.contacts.numpy().astype(bool)
            lines.append(f"balls: drops that touch the bunny, {balls.sum():,} of {example.particles:,} now")
        data[f"rain{number}_balls"] = balls
        if reference is not None:
            lost, alive = example.lost(reference), example.ages.numpy() + 1  # steps of the present life
            present = np.arange(example.steps)[:, None] >= example.steps - alive
            data[f"rain{number}_lost"] = (lost & present).any(axis=0)
            identical = example.state() == reference.state()
            end = "identical to the run without a bounder, to the bit" if identical else "red: drops that lost one"
            lines += [f"{lost.sum():,} contacts missed in {example.steps} steps", end]
        data[f"rain{number}_caption"] = np.array("\n".join(lines))
    return data


def _size(count: int) -> str:
    return f"{count} bytes" if count < 1024 else f"{count / 1024:.1f} kB"


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
    light(plotter)
    plotter.enable_depth_peeling(8)
    plotter.enable_anti_aliasing("ssaa")
    plotter.camera.position = center + np.array(away)
    plotter.camera.focal_point = center + np.array([0.0, 0.0, raised])
    plotter.camera.up = (0, 0, 1)
    plotter.camera.view_angle = angle


def _draw_bounds(data: dict[str, np.ndarray], path: Path) -> None:
    import pyvista

    count = sum(key.startswith("bound") and key.endswith("_value") for key in data)
    width = BOUNDS_SIZE[0] * count // COLUMNS_OF_BOUNDS
    plotter = pyvista.Plotter(off_screen=True, shape=(1, count), window_size=(width, BOUNDS_SIZE[1]), border=False)
    bunny = polygons(data["vertices"], data["faces"])
    for number in range(count):
        plotter.subplot(0, number)
        plotter.set_background("white")
        plotter.add_mesh(bunny, color=STONE, smooth_shading=True, ambient=0.25, specular=0.1)
        _add_bound(plotter, data, f"bound{number}", BOUND, 0.27)
        method, figures, apart = str(data[f"bound{number}_caption"]).split("\n")
        plotter.add_text(method, position=(0.06, 0.93), viewport=True, font_size=17, color=INK)
        plotter.add_text(figures, position=(0.06, 0.885), viewport=True, font_size=11, color=INK)
        if apart:
            plotter.add_text(apart, position=(0.06, 0.015), viewport=True, font_size=11, color=INK)
        _look(plotter, np.array(bunny.center), (-0.9, -5.4, 1.5), 0.1, 28)
    plotter.screenshot(str(path))
    plotter.close()


def _draw_rain(data: dict[str, np.ndarray], path: Path) -> None:
    import pyvista

    count = sum(key.endswith("_positions") for key in data)
    plotter = pyvista.Plotter(
        off_screen=True, shape=(1, count), window_size=(RAIN_PANEL[0] * count, RAIN_PANEL[1]), border=False
    )
    bunny = polygons(data["vertices"], data["faces"])
    for number in range(count):
        plotter.subplot(0, number)
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
        head, *lines = str(data[f"rain{number}_caption"]).split("\n")
        plotter.add_text(head, position=(0.04, 0.93), viewport=True, font_size=15, color=PAPER)
        plotter.add_text("\n".join(lines), position=(0.04, 0.84), viewport=True, font_size=11, color=PAPER)
        _look(plotter, np.array(bunny.center), (-1.3, -6.2, 1.6), 0.2, 22)
    plotter.screenshot(str(path))
    plotter.close()


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
