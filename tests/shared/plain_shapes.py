"""Balls, boxes and tori as functions, in any number of dimensions; all can be pickled."""

from functools import partial

import numpy as np

import warp_bounding as wb

TETRAHEDRON = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
LEANING = np.array([[0, 0, 0], [1, 0, 0.1], [0, 1.2, 0], [0.2, 0, 0.7]], np.float32)  # vertices of another one


def within(lower, upper, rng, *count: int) -> np.ndarray:
    """Points of boxes ``(N, n)``, most of their coordinates on faces: ``(*count, N, n)``."""
    share = rng.random((*count, *lower.shape))
    share = np.where(rng.random(share.shape) < 0.5, np.round(share), share)
    return np.clip(lower + share * (upper - lower), lower, upper)


def _beyond(lower, upper, a, b):
    """How far boxes lie beyond another box, by axis; below 0 where they overlap."""
    return np.maximum(lower - b, a - upper)


def _to_balls(centers, radii, x):
    return (np.linalg.norm(x[:, None] - centers, axis=2) - radii).min(axis=1)


def _free_of_balls(centers, radii, a, b):
    away = np.maximum(_beyond(a[:, None], b[:, None], centers, centers), 0.0)
    return (np.linalg.norm(away, axis=2) > radii * (1 + 1e-12)).all(axis=1)


def balls_at(*parts, **options) -> wb.shapes.Function:
    """Balls in one; parts are centres ``(n,)`` and radii."""
    centers, radii = (np.array(column, dtype=float) for column in zip(*parts, strict=True))
    low, high = (centers - radii[:, None]).min(axis=0), (centers + radii[:, None]).max(axis=0)
    told = {"distance": partial(_to_balls, centers, radii), "empty": partial(_free_of_balls, centers, radii)}
    return wb.shapes.Function(
        None, np.nextafter(low, -np.inf), np.nextafter(high, np.inf), **{"name": "ball"} | told | options
    )


def ball_at(center, radius: float, **options) -> wb.shapes.Function:
    return balls_at((center, radius), **options)


def _to_box(lower, upper, x):
    beyond = _beyond(x, x, lower, upper)
    return np.where((beyond > 0).any(axis=1), np.linalg.norm(np.maximum(beyond, 0), axis=1), beyond.max(axis=1))


def _free_of_box(lower, upper, a, b):
    return (_beyond(a, b, lower, upper) > 0).any(axis=1)


def box_of(lower, upper) -> wb.shapes.Function:
    corners = np.array([lower, upper], dtype=float)
    told = {"distance": partial(_to_box, *corners), "empty": partial(_free_of_box, *corners)}
    return wb.shapes.Function(None, *corners, name="box", **told)


def _to_torus(center, major, minor, x):
    x = x - center
    return np.hypot(np.linalg.norm(x[:, :-1], axis=1) - major, x[:, -1]) - minor


def torus_at(center, major: float, minor: float) -> wb.shapes.Function:
    """About the last axis."""
    reach = np.full(len(center), major + minor)
    reach[-1] = minor
    reach, distance = np.nextafter(reach, np.inf), partial(_to_torus, np.array(center, dtype=float), major, minor)
    return wb.shapes.Function(None, center - reach, center + reach, name="torus", distance=distance)
