"""How commands print: text on standard output, progress on standard error, or JSON for programs (``--json``)."""

import contextlib
import json
import warnings
from collections.abc import Iterator
from typing import Any

from rich.console import Console

from warp_bounding.bounders import Bounder, Certificate
from warp_bounding.errors import BoundingWarning
from warp_bounding.runtime import quiet
from warp_bounding.runtime.devices import device_of
from warp_bounding.runtime.progress import bar

__all__ = ["bar", "certificate_summary", "console", "other_shape", "print_json", "quiet_warp", "told_warnings", "warn"]


def console(as_json: bool) -> Console:
    """Where text for people goes: standard output, or standard error where that belongs to JSON."""
    return Console(stderr=as_json, highlight=False, soft_wrap=True, markup=False, emoji=False)


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
    quiet.quiet_warp()
    if device is not None:
        device_of(device)


def other_shape(name: str, given: str | None, fitted: str | None) -> str:
    """What to print first where the shape is not that of the fit."""
    about = f"its cells have SHA-256 {(given or 'unknown')[:16]}, those of the fit {(fitted or 'unknown')[:16]}"
    return f"{name} is not the shape that the bounder was fitted to: {about}. What follows is about {name}."


def certificate_summary(bounder: Bounder, certificate: Certificate | None) -> dict[str, Any] | None:
    """A certificate for ``--json``; ``None`` where there is none."""
    return certificate and certificate.to_dict() | {"proven": certificate.proven, "method": bounder.method}
