"""Rows of a benchmark, a line of JSON each, written as they are known: run again, it goes on where it stopped."""

import json
import math
import os
from pathlib import Path
from typing import Any

from paper.run import versions
from warp_bounding.runtime.launch import cpu_threads

__all__ = ["KeptRows"]


class KeptRows:
    """A folder with rows, and a page that is made of them.

    Args:
        folder: Where; made if it is not there.
        name: Of the file, without its ending.

    Attributes:
        folder: Where.
        rows: In the order in which they were measured; each names the versions and the number of threads that it was measured with.
    """

    def __init__(self, folder: Path, name: str):
        self.folder, self._file = folder, folder / f"{name}.jsonl"
        folder.mkdir(parents=True, exist_ok=True)
        lines = self._file.read_text().splitlines() if self._file.exists() else []
        self.rows: list[dict[str, Any]] = [json.loads(line) for line in lines]

    def __len__(self) -> int:
        return len(self.rows)

    def have(self, **known: Any) -> bool:
        """Whether there is a row with these values."""
        return any(all(row.get(key) == value for key, value in known.items()) for row in self.rows)

    def add(self, row: dict[str, Any]) -> None:
        """Keep a row: once this returns, it is on the disk. JSON has no NaN: it is left out."""
        self.rows.append(_plain(row) | {"threads": cpu_threads(), "versions": versions()})
        with self._file.open("a") as file:
            file.write(json.dumps(self.rows[-1]) + "\n")
            file.flush()
            os.fsync(file.fileno())

    @property
    def about(self) -> str:
        """Versions and threads in words, for the page."""
        told = "; ".join(dict.fromkeys(row["versions"] for row in self.rows))
        return f"{told}; {self.rows[0]['threads']} threads of a CPU"

    def write(self, page: str) -> None:
        """The page, beside the rows."""
        (self.folder / "README.md").write_text(page)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(own) for key, own in value.items()}
    if isinstance(value, list):
        return [_plain(own) for own in value]
    return None if isinstance(value, float) and math.isnan(value) else value
