"""What is known of one baked shape, kept as a file of its own: written by the worker when it is done, so that nothing depends on who asked for it."""

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from warp_bounding.runtime.whole_file import FileKind, write_whole

__all__ = ["RECORDS", "RECORD_FILE", "Record"]

RECORD_FILE = FileKind(".json", 0, b"{")
RECORDS = "records"  # folder of the records, in that of a bake
FORMAT = 1


@dataclass(frozen=True)
class Record:
    """One shape under one set of settings.

    Attributes:
        name: The shape's file without its extension.
        source: Its path, relative to the folder that was baked.
        hash: Of shape, settings and version.
        settings: Hash of the settings alone; ``settings/HASH.json`` has them.
        file: The bounder's file in the folder of the bake; empty where there is none.
        method: Of the bounder; ``"none"`` where a choice said that none pays; empty after an error.
        query: The kind of query that it answers.
        bytes: That one query can read (``Bounder.nbytes``).
        certificate: The certificate's kind; empty where there is none.
        fp_rate: False positives, per cent of the samples; ``None`` where they were not counted.
        seconds: That the task took, all in all.
        error: Why there is no bounder, in one line; empty where there is one.
        note: What the library warned of, in one line.
        sha256: Of the bounder's file.
        picture: A PNG in base64; empty where there is none.
    """

    name: str
    source: str
    hash: str
    settings: str
    file: str = ""
    method: str = ""
    query: str = ""
    bytes: int = 0
    certificate: str = ""
    fp_rate: float | None = None
    seconds: float = 0.0
    error: str = ""
    note: str = ""
    sha256: str = ""
    picture: str = ""

    @property
    def key(self) -> str:
        """The name of everything that belongs to it, without an extension."""
        return f"{self.name}-{self.hash}"

    def path_in(self, folder: Path) -> Path:
        """Where the record is, in the folder of a bake."""
        return folder / RECORDS / f"{self.key}.json"

    def write(self, path: Path) -> None:
        """Write it, whole or not at all.

        Raises:
            FileFormatError: If it cannot be written.
        """
        write_whole(path, json.dumps({"format": FORMAT} | asdict(self), indent=1).encode(), RECORD_FILE)

    @classmethod
    def read(cls, path: Path) -> "Record | None":
        """The record of a file; ``None`` where there is none, or another one than this version writes: the shape is then baked anew."""
        try:
            values: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            version = values.pop("format")
            right = version == FORMAT and set(values) == {f.name for f in fields(cls)}
            return cls(**values) if right else None
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None
