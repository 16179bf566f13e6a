"""The folder of a choice: each fitted candidate with its record, written whole, so that a choice that was stopped goes on."""

import hashlib
import json
import os
from pathlib import Path
from typing import Any

from warp_bounding.bounders import Bounder, load
from warp_bounding.errors import BoundingError, FileFormatError
from warp_bounding.runtime.whole_file import write_whole
from warp_bounding.version import __version__

__all__ = ["Kept"]

SETTINGS = "choice.json"
FORMAT = 1


class Kept:
    """A folder for one shape, one set of queries and one set of settings; nothing is kept where there is no folder.

    Args:
        folder: Where; made if it is not there.
        settings: JSON-ready, what all candidates have in common.

    Raises:
        FileFormatError: If it cannot be written to, or holds something else: it is then left as it is.
    """

    def __init__(self, folder: str | os.PathLike | None, settings: dict[str, Any]):
        self.folder = None if folder is None else Path(folder)
        if self.folder is None:
            return
        wanted = {"format": FORMAT, "version": __version__, **settings}
        file = self.folder / SETTINGS
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            found = json.loads(file.read_text(encoding="utf-8")) if file.exists() else None
            foreign = found is None and any(self.folder.iterdir())
        except (OSError, ValueError) as error:
            raise FileFormatError(f"{self.folder}: cannot be used for a choice ({error})") from error
        if foreign:
            raise FileFormatError(f"{self.folder}: holds other files, expected a new folder or one of a choice")
        if found is None:
            write_whole(file, json.dumps(wanted, indent=1).encode())
        elif found != wanted:
            differs = next(
                (key for key in wanted if not isinstance(found, dict) or found.get(key) != wanted[key]), "it"
            )
            got = found.get(differs) if isinstance(found, dict) else found
            raise FileFormatError(
                f"{self.folder}: holds a choice with another {differs}, {got!r} and not {wanted.get(differs)!r}; give another folder"
            )

    def _path(self, label: str, seconds: float) -> Path:
        name = hashlib.sha256(f"{label} {seconds:g}".encode()).hexdigest()[:16]
        return self.folder / f"{name}.safetensors"

    def get(self, label: str, seconds: float, device: str | None) -> Bounder | None:
        """The candidate as it was fitted with so many seconds; ``None`` where it was not."""
        if self.folder is None or not (file := self._path(label, seconds)).exists():
            return None
        try:
            return load(file, device=device)
        except BoundingError:
            return None  # a file that somebody damaged is fitted anew, and replaced

    def put(self, label: str, seconds: float, bounder: Bounder) -> None:
        """Keep a candidate."""
        if self.folder is not None:
            bounder.save(self._path(label, seconds))
