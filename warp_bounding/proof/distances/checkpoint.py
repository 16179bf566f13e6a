"""A proof that can be stopped and goes on where it stopped: what its search has still to do, in a file.

Such a file is believed as far as its claim goes: it is part of the machine that proves, not of what is to be proven. It
names the bounder's numbers, the shape with its
margin, some of its distances and the library's version, and holds a SHA-256 of its content; a file that says anything
else is refused, and kept as it is.
"""

import hashlib
import json
import os
from typing import NamedTuple

import numpy as np
import safetensors
import safetensors.numpy

from warp_bounding.bounders.distance import DistanceBounder
from warp_bounding.bounders.file_format import digest_of
from warp_bounding.errors import FileFormatError
from warp_bounding.indicators.shape import Shape
from warp_bounding.runtime.launch import working_seconds
from warp_bounding.runtime.whole_file import BOUNDER_FILE, check_writable, file_path, write_whole
from warp_bounding.version import __version__

__all__ = ["Boxes", "Checkpoint", "Left"]

KEY = "warp_bounding_checkpoint"
EVERY = 15.0  # seconds between two writes
ASKED = (
    1024  # points whose distances tell one function from another, of which a digest knows little more than the object
)


class Boxes(NamedTuple):
    """Boxes that wait: ``(N, n)`` lower and upper corners, ``(N,)`` the number of the box that each is a part of, and how often all of them were halved."""

    lower: np.ndarray
    upper: np.ndarray
    owner: np.ndarray
    level: int


class Left(NamedTuple):
    """What a search has found, and what it has still to do.

    Attributes:
        waiting: The last one is next.
        found: ``(N,)``, what is known of each box that the search began with.
        boxes: How many boxes were looked at.
        seconds: How long that took.
    """

    waiting: list[Boxes]
    found: np.ndarray
    boxes: int
    seconds: float


class Checkpoint:
    """The file of one proof, which is read at the beginning, written now and then, and removed at the end."""

    def __init__(self, path: str | os.PathLike, bounder: DistanceBounder, shape: Shape):
        """Look at the file, if there is one.

        Raises:
            FileFormatError: If it is no checkpoint, one of another proof, or damaged, or if none can be written there.
        """
        self.path, self._written = file_path(path), working_seconds()
        about = {"method": bounder.method, "sizes": bounder.sizes, "domain": bounder.domain.to_dict()}
        about |= {"threshold": float(bounder.threshold), "shape": shape.digest, "library": __version__}
        low, high = shape.lower, shape.upper  # what the search rests on, as this machine computes it
        asked = low + np.random.default_rng(0).uniform(-0.5, 1.5, (ASKED, shape.ndim)) * (high - low)
        about["distances"] = hashlib.sha256(np.asarray(shape.distances(asked)).tobytes()).hexdigest()
        self._claim = digest_of(bounder.tensors, about)
        check_writable(self.path, kind=BOUNDER_FILE)
        self._left = self._read() if self.path.exists() else None

    def load(self) -> Left | None:
        """What was left; ``None`` for a proof that begins."""
        return self._left

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
            for name in ("lower", "upper", "owner")
        }
        document = {"claim": self._claim, "boxes": left.boxes, "seconds": left.seconds}
        document["levels"] = [boxes.level for boxes in left.waiting]
        text = json.dumps({"sha256": digest_of(tensors, document), "left": document})
        write_whole(self.path, safetensors.numpy.save(tensors, metadata={KEY: text}), BOUNDER_FILE)
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
        if sha != digest_of(tensors, document):
            raise FileFormatError(f"{self.path}: the checkpoint is damaged; remove it to begin anew")
        if document["claim"] != self._claim:
            raise FileFormatError(f"{self.path}: the checkpoint of another bounder, shape or version; it is kept")
        waiting = [
            Boxes(*(tensors[f"{name}.{i}"] for name in ("lower", "upper", "owner")), level)
            for i, level in enumerate(document["levels"])
        ]
        return Left(waiting, tensors["found"].copy(), document["boxes"], document["seconds"])
