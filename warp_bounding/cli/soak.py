"""``warp-bounding soak``: a hundred million hard positives, none of which may be answered with no."""

from typing import TYPE_CHECKING, Annotated

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
from warp_bounding.cli.output import bar, console, other_shape, print_json, quiet_warp

if TYPE_CHECKING:
    from warp_bounding.proof.attest.soak import Soak

__all__ = ["command"]


def command(
    file: BounderFile,
    shape: Annotated[str, typer.Argument(metavar="SHAPE", help="The shape that it bounds.")],
    count: Annotated[str, typer.Option(help="Positives to ask, such as 1e8.")] = "1e8",
    seed: Annotated[
        int | None, typer.Option(help="Random seed; a fresh one if not given, and told, so that it can be repeated.")
    ] = None,
    resume: Annotated[
        str | None, typer.Option(metavar="STATE.json", help="Keep what was done here, and go on from it if it exists.")
    ] = None,
    threshold: Threshold = None,
    spacing: Spacing = None,
    origin: Origin = None,
    unknown: Unknown = None,
    hollow: Hollow = None,
    device: Device = "cpu",
    json: Json = False,
) -> int:
    """Ask FILE hard positives of SHAPE, as it is deployed. Exit status 0: none missed; 1: a false negative, printed.

    Certain positives by construction, near the object's boundary: grazing rays, touching boxes, tangent planes, points
    on faces and corners of cells; in float32, in float64, and of the shape placed in the world. A soak test proves
    nothing; it is there to contradict a proof. Ctrl-C ends it and says what was done until then.
    """
    from warp_bounding.bounders import load
    from warp_bounding.proof import soak

    wanted = whole_number("count", count)
    quiet_warp(device)
    bounder = load(file, device=device)
    indicator = read_shape(shape, threshold, spacing, origin, unknown, hollow)
    with bar("soak") as update:
        result = soak(bounder, indicator, wanted, seed=seed, state=resume, progress=update)
    same = result.indicator == bounder.info.get("indicator")
    if json:
        print_json(
            {"path": file, "shape": shape, "same_indicator": same, **result.to_dict(), "rate": round(result.rate)}
        )
    else:
        out = console(False)
        if not same:
            out.print(other_shape(shape, result.indicator, bounder.info.get("indicator")), style="yellow")
        out.print(_told(result))
        if resume and not result.complete:
            out.print(f"To go on: the same command again, with --resume {resume}")
    return 0 if result.missed is None else 1


def _told(result: "Soak") -> str:
    """The result in words."""
    kinds = ", ".join(f"{n:,} {form}" for form, n in result.forms.items() if n) or "none"
    took = f"seed {result.seed}, {result.seconds:.1f} s, {result.rate / 1e6:.1f} million/s"
    asked = f"{result.done:,} hard positive {result.query} queries"
    if result.missed is None:
        ended = "interrupted: " if result.interrupted else ""
        return f"{ended}{asked} asked, {result.wanted:,} wanted ({kinds}), none missed; {took}"
    where = f", the shape placed by {result.missed_world}" if result.missed_world else ""
    form = f"({result.missed_form}{where})"
    missed = f"FALSE NEGATIVE: the {result.query} {result.missed} {form} meets the shape and is answered with no."
    before = f"{asked} were answered with maybe before it ({kinds}); the same again with --seed {result.seed}"
    return f"{missed}\n{before}; {took}"
