"""Branch and bound that halves boxes until each is decided: the loop of ``certify``, and of the proofs of distances.

A *look* bounds some boxes. It returns what it found, and both halves of each box that it could not decide. Its result
for a box depends on that box alone. So a search looks at the same boxes and finds the same in any order: in one process
or in many, in one run or with interruptions. It takes the newest boxes first (depth first), so its memory grows with
the depth, not with the number of boxes.

*Many processes* (``scheduler``): this process looks at boxes until there are many, and divides them into tasks of some
seconds each. A task that takes much longer returns its open boxes. Dask repeats the task of a worker that dies.

*A checkpoint* is a file of all open boxes, those of unfinished tasks included.
"""

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

PARTS = 10_000  # steps in which progress is reported


class Boxes(NamedTuple):
    """Open boxes.

    Attributes:
        lower: ``(N, n)`` float64, lower corners.
        upper: ``(N, n)`` float64, upper corners.
        owner: ``(N,)`` int64, the number of the start box that each box is a part of.
        level: ``(N,)`` int64, how many halvings lead from the start box to each box.
        worth: The share of the whole search that one unit of their volume counts as.
    """

    lower: np.ndarray
    upper: np.ndarray
    owner: np.ndarray
    level: np.ndarray
    worth: float

    @property
    def count(self) -> int:
        """How many boxes there are."""
        return len(self.owner)

    @property
    def share(self) -> float:
        """Their share of the whole search."""
        return self.worth * float((self.upper - self.lower).prod(axis=1).sum())

    def part(self, some: slice | np.ndarray) -> "Boxes":
        """Some of these boxes."""
        return Boxes(*(each[some] for each in self[:-1]), self.worth)

    def halves(self, axis: np.ndarray) -> "Boxes":
        """Both halves of each box: first all lower ones, then all upper ones."""
        owner, level = np.tile(self.owner, 2), np.tile(self.level + 1, 2)
        return Boxes(*halve(self.lower, self.upper, axis), owner, level, self.worth)

    @classmethod
    def concatenated(cls, parts: list["Boxes"]) -> "Boxes":
        """The boxes of all parts, which must have one worth."""
        if len(parts) == 1:
            return parts[0]
        return cls(*map(np.concatenate, list(zip(*parts, strict=True))[:-1]), parts[0].worth)


class Seen(NamedTuple):
    """What a look returns.

    Attributes:
        halves: Halves of the undecided boxes, which may be cut to the parts that matter.
        number: ``(F,)`` int, indices into ``maxima``; ``maxima[number]`` is raised to at least ``value``.
        value: ``(F,)`` float64.
        failed: Ends the search: suspect points, and the owners of their boxes. ``None`` if it goes on.
    """

    halves: Boxes
    number: np.ndarray
    value: np.ndarray
    failed: tuple[np.ndarray, np.ndarray] | None = None


class Look(Protocol):
    """Bounds boxes. It must be picklable for work on many processes."""

    chunk: int  # boxes of one call, at most

    def __call__(self, boxes: Boxes) -> Seen: ...


class State(NamedTuple):
    """What a search has found, and what it still has to do.

    Attributes:
        waiting: Open boxes; the last ones are next.
        maxima: ``(F,)`` float64, the numbers that looks raise.
        boxes: How many boxes were looked at.
        seconds: How long that took.
        taken: How many of the starts were begun.
        failed: As in ``Seen``.
        complete: Whether every box is decided.
    """

    waiting: list[Boxes]
    maxima: np.ndarray
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
    maxima: np.ndarray,
    *,
    budget: float = float("inf"),
    most: float = float("inf"),
    checkpoint: "Checkpoint | None" = None,
    progress: Callable[[int, int], None] | None = None,
    scheduler: str | int | None = None,
) -> State:
    """Look at boxes and their halves until all are decided, one fails, or time is over.

    Args:
        look: Bounds the boxes.
        starts: Batches of start boxes: lower and upper corners ``(N, n)`` float64, and the batch's share of the search.
            The boxes of all batches are numbered consecutively.
        maxima: ``(F,)`` float64, initial values of the numbers that looks raise; changed in place.
        budget: Seconds.
        most: Boxes, after which the search stops as if time were over; ignored with a scheduler.
        checkpoint: Where to go on from, and to save the state; removed once all boxes are decided or one has failed.
        progress: Called with how much is done, and ``PARTS`` for all of it.
        scheduler: Address of a Dask scheduler whose workers look, or a number of processes of this machine.

    Returns:
        What was found, and what is left to do.
    """
    run, end = _Search(look, starts, maxima, checkpoint, progress), working_seconds() + budget
    try:
        if scheduler is None:
            run.alone(end, most)
        else:
            run.spread(end, scheduler)
    finally:  # Ctrl-C, too
        if checkpoint and run.failed is None and not run.complete:
            checkpoint.save(run.state, now=True)
    if checkpoint and (run.complete or run.failed is not None):
        checkpoint.remove()
    return run.state


FIRST = 64  # boxes for each worker, at least, before tasks are made
TASK, LONGEST = 10.0, 30.0  # seconds that a task should take, and after which it returns its open boxes
AHEAD = 2  # tasks in flight for each worker
WAIT = 1.0  # seconds between two looks at the clock


class _Search:
    """A running search; arguments as in ``search``."""

    def __init__(self, look: Look, starts: Iterable, maxima: np.ndarray, checkpoint=None, progress=None):
        self.look, self.checkpoint, self.progress, self.started = look, checkpoint, progress, working_seconds()
        state = (checkpoint.load(len(maxima)) if checkpoint else None) or State([], maxima)
        self.waiting, self.maxima, self.boxes, self.before, self.taken, *_ = state
        self.failed, self.complete, self.out = None, False, {}  # out: boxes that are being looked at, by task
        self.starts, self.begun, self.numbered = iter(starts), 0.0, 0
        for lower, _, share in islice(self.starts, self.taken):
            self.begun, self.numbered, columns = self.begun + share, self.numbered + len(lower), lower.shape[1:]
            if any(boxes.lower.shape[1:] != columns for boxes in self.waiting):
                raise checkpoint.damaged
        if any((boxes.owner >= self.numbered).any() for boxes in self.waiting):
            raise checkpoint.damaged
        self.done = self.begun - sum(boxes.share for boxes in self.waiting)

    @property
    def state(self) -> State:
        """See ``State``; boxes that are being looked at count as open."""
        waiting, spent = [*self.waiting, *self.out.values()], self.before + working_seconds() - self.started
        return State(waiting, self.maxima, self.boxes, spent, self.taken, self.failed, self.complete)

    def take(self, count: int) -> Boxes | None:
        """The next boxes, at most ``count``, all of one worth; ``None`` if there are none."""
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
        return Boxes.concatenated(taken)

    def see(self, boxes: Boxes) -> None:
        """Look at boxes in this process."""
        self.out[None] = boxes
        halves, number, value, failed = self.look(boxes)
        np.maximum.at(self.maxima, number, value)
        self.ended(None, State([halves] if halves.count else [], self.maxima, boxes.count, failed=failed))

    def ended(self, key, state: State) -> None:
        """Take over the state in which a task ended."""
        boxes = self.out.pop(key)
        self.waiting += state.waiting
        self.boxes, self.failed = self.boxes + state.boxes, self.failed or state.failed
        self.done += boxes.share - sum(each.share for each in state.waiting)

    def report(self) -> None:
        """Save a checkpoint when one is due, and report progress."""
        if self.checkpoint and self.failed is None:
            self.checkpoint.save(self.state)
        if self.progress:
            self.progress(round(PARTS * min(max(self.done, 0.0), 1.0)), PARTS)

    def alone(self, end: float, most: float = float("inf")) -> None:
        """Search in this process."""
        looked = False
        while self.failed is None and not (looked and (working_seconds() > end or self.boxes > most)):
            boxes = self.take(self.look.chunk)
            if boxes is None:
                self.complete = True
                return
            self.see(boxes)
            self.report()
            looked = True

    def spread(self, end: float, scheduler: str | int) -> None:
        """Search with Dask workers."""
        with Workers(scheduler) as workers:
            look, size = workers.held(self.look), 1.0  # boxes of a task
            given, spent = 0, 0.0  # boxes and seconds of finished tasks
            while self.failed is None:
                while len(self.out) < AHEAD * workers.count and (boxes := self._next(size, workers.count)) is not None:
                    self.out[workers.submit(_task, look, boxes, len(self.maxima))] = boxes
                if self.failed is not None or working_seconds() > end:
                    return
                if not self.out:
                    self.complete = True
                    return
                for key, state in workers.ended(WAIT):
                    given, spent = given + self.out[key].count, spent + state.seconds
                    size = TASK * given / max(spent, 1e-3)
                    np.maximum(self.maxima, state.maxima, out=self.maxima)
                    self.ended(key, state)
                self.report()

    def _next(self, size: float, workers: int) -> Boxes | None:
        """Boxes for a task. While few boxes are open this process looks at them first, which makes more."""
        while self.failed is None and (boxes := self.take(self.look.chunk)) is not None:
            self.waiting.append(boxes)
            waiting = sum(each.count for each in self.waiting)
            if self.out or waiting >= FIRST * workers:
                return self.take(max(1, int(min(size, self.look.chunk, waiting / (AHEAD * workers)))))
            self.see(self.take(self.look.chunk))
        return None


def _task(look: Look, boxes: Boxes, size: int) -> State:
    """Runs in a worker: search boxes and their halves for at most ``LONGEST`` seconds, or one look."""
    task = _Search(look, (), np.full(size, -np.inf))
    task.waiting.append(boxes)
    task.alone(working_seconds() + LONGEST)
    return task.state


# --- checkpoint ------------------------------------------------------------------------------------------------------


KEY = "warp_bounding_checkpoint"
EVERY = 15.0  # seconds between two writes


class Checkpoint:
    """The state of a search in a file: read at the beginning, written now and then, removed at the end.

    A proof trusts its checkpoint as it trusts the program, methods and activations that are registered from outside
    included: whoever can forge the file can forge a proof. The file names what it is about (the bounder's numbers, the
    shape with its margin, the library's version) and holds a SHA-256 of its content. A file that does not match is
    refused, and kept as it is. There is none for a function, which its digest does not tell from others.
    """

    def __init__(self, path: str | os.PathLike, bounder: Bounder, shape: Shape):
        """Read the file, if there is one.

        Raises:
            FileFormatError: If it is no checkpoint, one of another proof, or damaged, or if none can be written there.
            ShapeError: If the shape is a function, or made of one (``Shape.identified``).
        """
        shape.expect_identified("a checkpoint")
        self.path, self._written = file_path(path), working_seconds()
        about = {"method": bounder.method, "sizes": bounder.sizes, "domain": bounder.domain.to_dict()}
        about |= {"threshold": float(bounder.threshold), "shape": shape.digest, "library": __version__}
        self._claim = digest_of(bounder.tensors, about)
        check_writable(self.path)
        self._left = self._read() if self.path.exists() else None

    def load(self, count: int) -> State | None:
        """The saved state of a search with ``count`` numbers in ``maxima``; ``None`` if there was no file.

        Raises:
            FileFormatError: If the file holds another count of numbers.
        """
        if self._left is not None and len(self._left.maxima) != count:
            raise self.damaged
        return self._left

    @property
    def damaged(self) -> FileFormatError:
        """The error to raise where the file contradicts itself."""
        return FileFormatError(f"{self.path}: the checkpoint is damaged; remove it to begin anew")

    @property
    def seconds(self) -> float:
        """How long the proof took until it was stopped."""
        return self._left.seconds if self._left else 0.0

    def save(self, state: State, *, now: bool = False) -> None:
        """Write the state if the last write was ``EVERY`` seconds ago or more, or if ``now``.

        Raises:
            FileFormatError: If it cannot be written.
        """
        if not now and working_seconds() - self._written < EVERY:
            return
        tensors = {"maxima": state.maxima} | {
            f"{name}.{i}": np.ascontiguousarray(getattr(boxes, name))
            for i, boxes in enumerate(state.waiting)
            for name in Boxes._fields[:-1]
        }
        document = {"claim": self._claim, "boxes": state.boxes, "seconds": state.seconds, "taken": state.taken}
        document["worths"] = [boxes.worth for boxes in state.waiting]
        text = json.dumps({"sha256": digest_of(tensors, document), "left": document})
        write_whole(self.path, safetensors.numpy.save(tensors, metadata={KEY: text}))
        self._written = working_seconds()

    def remove(self) -> None:
        """Remove the file: the proof has ended."""
        self.path.unlink(missing_ok=True)

    def _read(self) -> State:
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
            maxima = tensors["maxima"].copy()
            state = State(waiting, maxima, document["boxes"], document["seconds"], document["taken"])
            if not _well_formed(state):
                raise self.damaged
        except (KeyError, TypeError, ValueError) as error:
            raise self.damaged from error
        return state


def unfinished(within: str, checkpoint: Checkpoint | None) -> str:
    """What is said of a search that ended before all boxes were decided."""
    goes_on = "" if checkpoint is None else f"; the same command goes on from {checkpoint.path}"
    return f"no decision within {within}{goes_on}"


def _well_formed(state: State) -> bool:
    """Whether all arrays and numbers have the types, shapes and ranges that a search gives them."""
    sound = all(type(count) is int and count >= 0 for count in (state.boxes, state.taken))
    sound = sound and type(state.seconds) is float and 0 <= state.seconds < float("inf")
    sound = sound and state.maxima.dtype == np.float64 and state.maxima.ndim == 1
    for low, high, owner, level, worth in state.waiting:
        sound = sound and low.dtype == high.dtype == np.float64 and owner.dtype == level.dtype == np.int64
        sound = sound and low.ndim == 2 and low.shape == high.shape and owner.shape == level.shape == (len(low),)
        sound = sound and type(worth) is float and worth >= 0
        sound = sound and ((owner >= 0) & (level >= 0)).all() and (low <= high).all()
    return bool(sound)
