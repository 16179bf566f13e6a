"""What every demo is made of: an ``Example``, one run; and a ``Demo``, which runs it with and without bounders.

A demo tells a ``Demo`` its shapes, how their bounders are fitted, how a run begins and what is drawn. The rest is the
same for all: bounders are fitted or loaded, the runs take turns, step by step, so that whatever else the machine does
slows all of them alike, each is compared with the run without a broad phase, to the bit, and a table, a verdict,
pictures and JSON are made of it.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import warp as wp
from rich.console import Console

import warp_bounding as wb
from sims.assets import Shape, once
from sims.chosen import Taken
from sims.drawing import Drawn
from sims.prefitted import FitSpec, fitted
from sims.report import Run, bounder_rows, kept, output, result, run_table, shown, verdict

__all__ = ["Demo", "Example", "compare", "now", "simulate", "weakest"]


class Example(ABC):
    """One run of a simulation, in the manner of Newton's examples: ``step``, ``render``, ``test_final``.

    Attributes:
        seconds: Per step: broad phase, narrow phase, whole step.
        calls: Per step: what the narrow phase was called for.
        certificate: What stands in for a certificate where the broad phase is no bounder.
    """

    LOST: ClassVar[str] = "contacts were missed"
    DIFFER: ClassVar[str] = "the final states differ"

    def __init__(self):
        self.seconds: list[tuple[float, float, float]] = []
        self.calls: list[int] = []
        self.certificate = ""

    @abstractmethod
    def step(self) -> None:
        """One step, timed phase by phase."""

    @abstractmethod
    def render(self, folder: Path) -> list[Path]:
        """Draw what there is after the last step into a folder; returns the pictures."""

    def state(self) -> bytes:
        """All that the result consists of; a class that overrides ``identical`` needs none."""
        raise NotImplementedError

    @abstractmethod
    def missed(self, reference: "Example | None" = None) -> int:
        """Number of contacts, or of what else ``Demo.MISSED`` names, that this run should have found and did not.

        Args:
            reference: A run of the same length without a broad phase; ``None`` will do where a class checks its own
                states exactly and does not read it.
        """

    def identical(self, reference: "Example") -> bool:
        """Whether ``state()`` is the reference's, bit by bit, as a proven bounder leaves it."""
        return self.state() == reference.state()

    def milliseconds(self) -> tuple[float, float, float]:
        """Median per step: broad phase, narrow phase, whole step."""
        return tuple(1e3 * float(x) for x in np.median(self.seconds, axis=0))

    def extra(self, reference: "Example") -> dict[str, Any]:
        """More numbers for the table, beside those of ``report.Run``."""
        return {}

    def test_final(self, reference: "Example") -> None:
        """Check this run against one without a broad phase.

        Raises:
            AssertionError: If it lacks something that the reference has, or a bit of the result differs.
        """
        missed = self.missed(reference)
        assert missed == 0, f"{missed} {self.LOST}"
        assert self.identical(reference), self.DIFFER


def now(device: wp.Device) -> float:
    """Seconds, once a device has done all that it was asked to."""
    wp.synchronize_device(device)
    return time.perf_counter()


def simulate(what: str, phases: Mapping[str, Any], make: Callable[[Any, bool], Example], steps: int) -> dict[str, Any]:
    """The same run without a broad phase (``"none"``) and with each, from one state, in turns, step by step.

    Args:
        what: Name of the simulation, beside the progress bar.
        phases: Broad phases by name.
        make: ``make(broad_phase or None, warm_up)`` returns a run that has not begun; with ``warm_up`` a small one,
            whose only step loads the kernels.
        steps: Number of steps.

    Returns:
        The runs, finished.
    """
    phases = {"none": None, **phases}
    for phase in shown(phases.values(), "loading kernels (compiled at first use, a minute)"):
        make(phase, True).step()
    examples = {name: make(phase, False) for name, phase in phases.items()}
    for name, phase in phases.items():
        if phase is None and name != "none":
            examples[name].certificate = "by construction"  # where none is chosen, too
    for _ in shown(range(steps), f"{what}, {len(examples)} runs in turns"):
        for example in examples.values():
            example.step()
    return examples


def weakest(bounders: Iterable[wb.Bounder]) -> str:
    """The weakest kind of some bounders' certificates; empty where one has none, and for no bounders."""
    kinds = {bounder.certificate.kind if bounder.certificate else "" for bounder in bounders}
    return next((kind for kind in ("", "statistical", "proven") if kind in kinds), "")


def compare(
    examples: Mapping[str, Example],
    bounders: Mapping[str, Mapping[str, wb.Bounder]],
    rows: Iterable[Mapping[str, Any]] = (),
    section: str = "",
) -> list[Run]:
    """What runs cost and lost against ``"none"``, the reference.

    Args:
        examples: By name: of a method, with more words after a comma or not, or of two methods, joined by a plus.
        bounders: By name of the method, then of the shape.
        rows: What ``report.bounder_rows`` has returned; a run's rate of false positives is the mean over the shapes.
        section: The section of the table in which the runs are shown.
    """
    reference, runs = examples["none"], []
    for name, example in examples.items():
        method = name.split(",")[0]
        parts = [method] if method in bounders else method.split("+")
        own = [row for row in rows if row["bounder"] == method]
        run = Run(
            name,
            sum(example.calls),
            *example.milliseconds(),
            missed=example.missed(reference),
            identical=example.identical(reference),
            fp_rate=_mean(row["fp_rate"] for row in own),
            fp_rate_cells=_mean(row.get("fp_rate_cells") for row in own),
            certificate=example.certificate or weakest(b for p in parts for b in bounders.get(p, {}).values()),
            section=section,
            extra=example.extra(reference),
        )
        runs.append(run)
    return runs


def _mean(rates: Iterable[float | None]) -> float | None:
    """``None`` where a rate is missing, and for none."""
    rates = list(rates)
    return sum(rates) / len(rates) if rates and None not in rates else None


@dataclass
class Demo(ABC):
    """A whole demo: from its options to what it prints and returns.

    Attributes:
        out: Folder for pictures, and for bounders that are fitted; made if there is none.
        quick: A small form.
        refit: Fit the learned bounders anew, into ``out``, rather than load them.
        budget: Seconds to fit each learned bounder, where ``refit``; what its spec says if ``None``.
        bounder_file: A file to take ``mlp`` from, for the shape that it was made of; the others' stay.
        seed: Of fits, and of all that is random.
        device: Warp device; the default device if ``None``.
        console: Where tables and sentences go; standard output if ``None``. Progress goes to standard error.
        specs: By name, how to fit the bounders that are compared; ``SPECS``, the demo's own, if ``None``.
    """

    out: Path
    quick: bool = False
    refit: bool = False
    budget: float | None = None
    bounder_file: Path | None = None
    seed: int = 0
    device: str | None = None
    console: Console | None = None
    specs: dict[str, FitSpec] | None = None
    notes: list[str] = field(default_factory=list, init=False)  # broken promises beside those of the runs, with markup
    taken: dict[str, Taken] = field(default_factory=dict, init=False)  # what ``choose`` takes, by section

    NAME: ClassVar[str]
    SPECS: ClassVar[dict[str, FitSpec]]
    SCENES: ClassVar[str] = ""  # what the names of all shapes' files begin with
    SAMPLES: ClassVar[tuple[int, int]] = (400_000, 400_000)  # random queries of a rate of false positives: full, quick
    DISTANCES: ClassVar[
        dict[str, Any]
    ] = {}  # what bounders of distances are asked for that rate, in ``evaluate``'s words
    CALLS: ClassVar[str] = "narrow calls"  # what the narrow phase is called for
    MISSED: ClassVar[str] = "contacts"  # what must not be missed

    @classmethod
    def run(cls, out: Path, **options) -> dict[str, Any]:
        """Do the whole demo; its options are the attributes.

        Returns:
            JSON-ready: see ``report.result``, and what the demo's own ``more`` adds.

        Raises:
            BoundingError: For an impossible option, an unknown device, or a bounder that is missing or does not fit.
        """
        return cls(Path(out), **options)._run()

    def _run(self) -> dict[str, Any]:
        self.console = self.console or output()
        self.specs = self.SPECS if self.specs is None else self.specs
        shapes = {name: once(shape) for name, shape in self.set_up().items()}
        self.bounders = self.fit(shapes)
        reported = self.SAMPLES[self.quick], self.DISTANCES
        self.rows = {name: bounder_rows(self.of_shape(name), shape, *reported) for name, shape in shapes.items()}
        runs, title, columns = self.simulate()
        self.console.print(run_table(title, runs, steps=self.steps, calls=self.CALLS, extra=columns))
        self.console.print(verdict(runs, self.MISSED))
        for section, taken in self.taken.items():
            self.console.print(taken.sentence(section), markup=False)
        self.tell(runs)
        for _ in shown([None], "drawing"):  # once: the progress bar tells what takes so long
            drawn = self.draw()
        for note in self.notes:
            self.console.print(note)
        self.console.print(drawn.lines(), markup=False)
        reported = result(self.NAME, self.shape, self.steps, runs, drawn.paths, **self.more())
        if self.taken:
            reported["chosen"] = {section: taken.to_dict() for section, taken in self.taken.items()}
        return reported | {"identical": kept(runs) and not self.notes}

    def fit(self, shapes: dict[str, Shape]) -> dict[str, dict[str, wb.Bounder]]:
        """All bounders, fitted or loaded, by name of the method, then of the shape."""
        device = str(wp.get_device(self.device))
        return fitted(shapes, self.specs, scenes=self.SCENES, file=self.bounder_file, device=device, **self.fits)

    @property
    def fits(self) -> dict[str, Any]:
        """Options of ``prefitted.bounders_of``."""
        return {"refit": self.refit, "budget": self.budget, "out": self.out, "seed": self.seed}

    def choose(self, **sizes: tuple[int, int]) -> None:
        """Set each option that was not given to the first of its two values, or to the second one if ``quick``."""
        for name, values in sizes.items():
            if getattr(self, name) is None:
                setattr(self, name, values[self.quick])

    def of_shape(self, name: str) -> dict[str, wb.Bounder]:
        """The bounders of one shape, by name of the method."""
        return {method: found[name] for method, found in self.bounders.items() if name in found}

    @abstractmethod
    def set_up(self) -> dict[str, Shape]:
        """Check the options, set ``steps`` and ``shape`` (its name), make what runs share.

        Returns:
            What is bounded, by name: the shapes themselves, margins included.
        """

    @abstractmethod
    def simulate(self) -> tuple[list[Run], str, dict[str, str]]:
        """All runs, the title of their table, and its columns of ``Example.extra``, heads by key."""

    def tell(self, runs: list[Run]) -> None:  # noqa: B027  not all demos have more to say
        """Print more sentences."""

    @abstractmethod
    def draw(self) -> Drawn:
        """The pictures."""

    @abstractmethod
    def more(self) -> dict[str, Any]:
        """More keys of the JSON."""
