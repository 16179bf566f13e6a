"""``warp-bounding certify``: prove from file and shape alone what a bounder claims."""

from typing import Annotated

import typer

from warp_bounding.cli.output import BounderFile, Json, bar, certificate_summary, console, print_json, quiet_warp
from warp_bounding.errors import BoundingError

__all__ = ["command"]


def command(
    file: BounderFile,
    shape: Annotated[str, typer.Argument(help="The shape that it is to bound.")],
    budget: Annotated[float, typer.Option(help="Seconds allowed.")] = 300.0,
    json: Json = False,
) -> int:
    """Prove from scratch that FILE has no false negative on SHAPE. Exit status 0: proven; 1: not."""
    from warp_bounding.bounders import load
    from warp_bounding.indicators import load_indicator
    from warp_bounding.proof import certify

    if not budget > 0:
        raise BoundingError(f"budget must be a positive number of seconds, got {budget}")
    quiet_warp()
    bounder = load(file, device="cpu")
    indicator = load_indicator(shape)
    with bar("certify") as update:
        certificate = certify(bounder, indicator, seconds=budget, progress=update)
    same = certificate.indicator == bounder.info.get("indicator")
    if json:
        summary = certificate_summary(bounder, certificate)
        print_json(
            {"path": file, "shape": shape, "proven": certificate.proven, "same_indicator": same, "certificate": summary}
        )
    else:
        out = console(False)
        out.print(f"{certificate.kind}: {certificate.message}")
        if certificate.counterexample:
            out.print(f"counterexample: {certificate.counterexample}")
        if not same:
            out.print("The cells differ from the ones it was fitted to; the verdict is about the shape given here.")
        out.print(f"{certificate.boxes:,} boxes, {certificate.seconds:.2f} s")
    return 0 if certificate.proven else 1
