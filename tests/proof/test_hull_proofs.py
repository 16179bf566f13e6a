"""Volumes of points around a mesh are proven over its hull: what a search brackets is decided, and no point is lost."""

from functools import cache

import numpy as np
import pytest
import trimesh

import warp_bounding as wb
from warp_bounding.indicators.parts import Clipped, Complement
from warp_bounding.proof.prove import least_value
from warp_bounding.proof.search.best_first import minimum
from warp_bounding.proof.search.vacancy import ShapePositives
from warp_bounding.queries.boundary import border_points

VOLUMES = ("aabb", "obb", "sphere", "ellipsoid", "oriented-ellipsoid", "kdop", "learned-kdop")
MARGINS = (0.0, 0.05)
EPS = 2e-3  # of f, in the search
CERTAIN = 1e-9  # of f: what float64 makes of values that are compared


@cache
def mesh(margin: float = 0.0) -> wb.IndicatorMesh:
    """A ball and a turned bar that sticks out of it, in coordinates far from 0 and with unequal sides."""
    ball, bar = trimesh.creation.icosphere(2, 0.4), trimesh.creation.box((1.6, 0.2, 0.3))
    bar.apply_transform(trimesh.transformations.rotation_matrix(0.7, (1, 2, 3)))
    both = trimesh.util.concatenate([ball, bar])
    return wb.IndicatorMesh(np.asarray(both.vertices) + np.array([3.0, -2.0, 0.5]), both.faces).dilated(margin)


@cache
def fitted(method: str, margin: float) -> wb.Bounder:
    options = {"steps": 50} if method == "learned-kdop" else {}
    return wb.fit(mesh(), "point", method, margin=margin, device="cpu", progress=False, **options)


@pytest.mark.parametrize("margin", MARGINS)
@pytest.mark.parametrize("method", VOLUMES)
def test_the_hull_decides_what_a_search_brackets(method, margin):
    bounder, shape = fitted(method, margin), mesh(margin)
    positives = ShapePositives(bounder, shape)
    points = bounder.domain.to_local(border_points(shape, 4096, np.random.default_rng(1)))
    searched = minimum(positives, *positives.boxes(), eps=EPS, points=points, positives=positives, boxes=100_000)
    hull = least_value(bounder, shape)
    assert searched.lower_bound <= hull.lower_bound <= searched.upper_bound + CERTAIN
    assert hull.boxes < 200
    assert bounder.certificate.lower_bound == hull.lower_bound


@pytest.mark.parametrize("margin", MARGINS)
@pytest.mark.parametrize("method", VOLUMES)
def test_no_point_of_the_object_is_denied(method, margin):
    bounder, shape = fitted(method, margin), mesh(margin)
    assert bounder.certificate.proven
    rng = np.random.default_rng(2)
    corner = shape.corners()[rng.integers(len(shape.corners()), size=20_000)]
    away = rng.normal(size=corner.shape)
    far = corner + margin * (1 - 1e-6) * away / np.linalg.norm(away, axis=1, keepdims=True)
    points = np.concatenate([far, shape.points(20_000, rng)]).astype(np.float32)
    points = points[shape.contains(points)]
    assert len(points) > 20_000
    assert (bounder.query(points).numpy() == 1).all()


@pytest.mark.parametrize("margin", MARGINS)
@pytest.mark.parametrize("method", VOLUMES)
def test_certify_decides_over_the_hull_and_still_refutes(method, margin):
    bounder, shape = fitted(method, margin), mesh()
    assert wb.certify(bounder, shape).proven
    lifted = bounder.to("cpu").freeze(float(bounder.threshold) + 0.05, None)
    found = wb.certify(lifted, shape, seconds=60)
    assert found.kind == "refuted"
    assert mesh(margin).contains(np.float32(found.counterexample)[None])[0]


def test_the_shape_is_asked_about_no_box(monkeypatch):
    def refuse(*_):
        raise AssertionError("a box was asked about")

    monkeypatch.setattr(wb.IndicatorMesh, "empty", refuse)
    for method in VOLUMES:
        assert wb.certify(fitted(method, MARGINS[1]), mesh()).proven


def test_thresholds_leave_rounding_and_nothing_else():
    for method in VOLUMES:
        bounder = fitted(method, MARGINS[1])
        rounding = bounder.rounding_bound()
        slack = bounder.certificate.lower_bound - float(bounder.threshold)
        assert rounding <= slack <= rounding * 1.01 + 2e-7


def test_other_shapes_are_searched_as_ever():
    bounder = fitted("kdop", MARGINS[0])
    low, high = mesh().lower, mesh().upper
    assert bounder.exact_on_hull(mesh())
    for shape in (wb.solids.Sphere([0, 0, 0], 1.0), Complement(mesh()), Clipped(mesh(), low, (low + high) / 2)):
        assert not bounder.exact_on_hull(shape)


@pytest.mark.parametrize("method", ["sphere", "ellipsoid", "oriented-ellipsoid"])
def test_ellipsoids_touch_the_dilated_hull(method):
    """The volume is about that around very many points of the dilated hull, and its threshold takes hardly more than 1."""
    bounder, shape = fitted(method, MARGINS[1]), mesh(MARGINS[1])
    assert -1.001 < float(bounder.threshold) <= -0.99
    away = trimesh.creation.icosphere(3, MARGINS[1]).vertices
    points = (shape.corners()[:, None] + away).reshape(-1, 3)
    reference = bounder.reference(bounder.domain.to_local(points)).min()
    assert float(bounder.threshold) <= reference <= float(bounder.threshold) + 2e-3
