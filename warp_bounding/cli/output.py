"""How commands print: text on standard output, progress on standard error, or JSON for programs (``--json``)."""

import contextlib
import json
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

from warp_bounding.bounders import Bounder, Certificate
from warp_bounding.errors import BoundingWarning
from warp_bounding.runtime import progress
from warp_bounding.runtime.launch import device_of
from warp_bounding.runtime.progress import bar

__all__ = [
    "bar",
    "certificate_summary",
    "console",
    "other_shape",
    "print_json",
    "print_table",
    "quiet_warp",
    "told_warnings",
    "warn",
]

WIDEST, NARROWEST = (
    10_000,
    12,
)  # characters: more than any table has, and fewer than which a column of words does not get


def console(as_json: bool) -> Console:
    """Where text for people goes: standard output, or standard error where that belongs to JSON."""
    return Console(stderr=as_json, highlight=False, soft_wrap=True, markup=False, emoji=False)


def print_table(out: Console, table: Table, wrapped: Sequence[str]) -> None:
    """Print a table whose columns of numbers are never cut off: at its natural width where that fits, or no terminal looks.

    Else the other columns wrap, down to ``NARROWEST`` characters; a terminal that is narrower than that cuts lines in two.

    Args:
        out: Where.
        table: All its columns but the wrapped ones hold numbers.
        wrapped: Headers of the columns that may wrap.
    """
    any_width, width = out.options.update(max_width=WIDEST), out.width
    natural = Measurement.get(out, any_width, table).maximum
    if out.is_terminal and natural > width:
        for column in table.columns:
            words = column.header in wrapped
            column.no_wrap, column.overflow, column.min_width = not words, "fold", NARROWEST if words else None
        natural = max(width, Measurement.get(out, any_width, table).minimum)
    out.width = natural  # a table is never printed wider than that
    out.print(table, crop=False)
    out.width = width


def warn(text: str) -> None:
    """Print one yellow line on standard error, about something that is no error."""
    console(True).print(" ".join(text.split()), style="yellow")


@contextlib.contextmanager
def told_warnings() -> Iterator[None]:
    """Print each of the library's own warnings by ``warn``, once; all others are shown as before."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", BoundingWarning)
        others, told = warnings.showwarning, set()

        def tell(message, category, *where, **more) -> None:
            if issubclass(category, BoundingWarning):
                if str(message) not in told:
                    warn(f"warp-bounding: {message}")
                told.add(str(message))
            else:
                others(message, category, *where, **more)

        warnings.showwarning = tell
        yield


def print_json(value: dict[str, Any]) -> None:
    """One JSON object on standard output."""
    print(json.dumps(value, allow_nan=False))


def quiet_warp(device: str | None = None) -> None:
    """Keep Warp's own messages off standard output, and check the device.

    Raises:
        DeviceError: If there is no such device.
    """
    progress.quiet_warp()
    if device is not None:
        device_of(device)


def other_shape(name: str, given: str | None, fitted: str | None) -> str:
    """What to print first where the shape is not that of the fit."""
    about = f"its SHA-256 is {(given or 'unknown')[:16]}, that of the fit {(fitted or 'unknown')[:16]}"
    return f"{name} is not the shape that the bounder was fitted to: {about}. What follows is about {name}."


def certificate_summary(bounder: Bounder, certificate: Certificate | None) -> dict[str, Any] | None:
    """A certificate for ``--json``; ``None`` where there is none."""
    return certificate and certificate.to_dict() | {"proven": certificate.proven, "method": bounder.method}
