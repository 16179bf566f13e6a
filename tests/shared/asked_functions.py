"""Bounders of every kind, and kernels that ask the functions of one with the data of another."""

from functools import cache

import numpy as np
import warp as wp
from bounding_shapes import EARLY, HIDDEN, shape

from warp_bounding.bounders import METHODS
from warp_bounding.bounders.cascade import Cascade
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.kernels.functions import Data
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.runtime.native import vector_type

QUERIES = ("point", "ray", "plane", "box")
FEW = ("aabb", "bvh", "mlp")  # methods of regions: what tells data apart is the same text for all
FAR = 1e3  # outside of every domain


def network(kind: type[Mlp], query: str, device: str) -> Mlp:
    """Random weights; a monotone network's have the signs that make it one."""
    rng, tensors, early = np.random.default_rng(0), {}, kind.method == "mlp-early"
    domain, hidden = domain_of(shape("c"), query), EARLY if early else HIDDEN
    inputs, outputs = (2, 2) if query == "plane" else (domain.ndim, 1)
    for index, (k, h) in enumerate(zip((inputs, *hidden), (*hidden, outputs), strict=True)):
        weight = np.abs(rng.normal(size=(h, k))).astype(np.float32)
        weight[:, : k // 2] *= -1 if index == 0 else 1
        tensors[f"layers.{index}.weight"] = weight
        tensors[f"layers.{index}.bias"] = rng.normal(size=h).astype(np.float32)
    if early:
        tensors["exits.0.weight"] = rng.normal(size=(outputs, hidden[0])).astype(np.float32)
        tensors["exits.0.bias"] = rng.normal(size=outputs).astype(np.float32)
        tensors["exits.thresholds"] = np.array([-1.0], np.float32)
    activation = "tanh" if kind.method == "monotone-mlp" else "sin"
    return kind(domain, tensors, {"hidden": list(hidden), "activation": activation, "octaves": 0}, device)


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


@cache
def asking_kernel(test, query: str) -> wp.Kernel:
    vector = vector_type(2)

    @wp.kernel(module="unique", enable_backward=False)
    def query_point(data: Data, a: wp.array(dtype=vector), b: wp.array(dtype=vector), answer: wp.array(dtype=wp.uint8)):
        i = wp.tid()
        answer[i] = wp.uint8(test(data, a[i]))

    @wp.kernel(module="unique", enable_backward=False)
    def query_region(
        data: Data, a: wp.array(dtype=vector), b: wp.array(dtype=vector), answer: wp.array(dtype=wp.uint8)
    ):
        i = wp.tid()
        answer[i] = wp.uint8(test(data, a[i], b[i]))

    return query_point if query == "point" else query_region


def ask(bounder, data: Data) -> np.ndarray:
    """Answers of a bounder's function, given some data, to queries far away: with its own it certainly says no."""
    query, device = bounder.query_kind, bounder.device
    first = {"point": [FAR, FAR], "ray": [FAR, FAR], "plane": [1.0, 1.0], "box": [FAR, FAR]}[query]
    second = {"point": [FAR, FAR], "ray": [1.0, 1.0], "plane": [4.0, 4.0], "box": [FAR + 1, FAR + 1]}[query]
    a, b = (wp.array(np.float32([row] * 3), dtype=wp.vec2, device=device) for row in (first, second))
    answer = wp.full(3, 7, dtype=wp.uint8, device=device)
    wp.launch(asking_kernel(bounder.func, query), 3, [data, a, b], [answer], device=device)
    return answer.numpy()


def remade(data: Data, parameters: slice, words: slice) -> Data:
    """The data in memory of their own that holds no more than a part of them."""
    part = Data()
    part.parameters = wp.array(data.parameters.numpy()[parameters], dtype=wp.float32, device=data.parameters.device)
    part.words = wp.array(data.words.numpy()[words], dtype=wp.uint32, device=data.words.device)
    return part
