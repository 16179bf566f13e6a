"""Options that several commands have, and what they mean."""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from warp_bounding.errors import IndicatorError, QueryError

__all__ = [
    "BounderFile",
    "Device",
    "Hollow",
    "Json",
    "Origin",
    "Queries",
    "Spacing",
    "Threshold",
    "Unknown",
    "read_queries",
    "read_shape",
    "shape_arguments",
    "whole_number",
]

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output, and nothing else there.")]
Device = Annotated[str, typer.Option(help="Warp device: cpu, cuda:0, ...")]
BounderFile = Annotated[str, typer.Argument(metavar="FILE", help="A bounder that `fit` wrote (.safetensors).")]
Threshold = Annotated[
    str | None, typer.Option(help="Which values of an array, or grey values of an image, are occupied: '<128', '<=0'.")
]
Spacing = Annotated[
    str | None,
    typer.Option(help="Size of an array's or image's cells, one or one for each axis: 0.05 or 0.1,0.05; rows first."),
]
Origin = Annotated[
    str | None, typer.Option(help="Where the centre of an array's or image's first cell is: -12.5,3; rows first.")
]
Unknown = Annotated[
    str | None,
    typer.Option(help="Of a map, what cells are that nobody has seen: occupied or free (default: occupied)."),
]
Hollow = Annotated[
    str | None,
    typer.Option(help="What air is that a shape encloses: filled, inside, or empty (default: a mesh's is filled)."),
]

Queries = Annotated[
    str | None,
    typer.Option(help="A .npy file, (Q, m), of queries as your simulation asks them: where false positives count."),
]


def read_shape(path: str, *said: str | None):
    """``load_indicator`` of what a command line says, as ``shape_arguments`` takes it.

    Raises:
        IndicatorError: In one line, for whatever cannot be read.
    """
    from warp_bounding.indicators import load_indicator

    return load_indicator(path, **shape_arguments(*said))


def shape_arguments(
    threshold: str | None,
    spacing: str | None,
    origin: str | None,
    unknown: str | None = None,
    hollow: str | None = None,
) -> dict[str, Any]:
    """What a command line says of a shape, as keyword arguments of ``load_indicator``; those that it does not say are left out.

    Raises:
        IndicatorError: For words where numbers are expected.
    """
    sizes = None if spacing is None else _numbers("spacing", spacing)
    said = {
        "threshold": threshold,
        "spacing": sizes[0] if sizes and len(sizes) == 1 else sizes,
        "origin": None if origin is None else _numbers("origin", origin),
        "unknown": unknown,
        "hollow": hollow,
    }
    return {name: value for name, value in said.items() if value is not None}


def read_queries(path: str) -> np.ndarray:
    """A ``.npy`` array of queries; see ``Bounder.query`` for what must be in it.

    Raises:
        QueryError: If there is no such file, or it holds something else.
    """
    from warp_bounding.indicators.formats.reading import reading

    if not Path(path).is_file():
        raise QueryError(f"{path}: {'a folder, expected a file' if Path(path).is_dir() else 'no such file'}")
    with reading(path, "a NumPy .npy array of queries"), open(path, "rb") as file:
        return np.lib.format.read_array(file, allow_pickle=False)


def _numbers(name: str, text: str) -> list[float]:
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise IndicatorError(f"{name} must be numbers such as 0.05 or 0.1,0.05, got {text!r}") from None


MOST = 10**15  # the largest count that is accepted; so many queries would take years


def whole_number(name: str, text: str) -> int:
    """A count that may be written as 1e8.

    Raises:
        QueryError: If the text is no such count.
    """
    try:
        value = float(text)
        if value == int(value) and 1 <= value <= MOST:
            return int(value)
    except (ValueError, OverflowError):
        pass
    raise QueryError(f"{name} must be a whole number from 1 to {MOST:.0e}, such as 1e6, got {text!r}")
