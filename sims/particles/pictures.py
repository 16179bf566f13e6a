"""Pictures of the moving bunny's bounds at one time, and of the rain; drawn by ``sims.drawing`` in a process of its own."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import warp_bounding as wb
from sims.drawing import INK, STONE, light, polygons, upright

if TYPE_CHECKING:
    from sims.particles.example import Example
    from sims.particles.scene import Scene

__all__ = ["bounds_data", "draw", "rain_data"]

BOUNDS_PICTURE, RAIN_PICTURE = "bounds.png", "rain.png"
CELLS = 96  # along each side of the domain, where a bound's surface is looked for
BOUND, FREE = "#2f7fd1", "#8fb4d6"
PALETTE = ["#0b3c8c", "#1f7fd0", "#39b8d9", "#a5e3d8"]
COLUMNS_OF_BOUNDS, BOUNDS_SIZE, RAIN_SIZE = 3, (1600, 640), (1600, 1200)


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
        lower, upper = bounder.domain.lower[1:], bounder.domain.upper[1:]
        step = (upper - lower) / CELLS
        axes = [np.linspace(lo - s, hi + s, CELLS + 3) for lo, hi, s in zip(lower, upper, step, strict=True)]
        places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        points = np.insert(places, 0, time, axis=1).astype(np.float32)
        value = bounder.values(points).numpy().astype(np.float64) - float(bounder.threshold)
        value[np.isneginf(value)] = -np.median(np.abs(value[np.isfinite(value)]))  # outside the domain: no
        data[f"bound{number}_value"] = value.reshape([CELLS + 3] * 3)
        data[f"bound{number}_origin"], data[f"bound{number}_step"] = lower - step, step
        data[f"bound{number}_caption"] = np.array(f"{method}\n{rate:.1f} % false positives, {_size(bounder.nbytes)}")
    return data


def rain_data(example: "Example") -> dict[str, np.ndarray]:
    """What the picture of the rain needs."""
    return {
        "vertices": example.scene.motion.vertices_at(example.time),
        "faces": example.scene.motion.faces,
        "positions": example.positions.numpy(),
        "velocities": example.velocities.numpy(),
        "contacts": example.contacts.numpy(),
    }


def _size(count: int) -> str:
    return f"{count} bytes" if count < 1024 else f"{count / 1024:.1f} kB"


def draw(data: dict[str, np.ndarray], folder: Path) -> None:
    """Draw all pictures that there are data for."""
    if "bound0_value" in data:
        _draw_bounds(data, folder / BOUNDS_PICTURE)
    if "positions" in data:
        _draw_rain(data, folder / RAIN_PICTURE)


def _bound_surface(data: dict[str, np.ndarray], number: int):
    """The surface where a bounder's answer changes."""
    import pyvista

    value = data[f"bound{number}_value"]
    grid = pyvista.ImageData(
        dimensions=value.shape, spacing=data[f"bound{number}_step"], origin=data[f"bound{number}_origin"]
    )
    grid["value"] = value.reshape(-1, order="F")
    surface = grid.contour([0.0], scalars="value", method="contour").triangulate()
    surface.points = upright(surface.points)
    surface.flip_faces(inplace=True)
    return surface.compute_normals(split_vertices=True, feature_angle=35.0)


def _draw_bounds(data: dict[str, np.ndarray], path: Path) -> None:
    import pyvista

    count = sum(key.endswith("_value") for key in data)
    width = BOUNDS_SIZE[0] * count // COLUMNS_OF_BOUNDS
    plotter = pyvista.Plotter(off_screen=True, shape=(1, count), window_size=(width, BOUNDS_SIZE[1]), border=False)
    bunny = polygons(data["vertices"], data["faces"])
    center = np.array(bunny.center)
    for number in range(count):
        plotter.subplot(0, number)
        plotter.set_background("white")
        plotter.add_mesh(bunny, color=STONE, smooth_shading=True, ambient=0.25, specular=0.1)
        bound = _bound_surface(data, number)
        plotter.add_mesh(bound, color=BOUND, opacity=0.27, smooth_shading=True, specular=0.6, specular_power=30)
        method, figures = str(data[f"bound{number}_caption"]).split("\n")
        plotter.add_text(method, position=(0.06, 0.915), viewport=True, font_size=17, color=INK)
        plotter.add_text(figures, position=(0.06, 0.865), viewport=True, font_size=11, color=INK)
        light(plotter)
        plotter.enable_depth_peeling(8)
        plotter.enable_anti_aliasing("ssaa")
        plotter.camera.position = center + np.array([-0.9, -5.4, 1.5])
        plotter.camera.focal_point = center + np.array([0.0, 0.0, 0.1])
        plotter.camera.up = (0, 0, 1)
        plotter.camera.view_angle = 26
    plotter.screenshot(str(path))
    plotter.close()


def _draw_rain(data: dict[str, np.ndarray], path: Path) -> None:
    import pyvista
    from matplotlib.colors import LinearSegmentedColormap

    plotter = pyvista.Plotter(off_screen=True, window_size=RAIN_SIZE)
    plotter.set_background("#0d1620", top="#2b3e50")
    bunny = polygons(data["vertices"], data["faces"])
    plotter.add_mesh(bunny, color=STONE, smooth_shading=True, ambient=0.18, specular=0.15)
    x, v = upright(data["positions"]), upright(data["velocities"])
    speed, touching = np.linalg.norm(v, axis=1), data["contacts"].astype(bool)
    near = touching | (speed < 0.9 * np.median(speed[~touching]))  # slowed by the bunny: sliding on it, or dripping off
    colors = LinearSegmentedColormap.from_list("water", PALETTE)
    drops = pyvista.PolyData(x[near])
    drops["speed"] = speed[near]
    ball = pyvista.Sphere(radius=0.008, theta_resolution=10, phi_resolution=8)
    plotter.add_mesh(
        drops.glyph(geom=ball, scale=False, orient=False),
        scalars="speed",
        cmap=colors,
        clim=(0.0, 2.5),
        smooth_shading=True,
        specular=0.6,
        show_scalar_bar=False,
    )
    free = np.flatnonzero(~near)[::4]
    lines = pyvista.line_segments_from_points(np.stack([x[free], x[free] - 0.02 * v[free]], axis=1).reshape(-1, 3))
    plotter.add_mesh(lines, color=FREE, opacity=0.45, line_width=1.2)
    caption = f"{len(x):,} particles rain on the moving bunny. Balls: drops that met it, the darker the slower."
    plotter.add_text(caption, position=(0.02, 0.015), viewport=True, font_size=13, color="#c9d6e2")
    light(plotter)
    plotter.enable_depth_peeling(4)
    plotter.enable_anti_aliasing("ssaa")
    center = np.array(bunny.center)
    plotter.camera.position = center + np.array([-1.3, -6.2, 1.6])
    plotter.camera.focal_point = center + np.array([0.0, 0.0, 0.2])
    plotter.camera.up = (0, 0, 1)
    plotter.camera.view_angle = 26
    plotter.screenshot(str(path))
    plotter.close()
