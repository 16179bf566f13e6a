"""A window on a view: turn it with the mouse, slide through radii or times, drag a plane that cuts the bound open, tick what is shown."""

import os
import sys
import textwrap
from functools import partial

import numpy as np

from warp_bounding.errors import BoundingError
from warp_bounding.views.needed import needed
from warp_bounding.views.stage import (
    BOUND,
    INK,
    OPACITY,
    STONE,
    aim,
    pixels,
    placing,
    polygons,
    show_points,
)
from warp_bounding.views.view import View

__all__ = ["Window", "check_display"]

SIZE = (1200, 900)  # pixels
BOX, FIRST, STEP = 22, 20, 34  # pixels: a tick box, where the first begins, and from one to the next
LETTERS = 110  # of a line of text
OPENED = 0.85  # opacity of a bound that is cut open


def check_display() -> None:
    """Refuse where there is no display to open a window on, rather than let VTK crash.

    Raises:
        BoundingError: Saying what works without one.
    """
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise BoundingError("there is no display for a window: expected --screenshot FILE.png or --html FILE.html")


class Window:
    """A window, not yet open.

    Args:
        view: What is seen.
        title: Of the window.
        up: The axis that is up, a name in ``UPS``; of a view in space.
        off_screen: Draw where nobody sees it, for tests.

    Raises:
        BoundingError: If pyvista is missing.
    """

    def __init__(self, view: View, title: str, up: str, *, off_screen: bool = False):
        pyvista = needed("pyvista")
        self.view, self.place, self.number = view, placing(view, up), 0
        self.shown = {"object": True, "bound": True, **{g.name: g.shown for g in view.groups}}
        self.plane: tuple[np.ndarray, np.ndarray] | None = None  # normal and origin of the cut
        self.plotter = pyvista.Plotter(window_size=SIZE, title=title, off_screen=off_screen)
        self.plotter.set_background("white")
        if view.solid:
            self.plotter.enable_depth_peeling(8)
            self.plotter.enable_anti_aliasing("fxaa")  # with samples of pixels nothing that is peeled is drawn
        self.draw()
        aim(self.plotter, view, self.place)
        self._controls()

    def open(self) -> None:
        """Show the window until it is closed."""
        self.plotter.show()

    def draw(self) -> None:
        """Draw what is shown by now."""
        view, plotter, state = self.view, self.plotter, self.view.states[self.number]
        if view.solid:
            self._add("object", polygons(state.object, self.place), STONE, 1.0)
            self._add("bound", self._bound(), BOUND, OPACITY if self.plane is None else OPENED)
        else:
            layers = tuple(name for name in ("object", "bound") if self.shown[name])
            plotter.add_mesh(
                pixels(view, state, self.place, layers), scalars="colour", rgb=True, lighting=False, name="pixels"
            )
        show_points(plotter, view, state, self.place, self.shown)
        at = f"{view.asked} {state.label}: " if state.label else ""
        text = "\n".join([*textwrap.wrap(f"{at}{state.rates}", LETTERS), *textwrap.wrap(view.brief, LETTERS)])
        plotter.add_text(text, position="upper_left", font_size=11, color=INK, name="rates")

    def toggle(self, name: str, shown: bool) -> None:
        """Show something, or hide it: ``object``, ``bound`` or a group of points."""
        self.shown[name] = bool(shown)
        self.draw()

    def go(self, number: float) -> None:
        """Go to the state that is nearest to a number."""
        nearest = round(float(number))
        if nearest != self.number:
            self.number = nearest
            self.draw()

    def cut(self, normal, origin) -> None:
        """Cut the bound by a plane, and show what lies on its normal's side."""
        self.plane = np.asarray(normal, dtype=float), np.asarray(origin, dtype=float)
        self.draw()

    def _bound(self):
        bound = polygons(self.view.states[self.number].bound, self.place)
        if bound is None or self.plane is None:
            return bound
        return bound.clip(tuple(-self.plane[0]), origin=tuple(self.plane[1]))

    def _add(self, name: str, surface, colour: str, opacity: float) -> None:
        if surface is None or not surface.n_cells or not self.shown[name]:
            self.plotter.remove_actor(name, render=False)
            return
        options = {"smooth_shading": True, "ambient": 0.3, "specular": 0.2, "reset_camera": False}
        self.plotter.add_mesh(surface, color=colour, opacity=opacity, name=name, **options)

    def _controls(self) -> None:
        view, plotter = self.view, self.plotter
        bound = "certainly inside" if view.within else "the bound: maybe"
        listed = [("object", "the object", STONE), ("bound", bound, BOUND)]
        listed += [(group.name, group.text, group.colour) for group in view.groups]
        ticks = [(text, colour, self.shown[name], partial(self.toggle, name)) for name, text, colour in listed]
        if view.solid:
            ticks.append(("a plane that cuts the bound", INK, False, self._cutting))
        for place, (text, colour, shown, tell) in enumerate(reversed(ticks)):
            high = FIRST + STEP * place
            options = {"value": shown, "position": (FIRST, high), "size": BOX, "border_size": 2}
            plotter.add_checkbox_button_widget(tell, **options, color_on=colour, color_off="white")
            plotter.add_text(text, position=(FIRST + BOX + 10, high), font_size=10, color=INK)
        if len(view.states) > 1:
            last = len(view.states) - 1
            options = {"title": f"{view.asked} {view.states[0].label} to {view.states[last].label}", "color": INK}
            plotter.add_slider_widget(
                self.go,
                rng=(0, last),
                value=0,
                pointa=(0.55, 0.08),
                pointb=(0.95, 0.08),
                fmt="",
                style="modern",
                **options,
            )

    def _cutting(self, on: bool) -> None:
        """Add the plane that cuts, or take it away."""
        if not on:
            self.plotter.clear_plane_widgets()
            self.plane = None
            self.draw()
            return
        middle = self.place(((self.view.lower + self.view.upper) / 2)[None])[0]
        corners = self.place(np.stack([self.view.lower, self.view.upper]))
        bounds = np.sort(corners, axis=0).T.reshape(-1).tolist()
        self.plotter.add_plane_widget(
            self.cut, normal=(0, 1, 0), origin=tuple(middle), color=INK, bounds=bounds, factor=1.0
        )
