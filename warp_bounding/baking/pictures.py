"""A picture of a shape and its bound: slices, pixel by pixel asked of both, without a display and without a renderer.

A pixel is object, *maybe*, or *no*. Of points and distances it is the point itself that is asked; of boxes one of the pixel's size, of rays the one
that starts there, along the slice's normal, of planes the one through it, across the way from the middle. A slice lies where the object is widest
among a few depths. An object of more dimensions is cut through its middle, and at the middle of its time.
"""

import io
from itertools import combinations

import numpy as np

from warp_bounding.bounders import Bounder, DistanceBounder
from warp_bounding.certificates.claim import as_fitted, in_local, of_side
from warp_bounding.evaluation.truth import PROTOCOLS, judge_of, truth_by
from warp_bounding.indicators import load_indicator
from warp_bounding.indicators.shape import OUT, Shape
from warp_bounding.queries.box import BOX
from warp_bounding.queries.distance import DISTANCE
from warp_bounding.queries.plane import PLANE
from warp_bounding.queries.point import POINT
from warp_bounding.queries.ray import RAY

__all__ = ["COLOURS", "picture"]

SIDE = 72  # pixels of a slice
GAP = 3  # pixels between slices
ROOM = 0.08  # of the longest side, around the object
DEPTHS = (0.5, 0.38, 0.62, 0.25, 0.75)  # where a slice may lie, as shares of the object's side; the first of equals
COARSE = 24  # pixels of a slice that is only looked at to find its depth
COLOURS = {"no": (0, 0, 0, 0), "maybe": (224, 122, 31, 255), "object": (45, 84, 122, 255)}  # RGBA; no is transparent
NO, MAYBE, OBJECT = range(3)


def picture(bounder: Bounder | DistanceBounder, source) -> bytes:
    """Draw slices of a shape and its bound, one for each pair of up to three axes, side by side.

    Args:
        bounder: Of any method and kind of query.
        source: What it bounds, as ``load_indicator`` takes it.

    Returns:
        A PNG with the colours ``COLOURS``; empty for objects of one dimension.
    """
    bounder, source = in_local(bounder, source)
    shape, truth, ask = _asked(bounder, source)
    axes = list(range(1 if shape.time else 0, shape.ndim))[:3]
    if len(axes) < 2:
        return b""
    slices = [_slice(bounder, shape, truth, ask, pair, axes) for pair in combinations(axes, 2)]
    wall = np.zeros((SIDE, GAP), np.uint8)
    parts = [part for piece in slices for part in (piece, wall)][:-1]
    return _png(np.hstack(parts))


def _asked(bounder, source):
    """The shape that is bounded, and functions from ``(N, m)`` queries to whether the truth, and the answer, is *yes* or *maybe*."""
    if isinstance(bounder, DistanceBounder):
        shape = load_indicator(source)
        shape = shape.dilated(bounder.info.get("margin") or 0.0) if isinstance(shape, Shape) else shape.to_grid()
        return shape, shape.contains, lambda x: bounder.query(x).numpy() != 0
    given = of_side(bounder, source)
    fitted = as_fitted(bounder, given)
    judge = judge_of(given, fitted, bounder.query_kind, PROTOCOLS[0])
    decide = truth_by(PROTOCOLS[0], bounder.query_kind, judge, bounder.device, bounder.domain.oracle_length, 0)
    return judge, lambda x: np.asarray(decide(x)) != OUT, lambda x: bounder.query(x).numpy() != 0


def _slice(bounder, shape: Shape, truth, ask, pair: tuple[int, int], axes: list[int]) -> np.ndarray:
    """``(SIDE, SIDE)`` of ``NO``, ``MAYBE`` and ``OBJECT``: the first axis of the pair to the right, the second one upwards."""
    lower, upper = shape.lower, shape.upper
    across = next((axis for axis in axes if axis not in pair), None)
    half = (0.5 + ROOM) * max(float((upper - lower)[list(pair)].max()), 1e-30)

    def points(side: int, depth: float) -> tuple[np.ndarray, float]:
        x = np.tile((lower + upper) / 2, (side * side, 1))
        steps = (np.arange(side) + 0.5) / side * 2 - 1
        x[:, pair[0]] += half * np.tile(steps, side)
        x[:, pair[1]] += half * np.repeat(-steps, side)  # the first row of a picture is the top one
        if across is not None:
            x[:, across] = lower[across] + depth * (upper - lower)[across]
        return x, 2 * half / side

    depth = DEPTHS[0]
    if across is not None:
        depth = max(DEPTHS, key=lambda d: int(shape.contains(points(COARSE, d)[0]).sum()))
    x, pixel = points(SIDE, depth)
    q = PIXELS[bounder.query_kind](x, pixel, pair, across, bounder).astype(np.float32)
    known = q.astype(np.float64)
    answers = np.where(truth(known), OBJECT, np.where(ask(q), MAYBE, NO))
    return answers.reshape(SIDE, SIDE).astype(np.uint8)


def _points(x, pixel, pair, across, bounder) -> np.ndarray:
    return x


def _boxes(x, pixel, pair, across, bounder) -> np.ndarray:
    reach = np.zeros(x.shape[1])
    reach[list(pair)] = pixel / 2
    return np.hstack([x - reach, x + reach])


def _rays(x, pixel, pair, across, bounder) -> np.ndarray:
    direction = np.zeros_like(x)
    direction[:, pair[1] if across is None else across] = 1.0
    return np.hstack([x, direction])


def _planes(x, pixel, pair, across, bounder) -> np.ndarray:
    normal = x - x.mean(axis=0)
    return np.hstack([normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30), x])


# What a pixel asks, by the kind of query.
PIXELS = {POINT.name: _points, RAY.name: _rays, PLANE.name: _planes, BOX.name: _boxes, DISTANCE.name: _points}


def _png(pixels: np.ndarray) -> bytes:
    from PIL import Image

    image = Image.fromarray(pixels, mode="P")
    image.putpalette([value for colour in COLOURS.values() for value in colour[:3]])
    file = io.BytesIO()
    image.save(file, "PNG", transparency=bytes(colour[3] for colour in COLOURS.values()), optimize=True)
    return file.getvalue()
