"""The folder of a choice: each fitted candidate with its record, written whole, so that a choice that was stopped goes on."""

import contextlib
import json
import os
import re
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from warp_bounding.bounders import Bounder, DistanceBounder, load
from warp_bounding.errors import BoundingError, FileFormatError
from warp_bounding.runtime.whole_file import write_whole
from warp_bounding.version import __version__

__all__ = ["Attempts", "Kept"]

SETTINGS, ATTEMPTS = "choice.json", "attempts.json"
FORMAT = 2


@dataclass
class Attempts:
    """What has been tried of one candidate, and what that told.

    Attributes:
        taken: Seconds that all fits took, those among them that came to nothing.
        given: Seconds that fits were given which ended, as they came.
        limit: Seconds after which a fit was stopped; 0 where none was.
        error: Why there can be no such bounder; empty where there can be.
        setup: Seconds that a network's training took before its first step; 0 where that is not known.
        round: Seconds between two refreshes of its samples; 0 where that is not known.
        starved: Why what was trained last tells little of its kind; empty for others.
    """

    taken: float = 0.0
    given: list[float] = field(default_factory=list)
    limit: float = 0.0
    error: str = ""
    setup: float = 0.0
    round: float = 0.0
    starved: str = ""


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
        self._attempts: dict[str, Attempts] = {}
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
        self._attempts = self._read()

    def _path(self, label: str, seconds: float) -> Path:
        name = re.sub(r"[^a-z0-9+]+", "-", label.lower()).strip("-")
        return self.folder / f"{name} {seconds:.3g} s.safetensors"

    def of(self, label: str) -> Attempts:
        """What has been tried of a candidate."""
        return self._attempts.setdefault(label, Attempts())

    def get(self, label: str, device: str | None) -> list[tuple[float, Bounder | DistanceBounder]]:
        """The candidate as it was fitted, with the seconds that each fit was given; what somebody damaged or removed is left out."""
        found = []
        for seconds in self.of(label).given if self.folder is not None else ():
            with contextlib.suppress(BoundingError):  # it is fitted anew, and replaced
                found.append((seconds, load(self._path(label, seconds), device=device)))
        return found

    def put(self, label: str, bounder: Bounder | DistanceBounder, seconds: float) -> None:
        """Keep a candidate that was fitted in so many seconds; ``note`` then keeps what is known of it."""
        if self.folder is not None:
            bounder.save(self._path(label, seconds))

    def note(self) -> None:
        """Write down what ``of`` tells of all candidates."""
        if self.folder is not None:
            told = {label: asdict(each) for label, each in self._attempts.items()}
            write_whole(self.folder / ATTEMPTS, json.dumps(told, indent=1).encode())

    def _read(self) -> dict[str, Attempts]:
        file = self.folder / ATTEMPTS
        try:
            return {label: Attempts(**each) for label, each in json.loads(file.read_text(encoding="utf-8")).items()}
        except (OSError, ValueError, TypeError, AttributeError):
            return {}  # none yet, or damaged: all is fitted anew
