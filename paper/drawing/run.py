"""A resumable run over figures: each part is kept at once, and each picture is drawn from what is kept.

A part that fails is reported and its figure is left as it is; the others go on.
"""

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from paper.drawing.base import Figure, Work
from paper.drawing.folder import FigureFolder
from paper.drawing.settings import PAPER
from paper.run import DIGEST, interruptions, reason_of, versions
from warp_bounding.errors import BounderError, FileFormatError, IndicatorError
from warp_bounding.runtime.whole_file import write_whole

__all__ = ["FigureRun", "Outcome", "lacking", "selected"]


@dataclass
class Outcome:
    """How a run ended."""

    done: list[str] = field(default_factory=list)  # names of figures that are complete and drawn
    failed: list[str] = field(default_factory=list)  # a line for each figure that is not, and why
    skipped: list[str] = field(default_factory=list)  # a line for each figure whose objects are missing
    broken: list[str] = field(default_factory=list)  # a line for each broken promise
    interrupted: bool = False  # by Ctrl-C


def lacking(figure: Figure, work: Work) -> str | None:
    """In one line, what of the paper's data a figure needs and lacks; ``None`` if there is nothing."""
    absent = [label for thing in figure.wanted(work.settings) if (label := work.missing(thing))]
    if not absent:
        return None
    few = ", ".join(absent[:4]) + (f" and {len(absent) - 4} more" if len(absent) > 4 else "")
    if work.settings.objects != PAPER or work.data is None:
        return f"{figure.name} shows the paper's objects ({few}): --data DIR is needed"
    return f"{figure.name} needs {few}, not in {work.data}"


def selected(name: str, figures: Sequence[Figure], work: Work) -> tuple[list[Figure], list[str]]:
    """The figures that a name means, and a line for each that ``all`` leaves out.

    Raises:
        BounderError: For an unknown name, or a figure whose objects are missing.
    """
    if name == "all":
        lines = {figure.name: lacking(figure, work) for figure in figures}
        return [f for f in figures if not lines[f.name]], [line for line in lines.values() if line]
    chosen = [figure for figure in figures if figure.name == name]
    if not chosen:
        raise BounderError(f"figure must be one of {', '.join(f.name for f in figures)}, or all, got {name!r}")
    if line := lacking(chosen[0], work):
        raise IndicatorError(line)
    return chosen, []


class FigureRun:
    """Computes and draws figures.

    Args:
        folder: Where they go.
        work: What they are computed with.
        reporter: Told of each step: has ``part``, ``within`` and ``say``.
    """

    def __init__(self, folder: FigureFolder, work: Work, reporter: Any):
        self.folder, self.work, self.reporter = folder, work, reporter
        self.outcome = Outcome()
        self._interrupted = threading.Event()
        work.note, work.heed = reporter.within, self._heed

    def go(self, figures: Sequence[Figure], command: str) -> Outcome:
        """Do all figures.

        Raises:
            FileFormatError: If the folder cannot be written to, or a figure's file in it is damaged.
            IndicatorError: If a figure in it shows other objects.
        """
        for figure in figures:
            self.folder.read(figure.name)  # before any work
        self.folder.remember(command)
        with interruptions(self._interrupted):
            try:
                for figure in figures:
                    self._try(figure)
            except KeyboardInterrupt:
                self.outcome.interrupted = True
        return self.outcome

    def _try(self, figure: Figure) -> None:
        try:
            found = self._compute(figure)
            self.reporter.within(f"drawing {figure.name}")
            self._draw(figure, found["parts"])
            self.outcome.broken += [f"{figure.name}, {line}" for line in figure.broken(found["parts"])]
            self.outcome.done.append(figure.name)
        except FileFormatError:
            raise
        except Exception as error:  # whatever ends one figure is reported, and the others go on
            line = f"{figure.name}: {reason_of(error)}"
            self.outcome.failed.append(line)
            self.reporter.say(f"failed: {line}")

    def _compute(self, figure: Figure) -> dict[str, Any]:
        """All parts; those that are there already are not computed again."""
        found = self.folder.read(figure.name)
        self.work.used.clear()
        for thing in figure.wanted(self.work.settings):
            self.work.shape(thing)
        digests = {label: digest[:DIGEST] for label, digest in self.work.used.items()}
        other = [label for label, digest in found["objects"].items() if digests.get(label, digest) != digest]
        if other:
            file = self.folder.file(figure.name)
            raise IndicatorError(f"{', '.join(other)}: not what {file} was made of; choose another --out")
        parts = figure.parts(self.work)
        for number, (name, compute) in enumerate(parts.items(), start=1):
            if name in found["parts"]:
                continue
            self.reporter.part(f"{figure.name} {number}/{len(parts)}: {name}")
            started = time.perf_counter()
            value = compute()
            self._heed()
            found["parts"][name] = {**value, "seconds": round(time.perf_counter() - started, 2)}
            found["objects"] |= digests
            found["versions"] = sorted({*found["versions"], versions()})
            self.folder.write(figure.name, found)
        found["parts"] = {name: found["parts"][name] for name in parts}
        return found

    def _draw(self, figure: Figure, parts: dict[str, Any]) -> None:
        """Write the pictures that differ from those that are there."""
        for ending, content in figure.draw(parts, self.work.tools).items():
            path = self.folder.path / f"{figure.name}.{ending}"
            if not path.exists() or path.read_bytes() != content:
                write_whole(path, content)

    def _heed(self) -> None:
        """End the run if it was interrupted: a callee may have swallowed that, and returned early."""
        if self._interrupted.is_set():
            raise KeyboardInterrupt
