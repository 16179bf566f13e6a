"""How a view is shown: one self-contained web page."""

from html import escape

import numpy as np

from warp_bounding.views.view import State, View, needed

__all__ = ["page"]

STONE, BOUND, MISSED, INK = "#b9ad9e", "#2f7fd1", "#e02f2f", "#22303c"  # object, bound, denied of the object, text
PIXEL_COLOURS = ("#ffffff", BOUND, STONE, MISSED)  # by ``State.pixels``
VIEW = (-0.65, -1.45, 0.6)  # towards the camera: to the right, into the picture, up

OPACITY = 0.3  # of the bound
EDGE = 30.0  # degrees between two triangles from which they meet in an edge, and are no parts of one curved surface
MOST_TRIANGLES = 60_000  # of a surface; one with more is simplified, so that a browser turns it smoothly
PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{title}</title><style>
body {{ font: 15px/1.5 system-ui, sans-serif; margin: 1rem; color: {ink} }} h1 {{ font-size: 1.15rem; margin: 0 }}
dt {{ font-weight: 600 }} dd {{ margin: 0 0 .5rem; overflow-wrap: anywhere }}
</style></head><body><h1>{title}</h1>
{plot}
<dl>
{facts}
</dl></body></html>
"""


def page(view: View, title: str, up: str, library: str | None = None) -> str:
    """A page of a view, which turns with the mouse; its legend hides and shows what is seen.

    Args:
        view: What is seen.
        title: Its heading.
        up: The axis that is up, ``"x"``, ``"y"`` or ``"z"``; of a view in space.
        library: Address of plotly.js (``.js``), for a page that does not hold it; else the page needs no network.

    Raises:
        BoundingError: If a package is missing.
    """
    figure, owners = needed("plotly.graph_objects").Figure(), []  # the state that each trace belongs to; -1: to all
    shared = view.solid and len({id(state.object) for state in view.states}) == 1
    if shared:  # one object at all radii is drawn once
        _add_surface(figure, view.states[0].object, "the object", STONE, 1.0)
        owners.append(-1)
    for number, state in enumerate(view.states):
        if view.solid:
            if not shared:
                _add_surface(figure, state.object, "the object", STONE, 1.0)
            _add_surface(figure, state.bound, view.bounds, BOUND, OPACITY)
        else:
            _add_pixels(figure, view, state)
        owners += [number] * (len(figure.data) - len(owners))
    seen = [[owner in (-1, number) for owner in owners] for number in range(len(view.states))]
    for trace, first in zip(figure.data, seen[0], strict=True):
        trace.visible = first
    if len(view.states) > 1:
        steps = [
            {"label": state.label, "method": "update", "args": [{"visible": visible}]}
            for state, visible in zip(view.states, seen, strict=True)
        ]
        figure.update_layout(sliders=[{"steps": steps, "currentvalue": {"prefix": f"{view.asked} "}}])
    figure.update_layout(margin={"t": 20}, height=700)
    names, (right, into, high) = view.names, VIEW
    if view.solid:
        eye = {"x": (high, right, into), "y": (right, high, -into), "z": (right, into, high)}[up]
        axes = {f"{axis}axis_title": name for axis, name in zip("xyz", names, strict=True)}
        camera = {"up": {axis: int(axis == up) for axis in "xyz"}, "eye": dict(zip("xyz", eye, strict=True))}
        figure.update_layout(scene={**axes, "aspectmode": "data", "camera": camera})
    else:
        right, high = (1, 0) if view.down else (0, 1)
        figure.update_xaxes(title=names[right])
        figure.update_yaxes(title=names[high], scaleanchor="x", scaleratio=view.stretch[high] / view.stretch[right])
        figure.update_yaxes(autorange="reversed" if view.down else True)
    facts = "\n".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in view.facts.items())
    plot = figure.to_html(full_html=False, include_plotlyjs=library or True, config={"displaylogo": False})
    return PAGE.format(title=escape(title), ink=INK, plot=plot, facts=facts)


def _add_surface(figure, surface, name: str, colour: str, opacity: float) -> None:
    """A surface with sharp edges, and no more triangles than a browser turns smoothly."""
    if surface.n_cells > MOST_TRIANGLES:
        surface = surface.clean().triangulate()
        surface = surface.decimate(1 - MOST_TRIANGLES / surface.n_cells)
    if surface.n_cells:
        surface = surface.compute_normals(split_vertices=True, feature_angle=EDGE, consistent_normals=False)
    corners = surface.regular_faces.astype(np.int32) if surface.n_cells else np.empty((0, 3), np.int32)
    axes = dict(zip("xyzijk", (*np.asarray(surface.points, np.float32).T, *corners.T), strict=True))
    figure.add_mesh3d(**axes, name=name, color=colour, opacity=opacity, showlegend=True, hoverinfo="skip")


def _add_pixels(figure, view: View, state: State) -> None:
    """Pixels of one state in a plane."""
    pixels = state.pixels(view.within)
    middles = [
        low + (np.arange(n) + 0.5) * (high - low) / n
        for low, high, n in zip(view.lower, view.upper, pixels.shape, strict=True)
    ]
    x, y = middles[::-1] if view.down else middles
    last = len(PIXEL_COLOURS) - 1
    scale = [[k / (last + 1), colour] for n, colour in enumerate(PIXEL_COLOURS) for k in (n, n + 1)]
    options = {"zmin": -0.5, "zmax": last + 0.5, "colorscale": scale, "showscale": False, "hoverinfo": "skip"}
    figure.add_heatmap(x=x, y=y, z=pixels if view.down else pixels.T, visible=True, **options)
