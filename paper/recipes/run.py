"""A resumable run of ``recipes``: fits of the same network in different ways, in the same time; a row for each at once."""

from typing import Any

from paper.columns import COLUMNS
from paper.plan import Job
from paper.proofs import Thresholds
from paper.recipes.rows import WAYS
from paper.run import Run
from warp_bounding.bounders.mlp import RECIPES, Mlp
from warp_bounding.errors import BounderError

__all__ = ["POINTS", "RecipeRun", "steps_asked"]

POINTS = tuple(c for c in COLUMNS if not c.kind.is_region)  # what is compared where no columns are named


def steps_asked(recipe: str) -> int | None:
    """Steps that a recipe asks for at least: of the paper's, a first stage and those in which all must be well."""
    from warp_bounding.training.recipes.paper import PaperRecipe

    if recipe == RECIPES[0]:
        return None
    paper = PaperRecipe()
    return (1 + paper.stable) * paper.stage


class RecipeRun(Run):
    """Fits the networks of a selection; the protocols of its jobs are the ways of training."""

    def cells(self, job: Job) -> list[str]:
        return [f"{job.title} ({way})" for way in job.protocols]

    def measure(self, job: Job, grid: Any) -> None:
        for way in job.protocols:
            self._measure(job, grid, way)

    def _measure(self, job: Job, grid: Any, name: str) -> None:
        from warp_bounding.training import fit

        settings, query, way = self.folder.settings, job.column.kind, WAYS[name]
        options = {"length": settings.length} if query.has_length else {}
        bounder = fit(
            grid,
            query.name,
            Mlp.method,
            budget=settings.seconds,
            seed=settings.seed,
            hidden=job.column.hidden,
            recipe=way.recipe,
            octaves=way.octaves,
            device=settings.fits.device,
            progress=lambda done, total=1.0, note="": self.reporter.within(f"{name}: {note}"),
            **options,
        )
        self.heed()
        told = bounder.info["training"]
        if not told["steps"]:
            raise BounderError(f"{name}: not a single step in {settings.seconds:g} s; give it more")
        rates = Thresholds.of(bounder, grid, settings.samples, settings.fits.sample_seed)
        spent = told["seconds"] - told.get("compile_seconds", 0.0)
        proof = float(bounder.certificate.seconds) if bounder.certificate else 0.0
        threshold = float(bounder.threshold)
        self.add(
            job,
            bounder,
            way=name,
            steps=int(told["steps"]),
            steps_asked=steps_asked(way.recipe),
            step_seconds=max(spent - proof, 0.0) / told["steps"],
            fp_rate=rates.fp(threshold),
            fn=rates.fn(threshold),
            fp_zero=rates.fp(0.0),
            fn_zero=rates.fn(0.0),
            positives=100 * float(rates.truth.mean()),
            fit_seconds=round(told["seconds"], 3),
            nbytes=int(bounder.nbytes),
            hidden="-".join(map(str, job.column.hidden)),
        )
