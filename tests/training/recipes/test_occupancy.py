"""The symmetric loss learns the object, and errs both ways: that is why it is here."""

import numpy as np
import pytest
from bounding_shapes import shape

from warp_bounding.bounders.mlp import Occupancy
from warp_bounding.queries import oracle, sample
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.training.engine import (
    Clock,
    single_threaded_torch,
)
from warp_bounding.training.recipes.occupancy import OccupancyTrainer
from warp_bounding.training.samples import Problem

HIDDEN = (16, 16)


def occupancy(query: str, name: str, steps: int, octaves: int = 0, progress=None) -> Occupancy:
    grid = shape(name)
    domain = domain_of(grid, query)
    with single_threaded_torch():
        trainer = OccupancyTrainer(Problem(grid, domain, query, 0, "cpu"), HIDDEN, "sin", octaves)
        trainer.run(Clock(1.0, steps, progress))
        tensors = trainer.finish()
    return Occupancy(domain, tensors, {"hidden": list(HIDDEN), "activation": "sin", "octaves": octaves}, "cpu")


@pytest.mark.parametrize(("query", "name"), [("point", "c"), ("plane", "c"), ("box", "c"), ("ray", "c")])
def test_it_errs_both_ways_and_little(query, name):
    notes = []
    bounder = occupancy(query, name, 250, progress=lambda done, total, note: notes.append(note))
    x = sample(query, shape(name), 20_000, np.random.default_rng(1))
    truth = oracle(query, shape(name), "cpu")(x)
    inside = np.isfinite(bounder.domain.to_local(x)).all(axis=1)
    answers = bounder.reference(bounder.domain.to_local(x)) >= float(bounder.threshold)
    assert inside.all()
    false_positives, false_negatives = (answers & ~truth).mean(), (~answers & truth).mean()
    assert false_positives + false_negatives < 0.4 * min(truth.mean(), 1 - truth.mean())
    assert 0 < false_negatives < 0.1
    assert "FN" in notes[0]


def test_runs_in_steps_repeat():
    first, second = (occupancy("point", "blob", 10, octaves=1) for _ in range(2))
    assert first.features == 6
    assert all(first.tensors[name].tobytes() == second.tensors[name].tobytes() for name in first.tensors)
