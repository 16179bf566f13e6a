"""The manifest: one row a shape in a CSV file, made of the records, so that it can be made anew whenever it is in doubt."""

import csv
import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from warp_bounding.baking.record import Record
from warp_bounding.runtime.whole_file import FileKind, write_whole

__all__ = ["COLUMNS", "MANIFEST", "read_manifest", "write_manifest"]

MANIFEST = "manifest.csv"
MANIFEST_FILE = FileKind(".csv", 0, b"name")
# What a row has, and how it is read back.
COLUMNS = {
    "name": str,
    "source": str,
    "hash": str,
    "settings": str,
    "file": str,
    "method": str,
    "query": str,
    "bytes": int,
    "certificate": str,
    "fp_rate": lambda text: float(text) if text else None,
    "seconds": float,
    "error": str,
    "note": str,
}


def write_manifest(folder: Path, records: Iterable[Record]) -> None:
    """Write the rows of all records, by source and settings, whole or not at all.

    Raises:
        FileFormatError: If the file cannot be written.
    """
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for record in sorted(records, key=lambda r: (r.source, r.settings, r.hash)):
        writer.writerow(["" if (value := getattr(record, name)) is None else value for name in COLUMNS])
    write_whole(folder / MANIFEST, text.getvalue().encode(), MANIFEST_FILE)


def read_manifest(folder: Path) -> list[dict[str, Any]]:
    """The rows, as they are typed in ``COLUMNS``; none where there is no manifest.

    Raises:
        OSError: If it cannot be read.
        ValueError: If it holds something else.
    """
    path = folder / MANIFEST
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        rows = csv.DictReader(file)
        if rows.fieldnames != list(COLUMNS):
            raise ValueError(f"expected the columns {', '.join(COLUMNS)}, got {', '.join(rows.fieldnames or ['none'])}")
        return [{name: read(row[name]) for name, read in COLUMNS.items()} for row in rows]
