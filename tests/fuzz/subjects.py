"""Honest bounders to be spoilt: of every method, kind of query and of shape, either side, of parts."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
import trimesh
from bounding_shapes import HIDDEN, random_mlp
from bounding_shapes import shape as grid_named
from plain_shapes import balls_at

import warp_bounding as wb
from warp_bounding.bounders import DISTANCES, METHODS, Bounder, Cascade
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.proof import least_value
from warp_bounding.queries import QUERY_KINDS
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.rounding import round_down

SHAPES = ("c", "blob", "animated")
CASCADES = {"point": "voxels+mlp", "plane": "learned-kdop+bvh", "box": "aabb+bvh", "ray": "kdop+bvh"}
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
FAR = {"hidden": HIDDEN, "steps": 60, "budget": 4.0}
DILATED = {"margin": MARGIN}
FITTED = {  # of a mesh: query, method, and options of ``fit``
    "box": ("point", "aabb", {}),
    "half-spaces, dilated": ("point", "kdop", DILATED),
    "ball": ("point", "sphere", {}),
    "oriented box, dilated": ("point", "obb", DILATED),
    "network": ("point", "mlp", LEARNED),
    "network, dilated": ("point", "mlp", DILATED | LEARNED),
    "cells": ("point", "voxels", {"resolution": 8}),
    "hierarchy": ("point", "bvh", {"leaves": 6, "resolution": 8}),
    "cascade": ("point", "kdop+mlp", DILATED | LEARNED),
    "rays of a box": ("ray", "aabb", {"length": LENGTH}),
    "planes of half-spaces": ("plane", "kdop", DILATED),
    "boxes of a hierarchy": ("box", "bvh", {"leaves": 6, "resolution": 8}),
    "inside, network": ("point", "mlp", {"side": "inside", **LEARNED}),
    "inside, dilated": ("point", "mlp", {"side": "inside", **DILATED, **LEARNED}),
    "distance of a box": ("distance", "aabb", DILATED),
    "distance of a network": ("distance", "mlp", FAR),
    "distance of a network, dilated": ("distance", "mlp", DILATED | FAR),
    "distance by nodes": ("distance", "distance-grid", {"nodes": 4, "budget": 4.0}),
}
# of every other shape without cells: each kind of claim once
ALSO = ("network", "cells", "half-spaces, dilated", "network, dilated", "rays of a box", "inside, dilated")
ALSO = (*ALSO, "distance of a network, dilated")
# configurations of an arm have no dilation in metres, no rays and no distance
UNFIT = {"arm": ALSO[2:]}


def _mesh():
    corners = ([[0, 0, 0], [1, 0.4, 0.5]], [[0.6, 0.7, 0.1], [1, 1, 1]])
    made = trimesh.util.concatenate([trimesh.creation.box(bounds=box) for box in corners])
    return wb.shapes.Mesh(made.vertices, made.faces)


def _motion():
    made = trimesh.creation.box(bounds=[[0, 0, 0], [0.5, 0.4, 0.6]])
    keys = [made.vertices + np.array(way) for way in ([0, 0, 0], [0.5, 0, 0.2], [0.5, 0.6, 0])]
    return wb.shapes.MovingMesh(keys, made.faces, times=[0.0, 0.4, 1.0])


def _star(x: np.ndarray) -> np.ndarray:
    """A distance that changes no faster than 1: of two balls."""
    return np.minimum(np.linalg.norm(x - 0.4, axis=1) - 0.5, np.linalg.norm(x + 0.5, axis=1) - 0.4)


def _arm():
    elbow = np.eye(4)
    elbow[0, 3] = 0.6
    joints = [wb.arms.Joint(lower=-2.0, upper=2.5), wb.arms.Joint(elbow, lower=-2.2, upper=2.2)]
    links = [wb.arms.Body.capsule([0, 0, 0], [0.6, 0, 0], 0.06, link=k) for k in range(2)]
    corners = ([0.5, 0.3, -0.5], [0.9, 0.7, 0.5]), ([-0.9, -0.8, -0.5], [-0.5, 0.1, 0.5])
    return wb.arms.ArmConfigurations(wb.arms.Arm(joints, links), [wb.arms.Body.box(*each) for each in corners])


OTHERS: dict[str, Callable] = {
    "mesh": _mesh,
    "motion": _motion,
    "function": lambda: wb.shapes.Function(None, [-1.0, -1.0], [1.0, 1.0], distance=_star),
    "balls": lambda: balls_at(([0.0, 0.0, 0.0], 0.5), ([0.5, 0.6, 0.6], 0.4)),
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
    bounder.info = {"indicator": subject.grid.digest, "margin": 0.0, "grid_shape": list(subject.grid.shape), "seed": 0}
    return bounder


def resolved(bounder: Bounder, name: str) -> Bounder:
    """At the threshold that its proof gives."""
    least = least_value(bounder, shape(name), boxes=BOXES, eps=0.05).lower_bound
    return bounder.freeze(float(round_down(np.nextafter(least - bounder.rounding_bound(), -np.inf))), None)


def network(name: str, query: str, hidden=HIDDEN) -> Mlp:
    grid = shape(name)
    return random_mlp(grid, hidden, "sin", gain=1.0, domain=domain_of(grid, query, LENGTH))


def made(method: str, name: str, query: str) -> Bounder:
    """A bounder at its threshold."""
    grid, kind = shape(name), METHODS[method]
    fit = kind.fit if not issubclass(kind, Mlp) else lambda *_, **__: network(name, query)
    return resolved(fit(grid, domain_of(grid, query, LENGTH), device="cpu"), name)


def _cascade(methods: str, name: str, query: str) -> Bounder:
    return Cascade.of([made(method, name, query) for method in methods.split("+")])


def _fit(name: str, *which: str, **told) -> Bounder:
    return wb.fit(shape(name), *which, device="cpu", progress=False, **told)


def _distance(method: str, name: str) -> Bounder:
    return _fit(name, "distance", method, budget=4.0, **DISTANT.get(method, {}))


def subjects() -> list[Subject]:
    """All of them."""
    found = []
    for name in OTHERS:
        for what in FITTED if name == "mesh" else [each for each in ALSO if each not in UNFIT.get(name, ())]:
            query, method, told = FITTED[what]
            found.append(Subject(f"{method} {query} {name}: {what}", name, partial(_fit, name, query, method, **told)))
    for name in SHAPES:
        ndim = shape(name).ndim
        for method, kind in METHODS.items():
            for query in QUERY_KINDS:
                if kind.conservative and kind.supports(query, ndim):
                    found.append(Subject(f"{method} {query} {name}", name, partial(made, method, name, query)))
        for method, kind in DISTANCES.items():
            if kind.supports("distance", ndim) and not shape(name).time:
                found.append(Subject(f"{method} distance {name}", name, partial(_distance, method, name)))
    for query, methods in CASCADES.items():
        found.append(Subject(f"{methods} {query} c", "c", partial(_cascade, methods, "c", query)))
    return found
