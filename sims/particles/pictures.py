"""Pictures of bounds and of rain, drawn off-screen with pyvista: no display is needed.

Drawing runs in a process of its own. Where there is no OpenGL, VTK does not raise an exception, it crashes; so a crash
costs the pictures, not the demo, and its complaints go to a log instead of the terminal. Without a display the process
asks for EGL, then for OSMesa.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

import warp_bounding as wb

if TYPE_CHECKING:
    from sims.rain import Example

__all__ = ["Drawn", "bounds_data", "rain_data", "render"]

BOUNDS_PICTURE, RAIN_PICTURE = "bounds.png", "rain.png"
CELLS = 96  # along each side of the domain, where a bound's surface is looked for
SECONDS = 120  # for drawing
WINDOWS = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow")

STONE, BOUND, INK, FREE = "#d8cfc4", "#2f7fd1", "#22303c", "#8fb4d6"
PALETTE = ["#0b3c8c", "#1f7fd0", "#39b8d9", "#a5e3d8"]
COLUMNS_OF_BOUNDS, BOUNDS_SIZE, RAIN_SIZE = 3, (1600, 640), (1600, 1200)


class Drawn(NamedTuple):
    """The pictures that were drawn, and in one line why some were not."""

    paths: list[Path]
    problem: str = ""


def bounds_data(shape: wb.IndicatorMesh, bounders: dict[str, tuple[wb.Bounder, float]]) -> dict[str, np.ndarray]:
    """What the picture of the bounds needs.

    Args:
        shape: The object.
        bounders: Per method: a bounder and its false positives in per cent.

    Returns:
        Arrays by name: for each bound, its decision function on a grid over its domain, one point beyond it included.
    """
    data = {"vertices": shape.vertices, "faces": shape.faces}
    for number, (method, (bounder, rate)) in enumerate(bounders.items()):
        domain = bounder.domain
        step = (domain.upper - domain.lower) / CELLS
        axes = [
            np.linspace(lo - s, hi + s, CELLS + 3) for lo, hi, s in zip(domain.lower, domain.upper, step, strict=True)
        ]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        value = bounder.values(points.astype(np.float32)).numpy().astype(np.float64) - float(bounder.threshold)
        value[np.isneginf(value)] = -np.median(np.abs(value[np.isfinite(value)]))  # outside the domain: no
        data[f"bound{number}_value"] = value.reshape([CELLS + 3] * 3)
        data[f"bound{number}_origin"], data[f"bound{number}_step"] = domain.lower - step, step
        data[f"bound{number}_caption"] = np.array(f"{method}\n{rate:.1f} % false positives, {_size(bounder.nbytes)}")
    return data


def rain_data(example: "Example") -> dict[str, np.ndarray]:
    """What the picture of the rain needs."""
    shape = example.scene.shape
    return {
        "vertices": shape.vertices,
        "faces": shape.faces,
        "positions": example.positions.numpy(),
        "velocities": example.velocities.numpy(),
        "contacts": example.contacts.numpy(),
    }


def _size(count: int) -> str:
    return f"{count} bytes" if count < 1024 else f"{count / 1024:.1f} kB"


def render(folder: Path, data: dict[str, np.ndarray]) -> Drawn:
    """Draw ``bounds.png`` and ``rain.png``, as far as there are data for them.

    Args:
        folder: Where to; made if there is none. A picture is replaced only whole.
        data: From ``bounds_data``, ``rain_data``, or both joined.

    Returns:
        The pictures, or why there are none.
    """
    folder.mkdir(parents=True, exist_ok=True)
    root = str(Path(__file__).resolve().parent.parent)
    with tempfile.TemporaryDirectory(dir=folder, prefix=".drawing") as work:
        file = Path(work) / "data.npz"
        np.savez(file, **data)
        problem = ""
        for window in _windows():
            environment = {**os.environ, **window}
            environment["PYTHONPATH"] = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
            command = [sys.executable, "-m", "sims.pictures", str(file), work]
            try:
                done = subprocess.run(
                    command, env=environment, capture_output=True, text=True, timeout=SECONDS, check=False
                )
            except subprocess.TimeoutExpired:
                problem = problem or f"drawing took more than {SECONDS} s"
                continue
            made = [Path(work) / name for name in (BOUNDS_PICTURE, RAIN_PICTURE) if (Path(work) / name).is_file()]
            if done.returncode == 0 and made:
                return Drawn([path.replace(folder / path.name) for path in made])
            problem = problem or _reason(done)
    return Drawn([], f"No pictures: {problem}. Everything else is complete.")


def _windows() -> list[dict[str, str]]:
    """Environments to try: the user's own choice or display first."""
    if os.environ.get("VTK_DEFAULT_OPENGL_WINDOW") or not sys.platform.startswith("linux"):
        return [{}]
    off_screen = [{"VTK_DEFAULT_OPENGL_WINDOW": name, "DISPLAY": ""} for name in WINDOWS]
    return [{}, *off_screen] if os.environ.get("DISPLAY") else off_screen


def _reason(done: subprocess.CompletedProcess) -> str:
    """Why the drawing process failed, in a few words."""
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    if "No module named 'pyvista'" in done.stderr:
        return "pyvista is not installed (pip install 'warp-bounding[sims]')"
    if done.returncode < 0 or "OpenGL" in done.stderr or "EGL" in done.stderr or "OSMesa" in done.stderr:
        return "this machine has no OpenGL for off-screen drawing (libEGL or libOSMesa)"
    return f"drawing failed ({lines[-1] if lines else f'status {done.returncode}'})"


# --- what runs in the process that draws ------------------------------------------------------------------------------


def draw(file: Path, folder: Path) -> None:
    """Draw all pictures that there are data for."""
    data = dict(np.load(file))
    if "bound0_value" in data:
        _draw_bounds(data, folder / BOUNDS_PICTURE)
    if "positions" in data:
        _draw_rain(data, folder / RAIN_PICTURE)


def _polygons(vertices: np.ndarray, faces: np.ndarray):
    """A pyvista surface, y up turned into z up."""
    import pyvista

    surface = pyvista.PolyData(_upright(vertices), np.insert(faces, 0, 3, axis=1).reshape(-1))
    return surface.compute_normals(split_vertices=False, feature_angle=180.0)


def _upright(points: np.ndarray) -> np.ndarray:
    """Coordinates for drawing: x, -z, y."""
    points = np.asarray(points, dtype=np.float64)
    return np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)


def _bound_surface(data: dict[str, np.ndarray], number: int):
    """The surface where a bounder's answer changes."""
    import pyvista

    value = data[f"bound{number}_value"]
    grid = pyvista.ImageData(
        dimensions=value.shape, spacing=data[f"bound{number}_step"], origin=data[f"bound{number}_origin"]
    )
    grid["value"] = value.reshape(-1, order="F")
    surface = grid.contour([0.0], scalars="value", method="contour").triangulate()
    surface.points = _upright(surface.points)
    surface.flip_faces(inplace=True)
    return surface.compute_normals(split_vertices=True, feature_angle=35.0)


def _light(plotter) -> None:
    import pyvista

    plotter.remove_all_lights()
    for position, strength in (((-3, -5, 6), 0.75), ((5, -3, 2), 0.3), ((0, 4, 5), 0.3)):
        light = pyvista.Light(position=position, focal_point=(0, 0, 0.8), intensity=strength, light_type="scene light")
        plotter.add_light(light)


def _draw_bounds(data: dict[str, np.ndarray], path: Path) -> None:
    import pyvista

    count = sum(key.endswith("_value") for key in data)
    width = BOUNDS_SIZE[0] * count // COLUMNS_OF_BOUNDS
    plotter = pyvista.Plotter(off_screen=True, shape=(1, count), window_size=(width, BOUNDS_SIZE[1]), border=False)
    bunny = _polygons(data["vertices"], data["faces"])
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
        _light(plotter)
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
    bunny = _polygons(data["vertices"], data["faces"])
    plotter.add_mesh(bunny, color=STONE, smooth_shading=True, ambient=0.18, specular=0.15)
    x, v = _upright(data["positions"]), _upright(data["velocities"])
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
    caption = f"{len(x):,} particles rain on the bunny. Balls: drops that met it, the darker the slower."
    plotter.add_text(caption, position=(0.02, 0.015), viewport=True, font_size=13, color="#c9d6e2")
    _light(plotter)
    plotter.enable_depth_peeling(4)
    plotter.enable_anti_aliasing("ssaa")
    center = np.array(bunny.center)
    plotter.camera.position = center + np.array([-1.3, -6.2, 1.6])
    plotter.camera.focal_point = center + np.array([0.0, 0.0, 0.2])
    plotter.camera.up = (0, 0, 1)
    plotter.camera.view_angle = 26
    plotter.screenshot(str(path))
    plotter.close()


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
