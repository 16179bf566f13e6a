"""Honest bounders to be spoilt: every method and kind of query on small grids in 2D, 3D and 4D (animated), and what
``load`` accepts
besides: bounders of meshes, motions, blend shapes, functions, solids and arms, of either side, dilated, in parts, and
    of several parts.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import trimesh
from bounding_shapes import EARLY, HIDDEN
from bounding_shapes import shape as grid_named
from random_networks import random_monotone

import warp_bounding as wb
from warp_bounding.bounders import DISTANCES, METHODS, Bounder, Cascade, DistanceBounder
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.bounders.mlp_early import MlpEarly
from warp_bounding.proof import least_value
from warp_bounding.queries import QUERY_KINDS
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.rounding import round_down

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

MARGIN = 0.02
LEARNED = {"hidden": HIDDEN, "steps": 5}  # of a fit
FITTED = {  # of a mesh: query, method, and options of ``fit``
    "box": ("point", "aabb", {}),
    "half-spaces, dilated": ("point", "kdop", {"margin": MARGIN}),
    "ball": ("point", "sphere", {}),
    "oriented box, dilated": ("point", "obb", {"margin": MARGIN}),
    "network": ("point", "mlp", LEARNED),
    "network, dilated": ("point", "mlp", {"margin": MARGIN, **LEARNED}),
    "exits": ("point", "mlp-early", {"hidden": EARLY, "steps": 5}),
    "parts": ("point", "mlp", {"thresholds": 8, **LEARNED}),
    "cells": ("point", "voxels", {"resolution": 8}),
    "hierarchy": ("point", "bvh", {"leaves": 6, "resolution": 8}),
    "cascade": ("point", "kdop+mlp", {"margin": MARGIN, **LEARNED}),
    "rays of a box": ("ray", "aabb", {"length": LENGTH}),
    "planes of half-spaces": ("plane", "kdop", {"margin": MARGIN}),
    "boxes of a network": ("box", "mlp", {"resolution": 8, **LEARNED}),
    "inside, network": ("point", "mlp", {"side": "inside", **LEARNED}),
    "inside, dilated": ("point", "mlp", {"side": "inside", "margin": MARGIN, **LEARNED}),
    "distance of a box": ("distance", "aabb", {"margin": MARGIN}),
    "distance of a network": ("distance", "mlp", {"hidden": HIDDEN, "steps": 60, "budget": 4.0}),
    "distance of a network, dilated": (
        "distance",
        "mlp",
        {"margin": MARGIN, "hidden": HIDDEN, "steps": 60, "budget": 4.0},
    ),
    "distance by nodes": ("distance", "distance-grid", {"nodes": 4, "budget": 4.0}),
}
ALSO = (  # of every other shape without cells: each kind of claim once
    "half-spaces, dilated",
    "network",
    "network, dilated",
    "parts",
    "cells",
    "rays of a box",
    "inside, dilated",
    "distance of a network, dilated",
)
UNFIT = {
    "blend": ("distance of a network, dilated",),  # it has none
    # configurations of an arm have no dilation in metres, and no rays; a distance would be one between joint values
    "arm": (
        "half-spaces, dilated",
        "network, dilated",
        "rays of a box",
        "inside, dilated",
        "distance of a network, dilated",
    ),
}


def _two_boxes() -> trimesh.Trimesh:
    corners = ([[0, 0, 0], [1, 0.4, 0.5]], [[0.6, 0.7, 0.1], [1, 1, 1]])
    return trimesh.util.concatenate([trimesh.creation.box(bounds=box) for box in corners])


def _mesh():
    made = _two_boxes()
    return wb.shapes.Mesh(made.vertices, made.faces)


def _motion():
    made = trimesh.creation.box(bounds=[[0, 0, 0], [0.5, 0.4, 0.6]])
    keys = [made.vertices + np.array(way) for way in ([0, 0, 0], [0.5, 0, 0.2], [0.5, 0.6, 0])]
    return wb.shapes.MovingMesh(keys, made.faces, times=[0.0, 0.4, 1.0])


def _blend_shapes():
    made = trimesh.creation.box(bounds=[[0, 0, 0], [0.5, 0.4, 0.6]])
    return wb.shapes.BlendShapes(
        made.vertices, [made.vertices * [1.0, 0.0, 0.3]], made.faces, lower=[-0.4], upper=[0.8]
    )


def _star(x: np.ndarray) -> np.ndarray:
    """A distance that changes no faster than 1: of two balls."""
    return np.minimum(np.linalg.norm(x - 0.4, axis=1) - 0.5, np.linalg.norm(x + 0.5, axis=1) - 0.4)


def _arm():
    elbow = np.eye(4)
    elbow[0, 3] = 0.6
    joints = [wb.arms.Joint(lower=-2.0, upper=2.5), wb.arms.Joint(elbow, lower=-2.2, upper=2.2)]
    links = [wb.arms.Body.capsule([0, 0, 0], [0.6, 0, 0], 0.06, link=k) for k in range(2)]
    obstacles = [
        wb.arms.Body.box([0.5, 0.3, -0.5], [0.9, 0.7, 0.5]),
        wb.arms.Body.box([-0.9, -0.8, -0.5], [-0.5, 0.1, 0.5]),
    ]
    return wb.arms.ArmConfigurations(wb.arms.Arm(joints, links), obstacles)


OTHERS: dict[str, Callable] = {
    "mesh": _mesh,
    "motion": _motion,
    "blend": _blend_shapes,
    "function": lambda: wb.shapes.Function(None, [-1.0, -1.0], [1.0, 1.0], distance=_star),
    "solid": lambda: wb.shapes.Sphere([0.0, 0.0, 0.0], 0.5) | wb.shapes.Box([0.2, 0.2, 0.2], [0.8, 0.9, 1.0]),
    "arm": _arm,
}


@cache
def shape(name: str):
    """A grid of ``bounding_shapes``, or one of ``OTHERS``."""
    return OTHERS[name]() if name in OTHERS else grid_named(name)


@dataclass(frozen=True)
class Subject:
    """One honest bounder, made when it is requested."""

    name: str
    shape: str
    make: Callable[[], Bounder]

    @property
    def grid(self):
        return shape(self.shape)

    @property
    def bounder(self) -> Bounder:
        return _made(self)


@cache
def _made(subject: Subject) -> Bounder:
    bounder = subject.make()
    if subject.shape in OTHERS:  # ``fit`` has told what it bounds
        return bounder
    digest = subject.grid.digest
    if bounder.of_distances:  # it may bound the cells in another metric
        digest = bounder.info["indicator"]
    bounder.info = {"indicator": digest, "margin": 0.0, "grid_shape": list(subject.grid.shape), "seed": 0}
    return bounder


def resolved(bounder: Bounder, name: str) -> Bounder:
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
        return resolved(random_monotone(grid, HIDDEN), name)
    if method == "mlp-early":
        whole, first = network(name, query, EARLY), network(name, query, EARLY[:1])
        shared = {k: v for k, v in whole.tensors.items() if k.startswith("layers.0.")}
        first = Mlp(first.domain, first.tensors | shared, first.sizes, "cpu")
        return MlpEarly.of([resolved(first, name), resolved(whole, name)])
    if issubclass(kind, Mlp):
        return resolved(network(name, query), name)
    return resolved(kind.fit(grid, domain, device="cpu"), name)


def _maker(method: str, *which: str) -> Callable[[], Bounder]:
    return lambda: made(method, *which)


def _cascade(methods: str, name: str, query: str) -> Callable[[], Bounder]:
    return lambda: Cascade.of([made(method, name, query) for method in methods.split("+")])


def _distance(method: str, name: str, **options) -> Callable[[], DistanceBounder]:
    told = {"budget": 4.0, "metric": "spacetime", "device": "cpu", "progress": False}
    return lambda: wb.fit(shape(name), "distance", method, **told, **DISTANT.get(method, {}), **options)


def _fit(name: str, query: str, method: str, **told) -> Callable[[], Bounder]:
    return lambda: wb.fit(shape(name), query, method, device="cpu", progress=False, **told)


def _hierarchy(name: str) -> Callable[[], Bounder]:
    return lambda: wb.hierarchy(shape(name), method="aabb", leaves=3, margin=MARGIN, device="cpu", progress=False)


def _without_cells() -> list[Subject]:
    """Bounders of shapes that are no grids."""
    found = []
    for name in OTHERS:
        for what in (what for what in (FITTED if name == "mesh" else ALSO) if what not in UNFIT.get(name, ())):
            query, method, told = FITTED[what]
            found.append(Subject(f"{method} {query} {name}: {what}", name, _fit(name, query, method, **told)))
    found += [
        Subject(f"union point {name}: hierarchy of boxes", name, _hierarchy(name)) for name in ("solid", "function")
    ]
    return found


def subjects() -> list[Subject]:
    """All of them."""
    found = _without_cells()
    for name in SHAPES:
        for method, kind in METHODS.items():
            for query in QUERY_KINDS:
                if kind.conservative and kind.supports(query, shape(name).ndim):
                    found.append(Subject(f"{method} {query} {name}", name, _maker(method, name, query)))
        for method, kind in DISTANCES.items():
            if kind.supports("distance", shape(name).ndim):
                found.append(Subject(f"{method} distance {name}", name, _distance(method, name)))
    found.append(Subject("mlp distance c in parts", "c", _distance(Mlp.method, "c", thresholds=20)))
    refined = _distance("distance-grid", "c", refine=4)
    found.append(Subject("distance-grid distance c refined", "c", refined))
    for query, methods in CASCADES:
        found.append(Subject(f"{methods} {query} c", "c", _cascade(methods, "c", query)))
    return found
