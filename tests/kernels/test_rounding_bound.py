"""``rounding_bound`` against bounds that are derived from the C text of f, operation by operation (``tracked``)."""

from functools import partial

import numpy as np
import pytest
from bounding_shapes import NETWORKS, crossed, device_coordinates, random_bounder, random_mlp, shape
from distances import far
from tracked import tracked

import warp_bounding as wb
from warp_bounding.bounders import DISTANCES, METHODS
from warp_bounding.bounders.bounder import Bounder
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.rounding import UNIT32

FAULT = 20.0  # by how much a bound is too small in a test
WIDE = 2.0**10  # half-widths of the domain: distances that are asked anywhere are looked at so far


def threshold_at_median(bounder: Bounder) -> Bounder:
    v = np.random.default_rng(1).uniform(-1, 1, (500, bounder.domain.ndim)) * bounder.domain.limit
    return bounder.freeze(float(np.float32(np.median(bounder.reference(v)))), None)


def network(hidden: tuple[int, ...], activation: str) -> Mlp:
    """A network of random weights. Those of ReLU are positive: all terms then add up, which is E's worst case."""
    made = random_mlp(shape("c"), hidden, activation)
    tensors = made.tensors if activation == "sin" else {name: np.abs(value) for name, value in made.tensors.items()}
    return Mlp(made.domain, tensors, made.sizes, "cpu")


def joined() -> Bounder:
    return wb.cascade(*(threshold_at_median(random_bounder(method, "blob")) for method in ("kdop", "sphere", "mlp")))


MADE = {f"{method} {name}": partial(random_bounder, method, name) for method, name in crossed(METHODS, ["blob"])}
MADE |= {f"mlp {activation} {len(hidden)}": partial(network, hidden, activation) for hidden, activation in NETWORKS}
MADE |= {"cascade": joined}
MADE |= {f"distance {method}": partial(far, method, "blob") for method in DISTANCES}


def coordinates(bounder: Bounder, v: np.ndarray) -> np.ndarray:
    """Float32 numbers where f is asked, in the domain or anywhere; those that a device has where they are of points."""
    limit = bounder.domain.limit.astype(np.float64) * (WIDE if getattr(bounder.source, "whole", False) else 1.0)
    v = np.clip(v, -limit, limit)
    if bounder.query_kind == "point":
        v = device_coordinates(bounder, bounder.domain.to_object(v).astype(np.float32))
    return v[(np.abs(v) <= limit).all(axis=1)].astype(np.float32)


def allowed(bounder: Bounder, v: np.ndarray, f: np.ndarray) -> np.ndarray | float:
    """E, and of a distance that is asked anywhere what it grows by."""
    if not bounder.of_distances:
        return bounder.rounding_bound()
    return bounder.rounding_bound() + bounder.growth() * UNIT32 * (np.abs(v).astype(float).sum(axis=1) + np.abs(f))


def check(bounder: Bounder) -> None:
    """The derived bound of every query is within E, and so is what float32 is off by: the text's, and the kernel's."""
    rng, limit = np.random.default_rng(0), bounder.domain.limit.astype(np.float64)
    if getattr(bounder.source, "whole", False):
        limit = limit * WIDE
    v = rng.uniform(-1, 1, (3000, bounder.domain.ndim)) * limit * 2.0 ** -rng.integers(0, 30, (3000, 1))
    v[:1000] = np.sign(v[:1000]) * limit * rng.choice([1.0, 1 - 2.0**-20, 0.5, 2.0**-60], (1000, bounder.domain.ndim))
    v[1000:2000] = rng.uniform(-1, 1, (1000, bounder.domain.ndim)) * limit
    for _ in range(4):
        v = coordinates(bounder, v)
        computed, exact, within, derived, doubt = tracked(bounder, v)
        off, error = np.abs(computed - exact), allowed(bounder, v, computed)
        assert doubt.mean() < 0.1
        assert (off + within <= derived + 2 * within)[~doubt].all()  # the derivation holds
        assert (derived <= error)[~doubt].all()
        assert (off + within <= error)[~doubt].all()
        if bounder.query_kind == "point" and not bounder.of_distances:
            x = bounder.domain.to_object(v.astype(np.float64)).astype(np.float32)
            same = (device_coordinates(bounder, x) == v).all(axis=1) & ~doubt
            assert same.mean() > 0.3
            assert (np.abs(bounder.values(x).numpy() - exact) + within <= error)[same].all()
        worst = v[np.argsort(-np.where(doubt, 0.0, off))[:500]]  # around these it may be off by more
        steps = rng.normal(size=(6, *worst.shape)) * limit * 2.0 ** -rng.integers(2, 24, (6, len(worst), 1))
        v = (worst + steps).reshape(-1, worst.shape[1])


@pytest.mark.parametrize("name", MADE)
def test_what_the_text_rounds_is_within_the_bound(name):
    check(MADE[name]())


@pytest.mark.parametrize("name", MADE)
def test_a_bound_that_is_too_small_is_refused(name, monkeypatch):
    """As ``fit`` and ``certify`` take E from one method, neither would notice."""
    bounder = MADE[name]()
    true, kind = bounder.rounding_bound(), type(bounder)
    monkeypatch.setattr(kind, "rounding_bound", lambda self: true / FAULT)
    if bounder.of_distances:
        grows = bounder.growth()
        monkeypatch.setattr(kind, "growth", lambda self: grows / FAULT)
    if not true:  # f is one of a few numbers
        check(bounder)
        return
    with pytest.raises(AssertionError):
        check(bounder)
