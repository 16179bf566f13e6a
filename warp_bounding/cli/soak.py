"""``warp-bounding soak``: a hundred million hard positives, none of which may be answered with no."""

from typing import Annotated

import typer

from warp_bounding.cli.output import BounderFile, Device, Json, bar, console, print_json, quiet_warp
from warp_bounding.cli.shape import Origin, Spacing, Threshold, read_shape
from warp_bounding.errors import QueryError

__all__ = ["command"]


def command(
    file: BounderFile,
    shape: Annotated[str, typer.Argument(help="The shape that it bounds.")],
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
    device: Device = "cpu",
    json: Json = False,
) -> int:
    """Ask FILE hard positives of SHAPE, as it is deployed. Exit status 0: none missed; 1: a false negative, which is printed.

    Certain positives by construction, near the object's boundary: grazing rays, touching boxes, tangent planes, points on
    faces and corners of cells; in float32, in float64, and of the shape placed in the world. A soak test proves nothing; it is
    there to contradict a proof. Ctrl-C ends it and says what was done until then.
    """
    from warp_bounding.bounders import load
    from warp_bounding.proof import soak

    wanted = _whole(count)
    quiet_warp(device)
    bounder = load(file, device=device)
    indicator = read_shape(shape, threshold, spacing, origin)
    with bar("soak") as update:
        result = soak(bounder, indicator, wanted, seed=seed, state=resume, progress=update)
    same = result.indicator == bounder.info.get("indicator")
    if json:
        print_json(
            {"path": file, "shape": shape, "same_indicator": same, **result.to_dict(), "rate": round(result.rate)}
        )
    else:
        out = console(False)
        kinds = ", ".join(f"{n:,} {form}" for form, n in result.forms.items() if n)
        ended = "interrupted: " if result.interrupted else ""
        out.print(
            f"{ended}{result.done:,} hard positive {result.query} queries asked of {wanted:,} ({kinds or 'none'}), "
            f"{'none' if result.missed is None else 'then one'} missed; seed {result.seed}, {result.seconds:.1f} s, "
            f"{result.rate / 1e6:.1f} million/s"
        )
        if result.missed is not None:
            where = f" placed by {result.missed_world}" if result.missed_world else ""
            out.print(f"FALSE NEGATIVE ({result.missed_form}{where}): {result.missed}")
        if not same:
            out.print("The cells differ from the ones it was fitted to; what was found is about the shape given here.")
        if resume and not result.complete:
            out.print(f"To go on: the same command again, with --resume {resume}")
    return 0 if result.missed is None else 1


def _whole(text: str) -> int:
    """A count that may be written as 1e8.

    Raises:
        QueryError: If it is none.
    """
    try:
        value = float(text)
        if value == int(value) and value >= 1:
            return int(value)
    except (ValueError, OverflowError):
        pass
    raise QueryError(f"count must be a whole number of at least 1, such as 1e8, got {text!r}")
