"""Closed forms against brute force: how far is a volume, as dense points of it tell?"""

import numpy as np
import pytest
from distances import far, points_around, thing

from warp_bounding.bounders.ellipsoids import NEWTON_STEPS
from warp_bounding.bounders.volumes import frame_norm


def brute(bounder, x: np.ndarray, count: int = 400_000) -> np.ndarray:
    """About the distance from points to the volume: to the nearest of many points in it, all of them certainly in it."""
    from scipy.spatial import cKDTree

    volume, rng = bounder.volume, np.random.default_rng(5)
    limit = volume.domain.limit.astype(np.float64)
    v = rng.uniform(-limit, limit, (count, volume.ndim)) * 2.5
    v = v[volume.reference(v) >= float(volume.threshold)]
    # to the border, along lines between points in the volume and others: bisection
    out = rng.uniform(-limit, limit, (len(v), volume.ndim)) * 4
    low, high = np.zeros(len(v)), np.ones(len(v))
    for _ in range(40):
        t = (low + high) / 2
        held = volume.reference(v + t[:, None] * (out - v)) >= float(volume.threshold)
        low, high = np.where(held, t, low), np.where(held, high, t)
    border = volume.domain.to_object(v + low[:, None] * (out - v))
    return cKDTree(np.concatenate([border, volume.domain.to_object(v)])).query(x)[0]


@pytest.mark.parametrize(
    ("method", "share"),
    [("aabb", 1e-9), ("obb", 1e-5), ("sphere", 1e-5), ("ellipsoid", 2e-3), ("oriented-ellipsoid", 2e-3), ("bvh", 1e-5)],
)
@pytest.mark.parametrize("name", ["c", "tetrahedron", "blob"])
def test_exact_forms(method, share, name, rng):
    """No point of the volume is nearer than F says, and none but a little farther is the nearest one."""
    bounder = far(method, name)
    x = points_around(thing(name), 200, rng).astype(np.float64)
    exact, dense = bounder.exact(x), brute(bounder, x)
    size = float(thing(name).extent.max())
    outside = dense > 0.05 * size
    assert (exact[outside] <= dense[outside] * (1 + 1e-12)).all()
    spacing = 0.05 * size  # of the dense points
    assert (dense[outside] <= exact[outside] * (1 + share) + spacing).all()


@pytest.mark.parametrize("method", ["kdop", "learned-kdop"])
@pytest.mark.parametrize("name", ["c", "tetrahedron", "blob"])
def test_lower_forms(method, name, rng):
    bounder = far(method, name)
    x = points_around(thing(name), 200, rng).astype(np.float64)
    exact, dense = bounder.exact(x), brute(bounder, x)
    assert (exact <= np.maximum(dense, 0) * (1 + 1e-12) + 1e-12).all()
    assert (exact > 0).sum() > 50
    if method == "kdop":
        assert (exact >= far("aabb", name).exact(x) - 2e-4 * float(thing(name).extent.max())).all()


def test_a_flat_ellipsoid_by_few_steps(rng):
    """Newton's steps of the kernel come within a thousandth of the distance, also of axes of 1 : 10."""
    from scipy.optimize import minimize_scalar

    from warp_bounding.bounders.ellipsoids import _dual

    s2 = np.array([1.0, 0.01, 0.25])
    z = rng.normal(size=(300, 3)) * np.exp2(rng.uniform(-2, 5, (300, 1)))
    z2, t = z * z, np.zeros(len(z))
    t = np.maximum((np.sqrt(z2 * s2) - s2).max(axis=1), 0)
    for _ in range(NEWTON_STEPS):
        parts = z2 * s2 / (t[:, None] + s2) ** 2
        q, slope = parts.sum(axis=1), (parts / (t[:, None] + s2)).sum(axis=1)
        t = np.maximum(t + (np.sqrt(q) - 1) * q / slope, 0)
    found = np.sqrt(np.maximum(t * ((z2 / (t[:, None] + s2)).sum(axis=1) - 1), 0))
    best = _dual(z, s2)
    assert (found <= best * (1 + 1e-9)).all()
    assert (found >= best * (1 - 1e-3)).all()
    for point, value in zip(z[:20], best[:20], strict=True):  # the dual's best is the distance

        def dual(logarithm, point=point):
            m = np.exp(logarithm)
            return -m * ((point**2 / (m + s2)).sum() - 1)

        assert value**2 == pytest.approx(
            max(-minimize_scalar(dual, bounds=(-30, 15), method="bounded").fun, 0), rel=1e-4, abs=1e-9
        )


def test_frames():
    turned = np.linalg.qr(np.random.default_rng(0).normal(size=(5, 5)))[0]
    assert 1 <= frame_norm(turned) < 1 + 1e-6
    assert frame_norm(turned * 1.1) == np.inf
    assert frame_norm(turned * (1 - 1e-6)) < 1
