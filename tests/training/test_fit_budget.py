"""The budget of bounders that are no networks; by what is passed on, and by a clock that has run out, not by seconds."""

import math
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
from bounding_shapes import object_points, shape

import warp_bounding as wb
from warp_bounding.bounders.bvh import Bvh, build
from warp_bounding.proof import prove
from warp_bounding.queries.domain import Domain

fit_module = import_module("warp_bounding.training.fit")  # the package has a function of that name


@pytest.mark.parametrize("name", ["c", "blob", "animated"])
def test_a_hierarchy_whose_time_is_over_has_fewer_boxes_and_is_proven(name, rng):
    grid = shape(name)
    whole = build(grid, 16)
    hurried = build(grid, 16, seconds=0.0)
    assert len(hurried.first) == 1 < len(whole.first)
    bounder = Bvh.fit(grid, Domain.of(grid), leaves=16, seconds=0.0, device="cpu")
    prove(bounder, grid)
    assert bounder.certificate.proven
    assert bounder.query(object_points(grid, rng, 1000)).numpy().all()


@pytest.mark.parametrize(
    ("options", "seconds"), [({}, 7.0), ({"method": "bvh+mlp", "hidden": (8,), "steps": 3}, math.inf)]
)
def test_the_budget_of_a_hierarchy(monkeypatch, options, seconds):
    """Where steps are given, the result is to be repeatable: no clock enters."""
    given, inner = [], Bvh.fit.__func__

    def recorded(cls, *arguments, **more):
        given.append(more["seconds"])
        return inner(cls, *arguments, **more)

    monkeypatch.setattr(Bvh, "fit", classmethod(recorded))
    wb.fit(shape("c"), **({"method": "bvh", "leaves": 4, "budget": 7.0, "device": "cpu"} | options))
    assert given == [pytest.approx(seconds, rel=0.01)]  # the proof has its share


@pytest.mark.parametrize("method", ["learned-kdop", "relu-field"])
def test_learned_closed_forms_leave_time_for_their_proof(monkeypatch, method):
    trainers = pytest.importorskip("warp_bounding.training.fit", reason="torch is not installed")
    given, real = [], trainers.TRAINERS[wb.METHODS[method]]

    def recorded(cls, problem, options, seconds, progress):
        given.append(seconds)
        return real.train(cls, problem, options, seconds, progress)

    monkeypatch.setitem(trainers.TRAINERS, wb.METHODS[method], replace(real, train=recorded))
    grid = shape("c")
    for seconds in (0.01, 1e9):
        monkeypatch.setattr(fit_module, "PROOF_SECONDS", seconds)
        wb.fit(grid, method=method, budget=4.0, steps=2, device="cpu")
    cells = int(np.sum(grid.occupancy))
    assert given[0] == pytest.approx(4.0 - min(2.0, 0.01 * cells))
    assert given[1] == pytest.approx(2.0)
