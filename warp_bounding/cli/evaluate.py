"""``warp-bounding evaluate``: false positives and false negatives among random queries."""

from typing import Annotated

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
from warp_bounding.cli.output import bar, certificate_summary, console, other_shape, print_json, quiet_warp

__all__ = ["command"]


def command(
    file: BounderFile,
    shape: Annotated[str, typer.Argument(metavar="SHAPE", help="The shape that it bounds.")],
    samples: Annotated[str, typer.Option(help="Number of random queries, such as 1e6.")] = "1e6",
    protocol: Annotated[str, typer.Option(help="exact, or sampled as in the paper.")] = "exact",
    seed: Annotated[int, typer.Option(help="Random seed of the samples.")] = 1,
    radius: Annotated[
        float | None, typer.Option(help="Of a distance: points within it are positive, object units (default: 0).")
    ] = None,
    query: Annotated[
        str | None, typer.Option(help="Of a distance: what it is asked, point, ray or box (default: point).")
    ] = None,
    length: Annotated[float | None, typer.Option(help="Of a distance that is asked rays: theirs (default: 1).")] = None,
    steps: Annotated[
        int | None, typer.Option(help="Of a distance: evaluations that a ray (default: 32) or a box (64) may take.")
    ] = None,
    threshold: Threshold = None,
    spacing: Spacing = None,
    origin: Origin = None,
    unknown: Unknown = None,
    hollow: Hollow = None,
    device: Device = "cpu",
    json: Json = False,
) -> int:
    """Measure FILE on SHAPE: rates are per cent of all samples. Exit status 1 if a false negative was found."""
    from warp_bounding.bounders import load
    from warp_bounding.evaluation import evaluate

    count = whole_number("samples", samples)
    quiet_warp(device)
    bounder = load(file, device=device)
    indicator = read_shape(shape, threshold, spacing, origin, unknown, hollow)
    with bar("evaluate") as update:
        told = {"radius": radius, "query": query, "length": length, "steps": steps}
        rates = evaluate(bounder, indicator, count, protocol, seed=seed, progress=update, **told)
    fitted = bounder.info.get("indicator")
    same = rates.indicator == fitted
    if json:
        summary = certificate_summary(bounder, bounder.certificate)
        about = {"path": file, "shape": shape, "same_indicator": same, "fitted_indicator": fitted}
        print_json({**about, "method": bounder.method, **rates.to_dict(), "certificate": summary})
    else:
        if not same:
            console(False).print(other_shape(shape, rates.indicator, fitted), style="yellow")
        text = f"{bounder.method}: {rates.fp_rate:.3f} % false positives, {rates.fn} false negatives"
        console(False).print(
            f"{text}, {rates.positives:.3f} % positives in {rates.samples:,} samples ({rates.protocol}), {rates.truth_told}"
        )
    return 0 if rates.fn == 0 else 1
