"""What there is to do, in which order, and how long it will take."""

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from paper.columns import COLUMNS, PAPER_OBJECTS, VARIANTS, Column, Variant
from paper.rows import PROTOCOLS, Key
from paper.settings import Preset, Settings, parse_budget
from paper.shapes import Shape
from warp_bounding.errors import BounderError

__all__ = ["Job", "Selection", "Share", "TimeLeft", "duration", "plan", "preset_seconds", "shares"]

# What is expected before anything has been measured, on two cores; seconds.
KDOP_SECONDS = 11.0  # after which a learned k-DOP's fit has ended whatever its budget
PARAMETRIC_PROOF = {4: 15.0}  # of its volumes around parameters, by dimension
FIELD_PROOF = {"2d-ray": 25.0, "4d-point": 20.0}
SLOW_THRESHOLDS = ("ray", "box")  # queries whose networks' thresholds take so long, whatever the budget:
THRESHOLD = {2: 4.0, 3: 6.0, 4: 11.0}  # by dimension
THRESHOLDS = {"mlp": 1, "mlp-early": 2}  # how many a network has: its exit has one, too
CLASSIC_FIT = {2: 0.1, 3: 0.5, 4: 1.7}  # by dimension
EVALUATE = {"3d-plane": 1.0, "4d-plane": 4.5, "4d-box": 1.5, "4d-point": 0.6, "2d-point": 0.3, "2d-box": 0.4}
SLOWEST_USUAL = 0.8  # a million queries of the other columns


@dataclass(frozen=True)
class Job:
    """One bounder to fit, and the protocols to measure it under; each is one cell, one row of the CSV."""

    shape: Shape  # the object
    column: Column  # the query
    variant: Variant  # the method
    space: str  # that it is fitted in
    protocols: tuple[str, ...]  # to measure

    @property
    def name(self) -> str:
        """For a file: no part but the object's name holds a dot, so no two jobs share one."""
        return f"{self.column.name}.{self.shape.name}.{self.variant.slug}"

    @property
    def file(self) -> str:
        """Name of its bounder's file: jobs that ask the same bounder share it."""
        if self.variant.of_distances:
            return f"{self.column.ndim}d.{self.shape.name}.{self.variant.slug}"
        return self.name

    @property
    def title(self) -> str:
        """For people."""
        return f"{self.column.name} {self.shape.name}: {self.variant.label}"

    def key(self, protocol: str) -> Key:
        """Of the row."""
        about = self.shape.ndim, self.shape.name, self.column.query, self.variant.method
        return (*about, self.space, self.variant.leaves, protocol)


class Selection(NamedTuple):
    """What is to be measured."""

    columns: Sequence[Column]
    variants: Sequence[Variant]
    shapes: Sequence[Shape]
    protocols: Sequence[str]


def plan(selection: Selection, done: Collection[Key] = ()) -> tuple[list[Job], int]:
    """What is missing, and the number of cells with what is done.

    The first object of every column comes first, and in a column what is cheap: so that all columns show something soon,
    and what an interrupted run shows is the same objects for every method.

    Raises:
        BounderError: If no method can answer any of the columns' queries.
    """
    columns, variants, shapes, protocols = selection
    jobs = [
        Job(shape, column, variant, space, tuple(protocols))
        for column in columns
        for variant in variants
        if (space := variant.space_in(column))
        for shape in shapes
        if shape.ndim == column.ndim
    ]
    if not jobs:
        methods = ", ".join(dict.fromkeys(v.name for v in variants))
        raise BounderError(
            f"nothing to measure: {methods} cannot bound {', '.join(c.name for c in columns)} of these objects"
        )
    rank = {s: [other for other in shapes if other.ndim == s.ndim].index(s) for s in shapes}
    missing = (replace(j, protocols=tuple(p for p in j.protocols if j.key(p) not in done)) for j in jobs)
    first = sorted((j for j in missing if j.protocols), key=lambda j: (rank[j.shape], j.variant.learned))
    return first, len(jobs) * len(protocols)


def _expected(job: Job, budget: float) -> float:
    """Seconds of a learned fit with a budget: some end before, and what sets a threshold takes its time however short the budget."""
    method, column = job.variant.last, job.column
    if method == "learned-kdop":
        return min(budget, KDOP_SECONDS) + (PARAMETRIC_PROOF.get(column.ndim, 0.0) if job.variant.parametric else 0.0)
    if method == "relu-field":
        return max(budget, FIELD_PROOF.get(column.name, 0.0))
    if method in THRESHOLDS and column.query in SLOW_THRESHOLDS:
        return max(budget, THRESHOLDS[method] * THRESHOLD[column.ndim])
    return budget


class TimeLeft:
    """Estimates the rest of a run by what it has taken so far; before that, a learned fit takes its budget."""

    def __init__(self, jobs: Sequence[Job], settings: Settings, fitted: Collection[str] = ()):
        """Begin.

        Args:
            jobs: All of them, in order.
            settings: Budgets of learned fits, and the number of samples.
            fitted: Files of bounders that are there already.
        """
        self._settings, self._rest, self._fitted = settings, list(jobs), set(fitted)
        self._first = {job.file: job for job in reversed(self._rest)}  # of those that share a bounder, who fits it
        self._sums: dict[tuple, tuple[float, int]] = {}

    def drop(self, job: Job) -> None:
        """Forget a job that failed; the next one of those that share its bounder will try again."""
        self._rest.remove(job)
        self._first = {job.file: job for job in reversed(self._rest)}

    def finish(self, job: Job, fit_seconds: float, evaluate_seconds: float) -> None:
        """Take note of what a job took; a fit that was loaded takes 0."""
        self._rest.remove(job)
        self._fitted.add(job.file)
        self._add(evaluate_seconds / len(job.protocols), ("evaluate", job.column))
        if fit_seconds:
            own = ("fit", job.column, job.variant)
            self._add(fit_seconds, *([own] if job.variant.learned else [own, ("fit", job.column), ("fit",)]))

    def _add(self, seconds: float, *keys: tuple) -> None:
        for key in keys:
            total, count = self._sums.get(key, (0.0, 0))
            self._sums[key] = total + seconds, count + 1

    def _mean(self, guess: float, *keys: tuple) -> float:
        total, count = next((self._sums[k] for k in keys if k in self._sums), (guess, 1))
        return total / count

    def fit(self, job: Job) -> float:
        """Seconds that its fit may take."""
        column, variant = job.column, job.variant
        if job.file in self._fitted or self._first[job.file] != job:
            return 0.0
        if variant.learned:
            return self._mean(self._guess(job), ("fit", column, variant))
        return self._mean(CLASSIC_FIT[column.ndim], ("fit", column, variant), ("fit", column), ("fit",))

    def _guess(self, job: Job) -> float:
        """Seconds of a learned fit that nothing is known of. Of a cascade whose last part has a row of its own, its front is left to fit."""
        column, variant = job.column, job.variant
        last = Variant(variant.last)
        shared = replace(job, variant=last).file if last != variant else None
        if shared in self._fitted or shared in self._first:
            variant = Variant(variant.front)
        return _expected(replace(job, variant=variant), self._settings.budget_of(column, variant))

    def measure(self, job: Job) -> float:
        """Seconds that its measurements may take."""
        guess = EVALUATE.get(job.column.name, SLOWEST_USUAL) * self._settings.samples / 1e6
        return len(job.protocols) * self._mean(guess, ("evaluate", job.column))

    def seconds(self, column: Column | None = None) -> float:
        """Of all that is left, or of one column's part of it."""
        return sum(self.fit(j) + self.measure(j) for j in self._rest if column in (None, j.column))

    @property
    def text(self) -> str:
        """Of all that is left, for people."""
        return f"{duration(self.seconds())} left"


def duration(seconds: float) -> str:
    """Seconds for people."""
    hours, minutes = divmod(round(seconds / 60), 60)
    if hours:
        return f"about {hours} h {minutes:02} min"
    return f"about {minutes} min" if minutes else "under a minute"


@dataclass(frozen=True)
class Share:
    """What one column of a plan takes."""

    column: Column
    fits: dict[float, int]  # number of learned fits, by seconds of each
    classic: int  # number of other fits
    cells: int  # number of measurements
    seconds: float  # in all

    @property
    def text(self) -> str:
        """One line for people: fits x seconds, everything else, the sum."""
        learned = " + ".join(f"{n} x {s:g} s" for s, n in sorted(self.fits.items(), reverse=True)) or "no learned fit"
        rest = f"{self.classic} closed forms, {self.cells} measurements"
        return f"{self.column.name}: {learned}; {rest}: {duration(self.seconds)}"


def shares(jobs: Sequence[Job], settings: Settings, fitted: Collection[str] = ()) -> list[Share]:
    """What each column of a plan takes; see ``TimeLeft`` for the arguments."""
    left, result = TimeLeft(jobs, settings, fitted), []
    for column in (c for c in COLUMNS if any(j.column == c for j in jobs)):
        own = [j for j in jobs if j.column == column]
        new = [j for j in own if left.fit(j)]
        fits = Counter(left.fit(j) for j in new if j.variant.learned)
        cells = sum(len(j.protocols) for j in own)
        result.append(Share(column, dict(fits), len(new) - fits.total(), cells, left.seconds(column)))
    return result


def preset_seconds(preset: Preset) -> float:
    """What a preset takes for every column and method, on as many objects as the paper has."""
    shapes = [Shape(ndim, str(number), Path()) for ndim, count in PAPER_OBJECTS.items() for number in range(count)]
    protocols = PROTOCOLS if preset.protocol == "both" else (preset.protocol,)
    general, budgets = parse_budget(preset.budget)
    settings = Settings.of({"samples": preset.samples, "budget": general, "budgets": budgets})
    return TimeLeft(plan(Selection(COLUMNS, VARIANTS, shapes, protocols))[0], settings).seconds()
