"""Honest bounders to be spoilt: every method and kind of query that it has, on small shapes in 2D, 3D and 4D (animated)."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from bounding_shapes import EARLY, HIDDEN, shape
from random_networks import random_monotone

import warp_bounding as wb
from warp_bounding.arithmetic import round_down
from warp_bounding.bounders import DISTANCES, METHODS, Bounder, Cascade, DistanceBounder
from warp_bounding.bounders.neural.mlp import Mlp
from warp_bounding.bounders.neural.mlp_early import MlpEarly
from warp_bounding.coordinates.region_domain import domain_of
from warp_bounding.proof import least_value
from warp_bounding.queries import QUERY_KINDS

SHAPES = ("c", "blob", "animated")
ACTIVATIONS = {"point": "sin", "ray": "relu", "plane": "tanh", "box": "sin"}
CASCADES = (
    ("point", "voxels+mlp"),
    ("plane", "learned-kdop+mlp"),
    ("box", "aabb+monotone-mlp"),
    ("ray", "kdop+mlp-early"),
)
DISTANT = {  # what distances are told, so that a fit takes no time to speak of
    "bvh": {"leaves": 6},
    "learned-kdop": {"steps": 4},
    "mlp": {"hidden": HIDDEN, "steps": 60},
    "distance-grid": {"nodes": 4},
}
LENGTH = 0.75
BOXES = 20_000  # of a search for a network's least value: what it has by then is proven


@dataclass(frozen=True)
class Subject:
    """One honest bounder, made when it is asked for."""

    name: str
    shape: str
    make: Callable[[], Bounder | DistanceBounder]

    @property
    def grid(self):
        return shape(self.shape)

    @property
    def bounder(self) -> Bounder | DistanceBounder:
        return _made(self)


@cache
def _made(subject: Subject) -> Bounder | DistanceBounder:
    bounder, digest = subject.make(), subject.grid.digest
    if isinstance(bounder, DistanceBounder):  # it may bound the cells in another metric
        digest = bounder.info["indicator"]
    bounder.info = {"indicator": digest, "margin": 0.0, "grid_shape": list(subject.grid.shape), "seed": 0}
    return bounder


def settled(bounder: Bounder, name: str) -> Bounder:
    """At the threshold that its proof gives."""
    least = least_value(bounder, shape(name), boxes=BOXES, eps=0.05).lower_bound
    return bounder.freeze(float(round_down(np.nextafter(least - bounder.rounding_bound(), -np.inf))), None)


def network(name: str, query: str, hidden=HIDDEN, seed: int = 0) -> Mlp:
    grid, rng, tensors = shape(name), np.random.default_rng(seed), {}
    domain, outputs = domain_of(grid, query, LENGTH), 2 if query == "plane" else 1
    inputs = grid.ndim if query in ("point", "plane") else domain.ndim
    for index, (k, h) in enumerate(zip((inputs, *hidden), (*hidden, outputs), strict=True)):
        tensors[f"layers.{index}.weight"] = (rng.normal(size=(h, k)) / np.sqrt(k)).astype(np.float32)
        tensors[f"layers.{index}.bias"] = rng.normal(size=h).astype(np.float32)
    return Mlp(domain, tensors, {"hidden": list(hidden), "activation": ACTIVATIONS[query], "octaves": 0}, "cpu")


def made(method: str, name: str, query: str) -> Bounder:
    """A bounder at its threshold."""
    grid, kind = shape(name), METHODS[method]
    domain = domain_of(grid, query, LENGTH)
    if method == "monotone-mlp":
        return settled(random_monotone(grid, HIDDEN), name)
    if method == "mlp-early":
        whole, first = network(name, query, EARLY), network(name, query, EARLY[:1])
        shared = {k: v for k, v in whole.tensors.items() if k.startswith("layers.0.")}
        first = Mlp(first.domain, first.tensors | shared, first.sizes, "cpu")
        return MlpEarly.of([settled(first, name), settled(whole, name)])
    if issubclass(kind, Mlp):
        return settled(network(name, query), name)
    return settled(kind.fit(grid, domain, device="cpu"), name)


def _maker(method: str, *which: str) -> Callable[[], Bounder]:
    return lambda: made(method, *which)


def _cascade(methods: str, name: str, query: str) -> Callable[[], Bounder]:
    return lambda: Cascade.of([made(method, name, query) for method in methods.split("+")])


def _distance(method: str, name: str, **options) -> Callable[[], DistanceBounder]:
    told = {"budget": 4.0, "metric": "spacetime", "device": "cpu", "progress": False}
    return lambda: wb.fit(shape(name), "distance", method, **told, **DISTANT.get(method, {}), **options)


def subjects() -> list[Subject]:
    """All of them."""
    found = []
    for name in SHAPES:
        for method, kind in METHODS.items():
            for query in QUERY_KINDS:
                if kind.conservative and kind.supports(query, shape(name).ndim):
                    found.append(Subject(f"{method} {query} {name}", name, _maker(method, name, query)))
        for method, kind in DISTANCES.items():
            if kind.supports(shape(name).ndim):
                found.append(Subject(f"{method} distance {name}", name, _distance(method, name)))
    found.append(Subject("mlp distance c in parts", "c", _distance(Mlp.method, "c", thresholds=20)))
    refined = _distance("distance-grid", "c", refine=4)
    found.append(Subject("distance-grid distance c refined", "c", refined))
    for query, methods in CASCADES:
        found.append(Subject(f"{methods} {query} c", "c", _cascade(methods, "c", query)))
    return found
