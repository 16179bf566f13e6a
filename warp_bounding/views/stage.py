"""A view on a pyvista plotter: what the window and the off-screen pictures have in common."""

from typing import Any

import numpy as np

from warp_bounding.views.needed import needed
from warp_bounding.views.surfaces import Surface
from warp_bounding.views.view import State, View

__all__ = ["BOUND", "INK", "MISSED", "STONE", "UPS", "aim", "direction", "pixels", "placed", "polygons", "show_points"]

STONE, BOUND, MISSED, INK = "#b9ad9e", "#2f7fd1", "#e02f2f", "#22303c"  # object, bound, denied of the object, text
OPACITY = 0.3  # of the bound
POINT = 6.0  # pixels, of a point
UPS = {"x": 0, "y": 1, "z": 2}  # the axis that is up in pictures
RIGHT_UP, DOWN_RIGHT = -1, -2  # of planes: where the first coordinate and the second go
ANGLE = 28.0  # of the view, degrees
EDGE = 30.0  # degrees between two triangles from which they meet in an edge, rather than being parts of one curved surface
VIEW = (-0.45, -1.0, 0.4)  # towards the camera: to the right, into the picture, up


def direction(view: View, up: str) -> int:
    """What ``placed`` is told: the axis that is up in a view in space; in a plane ``RIGHT_UP``, or ``DOWN_RIGHT`` of images."""
    return UPS[up] if view.solid else DOWN_RIGHT if view.down else RIGHT_UP


def placed(points: np.ndarray, up: int) -> np.ndarray:
    """Points ``(N, 3)`` turned so that the axis that is up becomes z; points ``(N, 2)`` of a plane, at z = 0."""
    points = np.asarray(points, dtype=np.float64)
    if points.shape[1] == 2:
        x, y = (points[:, 1], -points[:, 0]) if up == DOWN_RIGHT else points.T
        return np.stack([x, y, np.zeros(len(points))], axis=1)
    return np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1) if up == 1 else np.roll(points, 2 - up, axis=1)


def polygons(surface: Surface, up: int):
    """A pyvista mesh of a surface, with sharp edges where it has some; ``None`` where it is empty."""
    pyvista = needed("pyvista")
    if not len(surface.faces):
        return None
    faces = np.insert(surface.faces, 0, 3, axis=1).reshape(-1)
    found = pyvista.PolyData(placed(surface.vertices, up), faces)
    return found.compute_normals(
        split_vertices=True, feature_angle=EDGE, consistent_normals=False, auto_orient_normals=False
    )


def pixels(view: View, state: State, up: int, layers: tuple[str, ...] = ("object", "bound")):
    """A picture of a plane as a pyvista image of coloured cells."""
    pyvista = needed("pyvista")
    colours = coloured(view, state, layers)
    if up == DOWN_RIGHT:
        colours = colours.transpose(1, 0, 2)[:, ::-1]
    count = np.array(colours.shape[:2])
    corners = placed(np.stack([view.lower, view.upper]), up)
    lower, size = corners.min(axis=0), (corners.max(axis=0) - corners.min(axis=0))[:2] / count
    image = pyvista.ImageData(dimensions=(*(count + 1), 1), spacing=(*size, 1.0), origin=tuple(lower))
    image.cell_data["colour"] = colours.reshape(-1, 3, order="F")
    return image


def coloured(view: View, state: State, layers: tuple[str, ...]) -> np.ndarray:
    """``(X, Y, 3)`` uint8: the pixels of a plane."""
    bound = state.bound if "bound" in layers else np.zeros_like(state.bound)
    body = state.object if "object" in layers else np.zeros_like(bound)
    colours = np.full((*bound.shape, 3), 255, dtype=np.uint8)
    first, second = ((body, STONE), (bound, BOUND)) if view.within else ((bound, BOUND), (body, STONE))
    for mask, colour in (first, second):
        colours[mask] = _rgb(colour)
    colours[state.missed(view.within)] = _rgb(MISSED)
    return colours


def _rgb(colour: str) -> list[int]:
    return [int(colour[k : k + 2], 16) for k in (1, 3, 5)]


def show_points(plotter, view: View, state: State, up: int, shown: dict[str, bool]) -> None:
    """Add the groups of points that are shown, and take away the others."""
    pyvista = needed("pyvista")
    for group in view.groups:
        points = state.points[group.name]
        if not shown.get(group.name, group.shown) or not len(points):
            plotter.remove_actor(group.name, render=False)
            continue
        options: dict[str, Any] = {"color": group.colour, "point_size": POINT, "render_points_as_spheres": True}
        plotter.add_mesh(pyvista.PolyData(placed(points, up)), name=group.name, **options)


def aim(plotter, view: View, up: int) -> None:
    """Lights, and a camera that sees all of a view."""
    pyvista = needed("pyvista")
    corners = placed(np.stack([view.lower, view.upper]), up)
    middle, size = corners.mean(axis=0), np.abs(corners[1] - corners[0])
    if not view.solid:
        plotter.view_xy()
        plotter.camera.parallel_projection = True
        plotter.camera.focal_point, plotter.camera.position = middle, middle + np.array([0, 0, size.max()])
        width, height = plotter.renderer.GetSize()
        plotter.camera.parallel_scale = max(size[1], size[0] * height / max(width, 1)) / 2 * 1.12
        plotter.reset_camera_clipping_range()
        return
    radius = np.linalg.norm(size) / 2
    plotter.remove_all_lights()
    for source, strength in (((-3, -5, 6), 0.75), ((5, -3, 2), 0.3), ((0, 4, 5), 0.3)):
        place = tuple(middle + radius * np.array(source))
        plotter.add_light(
            pyvista.Light(position=place, focal_point=tuple(middle), intensity=strength, light_type="scene light")
        )
    away = np.array(VIEW) / np.linalg.norm(VIEW) * radius / np.sin(np.radians(ANGLE) / 2) * 0.82
    plotter.camera.focal_point, plotter.camera.position = tuple(middle), tuple(middle + away)
    plotter.camera.up, plotter.camera.view_angle = (0, 0, 1), ANGLE
