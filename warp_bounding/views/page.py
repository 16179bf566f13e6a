"""One self-contained web page of a view, which turns with the mouse and needs no network: plotly.js comes from the installed plotly.

Surfaces are stored as 16-bit numbers between the corners of what is seen, compressed; pictures of a plane as PNG.
"""

import base64
import io
import json
import zlib
from html import escape
from importlib.resources import files
from string import Template
from typing import Any

import numpy as np

from warp_bounding.views.needed import needed
from warp_bounding.views.stage import BOUND, MISSED, STONE, UPS, VIEW, polygons
from warp_bounding.views.surfaces import Surface
from warp_bounding.views.view import State, View

__all__ = ["MOST_TRIANGLES", "page"]

MOST_TRIANGLES = 60_000  # of a surface; one with more is simplified
CUTS = (2, 2, 1)  # by the axis that is up: the axis along which the camera looks the most
DISTANCE = 1.7  # of the camera from the middle, in plotly's units: about the sides of what is seen


def page(view: View, title: str, up: str) -> str:
    """A page of a view.

    Args:
        view: What is seen.
        title: Its heading.
        up: The axis that is up, a name in ``UPS``; of a view in space.

    Raises:
        BoundingError: If a package is missing.
    """
    library = needed("plotly.offline").get_plotlyjs()
    surfaces: list[dict[str, str]] = []
    numbers: dict[int, int] = {}  # of surfaces that several states have, by identity

    def number_of(surface: Surface) -> int:
        if id(surface) not in numbers:
            numbers[id(surface)] = len(surfaces)
            surfaces.append(_packed(view, surface))
        return numbers[id(surface)]

    told = {
        "names": view.names,
        "lower": view.lower.tolist(),
        "upper": view.upper.tolist(),
        "solid": view.solid,
        "asked": view.asked,
        "within": view.within,
        "down": view.down,
        "stretch": list(view.stretch),
        "up": UPS[up],
        "cut": CUTS[UPS[up]],
        "eye": _eye(UPS[up]),
        "colours": {"object": STONE, "bound": BOUND},
        "groups": [group._asdict() for group in view.groups],
        "states": [_state(view, state, number_of) for state in view.states],
        "surfaces": surfaces,
    }
    return _template("page.html").substitute(
        title=escape(title),
        style=_template("page.css").template,
        facts="\n".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in view.facts.items()),
        library=library,
        view=json.dumps(told, allow_nan=False).replace("</", "<\\/"),
        program=_template("page.js").template,
    )


def _template(name: str) -> Template:
    return Template((files("warp_bounding.views") / "templates" / name).read_text(encoding="utf-8"))


def _state(view: View, state: State, number_of) -> dict[str, Any]:
    about: dict[str, Any] = {"label": state.label, "rates": state.rates, "fn": state.fn}
    about["points"] = {name: _places(view, points) for name, points in state.points.items()}
    about["counts"] = {name: len(points) for name, points in state.points.items()}
    if view.solid:
        return about | {"object": number_of(state.object), "bound": number_of(state.bound)}
    layers = {"object": (state.object, STONE), "bound": (state.bound, BOUND)}
    layers["missed"] = (state.missed(view.within), MISSED)
    return about | {
        "pictures": {
            name: _png(mask if view.down else np.rot90(mask), colour) for name, (mask, colour) in layers.items()
        }
    }


def _eye(up: int) -> dict[str, float]:
    """Where the camera stands, in plotly's units, seen from the middle; as in pictures."""
    right, into, high = np.array(VIEW) / np.linalg.norm(VIEW) * DISTANCE
    turned = {0: (high, right, into), 1: (right, high, -into), 2: (right, into, high)}[up]
    return dict(zip("xyz", map(float, turned), strict=True))


def _packed(view: View, surface: Surface) -> dict[str, str]:
    """A surface with split edges, so that these look sharp, and no more triangles than a browser turns smoothly."""
    found = polygons(surface, np.asarray)
    if found is None:
        return {"vertices": _deflated(np.empty(0, "<u2")), "faces": _deflated(np.empty(0, "<u4"))}
    if found.n_cells > MOST_TRIANGLES:
        whole = found.clean().triangulate()
        simple = whole.decimate(1 - MOST_TRIANGLES / whole.n_cells)
        found = polygons(Surface(np.asarray(simple.points, np.float64), simple.regular_faces), np.asarray)
    faces = found.regular_faces.astype("<u4")
    return {"vertices": _places(view, np.asarray(found.points)), "faces": _deflated(np.ascontiguousarray(faces.T))}


def _places(view: View, points: np.ndarray) -> str:
    """Points ``(N, k)`` as 16-bit numbers between the corners of what is seen, axis by axis."""
    shares = (points - view.lower) / (view.upper - view.lower)
    return _deflated(np.ascontiguousarray(np.rint(np.clip(shares, 0, 1) * 65535).astype("<u2").T))


def _deflated(values: np.ndarray) -> str:
    return base64.b64encode(zlib.compress(values.tobytes(), 9)).decode()


def _png(mask: np.ndarray, colour: str) -> str:
    """Rows of a mask as a picture, clear where it is false."""
    image = needed("PIL.Image").fromarray(np.ascontiguousarray(mask).astype(np.uint8), mode="P")
    image.putpalette([0, 0, 0, *(int(colour[k : k + 2], 16) for k in (1, 3, 5))])
    content = io.BytesIO()
    image.save(content, "png", transparency=0, optimize=True)
    return "data:image/png;base64," + base64.b64encode(content.getvalue()).decode()
