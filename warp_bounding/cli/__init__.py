"""The command ``warp-bounding``: one file a command. ``main`` also runs the command lines of ``paper/`` and ``sims/``.

Every command takes ``--json``: one JSON object on standard output and nothing else there; progress goes to standard
error. Exit status: 0; 1 where something is not proven or was interrupted; 2 for bad usage or bad input, with one clear
line.
"""

import os
import sys
from collections.abc import Callable, Iterable
from typing import Annotated, Any

from warp_bounding.errors import BoundingError
from warp_bounding.version import __version__

__all__ = ["app", "app_of", "main"]

# What was a command once, and what does it now, in a clone of the repository.
MOVED = {"demo": "python -m sims"} | {
    name: f"python -m paper {name}" for name in ("table1", "recipes", "speed", "proofs", "figures")
}


def _app():
    import typer

    from warp_bounding.cli import bake, certify, choose, evaluate, fit, info, query, show, soak

    fit.state_options()
    bake.state_options()
    about = "Proven, tight, fast bounding volumes: fit one, prove it, measure it, see it at work."
    app = app_of("warp-bounding", about, (fit, choose, bake, query, certify, soak, evaluate, info, show))

    def tell(wanted: bool) -> None:
        if wanted:
            print(f"warp-bounding {__version__}")
            raise typer.Exit

    version = typer.Option("--version", callback=tell, is_eager=True, help="Print the version and end.")

    @app.callback()
    def common(version: Annotated[bool, version] = False) -> None:
        """Proven, tight, fast bounding volumes: fit one, prove it, measure it, see it at work."""

    return app


def app_of(name: str, about: str, modules: Iterable[Any]):
    """A command line with the ``command`` of each module, under the last part of the module's name."""
    import typer

    told = {"add_completion": False, "pretty_exceptions_enable": False}
    app = typer.Typer(name=name, help=about, no_args_is_help=True, **told)
    for module in modules:
        own, command = module.__name__.rpartition(".")[2], module.command
        app.command(name=own, cls=getattr(module, "Help", None), help=_paragraphs(command.__doc__))(command)
    return app


def _paragraphs(text: str) -> str:
    """A docstring with one line a paragraph, which any terminal can break where it has to."""
    return "\n\n".join(" ".join(part.split()) for part in text.split("\n\n"))


def __getattr__(name: str):
    if name == "app":
        return _app()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


INTERRUPTED = 130  # what the parser makes of Ctrl-C


def main(
    arguments: list[str] | None = None, program: str = "warp-bounding", app_of_it: Callable[[], Any] = _app
) -> None:
    """Run a command line and exit with its status.

    Args:
        arguments: Those of this process if ``None``.
        program: What an error's line begins with.
        app_of_it: Makes the command line.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by who started this, as in ``>&-``
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 (until the process ends)
    try:
        from warp_bounding.cli.output import told_warnings  # a second of imports, which Ctrl-C may end too

        with told_warnings():
            status = _run(arguments, program, app_of_it)
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
        status = 1
    sys.exit(status)


def _wrong_value(error: Exception) -> str | None:
    """What is wrong with a value that the parser has refused as no number, with the value; ``None`` of other errors."""
    refused = getattr(error.__cause__, "errors", None)  # of a parser that validates by types
    if refused is None or getattr(error, "param", None) is None:
        return None
    first = refused()[0]
    wanted = {"float": "a number", "int": "a whole number"}.get(first["type"].partition("_")[0])
    return wanted and f"{error.param.opts[0]} must be {wanted}, got {first['input']!r}"


def _run(arguments: list[str], program: str, app_of_it: Callable[[], Any]) -> int:
    """Exit status of a command; an error of the parser becomes an error of ours."""
    import typer

    if app_of_it is _app and arguments and arguments[0] in MOVED:
        raise BoundingError(
            f"{arguments[0]} is no command any more; in a clone of the repository: {MOVED[arguments[0]]}"
        )

    usage_error = typer.BadParameter.__base__  # the parser's UsageError, wherever typer takes its parser from
    try:
        status = app_of_it()(args=arguments, prog_name=program, standalone_mode=False)
        return status if isinstance(status, int) else 0
    except usage_error as error:
        if not error.format_message():  # no command: the help has been printed
            return 2
        context = getattr(error, "ctx", None)
        where = context.command_path if context else program
        raise BoundingError(
            f"{_wrong_value(error) or error.format_message().rstrip('.')} (see '{where} --help')"
        ) from error
    except typer.Exit as error:
        return error.exit_code
    except typer.Abort:
        return INTERRUPTED
