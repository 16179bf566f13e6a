"""A view on a pyvista plotter: what the window and the off-screen pictures have in common."""

from collections.abc import Callable
from typing import Any

import numpy as np

from warp_bounding.views.needed import needed
from warp_bounding.views.surfaces import Surface
from warp_bounding.views.view import State, View

__all__ = [
    "BOUND",
    "INK",
    "MISSED",
    "OPACITY",
    "STONE",
    "UPS",
    "VIEW",
    "Placing",
    "aim",
    "pixels",
    "placing",
    "polygons",
    "show_points",
]

Placing = Callable[[np.ndarray], np.ndarray]

STONE, BOUND, MISSED, INK = "#b9ad9e", "#2f7fd1", "#e02f2f", "#22303c"  # object, bound, denied of the object, text
OPACITY = 0.3  # of the bound
POINT = 6.0  # pixels, of a point
UPS = {"x": 0, "y": 1, "z": 2}  # the axis that is up in pictures
ANGLE = 28.0  # of the view, degrees
EDGE = (
    30.0  # degrees between two triangles from which they meet in an edge, rather than being parts of one curved surface
)
NEAR = 0.86  # of the distance from which the ball around what is seen fills the picture
VIEW = (-0.45, -1.0, 0.4)  # towards the camera: to the right, into the picture, up


def placing(view: View, up: str) -> Placing:
    """Where points of a view are put: a function from ``(N, k)`` to ``(N, 3)`` float64.

    Args:
        view: Of space, or of a plane, which lies at z = 0.
        up: The axis that becomes z, a name in ``UPS``; of a view of space.
    """
    axis, stretch = UPS[up], np.asarray(view.stretch)

    def of_space(points: np.ndarray) -> np.ndarray:
        x, y, z = np.asarray(points, dtype=np.float64).T
        return np.stack(((y, z, x), (x, -z, y), (x, y, z))[axis], axis=1)

    def of_plane(points: np.ndarray) -> np.ndarray:
        a, b = (np.asarray(points, dtype=np.float64) * stretch).T
        x, y = (b, -a) if view.down else (a, b)
        return np.stack([x, y, np.zeros(len(x))], axis=1)

    return of_space if view.solid else of_plane


def polygons(surface: Surface, place: Placing):
    """A pyvista mesh of a surface, put in its place, with sharp edges where it has some; ``None`` where it is empty."""
    pyvista = needed("pyvista")
    if not len(surface.faces):
        return None
    faces = np.insert(surface.faces, 0, 3, axis=1).reshape(-1)
    found = pyvista.PolyData(place(surface.vertices), faces)
    return found.compute_normals(
        split_vertices=True, feature_angle=EDGE, consistent_normals=False, auto_orient_normals=False
    )


def pixels(view: View, state: State, place: Placing, layers: tuple[str, ...] = ("object", "bound")):
    """A picture of a plane as a pyvista image of coloured cells."""
    pyvista = needed("pyvista")
    colours = coloured(view, state, layers)
    if view.down:
        colours = colours.transpose(1, 0, 2)[:, ::-1]
    count = np.array(colours.shape[:2])
    corners = place(np.stack([view.lower, view.upper]))
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


def show_points(plotter, view: View, state: State, place: Placing, shown: dict[str, bool]) -> None:
    """Add the groups of points that are shown, and take away the others."""
    pyvista = needed("pyvista")
    for group in view.groups:
        points = state.points[group.name]
        if not shown.get(group.name, group.shown) or not len(points):
            plotter.remove_actor(group.name, render=False)
            continue
        options: dict[str, Any] = {
            "color": group.colour,
            "point_size": POINT,
            "render_points_as_spheres": True,
            "lighting": False,
        }
        plotter.add_mesh(pyvista.PolyData(place(points)), name=group.name, **options)


def aim(plotter, view: View, place: Placing) -> None:
    """Lights, and a camera that sees all of a view."""
    pyvista = needed("pyvista")
    corners = place(np.stack([view.lower, view.upper]))
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
        at = tuple(middle + radius * np.array(source))
        plotter.add_light(
            pyvista.Light(position=at, focal_point=tuple(middle), intensity=strength, light_type="scene light")
        )
    away = np.array(VIEW) / np.linalg.norm(VIEW) * radius / np.sin(np.radians(ANGLE) / 2) * NEAR
    plotter.camera.focal_point, plotter.camera.position = tuple(middle), tuple(middle + away)
    plotter.camera.up, plotter.camera.view_angle = (0, 0, 1), ANGLE
