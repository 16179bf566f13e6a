"""The command ``warp-bounding``; ``main`` also runs the command lines of ``paper/`` and ``sims/``.

Every command takes ``--json``: one JSON object on standard output and nothing else there; progress goes to standard
error. Exit status: 0; 1 where something is not proven, or a choice was interrupted; 2 for bad usage or bad input, with
one clear line; 130 for Ctrl-C. Commands import what they need when they run, so that ``--help`` is quick.
"""

import contextlib
import functools
import inspect
import io
import json as json_text
import os
import sys
import tempfile
import textwrap
import time as clock
import warnings
import webbrowser
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer import Argument, Option

import warp_bounding as wb
from warp_bounding.errors import BoundingError, BoundingWarning, QueryError
from warp_bounding.runtime import VERBOSE
from warp_bounding.runtime.progress import bar, quiet_warp
from warp_bounding.runtime.whole_file import BOUNDER, check_writable, write_whole

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
    if "--verbose" in arguments:
        os.environ[VERBOSE] = "1"  # workers of a bake are told, too
    arguments = ["--output" if word == "--out" else word for word in arguments if word != "--verbose"]
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
        message = error.format_message().rstrip(".").replace("Value error, ", "")
        raise BoundingError(f"{message} (see '{where} --help')") from error
    except typer.Exit as error:
        return error.exit_code
    except typer.Abort:
        return INTERRUPTED


def _app(arguments: Sequence[str]) -> typer.Typer:
    """All commands; ``fit`` and ``bake`` have the options of methods where they are called, or completed.

    A docstring is a command's help, and its last line an ``Example:``.
    """
    if {"fit", "bake"} & {*arguments, *os.environ.get("COMP_WORDS", "").split()}:
        _with_options(fit, *_method_options())
        _with_options(bake, *_bake_options().values())
    app = typer.Typer(name="warp-bounding", no_args_is_help=True, pretty_exceptions_enable=False)
    for command in (fit, certify, evaluate, info, query, export, choose, show, bake):
        text, _, example = command.__doc__.partition("Example:")
        paragraphs = (" ".join(part.split()) for part in text.strip().split("\n\n"))
        example = f"Example: {' '.join(example.split())}"
        app.command(name=command.__name__, help="\n\n".join(paragraphs), epilog=example)(command)

    def tell(wanted: bool) -> None:
        if wanted:
            print(f"warp-bounding {wb.__version__}")
            raise typer.Exit

    version = Option("--version", callback=tell, is_eager=True, help="Print the version and end.")
    loud = Option("--verbose", help="Print Warp's own messages, too; may stand behind a command.")

    @app.callback(help=ABOUT)
    def common(version: Annotated[bool, version] = False, verbose: Annotated[bool, loud] = False) -> None:
        pass

    return app


# --- options ---------------------------------------------------------------------------------------------------------

MOST = 10**15  # so many queries would take years


def whole_number(text: Any, least: int = 0) -> int:
    """A whole number that may be written as 1e6."""
    with contextlib.suppress(ValueError, OverflowError):
        if least <= float(text) == int(float(text)) <= MOST:
            return int(float(text))
    raise ValueError(f"expected a whole number from {least} to {MOST:.0e}, such as 1e6, got {str(text)!r}")


def count(text: Any) -> int:
    """A whole number of at least 1."""
    return whole_number(text, 1)


def numbers(text: str) -> list[float]:
    """Numbers between commas, such as 0,0.05."""
    return [float(word) for word in text.split(",")]


def prices(text: str) -> float | tuple[float, ...]:
    """A number, or several."""
    found = numbers(text)
    return found[0] if len(found) == 1 else tuple(found)


def values(text: str, kind: type = str, example: str = "finger=0.04,wrist=0") -> dict[Any, float]:
    """Names and their values, such as finger=0.04,wrist=0."""
    try:
        return {kind(name): float(value) for name, _, value in (word.partition("=") for word in text.split(","))}
    except ValueError:
        raise ValueError(f"expected {example}, got {text!r}") from None


def coordinates(text: str) -> dict[int, float]:
    """Coordinates and their values, such as 3=0.5,4=0."""
    return values(text, int, "coordinates and values such as 3=0.5,4=0")


def words(text: str) -> list[str]:
    """Words between commas."""
    return [word.strip() for word in text.split(",")]


def number_option(help: str, parser: Callable[[Any], int] = whole_number) -> Any:
    """An option that takes a whole number."""
    return Option(help=help, parser=parser, metavar="N")


Text = str | None
Kind = Literal["point", "ray", "plane", "box", "distance"]
Axis = Literal["x", "y", "z"]
Json = Annotated[bool, Option("--json", help="Print one JSON object on standard output, and nothing else there.")]
Device = Annotated[str, Option(help="Warp device: cpu, cuda:0, ...")]
Seed = Annotated[int, number_option("Random seed.")]
Samples = Annotated[int, number_option("Random queries to measure on, such as 1e6.", count)]
Margin = Annotated[float, Option(help="Dilate the object by this length first, object units.")]
Length = Annotated[float | None, Option(help="Length of a ray, object units; other queries have none (default: 1)")]
EXISTS = {"exists": True, "dir_okay": False}
BounderFile = Annotated[Path, Argument(metavar="FILE", help="A bounder that `fit` wrote (.safetensors).", **EXISTS)]
ShapeFile = Annotated[Path, Argument(metavar="SHAPE", help="Image, voxel file, array, mesh or USD file.", **EXISTS)]
Output = Annotated[str, Option("--output", "-o", help="File to write the bounder to (.safetensors).")]
Workload = Annotated[
    Path | None, Option(help="A .npy file, (Q, m), of your own queries: where false positives count.", **EXISTS)
]
READING = {  # how the file of a shape is read: type or parser, and help
    "level": (str, "Which values of an array, or grey values of an image, are occupied: '<128', '<=0'."),
    "spacing": (numbers, "Size of an array's or image's cells, one or one an axis: 0.05 or 0.1,0.05; rows first."),
    "origin": (numbers, "Where the centre of an array's or image's first cell is: -12.5,3; rows first."),
    "unknown": (Literal["occupied", "free"], "Of a map, what unseen cells are (default: occupied)."),
    "hollow": (Literal["filled", "empty"], "What the air is that a shape encloses (default: a mesh's is filled)."),
}
KEYWORD = inspect.Parameter.KEYWORD_ONLY


def _option(name: str, kind: Any, *names: str, **about: Any) -> inspect.Parameter:
    """An option that need not be given, of a type or parsed by a function; whole numbers may be written as 1e6."""
    if kind is int:
        about |= {"parser": whole_number, "metavar": "N"}
    elif inspect.isfunction(kind):
        kind, about["parser"] = str, kind
    return inspect.Parameter(name, KEYWORD, default=None, annotation=Annotated[kind | None, Option(*names, **about)])


def command(function: Callable[..., tuple]) -> Callable[..., int]:
    """A command that prints what a function returns: exit status, an object for ``--json``, and lines for people.

    Empty lines are left out. Where there is a SHAPE, the function is given the options of ``READING``, too.
    """

    @functools.wraps(function)
    def run(json: bool, **given: Any) -> int:
        status, found, *lines = function(**given)
        if json:
            print_json(found)
        else:
            print(*filter(None, lines), sep="\n")
        return status

    own = [p for p in inspect.signature(function).parameters.values() if p.kind != inspect.Parameter.VAR_KEYWORD]
    run.own = [*own, inspect.Parameter("json", KEYWORD, default=False, annotation=Json)]
    if any(parameter.name == "shape" for parameter in own):
        panel = {"rich_help_panel": "How SHAPE is read"}
        run.own += [_option(name, kind, help=words, **panel) for name, (kind, words) in READING.items()]
    return _with_options(run)


def _with_options(run: Callable, *more: inspect.Parameter) -> Callable:
    """A command with its own options and these, in place of earlier ones."""
    run.__signature__ = inspect.Signature([*run.own, *more])
    return run


def reading_of(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options of a shape's file as keyword arguments of ``load_shape``."""
    found = {name: options[name] for name in READING if options.get(name) is not None}
    if len(found.get("spacing", ())) == 1:
        found["spacing"] = found["spacing"][0]
    return found


def read_queries(path: Path | None):
    """A ``.npy`` array, ``None`` for no path; ``QueryError`` if the file holds something else."""
    from numpy.lib.format import read_array

    from warp_bounding.shapes.formats.reading import reading

    if path is None:
        return None
    with reading(str(path), "a NumPy .npy array of queries"), open(path, "rb") as file:
        return read_array(file, allow_pickle=False)


def load_both(file: Path, shape: Path, device: str, options: Mapping[str, Any]) -> tuple[Any, Any]:
    """A bounder and a shape from their files."""
    quiet_warp(device)
    return wb.load(file, device=device), wb.load_shape(str(shape), **reading_of(options))


# --- output ----------------------------------------------------------------------------------------------------------

READABLE = 110  # columns that are easy to read, where no terminal looks


def print_json(value: dict[str, Any]) -> None:
    """Print one JSON object on standard output."""
    print(json_text.dumps(value, allow_nan=False, default=str))  # paths are text


def warn(text: str) -> None:
    """Print one yellow line on standard error, about something that is no error."""
    typer.secho(" ".join(text.split()), fg="yellow", err=True)


@contextlib.contextmanager
def reported_warnings() -> Iterator[None]:
    """Print each of the library's own warnings by ``warn``, once; all others are shown as before."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", BoundingWarning)
        others, told = warnings.showwarning, functools.cache(warn)

        def show(message, category, *where, **more) -> None:
            if issubclass(category, BoundingWarning):
                told(f"warp-bounding: {message}")
            else:
                others(message, category, *where, **more)

        warnings.showwarning = show
        yield


def about(bounder, path: Path | str, certificate=None, shape: Path | None = None, given: str = "") -> dict[str, Any]:
    """What ``--json`` says of a bounder, with its certificate or another one, and of a shape, ``given`` its SHA-256.

    Warns where the shape is not that of the fit.
    """
    certificate = certificate or bounder.certificate
    summary = certificate and certificate.to_dict() | {"proven": certificate.proven, "method": bounder.method}
    found = {"path": path, "method": bounder.method, "query": bounder.query_kind, "bytes": bounder.nbytes}
    found |= {"certificate": summary}
    if shape is not None:
        fitted = bounder.info.get("indicator")
        found |= {"shape": shape, "same_indicator": given == fitted, "fitted_indicator": fitted}
        if given != fitted:
            digests = f"its SHA-256 is {given[:16]}, that of the fit {str(fitted)[:16]}"
            warn(f"{shape.name} is not the shape that the bounder was fitted to: {digests}")
    return found


# --- fit -------------------------------------------------------------------------------------------------------------


@command
def fit(
    shape: ShapeFile,
    output: Output,
    query: Annotated[Kind, Option(help="Kind of query.")] = "point",
    budget: Annotated[float, Option(help="Seconds for training and proof.")] = 60.0,
    seed: Seed = 0,
    margin: Margin = 0.0,
    force: Annotated[bool, Option("--force", help="Take a margin that is larger than the object, too.")] = False,
    resolution: Annotated[int | None, number_option("Cells along a mesh's longest axis, for methods of cells.")] = None,
    length: Length = None,
    side: Annotated[Literal["outside", "inside"], Option(help="inside: no is certainly in the object.")] = "outside",
    workload: Workload = None,
    samples: Samples = 10**6,
    balls: Annotated[int | None, number_option("Of a robot (.urdf): balls for all links, to .urdf or .yaml.")] = None,
    device: Device = "cpu",
    **rest: Any,
) -> tuple:
    """Fit a bounder to SHAPE, prove that it has no false negative, and save it.

    Ctrl-C ends training early; the best bounder so far is proven and saved.

    With --balls, SHAPE is a robot, and balls that hold its links are written, as URDF or as cuRobo's YAML.

    Example: warp-bounding fit bunny.obj --method mlp --hidden 24,24 --margin 0.03 -o bunny.safetensors
    """
    from warp_bounding.certificates.statement import NOT_CONSERVATIVE

    quiet_warp(device)
    given = {"query": query, "length": length, "margin": margin, "force": force, "resolution": resolution, "side": side}
    if balls is not None:
        return _fit_balls(shape, output, balls, seed, rest | given | {"workload": workload})
    if shape.suffix.lower() == ".urdf":
        raise BoundingError(f"{shape}: is a robot; --balls 60 writes balls that hold its links")
    arguments = arguments_of(rest | given | {"budget": budget, "seed": seed, "device": device})
    check_writable(output, shape, *([workload] if workload else []), suffix=BOUNDER)
    own, loaded = read_queries(workload), wb.load_shape(str(shape), **reading_of(rest))
    started = clock.perf_counter()
    bounder = wb.fit(loaded, workload=own, **arguments)
    seconds = clock.perf_counter() - started
    bounder.save(output)
    rates, training = wb.evaluate(bounder, loaded, samples=samples), bounder.info["training"]
    box, quick = bounder.info["rates"]["fp_rate_aabb"], bounder.info["rates"]["fp_rate"]
    if quick > box:
        longer = "; a longer budget makes it tighter" if "steps" in training else ""
        warn(f"looser than a box: {quick:.1f} % false positives, method aabb {box:.1f} %{longer}")
    found = about(bounder, output) | {name: getattr(rates, name) for name in ("fp_rate", "fn", "samples", "positives")}
    found |= {"fit_seconds": round(seconds, 3), "training": training, "note": bounder.info.get("note")}
    rate = f"{rates.fp_rate:.2f} % false positives, {rates.fn} false negatives in {rates.samples:,} samples"
    return (
        0,
        found | {"truth": rates.truth, "conservative": bounder.conservative},
        f"{bounder.method}: {rate}, {rates.reported_truth}",
        bounder.certificate.message if bounder.certificate else NOT_CONSERVATIVE,
        f"{seconds:.1f} s, {training['compile_seconds']:.1f} of them for compiling kernels; written to {output}",
    )


def _fit_balls(robot: Path, output: str, count: int, seed: int, others: Mapping[str, Any]) -> tuple:
    """What ``fit`` returns after it made balls of a robot; refuses ``others`` that differ from what they are unset."""
    from warp_bounding.pairs.robot_balls import checked_suffix

    known = inspect.signature(fit).parameters
    unset = {name: known[name].default if name in known else None for name in others}
    if unfit := [f"--{name.replace('_', '-')}" for name, value in others.items() if value != unset[name]]:
        raise BoundingError(f"balls of a robot take no {', '.join(unfit)}")
    check_writable(output, robot, suffix=checked_suffix(output))
    started = clock.perf_counter()
    found = wb.pairs.RobotBalls.of(robot, count, seed=seed)
    found.save(output)
    seconds, counts = clock.perf_counter() - started, {link: len(own) for link, own in found.links.items()}
    about_it = {"path": output, "shape": robot, "balls": counts, "proven": True, "fit_seconds": round(seconds, 3)}
    lines = [f"{link}: {number} balls" for link, number in counts.items()]
    total = f"{sum(counts.values())} balls hold the {len(counts)} links of {found.name}, proven"
    return 0, about_it, *lines, f"{total}; {seconds:.1f} s; written to {output}"


def _method_options() -> list[inspect.Parameter]:
    """The method, and a parameter for each option of a method, in a panel of those that take it."""
    known, takers = list(wb.METHODS | wb.DISTANCES), {}
    for method, cls in (*wb.METHODS.items(), *wb.DISTANCES.items()):
        for option in cls.options:
            takers.setdefault(option.name, {}).setdefault(method, option)
    which = f"{', '.join(known)}; or several, queried in this order, as in learned-kdop+mlp."
    which += " Without it mlp, and bvh for rays, planes and boxes."
    found = [_option("method", str, help=which, autocompletion=lambda: known)]
    for name, own in takers.items():
        whose = "distances" if len(own) > len(known) / 2 else "networks" if "mlp" in own else ", ".join(own)
        texts: dict[str, list[str]] = {}
        for method, option in own.items():
            default = ",".join(map(str, option.default)) if isinstance(option.default, tuple) else option.default
            shown = option.help + ("" if default is None or default is False else f" (default: {default})")
            texts.setdefault(shown, []).append(method)
        words = [text if len(texts) == 1 else f"{', '.join(names)}: {text}" for text, names in texts.items()]
        about_it = {"help": "; ".join(words), "rich_help_panel": f"Options of {whose}"}
        parse = next(iter(own.values())).parse
        flag = [f"--{name}"] if parse is bool else []  # without a --no-NAME
        found.append(_option(name, parse, *flag, **about_it))
    return found


NOT_PASSED = {"samples", "workload", "checkpoint", "jobs", "scheduler", *READING}  # on to ``fit`` and ``choose``


def arguments_of(given: Mapping[str, Any]) -> dict[str, Any]:
    """The values of options as keyword arguments of ``fit`` or ``choose``."""
    return {name: value for name, value in given.items() if value is not None and name not in NOT_PASSED}


# --- certify, evaluate, info, query ----------------------------------------------------------------------------------


def one_of(jobs: int | None, scheduler: str | None) -> int | str | None:
    """Where work is done: processes of this machine, or a scheduler's."""
    if jobs is not None and scheduler is not None:
        raise BoundingError("jobs is for workers of this machine, got --jobs and --scheduler")
    return scheduler if jobs is None else jobs


@command
def certify(
    file: BounderFile,
    shape: ShapeFile,
    budget: Annotated[float, Option(help="Seconds allowed.")] = 900.0,
    margin: Annotated[float | None, Option(help="Not proven unless FILE claims this margin.")] = None,
    length: Annotated[float | None, Option(help="Not proven unless FILE claims rays of this length.")] = None,
    resolution: Annotated[int | None, number_option("Not proven unless FILE claims this resolution.")] = None,
    query: Annotated[Kind | None, Option(help="Not proven unless FILE claims this kind of query.")] = None,
    checkpoint: Annotated[Text, Option(help="Go on from this file, and keep there what is left.")] = None,
    jobs: Annotated[int | None, number_option("Processes of this machine (default: this one).", count)] = None,
    scheduler: Annotated[Text, Option(help="Address of a Dask scheduler, such as tcp://host:8786.")] = None,
    srdf: Annotated[Path | None, Option(help="Of a plan: which links need no check.", **EXISTS)] = None,
    scene: Annotated[
        Text, Option(parser=words, help="Of a plan: scenes, meshes, distances: cell.scene,part.stl")
    ] = None,
    hold: Annotated[Text, Option(parser=values, help="Of a plan: joints that stand, finger=0.04.")] = None,
    pieces: Annotated[
        int | None, number_option("Of a plan: convex bodies of a link's mesh (default: 1).", count)
    ] = None,
    **reading: Text,
) -> tuple:
    """Prove from scratch that FILE has no false negative on SHAPE. Exit status 0: proven; 1: not.

    Of the balls of a pair: that they hold SHAPE. Of balls of a robot's links (.urdf, .yaml), whoever made them: that
    they hold the robot SHAPE (.urdf); else a point of each link is printed that none holds. Of a plan (.json): that the
    robot SHAPE (.urdf) touches nothing of the scenes, and not itself, all along.

    Margin, length of rays, resolution and kind of query are taken from FILE, and printed. Those that are stated here
    are compared with FILE's.

    Example: warp-bounding certify bunny.safetensors bunny.obj --margin 0.03
    """
    from warp_bounding.bounders.file_format import read
    from warp_bounding.bounders.load import BALLS

    expected = {"margin": margin, "length": length, "resolution": resolution, "query": query}
    searched = {"checkpoint": checkpoint, "jobs": jobs, "scheduler": scheduler}
    processes, of_plan = one_of(jobs, scheduler), {"srdf": srdf, "scene": scene, "hold": hold, "pieces": pieces}
    if file.suffix.lower() == ".json":
        given = expected | reading | searched | {"margin": None}
        if unfit := [f"--{name}" for name, value in given.items() if value is not None]:
            raise BoundingError(f"a plan is certified at once; leave out {', '.join(unfit)}")
        return _certify_plan(file, shape, margin, **of_plan)
    if unfit := [f"--{name}" for name, value in of_plan.items() if value is not None]:
        raise BoundingError(f"{file}: is no plan (.json); leave out {', '.join(unfit)}")
    if file.suffix.lower() in (".urdf", ".yaml", ".yml"):
        given = expected | reading | searched
        if unfit := [f"--{name}" for name, value in given.items() if value is not None]:
            raise BoundingError(f"balls of a robot are certified at once; leave out {', '.join(unfit)}")
        return _certify_balls(file, shape, budget)
    if read(file)[1].get("method") == BALLS:
        given = expected | searched
        if unfit := [f"--{name}" for name, value in given.items() if value is not None]:
            raise BoundingError(f"balls of a pair are certified at once; leave out {', '.join(unfit)}")
        found = wb.pairs.Balls.load(file).certify(wb.load_shape(str(shape), **reading_of(reading)), budget)
        known = {"path": file, "shape": shape, "proven": found.proven, "certificate": found.to_dict()}
        return 0 if found.proven else 1, known, f"{found.kind}: {found.message}"
    bounder, loaded = load_both(file, shape, "cpu", reading)
    with bar("certify") as update:
        run = {"budget": budget, "progress": update, "checkpoint": checkpoint, "scheduler": processes}
        found = wb.certify(bounder, loaded, **expected, **run)
    of_both = about(bounder, file, found, shape, found.indicator)
    if restricted := getattr(loaded, "restriction", ""):
        warn(f"warp-bounding: {loaded.name}: {restricted}")
    return (
        0 if found.proven else 1,
        of_both | {"proven": found.proven},
        f"{found.kind}: {found.message}",
        f"counterexample: {found.counterexample}" if found.counterexample else "",
        f"{found.boxes:,} boxes, {found.seconds:.2f} s",
    )


def _certify_plan(file: Path, robot: Path, margin, srdf, scene, hold, pieces) -> tuple:
    """What ``certify`` returns of a plan."""
    quiet_warp()
    plan, arm = wb.arms.Plan.load(file), wb.arms.load_urdf(robot, srdf=srdf, held=hold, pieces=pieces or 1)
    obstacles = [body for name in scene or () for body in _obstacles(name)]
    of_plan = {"attached": plan.attached, "self_collision": plan.self_collision, "margin": plan.margin}
    motions = wb.arms.Motions(arm, obstacles, **of_plan)
    if motions.digest != plan.digest or margin not in (None, plan.margin):
        other = "margin" if motions.digest == plan.digest else "robot, scene or SRDF"
        kind, line = "inapplicable", f"the plan is of another {other}; pieces and joints that stand count, too"
    else:
        plan = motions.path(plan.waypoints)
        kind, line = "proven" if plan.proven else "undecided", plan.statement
    known = {"path": file, "shape": robot, "proven": kind == "proven", "kind": kind, "statement": line}
    return 0 if kind == "proven" else 1, known, f"{kind}: {line}"


def _obstacles(name: str) -> list:
    """What a file of a plan's scene holds."""
    suffix = Path(name).suffix.lower()
    if suffix in (".scene", ".yaml", ".yml"):
        return wb.arms.load_scene(name)
    if suffix != BOUNDER:
        return [wb.arms.Scan.of_mesh(wb.load_shape(name))]
    if not hasattr(bounder := wb.load(name, device="cpu"), "field"):
        raise BoundingError(f"{name}: expected a distance-grid, got {bounder.method}")
    return [bounder.field()]


def _certify_balls(file: Path, robot: Path, budget: float) -> tuple:
    """What ``certify`` returns of balls of a robot."""
    quiet_warp()
    balls = wb.pairs.RobotBalls.load(file)
    found = balls.certify(robot, budget=budget)
    if strange := balls.links.keys() - found.keys():
        warn(f"not links of {robot.name} with collision geometry, and left out: {', '.join(sorted(strange))}")
    bare = {link: held for link, held in found.items() if not held.proven}
    kind = "refuted" if any(held.kind == "refuted" for held in bare.values()) else "undecided" if bare else "proven"
    told = {link: vars(held) | {"proven": held.proven} for link, held in found.items()}
    for held in told.values():  # JSON has no infinity
        held |= {name: None for name in ("outside", "growth") if held[name] == float("inf")}
    return (
        1 if bare else 0,
        {"path": file, "shape": robot, "proven": not bare, "kind": kind, "links": told},
        *(f"{link}: {held}" for link, held in found.items()),
        f"{kind}: {len(found) - len(bare)} of {len(found)} links of {robot.name} are held by their balls",
    )


@command
def evaluate(
    file: BounderFile,
    shape: ShapeFile,
    samples: Samples = 10**6,
    seed: Annotated[int | None, number_option("Random seed (default: 1; a fresh one for --stress).")] = None,
    radius: Annotated[float | None, Option(help="Of a distance: points within it are positive (default: 0).")] = None,
    query: Annotated[Literal["point", "ray", "box"] | None, Option(help="Of a distance: what it is asked.")] = None,
    length: Annotated[float | None, Option(help="Of a distance that is asked rays: theirs (default: 1).")] = None,
    stress: Annotated[int | None, number_option("Ask so many hard positives instead, such as 1e8.", count)] = None,
    device: Device = "cpu",
    **reading: Text,
) -> tuple:
    """Measure FILE on SHAPE: rates are per cent of all samples. Exit status 1 if a false negative was found.

    With --stress, hard positives are asked as FILE is deployed: positives by construction, near the object's boundary
    (grazing rays, touching boxes, tangent planes, points on faces and corners of cells), in float32, in float64, and of
    the shape placed in the world. None may be missed. That proves nothing; it is there to contradict a proof. Ctrl-C
    ends it and says what was done until then.

    Example: warp-bounding evaluate bunny.safetensors bunny.obj --samples 1e7
    """
    bounder, loaded = load_both(file, shape, device, reading)
    if stress is not None:
        return _stress(file, shape, bounder, loaded, stress, seed)
    of_distance = {"radius": radius, "query": query, "length": length}
    with bar("evaluate") as update:
        seed = 1 if seed is None else seed
        rates = wb.evaluate(bounder, loaded, samples, seed=seed, progress=update, **of_distance)
    of_both = about(bounder, file, None, shape, rates.indicator)
    text = f"{bounder.method}: {rates.fp_rate:.3f} % false positives, {rates.fn} false negatives"
    where = f"{rates.samples:,} samples, {rates.reported_truth}"
    line = f"{text}, {rates.positives:.3f} % positives in {where}"
    return 0 if rates.fn == 0 else 1, of_both | rates.to_dict(), line


def _stress(file: Path, shape: Path, bounder, loaded, wanted: int, seed: int | None) -> tuple:
    """What ``evaluate`` returns after it asked hard positives."""
    with bar("stress") as update:
        found = wb.proof.stress_test(bounder, loaded, wanted, seed=seed, progress=update)
    of_both, ended = about(bounder, file, None, shape, found.indicator), "interrupted: " if found.interrupted else ""
    asked = f"{ended}{found.done:,} hard positive {found.query} queries, {found.wanted:,} wanted"
    verdict = "none missed"
    if found.missed is not None:
        place = f", the shape placed by {found.missed_world}" if found.missed_world else ""
        region = f"the {found.query} {found.missed} ({found.missed_form}{place})"
        verdict = f"FALSE NEGATIVE: {region} meets the shape and is answered with no"
    line = f"{verdict}; {asked}; --seed {found.seed}; {found.seconds:.1f} s"
    return 0 if found.missed is None else 1, of_both | vars(found), line


@command
def info(file: BounderFile) -> tuple:
    """Describe FILE: method, sizes, what is proven and what is not. Exit status 1 if it holds no proof.

    Example: warp-bounding info bunny.safetensors
    """
    from warp_bounding.bounders.voxels import Voxels
    from warp_bounding.certificates.statement import statement
    from warp_bounding.shapes.complement import SIDES

    quiet_warp()
    bounder = wb.load(file, device="cpu")
    certificate, words, domain = bounder.certificate, statement(bounder), bounder.domain
    kept = ("name", "indicator", "grid_shape", "margin", "resolution", "seed", "note", "library", "training", "rates")
    found = about(bounder, file) | {"dimension": bounder.ndim, "conservative": bounder.conservative}
    found |= {"side": SIDES[domain.unbounded], "length": domain.length, "threshold": float(bounder.threshold)}
    found |= {} if isinstance(bounder, Voxels) else bounder.sizes
    found |= {name: bounder.info.get(name) for name in kept} | {"statement": words}
    sizes = ", ".join(f"{key} {value}" for key, value in bounder.sizes.items())
    sizes = textwrap.shorten(sizes, 90, placeholder=" ...")
    rows = {"method": words["method"], "sizes": sizes, "tightness": bounder.tightness} | words
    rows |= {} if certificate else {"threshold": f"{float(bounder.threshold):.9g}"}
    indent = 2 + max(map(len, rows))
    lines = (f"{key:{indent}}{value}" for key, value in rows.items() if value)
    wrapped = {"width": READABLE, "subsequent_indent": " " * indent, "break_on_hyphens": False}
    return 0 if certificate and certificate.proven else 1, found, *(textwrap.fill(line, **wrapped) for line in lines)


@command
def query(
    file: BounderFile,
    points: Annotated[Path, Argument(metavar="POINTS.npy", help="(N, m) numbers: queries of FILE's kind.", **EXISTS)],
    output: Annotated[str, Option("--output", "-o", help="File to write (.npy): 1 maybe, 0 no.")],
    device: Device = "cpu",
) -> tuple:
    """Ask FILE about every row of POINTS.npy, in object space, and write the answers.

    Example: warp-bounding query bunny.safetensors points.npy -o mask.npy
    """
    import numpy as np

    quiet_warp(device)
    check_writable(output, file, points, suffix=".npy")
    bounder, queries = wb.load(file, device=device), read_queries(points)
    started = clock.perf_counter()
    try:
        mask = bounder.query(queries).numpy()
    except QueryError as error:
        raise QueryError(f"{points}: {error}") from error
    seconds, content, maybe = clock.perf_counter() - started, io.BytesIO(), int(mask.sum())
    np.save(content, mask)
    write_whole(output, content.getvalue(), ".npy")
    found = about(bounder, file) | {"points": points, "output": output}
    found |= {"count": len(mask), "maybe": maybe, "seconds": round(seconds, 6)}
    share = f" ({100 * maybe / len(mask):.2f} %)" if len(mask) else ""
    asked = f"{len(mask):,} {bounder.query_kind} queries"
    return 0, found, f"{bounder.method}: maybe for {maybe:,} of {asked}{share}; written to {output}"


@command
def export(
    file: BounderFile,
    output: Annotated[str, Option("--output", "-o", help="Header to write (.h).")],
    name: Annotated[str | None, Option(help="What functions begin with; by default the header's name.")] = None,
) -> tuple:
    """Write FILE as a header for C, C++ and CUDA, which answers single queries without this library.

    Example: warp-bounding export bunny.safetensors -o bunny.h
    """
    quiet_warp()
    bounder = wb.load(file, device="cpu")
    bounder.export(output, name)
    return 0, about(bounder, file) | {"output": output}, f"{bounder.method}, {bounder.summary}: written to {output}"


# --- choose ----------------------------------------------------------------------------------------------------------

NARROW = "Nanoseconds of your exact test for one query; or two, for one that is denied and one that is left: 100,900."


@command
def choose(
    shape: ShapeFile,
    output: Output,
    narrow_ns: Annotated[str, Option(parser=prices, help=NARROW)],
    query: Annotated[Kind, Option(help="Kind of query, but distance.")] = "point",
    workload: Workload = None,
    memory: Annotated[int | None, number_option("Most bytes that a query may read, such as 16e3.", count)] = None,
    margin: Margin = 0.0,
    length: Length = None,
    overhead_ns: Annotated[float, Option(help="What your step takes besides for a query, nanoseconds.")] = 0.0,
    how: Annotated[str, Option(help="Time bounders in a batch, or as a function in a kernel.")] = "batch",
    budget: Annotated[float, Option(help="Seconds for all fits.")] = 120.0,
    seed: Seed = 0,
    methods: Annotated[Text, Option(parser=words, help="Such as bvh,mlp,relu-field (default: all).")] = None,
    statistical: Annotated[bool, Option("--statistical", help="Choose among sampled bounders, too.")] = False,
    checkpoint: Annotated[Text, Option(help="Folder of candidates, to go on (default: OUTPUT with .choice).")] = None,
    device: Device = "cpu",
    **reading: Text,
) -> tuple:
    """Choose a broad phase for SHAPE: fit candidates of every method, measure them, save the one that costs the least.

    A bounder saves what your exact test takes for the queries that it denies, less its time. The answer may be that
    none pays; then nothing is written. A plot of cost against the narrow phase's price is written next to the output
    (.png). What the budget has no room for is listed.
    Ctrl-C ends fitting, and what is there is compared; the same command goes on where a killed one stopped.

    Example: warp-bounding choose bunny.obj --narrow-ns 600 --memory 16e3 --workload points.npy -o chosen.safetensors
    """
    from warp_bounding.choice import cost_plot, duration

    quiet_warp(device)
    given = {"query": query, "narrow_ns": narrow_ns, "length": length, "overhead_ns": overhead_ns, "margin": margin}
    given |= {"memory": memory, "budget": budget, "seed": seed, "device": device, "statistical": statistical}
    arguments = arguments_of(given | {"methods": methods, "how": how})
    picture = str(Path(output).with_suffix(".png"))
    for path, suffix in ((output, BOUNDER), (picture, ".png")):
        check_writable(path, shape, *([workload] if workload else []), suffix=suffix)
    own, loaded = read_queries(workload), wb.load_shape(str(shape), **reading_of(reading))
    kept = Path(output).with_suffix(".choice") if checkpoint is None else Path(checkpoint)
    choice = wb.choose(loaded, workload=own, checkpoint=kept, **arguments)
    if choice.bounder is not None:
        choice.bounder.save(output)
    write_whole(picture, cost_plot(choice), ".png")
    status = 1 if choice.about["interrupted"] else 0
    found = choice.to_dict() | {"path": output if choice.bounder is not None else None, "plot": picture}
    found["rows"] = [{k: None if v != v else v for k, v in row.items()} for row in found["rows"]]  # JSON has no NaN
    whose = "Your" if workload else "Random (--workload x.npy asks those of your simulation)"
    done = f"written to {output} and {picture}" if choice.bounder is not None else f"no bounder is written; {picture}"
    return (
        status,
        found,
        f"{whose} queries",
        *str(choice).splitlines(),
        choice.why + ".",
        f"Best by the narrow phase's price: {'; '.join(f'{s.label} from {duration(s.price)}' for s in choice.prices)}",
        "Interrupted: some candidates were not fitted; the same command goes on." if status else "",
        f"{choice.about['seconds']:.0f} s of fits and measurements, of a budget of {budget:g}; "
        f"{choice.about['compile_seconds']:.0f} s besides for compiling and loading kernels",
        f"{done}; candidates are kept in {kept}, for another choice, and can be deleted",
    )


# --- bake ------------------------------------------------------------------------------------------------------------


@command
def bake(
    folder: Annotated[Path, Argument(metavar="FOLDER", help="Folder with shapes, in folders inside it too.")],
    output: Annotated[str, Option("--output", "-o", help="Folder for bounders and manifest.")],
    jobs: Annotated[int | None, number_option("Worker processes of this machine (default: one a core).", count)] = None,
    scheduler: Annotated[Text, Option(help="Address of a Dask scheduler, such as tcp://host:8786.")] = None,
    **given: Any,
) -> tuple:
    """Fit a bounder to each shape of FOLDER, on many processes; with --narrow-ns choose one for each.

    What is there is not done again: after whatever ended a bake the same command goes on. A shape that cannot be read
    or bounded is a row of the manifest with an error. Exit status 1: some failed.

    Example: warp-bounding bake meshes --output bounders --method mlp --hidden 24,24 --budget 20 --margin 0.01
    """
    from warp_bounding.baking import MANIFEST

    quiet_warp(given["device"])
    one_of(jobs, scheduler)
    queries, choosing = given["workload"], given["narrow_ns"] is not None
    read_queries(queries)  # a file that holds none is told before
    own, options = inspect.signature(choose if choosing else fit).parameters, _bake_options()
    passed = {name: value for name, value in given.items() if name in own or value != options[name].default}
    passed = arguments_of(passed) | {"reading": reading_of(given), "workload": queries, "samples": given["samples"]}
    done = wb.baking.bake(folder, output, jobs=jobs, scheduler=scheduler, **passed)
    for record in (record for record in done.records if record.error):
        warn(f"{record.source}: {record.error}")
    proven = sum(record.certificate == "proven" for record in done.records)
    shapes, manifest = len(done.records), Path(output) / MANIFEST
    found = {name: getattr(done, name) for name in ("baked", "kept", "failed", "foreign")}
    found |= {name: round(getattr(done, name), 3) for name in ("seconds", "task_seconds")}
    found |= {"shapes": shapes, "proven": proven, "out": output, "manifest": manifest}
    kept = f", {done.kept:,} were there already" if done.kept else ""
    others = f"; {done.foreign:,} other files" if done.foreign else ""
    return (
        1 if done.failed else 0,
        found,
        f"{shapes:,} shapes: {done.baked:,} baked{kept}, {done.failed:,} failed; {proven:,} proven{others}",
        f"{done.seconds:.1f} s, {done.task_seconds:.1f} s of work; {manifest}",
    )


def _bake_options() -> dict[str, inspect.Parameter]:
    """All options of ``fit``, with fewer samples, and those of ``choose``, none of which must be given."""
    from warp_bounding.baking import SAMPLES

    own = ("shape", "output", "checkpoint", "json", "balls")
    parameters = (inspect.signature(choose).parameters | inspect.signature(fit).parameters).items()
    found = {name: p.replace(kind=KEYWORD) for name, p in parameters if name not in own}
    found["narrow_ns"] = _option("narrow_ns", prices, help=f"Choose instead. {NARROW}")
    return found | {"samples": found["samples"].replace(default=SAMPLES)}


# --- show ------------------------------------------------------------------------------------------------------------


@command
def show(
    file: BounderFile,
    shape: ShapeFile,
    html: Annotated[Text, Option(metavar="FILE.html", help="Write the web page there, and open no browser.")] = None,
    radius: Annotated[Text, Option(parser=numbers, help="Of a distance: such as 0,0.05,0.1; object units.")] = None,
    time: Annotated[Text, Option(parser=numbers, help="Of a shape that moves: a time, or several: 0,0.5,1.")] = None,
    held: Annotated[Text, Option("--slice", parser=coordinates, metavar="K=VALUE", help="Hold coordinates.")] = None,
    up: Annotated[Axis, Option(help="The axis that is up.")] = "y",
    resolution: Annotated[
        int | None, number_option("Cells along the longest side (80), or pixels in 2D (640).", count)
    ] = None,
    device: Device = "cpu",
    **reading: Text,
) -> tuple:
    """Show where FILE says maybe around SHAPE.

    Without --html the web page opens in the browser. A distance is shown at several radii, a shape that
    moves at several times; more than three coordinates need --slice.

    Example: warp-bounding show bunny.safetensors bunny.obj --html bunny.html
    """
    from warp_bounding.views import needed, page, view_of

    opened = html is None
    if opened:
        html = os.path.join(tempfile.mkdtemp(), f"{file.stem}.html")
    elif Path(html).suffix.lower() != ".html":
        raise BoundingError(f"{html}: expected a name that ends with .html")
    check_writable(html, file, shape)
    for package in ("pyvista", "plotly"):
        needed(package)
    bounder, loaded = load_both(file, shape, device, reading)
    with bar("show") as update:
        given = {"radii": radius or (), "times": time or (), "held": held, "resolution": resolution}
        view = view_of(bounder, loaded, progress=update, **given)
    write_whole(html, page(view, view.title, up).encode(), ".html")
    if opened and not webbrowser.open(Path(html).as_uri()):
        warn("there is no browser here that could open the page")
    return 0, about(bounder, file, None, shape, view.indicator) | {"html": html}, f"written to {html}"
