"""Boxes are halved until each is decided: the loop of ``certify``, and of the proofs of distances.

A *look* tells of boxes which of them are decided and what was found there, and gives the halves of the others. What it
tells of a box depends on that box alone. So the same boxes are looked at, and the same is found, in whatever order: in
one process or many, at once or with interruptions. Newest boxes come first, so memory grows with depth, not with the
number of boxes.

*On many processes* (``scheduler``) this one looks at boxes until there are many, and hands them out in tasks of some
seconds. A task that takes much longer gives back what it has left. Dask does a task of a worker that died again.

*A checkpoint* is a file with all boxes that wait, those of unfinished tasks included.
"""

import hashlib
import json
import os
from collections.abc import Callable, Iterable
from itertools import islice
from typing import NamedTuple, Protocol

import numpy as np
import safetensors
import safetensors.numpy

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.file_format import digest_of
from warp_bounding.errors import FileFormatError
from warp_bounding.runtime.launch import working_seconds
from warp_bounding.runtime.whole_file import check_writable, file_path, write_whole
from warp_bounding.runtime.workers import Workers
from warp_bounding.shapes.shape import Shape
from warp_bounding.version import __version__

PARTS = 10_000  # that progress is told in


class Boxes(NamedTuple):
    """Boxes that wait.

    Attributes:
        lower: ``(N, n)`` float64.
        upper: ``(N, n)`` float64.
        owner: ``(N,)`` int64, the number of the first box that each is a part of.
        level: ``(N,)`` int64, how often that was halved.
        worth: What share of the whole search a unit of their volume is.
    """

    lower: np.ndarray
    upper: np.ndarray
    owner: np.ndarray
    level: np.ndarray
    worth: float

    @property
    def count(self) -> int:
        """How many."""
        return len(self.owner)

    @property
    def share(self) -> float:
        """Of the whole search."""
        return self.worth * float((self.upper - self.lower).prod(axis=1).sum())

    def part(self, some: slice | np.ndarray) -> "Boxes":
        """Some of them."""
        return Boxes(*(each[some] for each in self[:-1]), self.worth)

    def halves(self, axis: np.ndarray) -> "Boxes":
        """Both halves of each."""
        owner, level = np.tile(self.owner, 2), np.tile(self.level + 1, 2)
        return Boxes(*halve(self.lower, self.upper, axis), owner, level, self.worth)

    @classmethod
    def together(cls, parts: list["Boxes"]) -> "Boxes":
        """Of parts of the same worth."""
        if len(parts) == 1:
            return parts[0]
        return cls(*map(np.concatenate, list(zip(*parts, strict=True))[:-1]), parts[0].worth)


class Seen(NamedTuple):
    """What a look has told.

    Attributes:
        left: Halves of the boxes that are not decided, or of a part of each.
        number: ``(F,)``, the numbers in ``found`` that become no less than
        value: ``(F,)``.
        failed: Points, and owners of the boxes that they are in, if the search is to end.
    """

    left: Boxes
    number: np.ndarray
    value: np.ndarray
    failed: tuple[np.ndarray, np.ndarray] | None = None


class Look(Protocol):
    """Looks at boxes. It can be pickled if workers are to do it."""

    chunk: int  # boxes at a time, at most

    def __call__(self, boxes: Boxes) -> Seen: ...


class Left(NamedTuple):
    """What a search has found, and what it has still to do.

    Attributes:
        waiting: The last one is next.
        found: ``(F,)``, what a look's numbers were raised to.
        boxes: How many boxes were looked at.
        seconds: How long that took.
        taken: How many of the starts were begun.
        failed: As of ``Seen``.
        complete: Whether every box is decided.
    """

    waiting: list[Boxes]
    found: np.ndarray
    boxes: int = 0
    seconds: float = 0.0
    taken: int = 0
    failed: tuple[np.ndarray, np.ndarray] | None = None
    complete: bool = False


def halve(low: np.ndarray, high: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both halves of each box: ``(2N, n)`` lower and upper corners."""
    row = np.arange(len(low))
    middle = (low[row, axis] + high[row, axis]) / 2
    left_high, right_low = high.copy(), low.copy()
    left_high[row, axis] = middle
    right_low[row, axis] = middle
    return np.concatenate([low, right_low]), np.concatenate([left_high, high])


def search(
    look: Look,
    starts: Iterable[tuple[np.ndarray, np.ndarray, float]],
    found: np.ndarray,
    *,
    budget: float = float("inf"),
    most: float = float("inf"),
    checkpoint: "Checkpoint | None" = None,
    progress: Callable[[int, int], None] | None = None,
    scheduler: str | int | None = None,
) -> Left:
    """Look at boxes and their halves until all are decided, one failed, or time is over.

    Args:
        look: Looks at them.
        starts: Lower and upper corners of the first boxes, some at a time, and what share of the search is done with
            them. They are numbered through.
        found: ``(F,)`` float64, where the numbers that looks give begin; raised in place.
        budget: Seconds.
        most: Boxes, after which it is as if time were over.
        checkpoint: Where to begin, and to write now and then what is left; removed when all boxes are decided.
        progress: Called with how much is done, in parts of ``PARTS``.
        scheduler: Address of a Dask scheduler whose workers are to look, or a number of processes of this machine.

    Returns:
        What was found, and what is left.
    """
    state, end = _Search(look, starts, found, checkpoint, progress), working_seconds() + budget
    try:
        if scheduler is None:
            state.alone(end, most)
        else:
            state.spread(end, scheduler)
    finally:  # Ctrl-C, too
        if checkpoint and state.failed is None and not state.complete:
            checkpoint.save(state.left, now=True)
    if checkpoint and (state.complete or state.failed is not None):
        checkpoint.remove()
    return state.left


FIRST = 64  # boxes for each worker, at least, before tasks are made
TASK, LONGEST = 10.0, 30.0  # seconds that a task should take, and after which it gives back what is left
AHEAD = 2  # tasks for each worker that are handed out at a time
WAIT = 1.0  # seconds between two looks at the clock


class _Search:
    """A search that runs; arguments as of ``search``."""

    def __init__(self, look: Look, starts: Iterable, found: np.ndarray, checkpoint=None, progress=None):
        self.look, self.checkpoint, self.progress, self.started = look, checkpoint, progress, working_seconds()
        left = (checkpoint.load(len(found)) if checkpoint else None) or Left([], found)
        self.waiting, self.found, self.boxes, self.before, self.taken, *_ = left
        self.failed, self.complete, self.out = None, False, {}  # the last: boxes that are being looked at, by any key
        self.starts, self.begun, self.numbered = iter(starts), 0.0, 0
        for lower, _, share in islice(self.starts, self.taken):
            self.begun, self.numbered, columns = self.begun + share, self.numbered + len(lower), lower.shape[1:]
            if any(boxes.lower.shape[1:] != columns for boxes in self.waiting):
                raise checkpoint.damaged
        if any((boxes.owner >= self.numbered).any() for boxes in self.waiting):
            raise checkpoint.damaged
        self.done = self.begun - sum(boxes.share for boxes in self.waiting)

    @property
    def left(self) -> Left:
        """See ``Left``: what is being looked at waits, too."""
        waiting, spent = [*self.waiting, *self.out.values()], self.before + working_seconds() - self.started
        return Left(waiting, self.found, self.boxes, spent, self.taken, self.failed, self.complete)

    def take(self, count: int) -> Boxes | None:
        """The next boxes, at most so many; ``None`` if there are none."""
        while not self.waiting:
            if (start := next(self.starts, None)) is None:
                return None
            lower, upper, share = start
            self.done, self.begun, self.taken = max(self.done, self.begun), self.begun + share, self.taken + 1
            owner = np.arange(self.numbered, self.numbered + len(lower))
            self.numbered += len(lower)
            if len(lower):
                boxes = Boxes(lower, upper, owner, np.zeros(len(lower), np.int64), 1.0)
                self.waiting.append(boxes._replace(worth=share / boxes.share if boxes.share > 0 else 0.0))
        taken = []
        while count > 0 and self.waiting and (not taken or self.waiting[-1].worth == taken[0].worth):
            boxes = self.waiting.pop()
            if boxes.count > count:
                self.waiting.append(boxes.part(slice(-count)))
            taken.append(boxes.part(slice(-count, None)))
            count -= taken[-1].count
        return Boxes.together(taken)

    def see(self, boxes: Boxes) -> None:
        """Look at boxes."""
        self.out[None] = boxes
        left, number, value, failed = self.look(boxes)
        np.maximum.at(self.found, number, value)
        self.ended(None, Left([left] if left.count else [], self.found, boxes.count, failed=failed))

    def ended(self, key, left: Left) -> None:
        """Boxes of this key were looked at."""
        boxes = self.out.pop(key)
        self.waiting += left.waiting
        self.boxes, self.failed = self.boxes + left.boxes, self.failed or left.failed
        self.done += boxes.share - sum(each.share for each in left.waiting)

    def tell(self) -> None:
        """Write a checkpoint and tell progress."""
        if self.checkpoint and self.failed is None:
            self.checkpoint.save(self.left)
        if self.progress:
            self.progress(round(PARTS * min(max(self.done, 0.0), 1.0)), PARTS)

    def alone(self, end: float, most: float = float("inf")) -> None:
        """Look at boxes here."""
        looked = False
        while self.failed is None and not (looked and (working_seconds() > end or self.boxes > most)):
            boxes = self.take(self.look.chunk)
            if boxes is None:
                self.complete = True
                return
            self.see(boxes)
            self.tell()
            looked = True

    def spread(self, end: float, scheduler: str | int) -> None:
        """Let Dask workers look at boxes."""
        with Workers(scheduler) as workers:
            look, size, given, spent = workers.held(self.look), 1.0, 0, 0.0  # the last two: of finished tasks
            while self.failed is None:
                while len(self.out) < AHEAD * workers.count and (boxes := self._next(size, workers.count)) is not None:
                    self.out[workers.submit(_task, look, boxes, len(self.found))] = boxes
                if self.failed is not None or working_seconds() > end:
                    return
                if not self.out:
                    self.complete = True
                    return
                for key, left in workers.ended(WAIT):
                    given, spent = given + self.out[key].count, spent + left.seconds
                    size = TASK * given / max(spent, 1e-3)
                    np.maximum(self.found, left.found, out=self.found)
                    self.ended(key, left)
                self.tell()

    def _next(self, size: float, workers: int) -> Boxes | None:
        """Boxes for a task; where there are few, their halves."""
        while self.failed is None and (boxes := self.take(self.look.chunk)) is not None:
            self.waiting.append(boxes)
            waiting = sum(each.count for each in self.waiting)
            if self.out or waiting >= FIRST * workers:
                return self.take(max(1, int(min(size, self.look.chunk, waiting / (AHEAD * workers)))))
            self.see(self.take(self.look.chunk))
        return None


def _task(look: Look, boxes: Boxes, size: int) -> Left:
    """What a worker does: look at boxes and their halves for a while."""
    own = _Search(look, (), np.full(size, -np.inf))
    own.waiting.append(boxes)
    own.alone(working_seconds() + LONGEST)
    return own.left


# --- checkpoint ------------------------------------------------------------------------------------------------------


KEY = "warp_bounding_checkpoint"
EVERY = 15.0  # seconds between two writes
TELLING = 1024  # points whose distances tell one function from another, of which a digest knows little but the object


class Checkpoint:
    """What a search has still to do, in a file: read at the beginning, written now and then, removed at the end.

    Such a file is believed as far as its claim goes: it is part of the machine that proves, not of what is to be
    proven. It names the bounder's numbers, the shape with its margin, some of its answers and the library's version,
    and holds a SHA-256 of its content; a file that says anything else is refused, and kept as it is.
    """

    def __init__(self, path: str | os.PathLike, bounder: Bounder, shape: Shape):
        """Look at the file, if there is one.

        Raises:
            FileFormatError: If it is no checkpoint, one of another proof, or damaged, or if none can be written there.
        """
        self.path, self._written = file_path(path), working_seconds()
        about = {"method": bounder.method, "sizes": bounder.sizes, "domain": bounder.domain.to_dict()}
        about |= {"threshold": float(bounder.threshold), "shape": shape.digest, "library": __version__}
        low, high = shape.lower, shape.upper  # what the search rests on, as this machine computes it
        queried = low + np.random.default_rng(0).uniform(-0.5, 1.5, (TELLING, shape.ndim)) * (high - low)
        answers = shape.distances(queried) if bounder.of_distances else shape.decide(queried)
        about["answers"] = hashlib.sha256(np.asarray(answers).tobytes()).hexdigest()
        self._claim = digest_of(bounder.tensors, about)
        check_writable(self.path)
        self._left = self._read() if self.path.exists() else None

    def load(self, count: int) -> Left | None:
        """What was left of a search with ``count`` numbers; ``None`` for one that begins.

        Raises:
            FileFormatError: If it is about another number.
        """
        if self._left is not None and len(self._left.found) != count:
            raise self.damaged
        return self._left

    @property
    def damaged(self) -> FileFormatError:
        """To raise."""
        return FileFormatError(f"{self.path}: the checkpoint is damaged; remove it to begin anew")

    @property
    def seconds(self) -> float:
        """How long the proof has taken until it was stopped."""
        return self._left.seconds if self._left else 0.0

    def save(self, left: Left, *, now: bool = False) -> None:
        """Write what is left, unless that was done a moment ago, or at once.

        Raises:
            FileFormatError: If it cannot be written.
        """
        if not now and working_seconds() - self._written < EVERY:
            return
        tensors = {"found": left.found} | {
            f"{name}.{i}": np.ascontiguousarray(getattr(boxes, name))
            for i, boxes in enumerate(left.waiting)
            for name in Boxes._fields[:-1]
        }
        document = {"claim": self._claim, "boxes": left.boxes, "seconds": left.seconds, "taken": left.taken}
        document["worths"] = [boxes.worth for boxes in left.waiting]
        text = json.dumps({"sha256": digest_of(tensors, document), "left": document})
        write_whole(self.path, safetensors.numpy.save(tensors, metadata={KEY: text}))
        self._written = working_seconds()

    def remove(self) -> None:
        """The proof has ended."""
        self.path.unlink(missing_ok=True)

    def _read(self) -> Left:
        try:
            with safetensors.safe_open(str(self.path), framework="numpy") as file:
                text = (file.metadata() or {})[KEY]
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dict)
            signed = json.loads(text)
            document, sha = signed["left"], signed["sha256"]
        except (safetensors.SafetensorError, OSError, ValueError, TypeError, KeyError) as error:
            raise FileFormatError(
                f"{self.path}: expected the checkpoint of a proof, or no file yet; it is kept"
            ) from error
        if sha != digest_of(tensors, document) or not isinstance(document, dict):
            raise self.damaged
        if document.get("claim") != self._claim:
            raise FileFormatError(f"{self.path}: the checkpoint of another bounder, shape or version; it is kept")
        try:
            waiting = [
                Boxes(*(tensors[f"{name}.{i}"] for name in Boxes._fields[:-1]), worth)
                for i, worth in enumerate(document["worths"])
            ]
            found = tensors["found"].copy()
            left = Left(waiting, found, document["boxes"], document["seconds"], document["taken"])
            if not _sound(left):
                raise self.damaged
        except (KeyError, TypeError, ValueError) as error:
            raise self.damaged from error
        return left


def _sound(left: Left) -> bool:
    """Whether these are numbers of the kinds and sizes that a search has."""
    sound = all(type(count) is int and count >= 0 for count in (left.boxes, left.taken))
    sound = sound and type(left.seconds) is float and 0 <= left.seconds < float("inf")
    sound = sound and left.found.dtype == np.float64 and left.found.ndim == 1
    for low, high, owner, level, worth in left.waiting:
        sound = sound and low.dtype == high.dtype == np.float64 and owner.dtype == level.dtype == np.int64
        sound = sound and low.ndim == 2 and low.shape == high.shape and owner.shape == level.shape == (len(low),)
        sound = sound and type(worth) is float and worth >= 0
        sound = sound and ((owner >= 0) & (level >= 0)).all() and (low <= high).all()
    return bool(sound)
