"""The picture of the cloth: the run with a proven bounder beside the one with a network that has no proof."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sims.drawing import CAPTIONS, INK, STONE, light, polygons, upright

if TYPE_CHECKING:
    from sims.cloth.example import Example

__all__ = ["cloth_data", "draw"]

PICTURE = "cloth.png"
PANEL = (800, 560)
TIPS = "White tips: the star's points between particles; only particles collide"
CLOTH, WRONG = "#3f7fc4", "#d62718"


def cloth_data(examples: "dict[str, Example]", reference: "Example | None" = None) -> dict[str, np.ndarray]:
    """What the picture needs.

    Args:
        examples: By name; a panel each.
        reference: The run without a broad phase, to say of a panel that it is identical to it.

    Returns:
        Arrays by name.
    """
    from sims.cloth.scene import RADIUS
    from sims.cloth.scene import shape as mesh_of

    data = {"names": np.array(list(examples)), "radius": np.array(RADIUS)}
    for number, (name, example) in enumerate(examples.items()):
        scene, depths = example.scene, example.look()
        data["triangles"] = scene.triangles
        for shape in scene.indices:
            data[f"{shape}_vertices"], data[f"{shape}_faces"] = scene.world_vertices(shape), mesh_of(shape).faces
        data["shapes"] = np.array(list(scene.indices))
        data[f"positions{number}"] = example.state.particle_q.numpy()
        data[f"depths{number}"] = depths
        head = CAPTIONS.get(name, name)
        under, deepest = int((depths > 0).sum()), example.deepest
        below = f"{under} particles under the surface" + (f" (red), the deepest {deepest:.3f}" if under else "")
        missed = f"{example.missed:,} contacts missed"
        if reference is not None and example is not reference and example.identical(reference):
            missed += "; identical to the run without a bounder, to the bit"
        data[f"caption{number}"] = np.array(f"{head}\n{missed}\n{below}")
    return data


def _top(positions: np.ndarray, triangles: np.ndarray, radius: float) -> np.ndarray:
    """The upper side of the cloth, which is as thick as its particles."""
    q = positions.astype(np.float64)
    a, b, c = (q[triangles[:, i]] for i in range(3))
    normals, across = np.zeros_like(q), np.cross(b - a, c - a)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], across)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return q + radius * np.divide(normals, length, out=np.zeros_like(q), where=length > 0)


def draw(data: dict[str, np.ndarray], folder: Path) -> None:
    """Draw ``cloth.png``."""
    import pyvista

    count = len(data["names"])
    plotter = pyvista.Plotter(off_screen=True, shape=(1, count), window_size=(PANEL[0] * count, PANEL[1]), border=False)
    for number in range(count):
        plotter.subplot(0, number)
        plotter.set_background("white")
        for shape in data["shapes"]:
            surface = polygons(data[f"{shape}_vertices"], data[f"{shape}_faces"])
            plotter.add_mesh(surface, color=STONE, smooth_shading=True, ambient=0.25, specular=0.1)
        top = _top(data[f"positions{number}"], data["triangles"], float(data["radius"]))
        cloth = polygons(top, data["triangles"])
        plotter.add_mesh(cloth, color=CLOTH, smooth_shading=True, ambient=0.15, specular=0.25, specular_power=20)
        under = data[f"depths{number}"] > 0
        if under.any():
            dots = pyvista.PolyData(upright(top[under]))
            ball = pyvista.Sphere(radius=1.3 * float(data["radius"]), theta_resolution=12, phi_resolution=10)
            plotter.add_mesh(dots.glyph(geom=ball, scale=False, orient=False), color=WRONG, ambient=0.5)
        head, *lines = str(data[f"caption{number}"]).split("\n")
        plotter.add_text(head, position=(0.04, 0.92), viewport=True, font_size=15, color=INK)
        plotter.add_text("\n".join(lines), position=(0.04, 0.84), viewport=True, font_size=11, color=INK)
        plotter.add_text(TIPS, position=(0.04, 0.02), viewport=True, font_size=10, color=INK)
        light(plotter, (0.0, 0.0, 1.0))
        plotter.enable_anti_aliasing("ssaa")
        plotter.camera.position = (-1.0, -5.6, 4.6)
        plotter.camera.focal_point = (0.08, 0.0, 0.86)
        plotter.camera.up = (0, 0, 1)
        plotter.camera.view_angle = 22
    plotter.screenshot(str(folder / PICTURE))
    plotter.close()
