"""Lines of a CSV file that hold one dataclass each: written, and read back with a clear word for what is wrong."""

import csv
import io
import math
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

from warp_bounding.errors import FileFormatError

__all__ = ["Lines", "number", "optional", "share", "whole"]

Reader = Callable[[str], Any]


def whole(text: str) -> int:
    """A number of at least 0 without a fraction."""
    if not text.isdecimal():
        raise ValueError(f"{text!r} is not a whole number")
    return int(text)


def number(text: str) -> float:
    """Any finite number."""
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text!r} is not a finite number")
    return value


def share(text: str) -> float:
    """A finite number of at least 0."""
    value = float(text)
    if not (math.isfinite(value) and value >= 0):
        raise ValueError(f"{text!r} is not a number of at least 0")
    return value


def optional(read: Reader) -> Reader:
    """The same, or ``None`` for nothing."""
    return lambda text: read(text) if text else None


class Lines:
    """How a dataclass stands in a line.

    Attributes:
        fields: Names, in order.
        header: First line of the file, its end included.
    """

    def __init__(self, kind: type, readers: Mapping[str, Reader]):
        self._kind, self._readers = kind, readers
        self.fields = tuple(f.name for f in fields(kind))
        self.header = ",".join(self.fields) + "\n"

    def format(self, row: Any) -> str:
        """The line of a row, its end included."""
        text = io.StringIO()
        values = ("" if (v := getattr(row, name)) is None else v for name in self.fields)
        csv.writer(text, lineterminator="\n").writerow(values)
        return text.getvalue()

    def parse(self, line: str) -> Any:
        """Inverse of ``format``.

        Raises:
            FileFormatError: With what is wrong with it, if it is not such a line.
        """
        try:
            (cells,) = csv.reader([line], strict=True)
        except (csv.Error, ValueError) as error:
            raise FileFormatError(str(error) or "not a line of a table") from None
        if len(cells) != len(self.fields):
            raise FileFormatError(f"{len(cells)} fields instead of {len(self.fields)}")
        values = {}
        for name, text in zip(self.fields, cells, strict=True):
            try:
                values[name] = self._readers.get(name, str)(text)
            except ValueError as error:
                raise FileFormatError(f"{name}: {error}") from None
        return self._kind(**values)
