"""The command ``warp-bounding``; ``main`` also runs the command lines of ``paper/`` and ``sims/``.

Every command takes ``--json``: one JSON object on standard output and nothing else there; progress goes to standard
error. Exit status: 0; 1 where something is not proven, or a choice was interrupted; 2 for bad usage or bad input, with
one clear line; 130 for Ctrl-C. Commands import what they need when they run, so that ``--help`` is quick.
"""

import contextlib
import inspect
import io
import json as json_text
import math
import os
import sys
import time as clock
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from warp_bounding.errors import BounderError, BoundingError, BoundingWarning, QueryError, ShapeError
from warp_bounding.runtime import whole_file
from warp_bounding.runtime.whole_file import check_writable, write_whole
from warp_bounding.version import __version__

__all__ = ["app_of", "main"]

INTERRUPTED = 130
ABOUT = "Proven, tight, fast bounding volumes: fit one, prove it, measure it, see it at work."

# --- the process -----------------------------------------------------------------------------------------------------


def main(
    arguments: list[str] | None = None,
    program: str = "warp-bounding",
    make_app: Callable[[], typer.Typer] | None = None,
) -> None:
    """Run a command line and exit with its status.

    Args:
        arguments: Those of this process if ``None``.
        program: What an error's line begins with.
        make_app: Makes the command line; this package's own if ``None``.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by who started this, as in ``>&-``
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 (until the process ends)
    try:
        with reported_warnings():
            status = _run(_app(arguments) if make_app is None else make_app(), arguments, program)
            sys.stdout.flush()
    except KeyboardInterrupt:
        status = INTERRUPTED
    except BoundingError as error:
        print(f"{program}: {' '.join(str(error).split())}", file=sys.stderr)
        status = 2
    except OSError as error:  # a full disk, a folder that may not be written to, an output that nobody reads any more
        where = f"{error.filename}: " if error.filename else ""
        print(f"{program}: {where}{error.strerror or ' '.join(str(error).split())}", file=sys.stderr)
        if not error.filename:  # standard output itself: what is left in its buffer would fail again at exit
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        status = 2
    if status == INTERRUPTED:
        print("interrupted", file=sys.stderr)
    sys.exit(status)


RENAMED = {"soak": "stress", "--queries": "--workload"}


def _run(app: typer.Typer, arguments: list[str], program: str) -> int:
    """Exit status of a command; an error of the parser becomes one of ours."""
    usage_error = typer.BadParameter.__base__  # the parser's UsageError, wherever typer takes its parser from
    try:
        status = app(args=arguments, prog_name=program, standalone_mode=False)
        return status if isinstance(status, int) else 0
    except usage_error as error:
        if not error.format_message():  # no command: the help has been printed
            return 2
        context = getattr(error, "ctx", None)
        where = context.command_path if context else program
        message = error.format_message().rstrip(".")
        now = next(
            (f"; it is {new} now" for old, new in RENAMED.items() if old in message.split("'") + message.split()), ""
        )
        raise BoundingError(f"{message}{now} (see '{where} --help')") from error
    except typer.Exit as error:
        return error.exit_code
    except typer.Abort:
        return INTERRUPTED


def app_of(name: str, about: str, commands: Mapping[str, Callable[..., int]]) -> typer.Typer:
    """A command line with these commands; their docstrings are the help."""
    options = {"add_completion": False, "pretty_exceptions_enable": False}
    app = typer.Typer(name=name, help=about, no_args_is_help=True, **options)
    for word, command in commands.items():
        paragraphs = (" ".join(part.split()) for part in (command.__doc__ or "").split("\n\n"))
        app.command(name=word, cls=getattr(command, "help_class", None), help="\n\n".join(paragraphs))(command)
    return app


def _app(arguments: Sequence[str]) -> typer.Typer:
    """All commands; ``fit`` and ``bake`` have the options of methods where they are called."""
    if {"fit", "bake"} & set(arguments):
        reading = [p for name, p in inspect.signature(fit).parameters.items() if name in READING]
        _with_options(fit, *reading, *_method_options())
        _with_options(bake, *_bake_options().values())
    commands = (fit, choose, bake, query, certify, stress, evaluate, info, show)
    app = app_of("warp-bounding", ABOUT, {command.__name__: command for command in commands})

    def tell(wanted: bool) -> None:
        if wanted:
            print(f"warp-bounding {__version__}")
            raise typer.Exit

    version = Option("--version", callback=tell, is_eager=True, help="Print the version and end.")

    @app.callback(help=ABOUT)
    def common(version: Annotated[bool, version] = False) -> None:
        pass

    return app


# --- options ---------------------------------------------------------------------------------------------------------

Text = str | None
Json = Annotated[bool, Option("--json", help="Print one JSON object on standard output, and nothing else there.")]
Device = Annotated[str, Option(help="Warp device: cpu, cuda:0, ...")]
Seed = Annotated[int, Option(help="Random seed.")]
Margin = Annotated[float, Option(help="Dilate the object by this length first, object units.")]
Length = Annotated[float | None, Option(help="Length of a ray, object units; other queries have none (default: 1)")]
BounderFile = Annotated[str, Argument(metavar="FILE", help="A bounder that `fit` wrote (.safetensors).")]
ShapeFile = Annotated[str, Argument(metavar="SHAPE", help="Image, voxel file, array, mesh or USD file.")]
Output = Annotated[str, Option("--output", "-o", help="File to write the bounder to (.safetensors).")]
Workload = Annotated[Text, Option(help="A .npy file, (Q, m), of your own queries: where false positives count.")]
READING = {  # how the file of a shape is read
    "threshold": "Which values of an array, or grey values of an image, are occupied: '<128', '<=0'.",
    "spacing": "Size of an array's or image's cells, one or one for each axis: 0.05 or 0.1,0.05; rows first.",
    "origin": "Where the centre of an array's or image's first cell is: -12.5,3; rows first.",
    "unknown": "Of a map, what cells are that nobody has seen: occupied or free (default: occupied).",
    "hollow": "What air is that a shape encloses: filled, inside, or empty (default: a mesh's is filled).",
}
KEYWORD = inspect.Parameter.KEYWORD_ONLY


def _with_options(command: Callable, *more: inspect.Parameter) -> Callable:
    """A command with these options in place of its ``**rest``."""
    vars(command).pop("__signature__", None)  # of an earlier call
    own = [p for p in inspect.signature(command).parameters.values() if p.kind != inspect.Parameter.VAR_KEYWORD]
    command.__signature__ = inspect.Signature([*own, *more])
    return command


def reads_shape(command: Callable) -> Callable:
    """A command with the options of ``READING`` in place of its ``**reading``."""
    texts = {name: Annotated[Text, Option(help=words)] for name, words in READING.items()}
    return _with_options(
        command, *(inspect.Parameter(n, KEYWORD, default=None, annotation=t) for n, t in texts.items())
    )


def reading_of(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options of a shape's file as keyword arguments of ``load_shape``; ``ShapeError`` for bad ones."""
    found = {name: options[name] for name in READING if options.get(name) is not None}
    for name in {"spacing", "origin"} & set(found):
        text = found[name]
        try:
            found[name] = [float(word) for word in text.split(",")]
        except ValueError:
            raise ShapeError(f"{name} must be numbers such as 0.05 or 0.1,0.05, got {text!r}") from None
    if len(found.get("spacing", ())) == 1:
        found["spacing"] = found["spacing"][0]
    return found


def read_shape(path: str, options: Mapping[str, Any]):
    """``load_shape`` of a file as options say; ``ShapeError``, in one line, for what cannot be read."""
    from warp_bounding.shapes import load_shape

    return load_shape(path, **reading_of(options))


def read_queries(path: str):
    """A ``.npy`` array; ``QueryError`` if there is no such file, or it holds something else."""
    from numpy.lib.format import read_array

    from warp_bounding.shapes.formats.reading import reading

    if not Path(path).is_file():
        raise QueryError(f"{path}: {'a folder, expected a file' if Path(path).is_dir() else 'no such file'}")
    with reading(path, "a NumPy .npy array of queries"), open(path, "rb") as file:
        return read_array(file, allow_pickle=False)


def whole_number(name: str, text: str) -> int:
    """A count that may be written as 1e8; ``QueryError`` for another text."""
    most = 10**15  # so many queries would take years
    with contextlib.suppress(ValueError, OverflowError):
        if 1 <= float(text) == int(float(text)) <= most:
            return int(float(text))
    raise QueryError(f"{name} must be a whole number from 1 to {most:.0e}, such as 1e6, got {text!r}")


# --- output ----------------------------------------------------------------------------------------------------------

WIDEST, READABLE = 10_000, 110  # columns: where no terminal looks, and as many as are easy to read


def console(as_json: bool = False):
    """Where text for people goes: standard output, or standard error where that belongs to JSON."""
    from rich.console import Console

    return Console(stderr=as_json, highlight=False, soft_wrap=True, markup=False, emoji=False)


def print_table(out, header: Mapping[str, str], rows: Sequence[tuple]) -> None:
    """Print a table on a ``rich`` console; numbers stay whole, and where the terminal is too narrow, words wrap.

    Args:
        out: The console.
        header: ``"left"`` for columns of words and ``"right"`` for numbers, by header.
        rows: The cells of each row, then its style.
    """
    from rich.measure import Measurement
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for name, side in header.items():
        words = side == "left"
        table.add_column(name, justify=side, no_wrap=not words, overflow="fold", min_width=12 if words else None)
    for *cells, style in rows:
        table.add_row(*cells, style=style)
    width = out.width
    out.width = max(width, Measurement.get(out, out.options, table).minimum) if out.is_terminal else WIDEST
    out.print(table, crop=False)
    out.width = width


def bar(description: str):
    """A progress bar on standard error; see ``progress.bar``."""
    from warp_bounding.runtime import progress

    return progress.bar(description)


def warn(text: str) -> None:
    """Print one yellow line on standard error, about something that is no error."""
    console(True).print(" ".join(text.split()), style="yellow")


@contextlib.contextmanager
def reported_warnings() -> Iterator[None]:
    """Print each of the library's own warnings by ``warn``, once; all others are shown as before."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", BoundingWarning)
        others, seen = warnings.showwarning, set()

        def show(message, category, *where, **more) -> None:
            if not issubclass(category, BoundingWarning):
                others(message, category, *where, **more)
            elif str(message) not in seen:
                seen.add(str(message))
                warn(f"warp-bounding: {message}")

        warnings.showwarning = show
        yield


def print_json(value: dict[str, Any]) -> None:
    """Print one JSON object on standard output."""
    print(json_text.dumps(value, allow_nan=False))


def quiet_warp(device: str | None = None) -> None:
    """Keep Warp's own messages off standard output, and check the device: ``DeviceError`` if there is no such one."""
    from warp_bounding.runtime import progress
    from warp_bounding.runtime.launch import device_of

    progress.quiet_warp()
    if device is not None:
        device_of(device)


def load_both(file: str, shape: str, device: str, options: Mapping[str, Any]) -> tuple[Any, Any]:
    """A bounder and a shape from their files."""
    from warp_bounding.bounders import load

    quiet_warp(device)
    return load(file, device=device), read_shape(shape, options)


def other_shape(name: str, given: str | None, fitted: str | None) -> str:
    """What to print first where the shape is not that of the fit."""
    about = f"its SHA-256 is {(given or 'unknown')[:16]}, that of the fit {(fitted or 'unknown')[:16]}"
    return f"{name} is not the shape that the bounder was fitted to: {about}. What follows is about {name}."


def certificate_summary(bounder, certificate) -> dict[str, Any] | None:
    """A certificate for ``--json``; ``None`` where there is none."""
    return certificate and certificate.to_dict() | {"proven": certificate.proven, "method": bounder.method}


# --- fit -------------------------------------------------------------------------------------------------------------

OF_FIT = ("query", "length", "margin", "force", "resolution", "side", "budget", "seed", "device", "method")


@reads_shape
def fit(
    shape: ShapeFile,
    output: Output,
    query: Annotated[str, Option(help="Kind of query: point, ray, plane, box or distance.")] = "point",
    method: Annotated[str, Option(help="Bounding method, such as mlp, kdop, aabb.")] = "mlp",
    budget: Annotated[float, Option(help="Seconds for training and proof.")] = 60.0,
    seed: Seed = 0,
    margin: Margin = 0.0,
    force: Annotated[bool, Option("--force", help="Take a margin that is larger than the object, too.")] = False,
    resolution: Annotated[int | None, Option(help="Cells along a mesh's longest axis, for methods of cells.")] = None,
    length: Length = None,
    side: Annotated[str, Option(help="outside, or inside: no is certainly in the object (points).")] = "outside",
    workload: Workload = None,
    samples: Annotated[str, Option(help="Random queries to measure on, such as 1e6.")] = "1e6",
    device: Device = "cpu",
    json: Json = False,
    **rest: Any,
) -> int:
    """Fit a bounder to SHAPE, prove that it has no false negative, and save it.

    The proof of an mlp's rays or boxes can take longer than the budget leaves for it (3D rays: some minutes); the
    certificate is then statistical, and says so. Ctrl-C ends training early; the best bounder so far is proven and
    saved. Exit status 1: a distance whose slack is larger than the object; it is saved all the same.
    """
    from warp_bounding.bounders import save
    from warp_bounding.certificates.statement import NOT_CONSERVATIVE
    from warp_bounding.choice import hardly_trained
    from warp_bounding.evaluation import evaluate as measure
    from warp_bounding.training import fit as train

    quiet_warp(device)
    given = {"query": query, "length": length, "margin": margin, "force": force, "resolution": resolution, "side": side}
    given |= {"budget": budget, "seed": seed, "device": device, "method": method}
    arguments, count = fit_arguments(rest | given), whole_number("samples", samples)
    check_writable(output, shape, *([workload] if workload else []), kind=whole_file.BOUNDER_FILE)
    own = None if workload is None else read_queries(workload)
    loaded, started = read_shape(shape, rest), clock.perf_counter()
    with bar("fit") as update:
        bounder = train(loaded, workload=own, progress=update, **arguments)
    seconds = clock.perf_counter() - started
    save(bounder, output)
    rates, training = measure(bounder, loaded, samples=count), bounder.info["training"]
    useless = bounder.query_kind == "distance" and bounder.slack >= bounder.size
    warning = _looser(bounder)
    if useless:
        warning = (
            f"the slack, {bounder.slack:.3g}, is larger than the object, {bounder.size:.3g}, so this says nothing near "
            "it; it is the best that was proven in this time: a longer budget, or fewer neurons, helps"
        )
    elif not warning and not rest.get("steps") and (little := hardly_trained(bounder)):
        warning = f"{little}; a longer budget makes it tighter"  # a user who gives steps knows
    if json:
        found = {"method": bounder.method, "query": bounder.query_kind, "conservative": bounder.conservative}
        found |= {name: getattr(rates, name) for name in ("fp_rate", "fn", "samples", "positives", "truth")}
        found |= {
            "fit_seconds": round(seconds, 3),
            "compile_seconds": training["compile_seconds"],
            "training": training,
        }
        found |= {"certificate": certificate_summary(bounder, bounder.certificate), "note": bounder.info.get("note")}
        print_json(found | {"warning": warning, "path": output})
    else:
        rate = f"{rates.fp_rate:.2f} % false positives, {rates.fn} false negatives in {rates.samples:,} samples"
        compiling = training["compile_seconds"]
        of_them = f", {compiling:.1f} of them for compiling kernels" if compiling >= 0.1 else ""
        console().print(f"{bounder.method}: {rate}, {rates.reported_truth}")
        console().print(bounder.certificate.message if bounder.certificate else NOT_CONSERVATIVE)
        console().print(f"{seconds:.1f} s{of_them}; written to {output}")
    if warning:
        warn(warning)
    return 1 if useless else 0


def _options_by_method() -> dict[str, list]:
    """The options of each method, those of its distance included, which the command line does not distinguish."""
    from warp_bounding.bounders import DISTANCES, METHODS

    found = {name: list(cls.options) for name, cls in METHODS.items()}
    for name, cls in DISTANCES.items():
        known = found.setdefault(name, [])
        known += [option for option in cls.options if option.name not in {have.name for have in known}]
    return found


def _method_options() -> list[inspect.Parameter]:
    """A parameter for each option of a method, with the help of all methods that take it."""
    words: dict[str, dict[str, list[str]]] = {}
    kinds = {}
    for method, options in _options_by_method().items():
        for option in options:
            default = ",".join(map(str, option.default)) if isinstance(option.default, tuple) else option.default
            shown = option.help + ("" if default is None else f" (default: {default})")
            words.setdefault(option.name, {}).setdefault(shown, []).append(method)
            kinds[option.name] = int if option.parse is int else str
    found = []
    for name, kind in kinds.items():
        text = "; ".join(f"{', '.join(methods)}: {shown}" for shown, methods in words[name].items())
        annotation = Annotated[kind | None, Option(help=text)]
        found.append(inspect.Parameter(name, KEYWORD, default=None, annotation=annotation))
    return found


def fit_arguments(given: Mapping[str, Any]) -> dict[str, Any]:
    """The values of options as keyword arguments of ``fit``; others are ignored.

    Raises:
        BounderError: For a text that is not what a method's option takes.
    """
    known = {option.name: option for options in _options_by_method().values() for option in options}
    of_method = {name: option.parse(given[name]) for name, option in known.items() if given.get(name) is not None}
    return {name: given[name] for name in OF_FIT} | of_method


def _looser(bounder) -> str | None:
    """A warning for a bounder that is looser than a box; ``None`` for others."""
    from warp_bounding.bounders.bounder import STEPS

    rates = bounder.info["rates"]
    if not rates["fp_rate"] > rates["fp_rate_aabb"]:
        return None
    more = "; a longer budget makes it tighter" if any(option is STEPS for option in type(bounder).options) else ""
    shares = f"{rates['fp_rate']:.1f} % false positives, method aabb {rates['fp_rate_aabb']:.1f} %"
    return f"looser than a box: {shares} ({rates['samples']:,} samples){more}"


# --- choose ----------------------------------------------------------------------------------------------------------

SHORT = 24  # characters of a remark that stands in the table; longer ones are footnotes
OF_CHOICE = ("query", "narrow_ns", "length", "overhead_ns", "margin", "budget", "seed", "device", "statistical")


@reads_shape
def choose(
    shape: ShapeFile,
    output: Output,
    narrow_ns: Annotated[float, Option(help="What your exact test takes for one query, nanoseconds.")],
    query: Annotated[str, Option(help="Kind of query: point, ray, plane or box.")] = "point",
    workload: Workload = None,
    memory: Annotated[Text, Option(help="Most bytes that a query may read, such as 16k or 4000.")] = None,
    margin: Margin = 0.0,
    length: Length = None,
    overhead_ns: Annotated[float, Option(help="What your step takes besides for a query, nanoseconds.")] = 0.0,
    budget: Annotated[float, Option(help="Seconds for all fits and measurements.")] = 120.0,
    seed: Seed = 0,
    networks: Annotated[str, Option(help="Hidden widths of networks to try; or none.")] = "24-24,16-16,50-50",
    methods: Annotated[Text, Option(help="Such as bvh,mlp,distance-grid (default: all).")] = None,
    statistical: Annotated[bool, Option("--statistical", help="Choose among sampled bounders, too.")] = False,
    folder: Annotated[Text, Option(help="Keeps candidates, to go on (default: OUTPUT with .choice).")] = None,
    device: Device = "cpu",
    json: Json = False,
    **reading: Text,
) -> int:
    """Choose a broad phase for SHAPE: fit candidates of every method, measure them, save the one that costs the least.

    What counts is t + p * narrow-ns: the nanoseconds that a bounder takes for a query, and the share of the queries
    that it leaves to your exact test. The answer may be that none pays; then nothing is written. A plot of cost against
    the narrow phase's price lies beside the output (.png). What the budget has no room for is listed with the one that
    it would need. Ctrl-C ends fitting, and what is there is compared; the same command goes on where a killed one
    stopped.
    """
    from warp_bounding.choice import choose as take
    from warp_bounding.choice import cost_plot, duration

    quiet_warp(device)
    given = {"query": query, "narrow_ns": narrow_ns, "length": length, "overhead_ns": overhead_ns, "margin": margin}
    given |= {"memory": memory, "budget": budget, "seed": seed, "device": device, "statistical": statistical}
    arguments = choose_arguments(given | {"networks": networks, "methods": methods})
    inputs, picture = (
        [shape, *([workload] if workload else [])],
        str(Path(output).with_suffix(whole_file.PICTURE_FILE.suffix)),
    )
    check_writable(output, *inputs, kind=whole_file.BOUNDER_FILE)
    check_writable(picture, *inputs, kind=whole_file.PICTURE_FILE)
    own = None if workload is None else read_queries(workload)
    loaded = read_shape(shape, reading)
    kept = Path(output).with_suffix(".choice") if folder is None else Path(folder)
    with bar("choose") as update:
        choice = take(loaded, workload=own, folder=kept, progress=update, **arguments)
    if choice.bounder is not None:
        choice.bounder.save(output)
    write_whole(picture, cost_plot(choice), whole_file.PICTURE_FILE)
    if json:
        found = choice.to_dict() | {"path": output if choice.bounder is not None else None, "plot": picture}
        rows = [{k: None if v != v else v for k, v in row.items()} for row in found["rows"]]  # JSON has no NaN
        print_json(found | {"rows": rows})
        return 1 if choice.about["interrupted"] else 0
    out, about = console(), choice.about
    where = f"{choice.threads} threads of a CPU" if choice.threads else choice.device
    whose, hint = ("your", "") if workload else ("random", "; --workload x.npy asks those of your simulation")
    meet = f"{100 * choice.positives:.3g} % meet the object"
    out.print(f"{choice.queries:,} {whose} queries, {meet}; {where}{hint}")
    _print_rows(out, choice)
    out.print(choice.why + ".")
    prices = "; ".join(f"{stretch.label} from {duration(stretch.price)}" for stretch in choice.prices)
    out.print(f"Best by the narrow phase's price: {prices}")
    if choice.more:
        out.print(choice.more + ".")
    if about["interrupted"]:
        out.print("Interrupted: some candidates were not fitted; the same command goes on.")
    seconds, before, compiling = (about[name] for name in ("seconds", "seconds_before", "compile_seconds"))
    took = f"{seconds:.0f} s of fits and measurements" + (f", {before:.0f} s before" if before >= 1 else "")
    took += f", of a budget of {about['budget']:g}"
    out.print(took + (f"; {compiling:.0f} s besides for compiling and loading kernels" if compiling >= 1 else ""))
    done = f"written to {output} and {picture}" if choice.bounder is not None else f"no bounder is written; {picture}"
    out.print(f"{done}; candidates are kept in {kept}, for another choice, and can be deleted")
    return 1 if about["interrupted"] else 0


def _print_rows(out, choice) -> None:
    remarks = dict.fromkeys(text for row in choice.rows for text in (row.why_not, row.note) if len(text) > SHORT)
    number, rows = {remark: f"[{index}]" for index, remark in enumerate(remarks, 1)}, []
    for row in choice.rows:
        numbers, cost = ("", "", ""), f"{row.cost:.4g}" if row.cost < 1000 else f"{row.cost:,.0f}"
        if row.cost == row.cost:  # not NaN
            numbers = (f"{row.nanoseconds:.3g}", f"{100 * row.share:.3g}", cost)
        words = " ".join(number.get(text, text) for text in (row.why_not or row.certificate, row.note))
        style = "bold" if row.label == choice.label else "dim" if row.why_not else ""
        seconds = f"{row.seconds:.0f}" if row.seconds else ""
        rows.append((row.label, f"{row.nbytes:,}" if row.nbytes else "", *numbers, seconds, words, style))
    header = dict.fromkeys(("", "bytes", "ns", "left %", "cost ns", "fit s", "certificate"), "right")
    print_table(out, header | {"": "left", "certificate": "left"}, rows)
    for remark, index in number.items():
        out.print(f"{index} {remark}", style="dim")


def choose_arguments(given: Mapping[str, Any]) -> dict[str, Any]:
    """The values of options as keyword arguments of ``choose``; others are ignored.

    Raises:
        BounderError: For sizes or a number of bytes that are none.
    """
    memory, methods, networks = given["memory"], given["methods"], given["networks"]
    sizes = () if networks.strip().lower() == "none" else networks.split(",")
    try:
        sizes = tuple(tuple(int(width) for width in word.split("-")) for word in sizes)
    except ValueError:
        raise BounderError(f"networks must be widths such as 24-24,50-50, or none, got {networks!r}") from None
    found = {name: given[name] for name in OF_CHOICE} | {"networks": sizes}
    found["methods"] = None if methods is None else [word.strip() for word in methods.split(",")]
    return found | {"memory": None if memory is None else _bytes(memory)}


def _bytes(text: str) -> int:
    """A number of bytes such as 16k; ``BounderError`` for other texts."""
    word, value = text.strip().lower().removesuffix("b"), 0.0
    unit = {"k": 1024, "m": 1024**2}.get(word[-1:], 1)
    with contextlib.suppress(ValueError):
        value = float(word[:-1] if unit > 1 else word) * unit
    if not 1 <= value < 2**40:
        raise BounderError(f"memory must be a number of bytes such as 16k or 4000, got {text!r}")
    return int(value)


# --- bake ------------------------------------------------------------------------------------------------------------

LINE_SECONDS = 30.0  # between two lines of progress, where standard error is no terminal


def bake(
    folder: Annotated[str, Argument(metavar="FOLDER", help="Folder with shapes, in folders inside it too.")],
    out: Annotated[str, Option(help="Folder for bounders, manifest and contact sheet.")],
    jobs: Annotated[int | None, Option(help="Worker processes of this machine (default: one a core).")] = None,
    scheduler: Annotated[Text, Option(help="Address of a Dask scheduler, such as tcp://host:8786.")] = None,
    largest: Annotated[float | None, Option(help="Files above so many megabytes are left out.")] = None,
    json: Json = False,
    **rest: Any,
) -> int:
    """Fit a bounder to each shape of FOLDER, with the options of fit, or with --narrow-ns choose one for each.

    Results are named by a hash of shape, settings and version, and written whole: the same command goes on where one
    that was stopped or killed has ended. What is wrong with a shape is reported and listed, and the others go on; exit
    status 1 where there was any. Ctrl-C keeps what is there.
    """
    from warp_bounding.baking.engine import LARGEST, SHEET, SchedulerError, bake_with
    from warp_bounding.baking.library import MANIFEST

    quiet_warp(rest["device"])
    settings = _settings(rest)
    if jobs is not None and scheduler is not None:
        raise BoundingError("jobs is for workers of this machine, got --jobs and --scheduler")
    last = [clock.perf_counter()]

    def log(done: float, total: float, note: str = "") -> None:
        if (now := clock.perf_counter()) - last[0] > LINE_SECONDS:
            last[0] = now
            print(f"bake: {note}", file=sys.stderr, flush=True)

    where = {"jobs": jobs, "scheduler": scheduler, "largest": LARGEST if largest is None else largest}
    try:
        with bar("bake") as update:
            update = update if sys.stderr.isatty() else log
            done = bake_with(settings, folder, out, progress=update, tell=lambda text: warn(text), **where)
    except SchedulerError as error:
        print(f"warp-bounding: {error}", file=sys.stderr)
        return 1
    for path in done.too_large:
        warn(f"{path}: left out, it is above --largest")
    failed = [record.source for record in done.records if record.error]
    proven = sum(record.certificate == "proven" for record in done.records)
    shapes, manifest, sheet = len(done.records), Path(out) / MANIFEST, Path(out) / SHEET
    if json:
        found = {"shapes": shapes, "baked": done.baked, "kept": done.kept, "failed": len(failed), "proven": proven}
        found |= {"foreign": done.foreign, "too_large": done.too_large, "errors": failed, "workers": done.workers}
        found |= {name: round(getattr(done, name), 3) for name in ("seconds", "task_seconds", "running_seconds")}
        print_json(found | {"out": out, "manifest": str(manifest), "contact_sheet": str(sheet)})
    else:
        kept = f", {done.kept:,} were there already" if done.kept else ""
        others = f"; {done.foreign:,} other files" if done.foreign else ""
        counts = f"{done.baked:,} baked{kept}, {len(failed):,} failed; {proven:,} proven{others}"
        console().print(f"{shapes:,} shapes: {counts}")
        console().print(f"{done.seconds:.1f} s, {done.task_seconds:.1f} s of work; {manifest}, {sheet}")
    return 1 if failed else 0


def _parameters(command: Callable) -> dict[str, inspect.Parameter]:
    """The options of ``fit`` or ``choose`` that ``bake`` has, too."""
    own = ("shape", "output", "folder", "json")
    return {
        name: p.replace(kind=KEYWORD) for name, p in inspect.signature(command).parameters.items() if name not in own
    }


def _bake_options() -> dict[str, inspect.Parameter]:
    """All options of ``fit``, with fewer samples, and those that only ``choose`` has, none of which must be given."""
    from warp_bounding.baking.engine import SAMPLES

    found = _parameters(choose) | _parameters(fit)
    text = "Choose a bounder for each shape: what your exact test takes for one query, nanoseconds."
    price = Annotated[float | None, Option(help=text)]
    found["narrow_ns"] = inspect.Parameter("narrow_ns", KEYWORD, default=None, annotation=price)
    return found | {"samples": found["samples"].replace(default=f"{SAMPLES:g}")}


def _settings(given: dict[str, Any]):
    """How each shape is baked; ``BoundingError`` where options do not go together."""
    from warp_bounding.baking.engine import Settings

    samples, queries = whole_number("samples", given["samples"]), given["workload"]
    if queries is not None:
        read_queries(queries)
        queries = str(Path(queries).resolve())
    of_fit, of_choose = set(_parameters(fit)), set(_parameters(choose))
    stated = {name for name, parameter in _bake_options().items() if given[name] != parameter.default}
    fitted, option = given["narrow_ns"] is None, lambda name: f"--{name.replace('_', '-')}"
    for name in sorted(stated & (of_choose - of_fit if fitted else of_fit - of_choose - {"samples"})):
        if fitted:
            wanted = f"is for a choice, which --narrow-ns asks for; got {given[name]!r} without it"
        else:
            wanted = f"is for a fit, and --narrow-ns asks for a choice; got {given[name]!r} too"
        raise BoundingError(f"{option(name)} {wanted}")
    arguments = fit_arguments(given) if fitted else choose_arguments(given)
    return Settings(arguments, reading_of(given), queries, samples)


# --- query, certify, soak, evaluate, info ----------------------------------------------------------------------------


def query(
    file: BounderFile,
    points: Annotated[str, Argument(metavar="POINTS.npy", help="(N, m) numbers: queries of FILE's kind.")],
    output: Annotated[str, Option("--output", "-o", help="File to write (.npy): 1 maybe, 0 no.")],
    device: Device = "cpu",
    json: Json = False,
) -> int:
    """Ask FILE about every row of POINTS.npy, in object space, and write the answers."""
    import numpy as np

    from warp_bounding.bounders import load

    quiet_warp(device)
    check_writable(output, file, points, kind=whole_file.ARRAY_FILE)
    bounder, queries = load(file, device=device), read_queries(points)
    started = clock.perf_counter()
    try:
        mask = bounder.query(queries).numpy()
    except QueryError as error:
        raise QueryError(f"{points}: {error}") from error
    seconds, content, maybe = clock.perf_counter() - started, io.BytesIO(), int(mask.sum())
    np.save(content, mask)
    write_whole(output, content.getvalue(), whole_file.ARRAY_FILE)
    if json:
        about = {
            "path": file,
            "points": points,
            "output": output,
            "method": bounder.method,
            "query": bounder.query_kind,
        }
        print_json(about | {"count": len(mask), "maybe": maybe, "seconds": round(seconds, 6)})
    else:
        share = f" ({100 * maybe / len(mask):.2f} %)" if len(mask) else ""
        asked = f"{len(mask):,} {bounder.query_kind} queries"
        console().print(f"{bounder.method}: maybe for {maybe:,} of {asked}{share}; written to {output}")
    return 0


@reads_shape
def certify(
    file: BounderFile,
    shape: ShapeFile,
    budget: Annotated[float, Option(help="Seconds allowed.")] = 900.0,
    margin: Annotated[float | None, Option(help="Not proven unless FILE claims this margin.")] = None,
    length: Annotated[float | None, Option(help="Not proven unless FILE claims rays of this length.")] = None,
    resolution: Annotated[int | None, Option(help="Not proven unless FILE claims this resolution.")] = None,
    query: Annotated[Text, Option(help="Not proven unless FILE claims this kind of query.")] = None,
    checkpoint: Annotated[Text, Option(help="Of a distance: go on from this file, and keep the rest there.")] = None,
    json: Json = False,
    **reading: Text,
) -> int:
    """Prove from scratch that FILE has no false negative on SHAPE. Exit status 0: proven; 1: not.

    Margin, length of rays, resolution and kind of query are taken from FILE, and printed. Those that are stated here
    are compared with FILE's.
    """
    from warp_bounding.proof import certify as prove
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
    bounder, loaded = load_both(file, shape, "cpu", reading)
    with bar("certify") as update:
        found = prove(bounder, loaded, **expected, seconds=budget, progress=update, checkpoint=checkpoint)
    fitted = bounder.info.get("indicator")
    same = found.indicator == fitted
    if json:
        verdict = {"proven": found.proven, "same_indicator": same, "certified_indicator": fitted}
        summary = certificate_summary(bounder, found)
        print_json({"path": file, "shape": shape, **verdict, "certificate": summary})
    else:
        out = console()
        if not same:
            out.print(other_shape(shape, found.indicator, fitted))
        out.print(f"{found.kind}: {found.message}")
        if found.counterexample:
            out.print(f"counterexample: {found.counterexample}")
        out.print(f"{found.boxes:,} boxes, {found.seconds:.2f} s")
    if restricted := getattr(loaded, "restriction", ""):
        warn(f"warp-bounding: {loaded.name}: {restricted}")
    return 0 if found.proven else 1


@reads_shape
def stress(
    file: BounderFile,
    shape: ShapeFile,
    count: Annotated[str, Option(help="Positives to ask, such as 1e8.")] = "1e8",
    seed: Annotated[int | None, Option(help="Random seed (default: a fresh one, which is printed).")] = None,
    resume: Annotated[Text, Option(metavar="STATE.json", help="Keep the state here, and go on from it.")] = None,
    device: Device = "cpu",
    json: Json = False,
    **reading: Text,
) -> int:
    """Ask FILE hard positives of SHAPE, as it is deployed. Exit status 0: none missed; 1: a false negative, printed.

    Certain positives by construction, near the object's boundary: grazing rays, touching boxes, tangent planes, points
    on faces and corners of cells; in float32, in float64, and of the shape placed in the world. A stress test proves
    nothing; it is there to contradict a proof. Ctrl-C ends it and says what was done until then.
    """
    from warp_bounding.proof import stress_test as ask

    wanted = whole_number("count", count)
    bounder, loaded = load_both(file, shape, device, reading)
    with bar("stress") as update:
        found = ask(bounder, loaded, wanted, seed=seed, state=resume, progress=update)
    fitted, status = bounder.info.get("indicator"), 0 if found.missed is None else 1
    same = found.indicator == fitted
    if json:
        about = {"path": file, "shape": shape, "same_indicator": same}
        print_json({**about, **found.to_dict(), "rate": round(found.rate)})
        return status
    out = console()
    if not same:
        out.print(other_shape(shape, found.indicator, fitted), style="yellow")
    kinds = ", ".join(f"{n:,} {form}" for form, n in found.forms.items() if n) or "none"
    took = f"seed {found.seed}, {found.seconds:.1f} s, {found.rate / 1e6:.1f} million/s"
    asked = f"{found.done:,} hard positive {found.query} queries"
    if found.missed is None:
        ended = "interrupted: " if found.interrupted else ""
        out.print(f"{ended}{asked} asked, {found.wanted:,} wanted ({kinds}), none missed; {took}")
    else:
        form = found.missed_form + (f", the shape placed by {found.missed_world}" if found.missed_world else "")
        region = f"the {found.query} {found.missed} ({form})"
        out.print(f"FALSE NEGATIVE: {region} meets the shape and is answered with no.")
        again = f"the same again with --seed {found.seed}"
        out.print(f"{asked} were answered with maybe before it ({kinds}); {again}; {took}")
    if resume and not found.complete:
        out.print(f"To go on: the same command again, with --resume {resume}")
    return status


@reads_shape
def evaluate(
    file: BounderFile,
    shape: ShapeFile,
    samples: Annotated[str, Option(help="Number of random queries, such as 1e6.")] = "1e6",
    protocol: Annotated[str, Option(help="exact, or sampled as in the paper.")] = "exact",
    seed: Annotated[int, Option(help="Random seed of the samples.")] = 1,
    radius: Annotated[float | None, Option(help="Of a distance: points within it are positive (default: 0).")] = None,
    query: Annotated[Text, Option(help="Of a distance: what it is asked: point, ray or box.")] = None,
    length: Annotated[float | None, Option(help="Of a distance that is asked rays: theirs (default: 1).")] = None,
    steps: Annotated[int | None, Option(help="Of a distance: most evaluations of a ray (32) or a box (64).")] = None,
    device: Device = "cpu",
    json: Json = False,
    **reading: Text,
) -> int:
    """Measure FILE on SHAPE: rates are per cent of all samples. Exit status 1 if a false negative was found."""
    from warp_bounding.evaluation import evaluate as measure

    count = whole_number("samples", samples)
    bounder, loaded = load_both(file, shape, device, reading)
    of_distance = {"radius": radius, "query": query, "length": length, "steps": steps}
    with bar("evaluate") as update:
        rates = measure(bounder, loaded, count, protocol, seed=seed, progress=update, **of_distance)
    fitted = bounder.info.get("indicator")
    same = rates.indicator == fitted
    if json:
        about = {"path": file, "shape": shape, "same_indicator": same, "fitted_indicator": fitted}
        summary = certificate_summary(bounder, bounder.certificate)
        print_json({**about, "method": bounder.method, **rates.to_dict(), "certificate": summary})
    else:
        if not same:
            console().print(other_shape(shape, rates.indicator, fitted), style="yellow")
        text = f"{bounder.method}: {rates.fp_rate:.3f} % false positives, {rates.fn} false negatives"
        where = f"{rates.samples:,} samples ({rates.protocol}), {rates.reported_truth}"
        console().print(f"{text}, {rates.positives:.3f} % positives in {where}")
    return 0 if rates.fn == 0 else 1


def info(file: BounderFile, json: Json = False) -> int:
    """Describe FILE: method, sizes, what is proven and what is not. Exit status 1 if it holds no proof."""
    from rich.console import Console
    from rich.table import Table

    from warp_bounding.bounders import load
    from warp_bounding.bounders.voxels import Voxels
    from warp_bounding.certificates.statement import statement
    from warp_bounding.shapes.parts import SIDES

    quiet_warp()
    bounder = load(file, device="cpu")
    certificate, words, domain = bounder.certificate, statement(bounder), bounder.domain
    proven = certificate is not None and certificate.proven
    if json:
        kept = ("name", "indicator", "grid_shape", "margin", "resolution", "seed", "note", "library")
        found = {"path": file, "method": bounder.method, "query": bounder.query_kind, "dimension": bounder.ndim}
        found |= {"side": SIDES[domain.unbounded], "length": domain.length, "conservative": bounder.conservative}
        found |= {"bytes": bounder.nbytes, "threshold": float(bounder.threshold)}
        found |= {} if isinstance(bounder, Voxels) else bounder.sizes
        found |= {name: bounder.info.get(name) for name in (*kept, "training", "rates")}
        print_json(found | {"certificate": certificate_summary(bounder, certificate), "statement": words})
        return 0 if proven else 1
    out = Console(highlight=False, markup=False, emoji=False)
    out.width = min(READABLE, out.width) if out.is_terminal else READABLE
    table = Table(show_header=False, box=None, pad_edge=False, expand=False)
    table.add_column(no_wrap=True, style="bold")
    table.add_column(overflow="fold")
    side = " from the inside" if domain.unbounded else ""
    about = f"{bounder.ndim}D {bounder.query_kind} queries{side}, {bounder.nbytes:,} bytes"
    sizes, most = ", ".join(f"{key} {value}" for key, value in bounder.sizes.items()), 90
    rows = {"method": f"{bounder.method}, {about}", "sizes": sizes[:most] + (" ..." if len(sizes) > most else "")}
    rows |= {"tightness": bounder.tightness} | words
    rows |= {} if certificate else {"threshold": f"{float(bounder.threshold):.9g}"}
    styles = {"certificate": "green" if proven else "yellow", "note": "yellow"}
    for key, value in rows.items():
        if value:
            table.add_row(key, value, style=styles.get(key))
    out.print(table)
    return 0 if proven else 1


# --- show ------------------------------------------------------------------------------------------------------------

LEVELS, PANELS = 6, 3  # radii or times that are shown if none are named, and of these in a picture
FARTHEST = 0.25  # of the object's longest side: the largest of these radii
RESOLUTIONS = 2, 1024  # cells, or pixels: least and most


@reads_shape
def show(
    file: BounderFile,
    shape: ShapeFile,
    screenshot: Annotated[Text, Option(metavar="FILE.png", help="Write a picture, open no window.")] = None,
    html: Annotated[Text, Option(metavar="FILE.html", help="Write a web page that turns with the mouse.")] = None,
    radius: Annotated[Text, Option(help="Of a distance: radii such as 0,0.05,0.1; object units.")] = None,
    time: Annotated[Text, Option(help="Of a shape that moves: a time, or several such as 0,0.5,1.")] = None,
    slice_: Annotated[Text, Option("--slice", metavar="K=VALUE,...", help="Hold coordinates, from 0 on.")] = None,
    cut: Annotated[Text, Option(help="Cut the bound of a picture open along an axis: x, y or z.")] = None,
    up: Annotated[str, Option(help="The axis that is up: x, y or z.")] = "y",
    resolution: Annotated[int | None, Option(help="Cells along the longest side (80), or pixels in 2D (640).")] = None,
    samples: Annotated[str, Option(help="Random points to ask, for each radius or time.")] = "1e5",
    seed: Annotated[int, Option(help="Random seed of these points.")] = 1,
    device: Device = "cpu",
    json: Json = False,
    **reading: Text,
) -> int:
    """Show where FILE says maybe around SHAPE, and where its answers to random points are wrong.

    Without --screenshot or --html a window opens. A distance is shown at several radii, a shape that moves at several
    times; more than three coordinates need --slice.
    """
    from warp_bounding.views.draw import UPS, Window, check_display, page, picture
    from warp_bounding.views.view import needed, view_of

    radii, times, held = _numbers("radius", radius), _numbers("time", time), _held(slice_)
    count, (least, most) = whole_number("samples", samples), RESOLUTIONS
    for name, value in (("up", up), ("cut", cut)):
        if value is not None and value not in UPS:
            raise QueryError(f"{name} must be one of {', '.join(UPS)}, got {value!r}")
    if cut is not None and screenshot is None:
        raise QueryError("--cut is for --screenshot; windows and pages have a plane that cuts")
    if resolution is not None and not least <= resolution <= most:
        raise QueryError(f"resolution must be from {least} to {most}, got {resolution}")
    if seed < 0:
        raise QueryError(f"seed must be at least 0, got {seed}")
    for path, kind in ((screenshot, whole_file.PICTURE_FILE), (html, whole_file.PAGE_FILE)):
        if path is not None and Path(path).suffix.lower() != kind.suffix:
            raise BoundingError(f"{path}: expected a name that ends with {kind.suffix}")
        if path is not None:
            check_writable(path, file, shape, kind=kind)
    needed("pyvista")
    if html is not None:
        needed("plotly")
    if screenshot is None and html is None:
        if json:
            raise QueryError("--json is for --screenshot or --html; a window prints nothing")
        check_display()
    bounder, loaded = load_both(file, shape, device, reading)
    options = {"radii": radii or _radii(bounder, times), "times": times or _times(loaded, radii), "held": held}
    with bar("show") as update:
        options |= {"resolution": resolution, "samples": count, "seed": seed, "progress": update}
        view = view_of(bounder, loaded, **options)
    if "Another shape" in view.facts:
        warn(view.facts["Another shape"])
    if html is not None:
        write_whole(html, page(view, view.title, up).encode(), whole_file.PAGE_FILE)
    if screenshot is not None:
        panels = view.states if radii or times else _spread(view.states)
        write_whole(screenshot, picture(replace(view, states=panels), view.title, up, cut), whole_file.PICTURE_FILE)
    if json:
        names = ("label", "fp_rate", "fn", "samples", "undecided")
        fitted, states = bounder.info.get("indicator"), view.states
        found = {
            "method": bounder.method,
            "query": bounder.query_kind,
            "bytes": bounder.nbytes,
            "asked": view.asked or None,
        }
        found |= {"same_indicator": view.indicator == fitted, "fitted_indicator": fitted}
        found |= {"states": [{name: getattr(state, name) for name in names} for state in states]}
        found |= {"certificate": certificate_summary(bounder, bounder.certificate), "path": file, "shape": shape}
        print_json(found | {"screenshot": screenshot, "html": html})
        return 0
    for state in view.states:
        at = f"{view.asked} {state.label}: " if state.label else ""
        console().print(f"{bounder.method}: {at}{state.rates}")
    for path in filter(None, (html, screenshot)):
        console().print(f"written to {path}")
    if html is None and screenshot is None:
        Window(view, view.title, up).open()
    return 0


def _numbers(name: str, text: str | None) -> list[float]:
    """Numbers from text such as 0,0.05."""
    try:
        return [float(word) for word in text.split(",")] if text is not None else []
    except ValueError:
        raise QueryError(f"{name} must be a number, or several such as 0,0.05,0.1, got {text!r}") from None


def _held(text: str | None) -> dict[int, float]:
    """Coordinates and their values from text such as 3=0.5,4=0."""
    words = [word.partition("=") for word in text.split(",")] if text is not None else []
    try:
        return {int(axis): float(value) for axis, _, value in words}
    except ValueError:
        raise QueryError(f"slice must be coordinates and values such as 3=0.5,4=0, got {text!r}") from None


def _radii(bounder, times: Sequence[float]) -> list[float]:
    """Radii to show a distance at, if none are named: from 0 to a share of the object's longest side."""
    if bounder.query_kind != "distance" or bounder.domain.time or len(times) > 1:
        return [0.0]
    farthest = float(f"{FARTHEST * bounder.size:.1g}")
    return [round(farthest * k / (LEVELS - 1), 12) for k in range(LEVELS)]


def _times(shape, radii: Sequence[float]) -> list[float]:
    """Times to show a motion at, if none are named: evenly spread, or the middle one where there are several radii."""
    if not shape.time:
        return []
    start, end = float(shape.sample_lower[0]), float(shape.sample_upper[0])
    return [(start + end) / 2] if len(radii) > 1 else [start + (end - start) * k / (LEVELS - 1) for k in range(LEVELS)]


def _spread(states: list) -> list:
    """The first, the last, and some in between."""
    return [states[k] for k in sorted({round(k * (len(states) - 1) / (PANELS - 1)) for k in range(PANELS)})]
