"""A resumable run of ``speed``: fit what is missing, then race all methods of a column, an object and a device together.

Every race has the reference among its methods, the network without exits. So what is added to a folder later, or was
missing when a run was killed, is compared with what is there by the ratio to the reference in the same round.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from paper.columns import COLUMNS, FITTED, ROWS, VARIANTS, Variant
from paper.plan import Job
from paper.run import Run
from paper.speed.race import device_name, race
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.queries import sample

__all__ = ["METHODS", "REFERENCE", "SpeedRun"]

REFERENCE = Variant(Mlp.method)
# What is raced where no methods are named: an occupancy network has the code of the reference, one with thresholds of parts
# nearly, and distances are asked otherwise.
METHODS = tuple(
    v.name for v in VARIANTS if v.conservative and v.leaves is None and v.method in ROWS and v.method not in FITTED
)
QUERY_SEED = 2  # added to the fits' for the queries of a race


class SpeedRun(Run):
    """Races the bounders of a selection; the protocols of its jobs are the Warp devices."""

    def __init__(self, *inputs):
        super().__init__(*inputs)
        order = {job.name: number for number, job in enumerate(self.jobs)}
        self.jobs.sort(key=lambda job: (COLUMNS.index(job.column), job.shape, order[job.name]))
        self._held: dict[str, tuple[Job, Any, float | None]] = {}

    def measure(self, job: Job, grid: Any) -> None:
        self._held[job.name] = (job, *self._bounder(job, grid))

    def cells(self, job: Job) -> list[str]:
        return [f"{job.title} ({device})" for device in job.protocols]

    def _try(self, job: Job) -> None:
        super()._try(job)
        place = self.jobs.index(job)
        behind = self.jobs[place + 1 :]
        if behind and (behind[0].column, behind[0].shape) == (job.column, job.shape):
            return
        held, self._held = list(self._held.values()), {}
        for device in dict.fromkeys(device for each, *_ in held for device in each.protocols):
            self._race([entry for entry in held if device in entry[0].protocols], device)

    def _race(self, held: list[tuple[Job, Any, float | None]], device: str) -> None:
        """Race the bounders of a column and an object on a device; a failure of one is a failure of all."""
        try:
            rows = self._raced(held, device)
        except Exception as error:  # such as memory that a device does not have: the other races go on
            for job, *_ in held:
                self.fail(replace(job, protocols=(device,)), f"{type(error).__name__}: {' '.join(str(error).split())}")
            return
        for job, bounder, measured in rows:
            self.add(job, bounder, **measured)

    def _raced(self, held: list[tuple[Job, Any, float | None]], device: str) -> list[tuple[Job, Any, dict[str, Any]]]:
        import warp as wp

        from warp_bounding.evaluation import evaluate

        first, settings = held[0][0], self.folder.settings
        grid = self._grids[first.shape]
        self.reporter.within(f"racing {len(held)} methods on {device}")
        reference = replace(first, variant=REFERENCE, space=str(REFERENCE.space_in(first.column)))
        entries = {job.name: (job, bounder, seconds) for job, bounder, seconds in held}
        if reference.name not in entries:
            entries[reference.name] = (reference, *self._bounder(reference, grid))
        rng = np.random.default_rng(settings.seed + QUERY_SEED)
        x = np.asarray(sample(first.column.query, grid, settings.queries, rng), dtype=np.float32)
        asked = {name: bounder.to(device) for name, (_, bounder, _) in entries.items()}
        times = race(asked, wp.array(x, device=device), settings.rounds, self.heed)
        rows = []
        for job, bounder, seconds in held:
            ratios = times[job.name] / times[reference.name]
            rates = evaluate(bounder, grid, settings.samples, seed=settings.fits.sample_seed)
            self.heed()
            measured = {
                "space": job.space,
                "leaves": job.variant.leaves,
                "device": device,
                "device_name": device_name(device),
                "ns": float(np.median(times[job.name])) / settings.queries * 1e9,
                "ratio": float(np.median(ratios)),
                "ratio_low": float(ratios.min()),
                "ratio_high": float(ratios.max()),
                "reference": REFERENCE.method,
                "fp_rate": float(rates.fp_rate),
                "fn": int(rates.fn),
                "positives": float(rates.positives),
                "nbytes": int(bounder.nbytes),
                "fit_seconds": None if seconds is None else round(seconds, 3),
            }
            rows.append((job, bounder, measured))
        return rows

    def _bounder(self, job: Job, grid: Any) -> tuple[Any, float | None]:
        """The bounder of a job, and the seconds that its fit took."""
        bounder = self.load(self.folder.bounder(job.file), grid)
        if bounder is None:
            last = None
            if job.variant.last != job.variant.method:  # the last part of a cascade is the same by itself
                last = self.load(self.folder.bounder(replace(job, variant=Variant(job.variant.last)).file), grid)
            bounder = self.fit(
                job, grid, lambda done, total=1.0, note="": self.reporter.within(f"fitting, {note}"), last
            )
        return bounder, (bounder.info.get("training") or {}).get("seconds")
