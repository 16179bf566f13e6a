"""``warp-bounding show``: see a bound around its object, in a window, a picture or a web page."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from warp_bounding.cli.options import (
    BounderFile,
    Device,
    Hollow,
    Json,
    Origin,
    Spacing,
    Threshold,
    Unknown,
    read_shape,
    whole_number,
)
from warp_bounding.cli.output import bar, certificate_summary, console, print_json, quiet_warp, warn
from warp_bounding.errors import BoundingError, QueryError
from warp_bounding.runtime.whole_file import PAGE_FILE, PICTURE_FILE, FileKind, check_writable, write_whole

__all__ = ["command"]

LEVELS = 6  # radii or times that are shown if none are named
FARTHEST = 0.25  # of the object's longest side: the largest of these radii
PANELS = 3  # of a picture, if no radii or times are named
RESOLUTIONS = 2, 1024  # cells, or pixels: least and most


def command(
    file: BounderFile,
    shape: Annotated[str, typer.Argument(metavar="SHAPE", help="The shape that it bounds.")],
    screenshot: Annotated[
        str | None, typer.Option(metavar="FILE.png", help="Write a picture instead of opening a window.")
    ] = None,
    html: Annotated[
        str | None,
        typer.Option(metavar="FILE.html", help="Write one web page that turns with the mouse and needs no network."),
    ] = None,
    radius: Annotated[
        str | None, typer.Option(help="Of a distance: a radius, or several such as 0,0.05,0.1; object units.")
    ] = None,
    time: Annotated[str | None, typer.Option(help="Of a shape that moves: a time, or several such as 0,0.5,1.")] = None,
    slice_: Annotated[
        str | None,
        typer.Option("--slice", metavar="K=VALUE,...", help="Hold coordinates, counted from 0, at values: 3=0.5,4=0."),
    ] = None,
    cut: Annotated[str | None, typer.Option(help="Cut the bound of a picture open along an axis: x, y or z.")] = None,
    up: Annotated[str, typer.Option(help="The axis that is up: x, y or z.")] = "y",
    resolution: Annotated[
        int | None, typer.Option(help="Cells along the longest side (default: 80), or pixels in 2D (640).")
    ] = None,
    samples: Annotated[str, typer.Option(help="Random points to ask, for each radius or time.")] = "1e5",
    seed: Annotated[int, typer.Option(help="Random seed of these points.")] = 1,
    threshold: Threshold = None,
    spacing: Spacing = None,
    origin: Origin = None,
    unknown: Unknown = None,
    hollow: Hollow = None,
    device: Device = "cpu",
    json: Json = False,
) -> int:
    """Show where FILE says maybe around SHAPE, and where its answers to random points are wrong.

    Without --screenshot or --html a window opens. A distance is shown at several radii, a shape that moves at several
    times; more than three coordinates need --slice.
    """
    from warp_bounding.bounders import load
    from warp_bounding.views.draw import Window, check_display, page, picture
    from warp_bounding.views.view import facts_of, needed, title_of, view_of

    radii, times, held = _numbers("radius", radius), _numbers("time", time), _held(slice_)
    _check_options(up, cut, screenshot, resolution, seed)
    count = whole_number("samples", samples)
    for path, kind in ((screenshot, PICTURE_FILE), (html, PAGE_FILE)):
        _check_output(path, kind, file, shape)
    needed("pyvista")
    if html is not None:
        needed("plotly")
    if screenshot is None and html is None:
        if json:
            raise QueryError("--json is for --screenshot or --html; a window prints nothing")
        check_display()
    quiet_warp(device)
    bounder, indicator = load(file, device=device), read_shape(shape, threshold, spacing, origin, unknown, hollow)
    with bar("show") as update:
        view = view_of(
            bounder,
            indicator,
            radii=radii or _radii(bounder, times),
            times=times or _times(indicator, radii),
            held=held,
            resolution=resolution,
            samples=count,
            seed=seed,
            progress=update,
        )
    title = title_of(bounder, indicator)
    view.facts = facts_of(bounder, indicator, view)
    if "Another shape" in view.facts:
        warn(view.facts["Another shape"])
    written = []
    if html is not None:
        write_whole(html, page(view, title, up).encode(), PAGE_FILE)
        written.append(html)
    if screenshot is not None:
        panels = view.states if radii or times else _spread(view.states)
        write_whole(screenshot, picture(replace(view, states=panels), title, up, cut), PICTURE_FILE)
        written.append(screenshot)
    if json:
        print_json(_report(bounder, view) | {"path": file, "shape": shape, "screenshot": screenshot, "html": html})
        return 0
    out = console(False)
    for state in view.states:
        at = f"{view.asked} {state.label}: " if state.label else ""
        out.print(f"{bounder.method}: {at}{state.rates}")
    for path in written:
        out.print(f"written to {path}")
    if not written:
        Window(view, title, up).open()
    return 0


def _check_options(up: str, cut: str | None, screenshot: str | None, resolution: int | None, seed: int) -> None:
    """Refuse what no file is needed to see."""
    from warp_bounding.views.draw import UPS

    for name, value in (("up", up), ("cut", cut)):
        if value is not None and value not in UPS:
            raise QueryError(f"{name} must be one of {', '.join(UPS)}, got {value!r}")
    if cut is not None and screenshot is None:
        raise QueryError("--cut is for --screenshot; windows and pages have a plane that cuts")
    if resolution is not None and not RESOLUTIONS[0] <= resolution <= RESOLUTIONS[1]:
        raise QueryError(f"resolution must be from {RESOLUTIONS[0]} to {RESOLUTIONS[1]}, got {resolution}")
    if seed < 0:
        raise QueryError(f"seed must be at least 0, got {seed}")


def _report(bounder, view) -> dict[str, Any]:
    """What ``--json`` prints of a bounder and what is seen of it."""
    fitted = bounder.info.get("indicator")
    states = [
        {"label": s.label, "fp_rate": s.fp_rate, "fn": s.fn, "samples": s.samples, "undecided": s.undecided}
        for s in view.states
    ]
    return {
        "method": bounder.method,
        "query": bounder.query_kind,
        "bytes": bounder.nbytes,
        "same_indicator": view.indicator == fitted,
        "fitted_indicator": fitted,
        "asked": view.asked or None,
        "states": states,
        "certificate": certificate_summary(bounder, bounder.certificate),
    }


def _check_output(path: str | None, kind: FileKind, *inputs: str) -> None:
    """Refuse a path that cannot be written to, or is called as another kind of file."""
    if path is None:
        return
    if Path(path).suffix.lower() != kind.suffix:
        raise BoundingError(f"{path}: expected a name that ends with {kind.suffix}")
    check_writable(path, *inputs, kind=kind)


def _numbers(name: str, text: str | None) -> list[float]:
    """Numbers from text such as 0,0.05."""
    if text is None:
        return []
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise QueryError(f"{name} must be a number, or several such as 0,0.05,0.1, got {text!r}") from None


def _held(text: str | None) -> dict[int, float]:
    """Coordinates and their values from text such as 3=0.5,4=0."""
    held = {}
    for word in text.split(",") if text is not None else ():
        axis, _, value = word.partition("=")
        try:
            number = int(axis)
            held[number] = float(value)
        except ValueError:
            raise QueryError(f"slice must be coordinates and values such as 3=0.5,4=0, got {text!r}") from None
    return held


def _radii(bounder, times: Sequence[float]) -> list[float]:
    """Radii to show a distance at, if none are named: from 0 to a share of the object's longest side."""
    from warp_bounding.bounders.distance import DistanceBounder

    if not isinstance(bounder, DistanceBounder) or bounder.domain.time or len(times) > 1:
        return [0.0]
    farthest = float(f"{FARTHEST * bounder.size:.1g}")
    return [round(farthest * k / (LEVELS - 1), 12) for k in range(LEVELS)]


def _times(shape, radii: Sequence[float]) -> list[float]:
    """Times to show a shape that moves at, if none are named: evenly spread, or the middle one where there are several radii."""
    if not shape.time:
        return []
    start, end = float(shape.sample_lower[0]), float(shape.sample_upper[0])
    return [(start + end) / 2] if len(radii) > 1 else np.linspace(start, end, LEVELS).tolist()


def _spread(states: list) -> list:
    """The first, the last, and some in between."""
    return [states[k] for k in dict.fromkeys(np.linspace(0, len(states) - 1, PANELS).round().astype(int).tolist())]
