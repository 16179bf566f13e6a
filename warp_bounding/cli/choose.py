"""``warp-bounding choose``: which bounder for these queries and this narrow phase; fit, measure, compare, save."""

import json as json_text
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

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
)
from warp_bounding.cli.output import bar, console, print_json, print_table, quiet_warp
from warp_bounding.errors import BounderError
from warp_bounding.runtime.whole_file import BOUNDER_FILE, PICTURE_FILE, check_writable, write_whole

__all__ = ["choose_arguments", "command"]

UNITS = {"": 1, "k": 1024, "m": 1024**2}
TOLERATED = 0.15  # of a budget, by which a choice may exceed it without a word
SHORT = 24  # characters of a remark that stands in the table; longer ones are footnotes


def command(
    shape: Annotated[str, typer.Argument(metavar="SHAPE", help="Image, voxel file, array, mesh or USD file.")],
    output: Annotated[str, typer.Option("--output", "-o", help="File to write the chosen bounder to (.safetensors).")],
    narrow_ns: Annotated[float, typer.Option(help="What your exact test takes for one query, nanoseconds.")],
    query: Annotated[str, typer.Option(help="Kind of query: point, ray, plane or box.")] = "point",
    queries: Queries = None,
    memory: Annotated[
        str | None, typer.Option(help="Most bytes that a query may read, such as 16k (16,384) or 4000.")
    ] = None,
    margin: Annotated[float, typer.Option(help="Dilate the object by this length first, object units.")] = 0.0,
    length: Annotated[float | None, typer.Option(help="Length of a ray, object units (default: 1)")] = None,
    overhead_ns: Annotated[
        float, typer.Option(help="What your step takes for a query if any bounder is asked, beside the bounder itself.")
    ] = 0.0,
    budget: Annotated[float, typer.Option(help="Seconds for all fits and measurements.")] = 120.0,
    seed: Annotated[int, typer.Option(help="Random seed.")] = 0,
    networks: Annotated[
        str, typer.Option(help="Hidden widths of the networks that are tried, such as 24-24,50-50; none for none.")
    ] = "16-16,24-24,50-50",
    methods: Annotated[
        str | None, typer.Option(help="Methods that are tried, such as bvh,mlp,distance-grid (default: all).")
    ] = None,
    statistical: Annotated[
        bool, typer.Option("--statistical", help="A bounder that samples attest may be chosen, too.")
    ] = False,
    folder: Annotated[
        str | None,
        typer.Option(help="Where candidates are kept, so that a choice goes on (default: beside the output, .choice)."),
    ] = None,
    threshold: Threshold = None,
    spacing: Spacing = None,
    origin: Origin = None,
    unknown: Unknown = None,
    hollow: Hollow = None,
    device: Device = "cpu",
    json: Json = False,
) -> int:
    """Choose a broad phase for SHAPE: fit candidates of every method, measure them, save the one that costs the least.

    What counts is t + p * narrow-ns: the nanoseconds that a bounder takes for a query, and the share of the queries that it leaves to your
    exact test. The answer may be that none pays; then nothing is written. A plot of cost against the narrow phase's price
    lies beside the output (.png). What the budget has no room for is listed with the one that it would need. Ctrl-C ends fitting, and what is there is compared; the same command goes on where a killed one stopped.
    """
    from warp_bounding.choice import choose, cost_plot

    quiet_warp(device)
    of_queries = {"query": query, "narrow_ns": narrow_ns, "length": length, "overhead_ns": overhead_ns}
    of_fits = {"margin": margin, "memory": memory, "budget": budget, "seed": seed, "device": device}
    tried = {"networks": networks, "methods": methods, "statistical": statistical}
    arguments = choose_arguments(of_queries | of_fits | tried)
    inputs = [shape, *([] if queries is None else [queries])]
    picture = str(Path(output).with_suffix(PICTURE_FILE.suffix))
    check_writable(output, *inputs, kind=BOUNDER_FILE)
    check_writable(picture, *inputs, kind=PICTURE_FILE)
    asked = None if queries is None else read_queries(queries)
    indicator = read_shape(shape, threshold, spacing, origin, unknown, hollow)
    kept = Path(output).with_suffix(".choice") if folder is None else Path(folder)
    with bar("choose") as update:
        choice = choose(indicator, queries=asked, folder=kept, progress=update, **arguments)
    if choice.bounder is not None:
        choice.bounder.save(output)
    write_whole(picture, cost_plot(choice)["png"], PICTURE_FILE)
    told = choice.to_dict() | {"path": output if choice.bounder is not None else None, "plot": picture}
    write_whole(kept / "rows.json", json_text.dumps(_without_nan(told), indent=1).encode())
    if json:
        print_json(_without_nan(told))
    else:
        _print(choice, output, picture, str(kept), "your" if asked is not None else "random")
    return 1 if choice.about["interrupted"] else 0


def choose_arguments(said: Mapping[str, Any]) -> dict[str, Any]:
    """What a command line says of a choice, as keyword arguments of ``choose``.

    Args:
        said: The values of this command's options, by name. Others are ignored.

    Raises:
        BounderError: For sizes or a number of bytes that are none.
    """
    as_they_are = ("query", "narrow_ns", "length", "overhead_ns", "margin", "budget", "seed", "device", "statistical")
    memory, methods = said["memory"], said["methods"]
    return {name: said[name] for name in as_they_are} | {
        "memory": None if memory is None else _bytes(memory),
        "networks": _sizes(said["networks"]),
        "methods": None if methods is None else [word.strip() for word in methods.split(",")],
    }


def _print(choice, output: str, picture: str, kept: str, whose: str) -> None:
    from rich.markup import escape
    from rich.table import Table

    from warp_bounding.choice import duration

    out = console(False)
    where = f"{choice.threads} threads of a CPU" if choice.threads else choice.device
    table, words = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0)), ("", "certificate")
    for name in ("", "bytes", "ns", "left %", "cost ns", "fit s", "certificate"):
        table.add_column(name, justify="left" if name in words else "right")
    out.print(
        f"{choice.queries:,} {whose} queries, {100 * choice.positives:.3g} % meet the object; {where}"
        + ("; --queries x.npy asks those of your simulation" if whose == "random" else "")
    )
    remarks = dict.fromkeys(remark for row in choice.rows for remark in (row.why_not, row.note) if len(remark) > SHORT)
    number = {remark: f"[{index}]" for index, remark in enumerate(remarks, 1)}
    for row in choice.rows:
        measured = row.cost == row.cost  # not NaN
        cost = f"{row.cost:.4g}" if row.cost < 1000 else f"{row.cost:,.0f}"
        numbers = f"{row.nanoseconds:.3g}", f"{100 * row.share:.3g}", cost
        told = [number.get(remark, remark) for remark in (row.why_not or row.certificate, row.note)]
        table.add_row(
            row.label,
            f"{row.nbytes:,}" if row.nbytes or measured else "",
            *(numbers if measured else ("", "", "")),
            f"{row.seconds:.0f}" if row.seconds else "",
            escape(" ".join(told)),
            style="bold" if row.label == choice.label else "dim" if row.why_not else "",
        )
    print_table(out, table, words)
    for remark, index in number.items():
        out.print(escape(f"{index} {remark}"), style="dim")
    out.print(choice.why + ".")
    out.print(
        "Best by the narrow phase's price: " + "; ".join(f"{s.label} from {duration(s.price)}" for s in choice.prices)
    )
    if choice.more:
        out.print(choice.more + ".")
    if choice.about["interrupted"]:
        out.print("Interrupted: some candidates were not fitted; the same command goes on.")
    out.print(_taken(choice.about))
    written = (
        f"written to {output} and {picture}" if choice.bounder is not None else f"no bounder is written; {picture}"
    )
    out.print(f"{written}; candidates are kept in {kept}, for another choice, and can be deleted")


def _taken(about: Mapping[str, Any]) -> str:
    """How long it took."""
    before, compiling = about["seconds_before"], about["compile_seconds"]
    told = f"{about['seconds']:.0f} s of fits and measurements" + (f", {before:.0f} s before" if before >= 1 else "")
    over = about["seconds"] + before - (1 + TOLERATED) * about["budget"]
    told += f", of a budget of {about['budget']:g}"
    if over > 0 and about["seconds"] > before:
        told += "; that is more, since single steps on this shape or machine take longer than was left"
    return told + (f"; {compiling:.0f} s besides for compiling and loading kernels" if compiling >= 1 else "")


def _without_nan(value):
    """For JSON, which has no NaN."""
    if isinstance(value, dict):
        return {key: _without_nan(own) for key, own in value.items()}
    if isinstance(value, list):
        return [_without_nan(own) for own in value]
    return None if isinstance(value, float) and value != value else value


def _sizes(text: str) -> tuple[tuple[int, ...], ...]:
    """Hidden widths such as 24-24,50-50; raises ``BounderError`` for other words."""
    if text.strip().lower() == "none":
        return ()
    try:
        return tuple(tuple(int(width) for width in word.split("-")) for word in text.split(","))
    except ValueError:
        raise BounderError(f"networks must be widths such as 24-24,50-50, or none, got {text!r}") from None


def _bytes(text: str) -> int:
    """A number of bytes such as 16k; raises ``BounderError`` for other words."""
    word = text.strip().lower().removesuffix("b")
    unit = word[-1:] if word[-1:] in ("k", "m") else ""
    try:
        value = float(word.removesuffix(unit)) * UNITS[unit]
    except ValueError:
        value = 0.0
    if not 1 <= value < 2**40:
        raise BounderError(f"memory must be a number of bytes such as 16k or 4000, got {text!r}")
    return int(value)
