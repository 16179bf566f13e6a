"""Bounders of every kind, and kernels that ask the functions of one with the data of another."""

from functools import cache

import numpy as np
import warp as wp
from asking import asking_kernel
from bounding_shapes import EARLY, HIDDEN, random_mlp, shape

from warp_bounding.bounders import METHODS
from warp_bounding.bounders.cascade import Cascade
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.kernels.functions import Data
from warp_bounding.queries.region_domain import domain_of

QUERIES = ("point", "ray", "plane", "box")
FEW = ("aabb", "bvh", "mlp")  # methods of regions: what tells data apart is the same text for all
FAR = 1e3  # outside of every domain


def network(kind: type[Mlp], query: str, device: str) -> Mlp:
    early, domain = kind.method == "mlp-early", domain_of(shape("c"), query)
    made = random_mlp(None, EARLY if early else HIDDEN, domain=domain)
    tensors, outputs = dict(made.tensors), made.head.outputs
    if early:
        tensors["exits.0.weight"] = np.ones((outputs, EARLY[0]), np.float32)
        tensors["exits.0.bias"] = np.ones(outputs, np.float32)
        tensors["exits.thresholds"] = np.array([-1.0], np.float32)
    return kind(domain, tensors, made.sizes, device)


@cache
def bounders(query: str, device: str) -> dict:
    """One of every method of points, of a few of regions, and cascades; equal sources once."""
    found = {}
    for method, kind in METHODS.items():
        if not kind.supports(query, 2) or (query != "point" and method not in FEW):
            continue
        if issubclass(kind, Mlp):
            found[method] = network(kind, query, device)
        else:
            found[method] = kind.fit(shape("c"), domain_of(shape("c"), query), device=device)
    found["aabb+mlp"] = Cascade.of([found["aabb"], found["mlp"]])
    if query == "point":
        found["voxels+mlp"] = Cascade.of([found["voxels"], found["mlp"]])
    return {bounder.source: bounder for bounder in found.values()}


def ask(bounder, data: Data) -> np.ndarray:
    """Answers of a bounder's function, given some data, to queries far away: with its own it certainly says no."""
    query, device = bounder.query_kind, bounder.device
    first = {"point": [FAR, FAR], "ray": [FAR, FAR], "plane": [1.0, 1.0], "box": [FAR, FAR]}[query]
    second = {"point": [FAR, FAR], "ray": [1.0, 1.0], "plane": [4.0, 4.0], "box": [FAR + 1, FAR + 1]}[query]
    a, b = (wp.array(np.float32([row] * 3), dtype=wp.vec2, device=device) for row in (first, second))
    answer, given = wp.zeros(3, dtype=wp.uint8, device=device), [a] if query == "point" else [a, b]
    wp.launch(asking_kernel(bounder.func, 2, query != "point"), 3, [data, *given], [answer], device=device)
    return answer.numpy()


def remade(data: Data, parameters: slice, words: slice) -> Data:
    """The data in memory of their own that holds no more than a part of them."""
    part = Data()
    part.parameters = wp.array(data.parameters.numpy()[parameters], dtype=wp.float32, device=data.parameters.device)
    part.words = wp.array(data.words.numpy()[words], dtype=wp.uint32, device=data.words.device)
    return part
