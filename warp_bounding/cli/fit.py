"""``warp-bounding fit``: fit a bounder to a shape, prove it, save it."""

import time
from typing import Annotated

import typer

from warp_bounding.cli.output import (
    NOT_CONSERVATIVE,
    Device,
    Json,
    bar,
    certificate_summary,
    console,
    print_json,
    quiet_warp,
    warn,
)
from warp_bounding.cli.shape import Origin, Spacing, Threshold, read_shape

__all__ = ["command"]


def command(
    shape: Annotated[str, typer.Argument(help="Image, voxel file, array, mesh or USD file.")],
    output: Annotated[str, typer.Option("--output", "-o", help="File to write (.safetensors).")],
    query: Annotated[str, typer.Option(help="Kind of query: point, ray, plane or box.")] = "point",
    method: Annotated[str, typer.Option(help="Bounding method, such as mlp, kdop, aabb.")] = "mlp",
    hidden: Annotated[str, typer.Option(help="Widths of the hidden layers, mlp.")] = "50,50",
    activation: Annotated[
        str, typer.Option(help="sin, relu or tanh, mlp; monotone-mlp: tanh or relu, tanh for sin.")
    ] = "sin",
    octaves: Annotated[int, typer.Option(help="Octaves of positional encoding, mlp; 0 for none.")] = 0,
    k: Annotated[int | None, typer.Option(help="Half-spaces, kdop and learned-kdop.")] = None,
    leaves: Annotated[
        int | None,
        typer.Option(help="Leaf boxes, bvh; as many as have the memory of a network of --hidden if not given."),
    ] = None,
    budget: Annotated[float, typer.Option(help="Seconds for training and proof.")] = 60.0,
    steps: Annotated[int | None, typer.Option(help="Training steps instead of seconds: repeatable to the bit.")] = None,
    recipe: Annotated[
        str, typer.Option(help="Training recipe: default, or paper for the paper's schedule.")
    ] = "default",
    seed: Annotated[int, typer.Option(help="Random seed.")] = 0,
    margin: Annotated[float, typer.Option(help="Dilate the object by this length first, object units.")] = 0.0,
    threshold: Threshold = None,
    spacing: Spacing = None,
    origin: Origin = None,
    force: Annotated[bool, typer.Option("--force", help="Take a margin that is larger than the object, too.")] = False,
    resolution: Annotated[int | None, typer.Option(help="Cells along a mesh's longest axis (64).")] = None,
    length: Annotated[float, typer.Option(help="Length of a ray, object units; other queries have none.")] = 1.0,
    space: Annotated[
        str, typer.Option(help="geometric, or parametric: the paper's fit to the queries' own numbers.")
    ] = "geometric",
    samples: Annotated[
        int, typer.Option(help="Random queries that the false-positive rate is measured on.")
    ] = 1_000_000,
    device: Device = "cpu",
    json: Json = False,
) -> int:
    """Fit a bounder to SHAPE, prove that it has no false negative, and save it.

    The proof of an mlp's rays or boxes can take longer than the budget leaves for it (3D rays: some minutes); the certificate is
    then statistical, and says so. Ctrl-C ends training early; the best bounder so far is proven and saved.
    """
    from warp_bounding.bounders import save
    from warp_bounding.bounders.storage import check_writable
    from warp_bounding.errors import BounderError
    from warp_bounding.evaluation import evaluate
    from warp_bounding.training import fit

    quiet_warp(device)
    try:
        widths = tuple(int(w) for w in hidden.split(","))
    except ValueError:
        raise BounderError(f"hidden must be widths such as 50,50, got {hidden!r}") from None
    if samples < 1:
        raise BounderError(f"samples must be at least 1, got {samples}")
    check_writable(output)
    indicator = read_shape(shape, threshold, spacing, origin)
    started = time.perf_counter()
    with bar("fit") as update:
        bounder = fit(
            indicator,
            query=query,
            method=method,
            hidden=widths,
            activation=activation,
            octaves=octaves,
            k=k,
            leaves=leaves,
            budget=budget,
            steps=steps,
            recipe=recipe,
            seed=seed,
            margin=margin,
            force=force,
            resolution=resolution,
            length=length,
            space=space,
            device=device,
            progress=update,
        )
    seconds = time.perf_counter() - started
    save(bounder, output)
    rates = evaluate(bounder, indicator, samples=samples)
    certificate = bounder.certificate
    if json:
        summary = certificate_summary(bounder, certificate) if certificate else None
        print_json(
            {
                "method": bounder.method,
                "query": bounder.query_kind,
                "conservative": bounder.conservative,
                "fp_rate": rates.fp_rate,
                "fn": rates.fn,
                "samples": rates.samples,
                "positives": rates.positives,
                "truth": rates.truth,
                "fit_seconds": round(seconds, 3),
                "certificate": summary,
                "training": bounder.info.get("training"),
                "note": bounder.info.get("note"),
                "path": output,
            }
        )
    else:
        out = console(False)
        out.print(
            f"{bounder.method}: {rates.fp_rate:.2f} % false positives, {rates.fn} false negatives in {rates.samples:,} samples, "
            f"{rates.truth}"
        )
        out.print(certificate.message if certificate else NOT_CONSERVATIVE)
        out.print(f"{seconds:.1f} s; written to {output}")
    if bounder.info.get("note"):
        warn(bounder.info["note"])
    return 0  # what could be said of the bounder has been; one that misses its claim raises
