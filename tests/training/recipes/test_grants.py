"""Grants in training: they tell early what is *maybe* in the end, at a price that is kept, and change no promise."""

import numpy as np
import pytest
from bounding_shapes import shape

import warp_bounding as wb
from warp_bounding.kernels.source import GRANTED
from warp_bounding.queries import oracle, sample
from warp_bounding.training.recipes.early import COST

STEPS = {"point": 200, "ray": 100, "plane": 300, "box": 100}


@pytest.mark.parametrize("query", [pytest.param(q, marks=[pytest.mark.slow] * (q == "ray")) for q in STEPS])
def test_a_fit_grants_much_and_costs_little(query):
    grid = shape("c")
    bounder = wb.fit(grid, query, "mlp-early", hidden=(12, 10), steps=STEPS[query], device="cpu", progress=False)
    x = sample(query, grid, 100_000, np.random.default_rng(9)).astype(np.float32)
    truth = oracle(query, grid, "cpu", bounder.domain.oracle_length)(x)
    never = bounder.granting([], [GRANTED])
    assert never.threshold == bounder.threshold
    answers, before = bounder.query(x).numpy() != 0, never.query(x).numpy() != 0
    assert answers[truth].all()
    assert answers[before].all()
    granted = bounder.values(x).numpy() == np.float32(GRANTED)
    assert granted.mean() > 0.2 * before.mean()
    allowed = COST * (before & ~truth).sum()
    assert (answers & ~before).sum() <= allowed + 5 * np.sqrt(allowed) + 10  # other queries than those it was chosen by
    assert never.certificate == bounder.certificate
