"""``warp-bounding certify``: prove from file and shape alone what a bounder claims."""

import math
from typing import Annotated

import typer

from warp_bounding.cli.options import BounderFile, Hollow, Json, Origin, Spacing, Threshold, Unknown, read_shape
from warp_bounding.cli.output import bar, certificate_summary, console, other_shape, print_json, quiet_warp, warn
from warp_bounding.errors import BoundingError

__all__ = ["command"]


def command(
    file: BounderFile,
    shape: Annotated[str, typer.Argument(metavar="SHAPE", help="The shape that it is to bound.")],
    budget: Annotated[float, typer.Option(help="Seconds allowed.")] = 900.0,
    margin: Annotated[float | None, typer.Option(help="Not proven unless FILE claims this margin.")] = None,
    length: Annotated[float | None, typer.Option(help="Not proven unless FILE claims rays of this length.")] = None,
    resolution: Annotated[int | None, typer.Option(help="Not proven unless FILE claims this resolution.")] = None,
    query: Annotated[str | None, typer.Option(help="Not proven unless FILE claims this kind of query.")] = None,
    checkpoint: Annotated[
        str | None, typer.Option(help="Of a distance: go on from this file, and keep what is left of the proof there.")
    ] = None,
    threshold: Threshold = None,
    spacing: Spacing = None,
    origin: Origin = None,
    unknown: Unknown = None,
    hollow: Hollow = None,
    json: Json = False,
) -> int:
    """Prove from scratch that FILE has no false negative on SHAPE. Exit status 0: proven; 1: not.

    Margin, length of rays, resolution and kind of query are taken from FILE, and printed. Those that are stated here are
    compared with FILE's.
    """
    from warp_bounding.bounders import load
    from warp_bounding.proof import certify
    from warp_bounding.queries import check_query
    from warp_bounding.queries.distance import DISTANCE

    if not budget > 0:
        raise BoundingError(f"budget must be a positive number of seconds, got {budget}")
    expected = {"margin": margin, "length": length, "resolution": resolution, "query": query}
    for name, least in (("margin", 0.0), ("length", math.ulp(0.0)), ("resolution", 1)):
        if expected[name] is not None and not least <= expected[name] < math.inf:
            raise BoundingError(f"{name} must be one that a bounder can have, got {expected[name]}")
    if query is not None:
        check_query(query, DISTANCE.name)
    quiet_warp()
    bounder = load(file, device="cpu")
    indicator = read_shape(shape, threshold, spacing, origin, unknown, hollow)
    with bar("certify") as update:
        certificate = certify(bounder, indicator, **expected, seconds=budget, progress=update, checkpoint=checkpoint)
    fitted = bounder.info.get("indicator")
    same = certificate.indicator == fitted
    if json:
        verdict = {"proven": certificate.proven, "same_indicator": same, "certified_indicator": fitted}
        summary = certificate_summary(bounder, certificate)
        print_json({"path": file, "shape": shape, **verdict, "certificate": summary})
    else:
        out = console(False)
        if not same:
            out.print(other_shape(shape, certificate.indicator, fitted))
        out.print(f"{certificate.kind}: {certificate.message}")
        if certificate.counterexample:
            out.print(f"counterexample: {certificate.counterexample}")
        out.print(f"{certificate.boxes:,} boxes, {certificate.seconds:.2f} s")
    if restricted := getattr(indicator, "restriction", ""):
        warn(f"warp-bounding: {indicator.name}: {restricted}")
    return 0 if certificate.proven else 1
