"""A folder of bounders as a mapping by name, and many bounders in one launch; both need no more than loading one does.

``BounderLibrary`` loads bounders when they are requested. In a ``BounderStack`` each query names the bounder that it
asks: bounders of equal sizes share one ``wp.Func`` and differ in their data, so they are a *group*: an array of
``Data``, and for each bounder its place in it. A stack asks one kernel a group; in a kernel of your own,
``wp.static(group.func)(group.data[group.slots[s]], q)`` asks bounder s.
"""

import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from warp_bounding.bounders import Bounder, load
from warp_bounding.errors import FileFormatError, QueryError
from warp_bounding.kernels.functions import Data, point_func
from warp_bounding.kernels.source import Source
from warp_bounding.runtime.arrays import Picklable, flat_queries, new_output
from warp_bounding.runtime.launch import launch_blocks
from warp_bounding.runtime.native import named, unique_name, vector_type
from warp_bounding.runtime.whole_file import BOUNDER, file_path

MANIFEST, RECORDS = "manifest.csv", "records"  # in the folder of a bake
HASH_DIGITS = 12  # hexadecimal: two of 10^5 shapes share them with a probability of 2e-5
KEY = re.compile(rf"(.+)-([0-9a-f]{{{HASH_DIGITS}}})")  # name-hash, of a baked file


@dataclass(frozen=True)
class Record:
    """What is known of one shape under one set of settings, kept as a file of its own in the folder of a bake."""

    name: str  # the shape's file without its extension
    source: str  # its path, relative to the folder that was baked
    hash: str  # of shape, settings and version
    settings: str  # hash of the settings alone
    file: str = ""  # the bounder's, in the folder of the bake; empty where there is none
    method: str = ""  # "none" where a choice said that none pays; empty after an error
    query: str = ""  # the kind of query that the bounder answers
    bytes: int = 0  # that one query can read (``Bounder.nbytes``)
    certificate: str = ""  # its kind; empty where there is none
    fp_rate: float | None = None  # false positives, per cent of the samples; ``None`` where they were not counted
    seconds: float = 0.0  # that the task took, all in all
    error: str = ""  # why there is no bounder, in one line
    note: str = ""  # what the library warned of, in one line
    picture: str = ""  # a PNG in base64

    @property
    def row(self) -> dict[str, Any]:
        """All but the picture."""
        return {name: value for name, value in asdict(self).items() if name != "picture"}

    @classmethod
    def read(cls, path: Path) -> "Record | None":
        """The record of a file; ``None`` if there is none, and the shape is then baked anew."""
        try:
            return cls(**json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):
            return None

    @classmethod
    def all_of(cls, folder: Path) -> "list[Record]":
        """Those in the folder of a bake, by source."""
        found = filter(None, map(cls.read, (folder / RECORDS).glob("*.json")))
        return sorted(found, key=lambda record: (record.source, record.settings, record.hash))


class BounderLibrary(Picklable, Mapping):
    """The bounders of a folder, by name.

    A name is that of the shape's file without its extension; where several bounders have it (of other settings, or of
    shapes in other folders), each is called ``name-hash``. What is listed is what lies in the folder when the library
    is made: files are whole or not there, so a bake may still be running.

    Args:
        folder: That ``bake`` wrote, or any other with bounders' files.
        device: Warp device of the bounders; the default device if ``None``.

    Raises:
        FileFormatError: If there is no such folder.

    Example:
        >>> bounder.save("bounders/ball.safetensors")
        >>> library = wb.baking.BounderLibrary("bounders", device="cpu")
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
        keys = sorted(file.stem for file in self.folder.glob(f"*{BOUNDER}") if not file.name.startswith("."))
        names = {key: found[1] if (found := KEY.fullmatch(key)) else key for key in keys}
        count = Counter(names.values())
        self._keys = {key if count[name] > 1 else name: key for key, name in names.items()}
        self._loaded: dict[str, Bounder] = {}

    @property
    def names(self) -> list[str]:
        """All names, sorted; a bounder's place in this list is its number in ``stack()``.

        Example:
            >>> bounder.save("bounders/ball.safetensors")
            >>> wb.baking.BounderLibrary("bounders").names
            ['ball']
        """
        return list(self._keys)

    def path(self, name: str) -> Path:
        """The file of a bounder; raises ``KeyError`` for no name.

        Example:
            >>> bounder.save("bounders/ball.safetensors")
            >>> wb.baking.BounderLibrary("bounders").path("ball").name
            'ball.safetensors'
        """
        return self.folder / f"{self._keys[name]}{BOUNDER}"

    def __getitem__(self, name: str) -> Bounder:
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
        """A row for each shape that was baked, those with an error too; fields as in ``library.Record``.

        Example:
            >>> bounder.save("bounders/ball.safetensors")
            >>> wb.baking.BounderLibrary("bounders").manifest  # of a folder that no bake wrote
            []
        """
        return [record.row for record in Record.all_of(self.folder)]

    def stack(self, names: Iterable[str] | None = None) -> "BounderStack":
        """Bounders that are queried together, by number; all of the library if ``None``.

        Args:
            names: Which, in the order of their numbers; all, in the order of ``names``, if ``None``.

        Raises:
            QueryError: If they do not bound the same kind of query of the same dimension, or there are none.
            KeyError: For no name of the library.

        Example:
            >>> bounder.save("bounders/ball.safetensors")
            >>> stack = wb.baking.BounderLibrary("bounders", device="cpu").stack(["ball"])
            >>> bool((stack.query(np.zeros(100, np.int32), points).numpy() == bounder.query(points).numpy()).all())
            True
        """
        return BounderStack([self[name] for name in (self.names if names is None else names)])

    def __repr__(self) -> str:
        return f"<library of {len(self)} bounders in {self.folder}>"


@dataclass(frozen=True)
class BounderGroup:
    """Bounders that share a function.

    Attributes:
        func: As in ``Bounder.func``; write ``wp.static(group.func)`` in a kernel.
        data: ``wp.array(dtype=wb.Data)``, one entry a bounder of the group.
        slots: ``wp.array(dtype=wp.int32)``, ``(S,)``: the place in ``data`` of each bounder of the stack, -1 for those
            of other groups.
        members: Numbers of the bounders in the stack, in the order of ``data``.
    """

    func: wp.Function
    data: wp.array
    slots: wp.array
    members: tuple[int, ...]
    source: Source
    held: tuple[Data, ...]  # whose memory ``data`` points to


class BounderStack:
    """Bounders that are queried together, each by its number.

    Args:
        bounders: Of the same kind of query, dimension and device. Thresholds are those of now.

    Raises:
        QueryError: If they are of several kinds, or there are none.

    Example:
        >>> stack = wb.baking.BounderStack([bounder, wb.fit(ball, method="kdop", device="cpu")])
        >>> stack
        <stack of 2 bounders, 2 functions, 3D point queries>
    """

    def __init__(self, bounders: Sequence[Bounder]):
        if not bounders:
            raise QueryError("a stack needs at least one bounder, got none")
        for bounder in bounders:
            if bounder.of_distances:
                raise QueryError(f"a stack is asked points, rays, planes or boxes, got {bounder!r}, a distance")
            bounder.expect_local("a stack")
        first = bounders[0]
        self.query_kind, self.ndim, self.device = first.query_kind, first.ndim, first.device
        self._columns = first.domain.columns
        groups: dict[Source, list[int]] = {}
        for number, bounder in enumerate(bounders):
            if (bounder.query_kind, bounder.ndim, bounder.device) != (self.query_kind, self.ndim, self.device):
                raise QueryError(f"a stack is of one kind, dimension and device, got {first!r} and {bounder!r}")
            groups.setdefault(bounder.source, []).append(number)
        self._bounders = [bounder.to() for bounder in bounders]  # at these thresholds, for pickling
        self.groups: tuple[BounderGroup, ...] = ()
        for source, members in groups.items():
            slots = np.full(len(bounders), -1, np.int32)
            slots[members] = np.arange(len(members))
            held = tuple(bounders[number].data for number in members)
            data = wp.array(list(held), dtype=Data, device=self.device)
            places = wp.array(slots, dtype=wp.int32, device=self.device)
            self.groups += (BounderGroup(point_func(source), data, places, tuple(members), source, held),)

    def __reduce__(self):
        return BounderStack, (self._bounders,)

    def __len__(self) -> int:
        return len(self._bounders)

    def __repr__(self) -> str:
        return f"<stack of {len(self)} bounders, {len(self.groups)} functions, {self.ndim}D {self.query_kind} queries>"

    def query(self, shape_indices, x, *, out: wp.array | None = None) -> wp.array:
        """Ask each query of one bounder.

        Args:
            shape_indices: ``(N,)`` NumPy array or ``wp.array`` of whole numbers: which bounder each query asks. A
                number of no bounder is answered with *maybe*. Those on the device as int32 are read in place.
            x: As for ``Bounder.query``, in the coordinates of each query's own shape.
            out: ``(N,)`` bool to write to, instead of a new array.

        Returns:
            ``(N,)`` bool ``wp.array``: true = maybe, false = certainly not.

        Raises:
            QueryError: For a wrong shape, dtype or device.

        Example:
            >>> stack = wb.baking.BounderStack([bounder, wb.fit(ball, method="kdop", device="cpu")])
            >>> stack.query([0, 1, 1], points[:3]).shape
            (3,)
        """
        queries, count, _ = flat_queries(x, self._columns, self.device)
        numbers = self._numbers(shape_indices, count)
        out = new_output(out, count, wp.bool, self.device)
        out.fill_(True)
        if not count:
            return out
        rows, vector = count * self._columns // self.ndim, vector_type(self.ndim)
        vectors = wp.array(ptr=queries.ptr, dtype=vector, shape=(rows,), device=self.device, copy=False)
        for group in self.groups:
            inputs = [0, group.data, group.slots, len(self), numbers, vectors]
            launch_blocks(_asking(group.source), count, inputs, [out], self.device, first_index=0, block=1)
        return out

    def _numbers(self, given, count: int) -> wp.array:
        if isinstance(given, wp.array) and given.dtype == wp.int32 and given.device == self.device:
            numbers = given
        else:
            values = given.numpy() if isinstance(given, wp.array) else np.asarray(given)
            if values.dtype.kind not in "iu" and values.size:
                raise QueryError(f"shape_indices must be whole numbers, got {values.dtype}")
            numbers = wp.array(values.astype(np.int32), dtype=wp.int32, device=self.device)
        if numbers.shape != (count,):
            raise QueryError(f"shape_indices must have shape ({count},), one for each query, got {numbers.shape}")
        return numbers


@cache
def _asking(source: Source) -> wp.Kernel:
    """The kernel that answers the queries of one group's bounders, and leaves the answers of others as they are."""
    test, vector, row = point_func(source), vector_type(source.ndim), 2 if source.is_region else 1

    @named(unique_name(source, "stack")).kernel
    def ask(
        # inputs
        first: int,
        data: wp.array(dtype=Data),
        slots: wp.array(dtype=wp.int32),
        size: int,
        numbers: wp.array(dtype=wp.int32),
        x: wp.array(dtype=vector),
        # outputs
        out: wp.array(dtype=wp.bool),
    ):
        thread, _ = wp.tid()
        i = first + thread
        number = numbers[i]
        if number >= 0 and number < size:
            slot = slots[number]
            if slot >= 0:
                if wp.static(row == 1):
                    out[i] = test(data[slot], x[i])
                else:
                    out[i] = test(data[slot], x[2 * i], x[2 * i + 1])

    return ask
