"""``BounderLibrary``: a folder of bounders as a mapping by name, loaded when they are asked for; it needs no more than loading one does."""

import csv
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from warp_bounding.baking.stack import BounderStack
from warp_bounding.bounders import Bounder, DistanceBounder, load
from warp_bounding.errors import FileFormatError, QueryError
from warp_bounding.runtime.arrays import Picklable
from warp_bounding.runtime.whole_file import BOUNDER_FILE, file_path

__all__ = ["COLUMNS", "HASH_DIGITS", "MANIFEST", "BounderLibrary"]

MANIFEST = "manifest.csv"
# What a row of the manifest has, and how it is read back.
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
HASH_DIGITS = 12  # hexadecimal: two of 10^5 shapes share them with a probability of 2e-5
KEY = re.compile(rf"(.+)-([0-9a-f]{{{HASH_DIGITS}}})")  # name-hash, of a baked file


class BounderLibrary(Picklable, Mapping):
    """The bounders of a folder, by name.

    A name is that of the shape's file without its extension; where several bounders have it (of other settings, or of shapes in other folders),
    each is called ``name-hash``. What is listed is what lies in the folder when the library is made: files are whole or not there, so a bake may
    still be running.

    Args:
        folder: That ``bake`` wrote, or any other with bounders' files.
        device: Warp device of the bounders; the default device if ``None``.

    Raises:
        FileFormatError: If there is no such folder.

    Example:
        >>> bounder.save("bounders/ball.safetensors")
        >>> library = wb.BounderLibrary("bounders", device="cpu")
        >>> library.names, len(library), "ball" in library
        (['ball'], 1, True)
        >>> library["ball"].certificate.proven
        True
    """

    def __init__(self, folder, device: str | None = None):
        self.folder = file_path(folder)
        if not self.folder.is_dir():
            is_what = "a file, expected a folder of bounders" if self.folder.exists() else "no such folder"
            raise FileFormatError(f"{self.folder}: {is_what}")
        self.device = device
        keys = sorted(
            file.stem for file in self.folder.glob(f"*{BOUNDER_FILE.suffix}") if not file.name.startswith(".")
        )
        names = {key: found[1] if (found := KEY.fullmatch(key)) else key for key in keys}
        count = Counter(names.values())
        self._keys = {key if count[name] > 1 else name: key for key, name in names.items()}
        self._loaded: dict[str, Bounder | DistanceBounder] = {}

    @property
    def names(self) -> list[str]:
        """All names, sorted; a bounder's place in this list is its number in ``stack()``.

        Example:
            >>> bounder.save("bounders/ball.safetensors")
            >>> wb.BounderLibrary("bounders").names
            ['ball']
        """
        return list(self._keys)

    def path(self, name: str) -> Path:
        """The file of a bounder; raises ``KeyError`` for no name.

        Example:
            >>> bounder.save("bounders/ball.safetensors")
            >>> wb.BounderLibrary("bounders").path("ball").name
            'ball.safetensors'
        """
        return self.folder / f"{self._keys[name]}{BOUNDER_FILE.suffix}"

    def __getitem__(self, name: str) -> Bounder | DistanceBounder:
        if name not in self._loaded:
            self._loaded[name] = load(self.path(name), self.device)
        return self._loaded[name]

    def __contains__(self, name: object) -> bool:
        return name in self._keys  # without loading it

    def __iter__(self) -> Iterator[str]:
        return iter(self._keys)

    def __len__(self) -> int:
        return len(self._keys)

    @cached_property
    def manifest(self) -> list[dict[str, Any]]:
        """A row for each shape that was baked, those with an error too; see the guide of ``bake`` for its columns.

        Raises:
            FileFormatError: If the manifest is not one.

        Example:
            >>> bounder.save("bounders/ball.safetensors")
            >>> wb.BounderLibrary("bounders").manifest  # of a folder that no bake wrote
            []
        """
        path = self.folder / MANIFEST
        if not path.exists():
            return []
        try:
            with path.open(encoding="utf-8", newline="") as file:
                rows = csv.DictReader(file)
                if rows.fieldnames != list(COLUMNS):
                    got = ", ".join(rows.fieldnames or ["none"])
                    raise ValueError(f"expected the columns {', '.join(COLUMNS)}, got {got}")
                return [{name: read(row[name]) for name, read in COLUMNS.items()} for row in rows]
        except (OSError, ValueError) as error:
            raise FileFormatError(f"{path}: no manifest of a bake ({error})") from error

    def stack(self, names: Iterable[str] | None = None) -> BounderStack:
        """Bounders that are asked together, by number; all of the library if ``None``.

        Args:
            names: Which, in the order of their numbers; all, in the order of ``names``, if ``None``.

        Raises:
            QueryError: If they do not bound the same kind of query of the same dimension, or there are none.
            KeyError: For no name of the library.

        Example:
            >>> bounder.save("bounders/ball.safetensors")
            >>> stack = wb.BounderLibrary("bounders", device="cpu").stack(["ball"])
            >>> bool((stack.query(np.zeros(100, np.int32), points).numpy() == bounder.query(points).numpy()).all())
            True
        """
        return BounderStack([self[name] for name in (self.names if names is None else names)])

    def query_pairs(self, shape_indices, points):
        """Ask each query of a bounder of its own: ``stack().query``, with the stack kept.

        Args:
            shape_indices: ``(N,)`` whole numbers: places in ``names``.
            points: ``(N, m)`` queries, each in the coordinates of its own shape.

        Returns:
            ``(N,)`` uint8 ``wp.array``: 1 = maybe, 0 = certainly not.

        Raises:
            QueryError: As ``stack`` and ``BounderStack.query`` do.

        Example:
            >>> bounder.save("bounders/ball.safetensors")
            >>> library = wb.BounderLibrary("bounders", device="cpu")
            >>> library.query_pairs(np.zeros(100, np.int32), points).shape
            (100,)
        """
        return self._stack.query(shape_indices, points)

    @cached_property
    def _stack(self) -> BounderStack:
        if not self._keys:
            raise QueryError(f"{self.folder}: there are no bounders in it")
        return self.stack()

    def __repr__(self) -> str:
        return f"<library of {len(self)} bounders in {self.folder}>"
