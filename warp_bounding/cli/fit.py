"""``warp-bounding fit``: fit a bounder to a shape, prove it, save it."""

import time
from collections.abc import Mapping
from inspect import Parameter, signature
from typing import Annotated, Any

import typer

from warp_bounding.bounders import DISTANCES, METHODS, Bounder, DistanceBounder
from warp_bounding.bounders.bounder import STEPS, Option
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.bounders.mlp_distance import MlpDistance
from warp_bounding.certificates.statement import NOT_CONSERVATIVE
from warp_bounding.cli.options import (
    Device,
    Hollow,
    Json,
    Origin,
    Queries,
    Spacing,
    Threshold,
    Unknown,
    read_queries,
    read_shape,
    whole_number,
)
from warp_bounding.cli.output import bar, certificate_summary, console, print_json, quiet_warp, warn
from warp_bounding.runtime.whole_file import BOUNDER_FILE, check_writable

__all__ = ["command", "fit_arguments", "state_options"]


def _options() -> dict[str, Option]:
    """The options of all methods, by name."""
    return {option.name: option for options in _by_method().values() for option in options}


def _by_method() -> dict[str, list[Option]]:
    """The options of each method, those of its distance included, which the command line tells apart by nothing."""
    found = {name: list(cls.options) for name, cls in METHODS.items()}
    for name, cls in DISTANCES.items():
        known = found.setdefault(name, [])
        known += [option for option in cls.options_taken() if option.name not in {have.name for have in known}]
    return found


def command(
    shape: Annotated[str, typer.Argument(metavar="SHAPE", help="Image, voxel file, array, mesh or USD file.")],
    output: Annotated[str, typer.Option("--output", "-o", help="File to write (.safetensors).")],
    query: Annotated[str, typer.Option(help="Kind of query: point, ray, plane, box or distance.")] = "point",
    method: Annotated[str, typer.Option(help="Bounding method, such as mlp, kdop, aabb.")] = "mlp",
    budget: Annotated[float, typer.Option(help="Seconds for training and proof.")] = 60.0,
    seed: Annotated[int, typer.Option(help="Random seed.")] = 0,
    margin: Annotated[float, typer.Option(help="Dilate the object by this length first, object units.")] = 0.0,
    threshold: Threshold = None,
    spacing: Spacing = None,
    origin: Origin = None,
    unknown: Unknown = None,
    hollow: Hollow = None,
    force: Annotated[bool, typer.Option("--force", help="Take a margin that is larger than the object, too.")] = False,
    resolution: Annotated[
        int | None,
        typer.Option(help="Cells along a mesh's longest axis, where cells are laid (64; 128 for regions)."),
    ] = None,
    length: Annotated[
        float | None, typer.Option(help="Length of a ray, object units; other queries have none (default: 1)")
    ] = None,
    side: Annotated[
        str,
        typer.Option(help="outside: no is certainly not in the object; inside: no is certainly in it (points)."),
    ] = "outside",
    queries: Queries = None,
    metric: Annotated[
        str | None,
        typer.Option(
            help="Of a distance, where a grid's coordinate 0 is time: space, or spacetime: one more coordinate."
        ),
    ] = None,
    samples: Annotated[
        str, typer.Option(help="Random queries that the false-positive rate is measured on, such as 1e6.")
    ] = "1e6",
    device: Device = "cpu",
    json: Json = False,
    **told: Any,
) -> int:
    """Fit a bounder to SHAPE, prove that it has no false negative, and save it.

    The proof of an mlp's rays or boxes can take longer than the budget leaves for it (3D rays: some minutes); the
    certificate is then statistical, and says so. Ctrl-C ends training early; the best bounder so far is proven and
    saved. Exit status 1: a distance whose slack is larger than the object; it is saved all the same.
    """
    from warp_bounding.bounders import save
    from warp_bounding.choice import hardly_trained
    from warp_bounding.evaluation import evaluate
    from warp_bounding.training import fit

    quiet_warp(device)
    of_queries = {"query": query, "length": length}
    of_object = {"margin": margin, "force": force, "resolution": resolution, "side": side}
    run = {"budget": budget, "seed": seed, "device": device}
    arguments = fit_arguments(told | {"method": method, "metric": metric} | of_queries | of_object | run)
    count = whole_number("samples", samples)
    check_writable(output, shape, *([] if queries is None else [queries]), kind=BOUNDER_FILE)
    asked = None if queries is None else read_queries(queries)
    indicator = read_shape(shape, threshold, spacing, origin, unknown, hollow)
    started = time.perf_counter()
    with bar("fit") as update:
        bounder = fit(indicator, queries=asked, progress=update, **arguments)
    seconds = time.perf_counter() - started
    save(bounder, output)
    rates = evaluate(bounder, indicator, samples=count)
    warning = _looser(bounder)
    if not warning and not told.get("steps") and _network(bounder) and (little := hardly_trained(bounder)):
        warning = f"{little}; a longer budget makes it tighter"  # who asks for steps is told nothing new
    if json:
        print_json(_report(bounder, rates, seconds) | {"warning": warning, "path": output})
    else:
        _tell(bounder, rates, f"{_took(bounder, seconds)}; written to {output}")
    if warning:
        warn(warning)
    return 1 if _says_nothing(bounder) else 0


def _report(bounder: Bounder | DistanceBounder, rates: Any, seconds: float) -> dict[str, Any]:
    """What ``--json`` prints of a fit."""
    about = {"method": bounder.method, "query": bounder.query_kind, "conservative": bounder.conservative}
    measured = {name: getattr(rates, name) for name in ("fp_rate", "fn", "samples", "positives", "truth")}
    training = bounder.info["training"]
    took = {"fit_seconds": round(seconds, 3), "compile_seconds": training["compile_seconds"]}
    proof = {"certificate": certificate_summary(bounder, bounder.certificate), "training": training}
    return {**about, **measured, **took, **proof, "note": bounder.info.get("note")}


def _tell(bounder: Bounder | DistanceBounder, rates: Any, end: str) -> None:
    """Print what a person wants to know of a fit."""
    out = console(False)
    out.print(
        f"{bounder.method}: {rates.fp_rate:.2f} % false positives, {rates.fn} false negatives in {rates.samples:,} samples, "
        f"{rates.truth_told}"
    )
    out.print(bounder.certificate.message if bounder.certificate else NOT_CONSERVATIVE)
    out.print(end)


def _took(bounder: Bounder | DistanceBounder, seconds: float) -> str:
    compiling = bounder.info["training"]["compile_seconds"]
    return f"{seconds:.1f} s" + (f", {compiling:.1f} of them for compiling kernels" if compiling >= 0.1 else "")


OWN = ("query", "length", "margin", "force", "resolution", "side", "budget", "seed", "device", "method")


def fit_arguments(said: Mapping[str, Any]) -> dict[str, Any]:
    """What a command line says of a fit, as keyword arguments of ``fit``.

    Args:
        said: The values of this command's options, by name; those of methods are texts, or ``None`` where they are not given. Others are ignored.

    Raises:
        BounderError: For a text that is not what a method's option takes.
    """
    known = _options()
    of_method = {name: option.parse(said[name]) for name, option in known.items() if said.get(name) is not None}
    metric = said.get("metric")
    return {name: said[name] for name in OWN} | of_method | ({} if metric is None else {"metric": metric})


def _network(bounder: Bounder | DistanceBounder) -> bool:
    """Whether it is a conservative network, or has one as its last part."""
    last = (getattr(bounder, "parts", None) or [bounder])[-1]
    return isinstance(last, (Mlp, MlpDistance)) and last.conservative


def _says_nothing(bounder: Bounder | DistanceBounder) -> bool:
    """Whether it is a distance whose slack is larger than the object."""
    return isinstance(bounder, DistanceBounder) and bounder.slack >= bounder.size


def _looser(bounder: Bounder | DistanceBounder) -> str | None:
    """A warning for a distance that says nothing, and for a bounder that is looser than a box; ``None`` for others."""
    if _says_nothing(bounder):
        return (
            f"the slack, {bounder.slack:.3g}, is larger than the object, {bounder.size:.3g}, so this says nothing near it; it is the best that was proven "
            "in this time: a longer budget, or fewer neurons, helps"
        )
    rates = bounder.info["rates"]
    if not rates["fp_rate"] > rates["fp_rate_aabb"]:
        return None
    more = "; a longer budget makes it tighter" if any(option is STEPS for option in type(bounder).options) else ""
    shares = f"{rates['fp_rate']:.1f} % false positives, method aabb {rates['fp_rate_aabb']:.1f} %"
    return f"looser than a box: {shares} ({rates['samples']:,} samples){more}"


def state_options() -> None:
    """Give ``command`` a parameter for each option of a method, with the help of all methods that take it."""
    words: dict[str, dict[str, list[str]]] = {}
    for method, options in _by_method().items():
        for option in options:
            default = option.default if not isinstance(option.default, tuple) else ",".join(map(str, option.default))
            shown = "" if default is None else f" (default: {default})"
            words.setdefault(option.name, {}).setdefault(option.help + shown, []).append(method)
    stated = [
        Parameter(
            name,
            Parameter.KEYWORD_ONLY,
            default=None,
            annotation=Annotated[
                (int if option.parse is int else str) | None,
                typer.Option(help="; ".join(f"{', '.join(who)}: {text}" for text, who in words[name].items())),
            ],
        )
        for name, option in _options().items()
    ]
    command.__signature__ = _OWN.replace(parameters=[*_OWN.parameters.values()][:-1] + stated)


_OWN = signature(command)
