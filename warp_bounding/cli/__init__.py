"""The command ``warp-bounding``: one file a command.

Every command takes ``--json``: one JSON object on standard output and nothing else there; progress goes to standard error.
Exit status: 0; 1 where something is not proven or was interrupted; 2 for bad usage or bad input, with one clear line.
"""

import sys

from warp_bounding.errors import BoundingError

__all__ = ["app", "main"]


def _app():
    import typer

    from warp_bounding.cli import certify, demo, evaluate, fit, info

    app = typer.Typer(
        name="warp-bounding",
        help="Proven, tight, fast bounding volumes: fit one, prove it, measure it, see it at work.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
    )
    for command in (fit, certify, evaluate, info, demo):
        app.command(name=command.__name__.rpartition(".")[2])(command.command)

    @app.callback()
    def common() -> None:
        """Proven, tight, fast bounding volumes: fit one, prove it, measure it, see it at work."""

    return app


def __getattr__(name: str):
    if name == "app":
        return _app()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its status."""
    import typer

    usage_error = typer.BadParameter.__base__  # the parser's UsageError, wherever typer takes its parser from
    try:
        status = _app()(args=arguments, standalone_mode=False)
        sys.exit(status if isinstance(status, int) else 0)
    except usage_error as error:
        if not error.format_message():  # the help was asked for by giving no command
            sys.exit(2)
        context = getattr(error, "ctx", None)
        where = context.command_path if context else "warp-bounding"
        _fail(f"{error.format_message()} (see '{where} --help')")
    except typer.Exit as error:
        sys.exit(error.exit_code)
    except (typer.Abort, KeyboardInterrupt):
        print("interrupted", file=sys.stderr)
        sys.exit(1)
    except BoundingError as error:
        _fail(str(error))


def _fail(message: str) -> None:
    print(f"warp-bounding: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(2)
