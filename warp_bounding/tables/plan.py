"""What there is to do, in which order, and how long it will take."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

from warp_bounding.errors import BounderError
from warp_bounding.tables.columns import Column, Supports, Variant
from warp_bounding.tables.rows import Key
from warp_bounding.tables.shapes import Shape

__all__ = ["Job", "TimeLeft", "plan"]


@dataclass(frozen=True)
class Job:
    """One bounder to fit, and the protocols to measure it under; each is one cell, one row of the CSV.

    Attributes:
        shape: The object.
        column: The query.
        variant: The method.
        space: That it is fitted in.
        protocols: To measure.
    """

    shape: Shape
    column: Column
    variant: Variant
    space: str
    protocols: tuple[str, ...]

    @property
    def name(self) -> str:
        """For a file: no part but the object's name holds a dot, so no two jobs share one."""
        return f"{self.column.name}.{self.shape.name}.{self.variant.slug}"

    @property
    def title(self) -> str:
        """For people."""
        return f"{self.column.name} {self.shape.name}: {self.variant.label}"

    def key(self, protocol: str) -> Key:
        """Of the row."""
        variant = self.variant
        about = (self.shape.ndim, self.shape.name, self.column.query, variant.method, self.space, variant.leaves)
        return (*about, protocol)


def plan(
    columns: Iterable[Column],
    variants: Iterable[Variant],
    shapes: Sequence[Shape],
    protocols: Sequence[str],
    supports: Supports,
    done: Collection[Key],
) -> tuple[list[Job], int]:
    """What is missing, and the number of cells with what is done.

    The first object of every column comes first, and in a column what is cheap: so that all columns show something soon,
    and what an interrupted run shows is the same objects for every method.

    Raises:
        BounderError: If no method can answer any of the columns' queries.
    """
    jobs, total = [], 0
    rank = {s: i for n in {s.ndim for s in shapes} for i, s in enumerate(s for s in shapes if s.ndim == n)}
    for column in columns:
        for variant in variants:
            space = variant.space_in(column, supports)
            if space is None:
                continue
            for shape in (s for s in shapes if s.ndim == column.ndim):
                job = Job(shape, column, variant, space, tuple(protocols))
                missing = tuple(p for p in protocols if job.key(p) not in done)
                total += len(protocols)
                if missing:
                    jobs.append(Job(shape, column, variant, space, missing))
    if not total:
        methods = ", ".join(dict.fromkeys(v.name for v in variants))
        raise BounderError(
            f"nothing to measure: {methods} cannot bound {', '.join(c.name for c in columns)} of these objects"
        )
    return sorted(jobs, key=lambda j: (rank[j.shape], j.variant.learned)), total


class TimeLeft:
    """Estimates the rest of a run: the budget for a learned fit, for everything else what it has taken so far."""

    GUESS = 3.0  # seconds of a cell, before any has been measured

    def __init__(self, jobs: Sequence[Job], budget: float, fitted: Collection[str] = ()):
        """Begin.

        Args:
            jobs: All of them, in order.
            budget: Seconds of a learned fit.
            fitted: Names of jobs whose bounder is there already.
        """
        self._budget, self._rest, self._fitted = budget, list(jobs), set(fitted)
        self._sums: dict[tuple, tuple[float, int]] = {}

    def drop(self, job: Job) -> None:
        """Forget a job that failed."""
        self._rest.remove(job)

    def finish(self, job: Job, fit_seconds: float, evaluate_seconds: float) -> None:
        """Take note of what a job took; a fit that was loaded takes 0."""
        self._rest.remove(job)
        each = evaluate_seconds / len(job.protocols)
        self._add(each, ("evaluate", job.column), ("evaluate",))
        if fit_seconds and not job.variant.learned:
            self._add(fit_seconds, ("fit", job.column, job.variant), ("fit", job.column), ("fit",))

    def _add(self, seconds: float, *keys: tuple) -> None:
        for key in keys:
            total, count = self._sums.get(key, (0.0, 0))
            self._sums[key] = total + seconds, count + 1

    def _mean(self, *keys: tuple) -> float:
        total, count = next((self._sums[k] for k in keys if k in self._sums), (self.GUESS, 1))
        return total / count

    def job(self, job: Job) -> float:
        """Seconds that a job may take."""
        fit = 0.0
        if job.name not in self._fitted:
            fit = self._budget
            if not job.variant.learned:
                fit = self._mean(("fit", job.column, job.variant), ("fit", job.column), ("fit",))
        return fit + len(job.protocols) * self._mean(("evaluate", job.column), ("evaluate",))

    @property
    def seconds(self) -> float:
        """Of all that is left."""
        return sum(map(self.job, self._rest))

    @property
    def text(self) -> str:
        """The same for people."""
        minutes = round(self.seconds / 60)
        if minutes < 1:
            return "under a minute left"
        hours, minutes = divmod(minutes, 60)
        return f"about {hours} h {minutes:02} min left" if hours else f"about {minutes} min left"
