"""The folder of a bake: bounders by hash, records, settings, the manifest and the contact sheet; one bake at a time writes to it."""

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path

from warp_bounding.baking.contact_sheet import SHEET, write_sheet
from warp_bounding.baking.manifest import write_manifest
from warp_bounding.baking.record import RECORD_FILE, RECORDS, Record
from warp_bounding.baking.settings import Settings
from warp_bounding.errors import BoundingError, FileFormatError
from warp_bounding.runtime.whole_file import BOUNDER_FILE, write_whole

__all__ = ["BakeFolder"]

MARK = "bake.json"  # tells a folder of bakes from any other
LOCK = ".bake.lock"
SETTINGS = "settings"
FORMAT = 1


class BakeFolder:
    """Where a bake writes; made if it is not there.

    Args:
        path: Absolute.

    Raises:
        FileFormatError: If it cannot be written to, or holds something else: it is then left as it is.
    """

    def __init__(self, path: Path):
        self.path = path
        try:
            path.mkdir(parents=True, exist_ok=True)
            marked = (path / MARK).exists()
            foreign = not marked and any(not file.name.startswith(".") for file in path.iterdir())
        except OSError as error:
            raise FileFormatError(f"{path}: cannot be used for a bake ({error.strerror or error})") from error
        if foreign:
            raise FileFormatError(f"{path}: holds other files, expected a new folder or one of a bake")
        if not marked:
            write_whole(path / MARK, json.dumps({"format": FORMAT, "contact_sheet": SHEET}).encode(), RECORD_FILE)

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other bakes out; the system gives the lock back if this process is killed.

        Raises:
            FileFormatError: If another bake has it.
            BoundingError: If filelock is not installed.
        """
        try:
            from filelock import FileLock, Timeout
        except ImportError as error:
            raise BoundingError("baking needs filelock: pip install 'warp-bounding[bake]'") from error
        lock = FileLock(self.path / LOCK, timeout=0)
        try:
            lock.acquire()
        except Timeout:
            expected = "wait until it has ended, or give another folder"
            raise FileFormatError(f"{self.path}: another bake writes to it; {expected}") from None
        with lock:
            lock.release()  # ``with`` has taken it once more
            yield

    def clean(self) -> None:
        """Remove what workers that were killed while they wrote have left: files under names that nobody reads."""
        for folder in (self.path, self.path / RECORDS):
            for left in folder.glob(".*.*.*"):
                if BOUNDER_FILE.suffix in left.suffixes or RECORD_FILE.suffix in left.suffixes:
                    left.unlink(missing_ok=True)

    def keep_settings(self, settings: Settings) -> None:
        """Write what the hash of the settings stands for."""
        text = json.dumps(settings.to_dict(), indent=1)
        write_whole(self.path / SETTINGS / f"{settings.digest}.json", text.encode(), RECORD_FILE)

    def record_path(self, record: Record) -> Path:
        """Where the record of a shape is."""
        return record.path_in(self.path)

    def records(self) -> list[Record]:
        """All records, of this bake and of those before, with other settings too."""
        found = (Record.read(path) for path in sorted((self.path / RECORDS).glob("*.json")))
        return [record for record in found if record is not None]

    def conclude(self, records: list[Record]) -> None:
        """Write the manifest and the contact sheet of all records."""
        write_manifest(self.path, records)
        write_sheet(self.path, records, lambda record: Record.read(self.record_path(record)) or record)
