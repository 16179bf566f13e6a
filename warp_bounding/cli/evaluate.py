"""``warp-bounding evaluate``: false positives and false negatives among random queries."""

from typing import Annotated

import typer

from warp_bounding.cli.output import (
    BounderFile,
    Device,
    Json,
    bar,
    certificate_summary,
    console,
    print_json,
    quiet_warp,
)
from warp_bounding.cli.shape import Origin, Spacing, Threshold, read_shape

__all__ = ["command"]


def command(
    file: BounderFile,
    shape: Annotated[str, typer.Argument(help="The shape that it bounds.")],
    samples: Annotated[int, typer.Option(help="Number of random queries.")] = 1_000_000,
    protocol: Annotated[str, typer.Option(help="exact, or sampled as in the paper.")] = "exact",
    seed: Annotated[int, typer.Option(help="Random seed of the samples.")] = 1,
    threshold: Threshold = None,
    spacing: Spacing = None,
    origin: Origin = None,
    device: Device = "cpu",
    json: Json = False,
) -> int:
    """Measure FILE on SHAPE: rates are per cent of all samples. Exit status 1 if a false negative was found."""
    from warp_bounding.bounders import load
    from warp_bounding.evaluation import evaluate

    quiet_warp(device)
    bounder = load(file, device=device)
    indicator = read_shape(shape, threshold, spacing, origin)
    with bar("evaluate") as update:
        rates = evaluate(bounder, indicator, samples, protocol, seed=seed, progress=update)
    if json:
        certificate = bounder.certificate
        summary = certificate_summary(bounder, certificate) if certificate else None
        print_json({"path": file, "shape": shape, "method": bounder.method, **rates.to_dict(), "certificate": summary})
    else:
        text = f"{bounder.method}: {rates.fp_rate:.3f} % false positives, {rates.fn} false negatives"
        console(False).print(
            f"{text}, {rates.positives:.3f} % positives in {rates.samples:,} samples ({rates.protocol}), {rates.truth}"
        )
    return 0 if rates.fn == 0 else 1
