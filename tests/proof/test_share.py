"""Thresholds of points that samples attest, and how much of the domain is proven all the same."""

from functools import cache

import numpy as np
import pytest

import warp_bounding as wb
from warp_bounding.errors import BounderError


@cache
def shape() -> wb.arms.ArmConfigurations:
    """A planar arm of three joints among posts."""
    step = np.eye(4)
    step[0, 3] = 0.4
    joints = [wb.arms.Joint(step if i else np.eye(4), lower=-2.0, upper=2.0) for i in range(3)]
    links = [wb.arms.Body.capsule([0, 0, 0], [0.4, 0, 0], 0.05, link=i) for i in range(3)]
    posts = [wb.arms.Body.sphere(place, 0.15) for place in ([0.6, 0.6, 0], [0.5, -0.7, 0])]
    arm = wb.arms.Arm(joints, links)
    return wb.arms.ArmConfigurations(arm, posts, weights=arm.reaching)


@cache
def attested() -> wb.Bounder:
    options = {"hidden": (16, 16), "steps": 400, "certificate": "statistical"}
    return wb.fit(shape(), device="cpu", progress=False, **options)


def test_the_certificate_is_statistical_and_says_so(tmp_path):
    bounder = attested()
    certificate = bounder.certificate
    assert certificate.kind == "statistical"
    assert certificate.samples >= 1_000_000
    assert "No proof was tried" in certificate.message
    assert wb.evaluate(bounder, shape(), samples=100_000).fn == 0
    bounder.save(tmp_path / "b.safetensors")
    assert wb.load(tmp_path / "b.safetensors", device="cpu").certificate == certificate


def test_what_is_proven_grows_with_time_and_falls_with_a_threshold_that_is_too_high():
    bounder = attested()
    shares = [wb.proven_share(bounder, shape(), boxes=boxes, seconds=600).volume for boxes in (1000, 30_000, 300_000)]
    assert 0 <= shares[0] <= shares[1] <= shares[2] <= 1
    assert shares[2] > 0.5
    high = bounder.to("cpu").freeze(bounder.threshold + 4.0, None)
    x = np.random.default_rng(0).uniform(shape().lower, shape().upper, (100_000, 3)).astype(np.float32)
    wrong = (shape().contains(x) & (high.query(x).numpy() == 0)).mean()
    assert wrong > 0
    lost = wb.proven_share(high, shape(), boxes=300_000, seconds=600).volume
    assert lost < 1 - wrong / 2


def test_a_proven_bounder_is_proven_everywhere():
    box = wb.fit(shape(), method="aabb", device="cpu", progress=False)
    found = wb.proven_share(box, shape(), seconds=600, boxes=2_000_000)
    assert found.volume == pytest.approx(1.0, abs=1e-9)
    assert found.boxes > 0


def test_random_places_estimate_it():
    bounder = attested()
    all_of_it = wb.proven_share(bounder, shape(), boxes=300_000, seconds=600).volume
    some = wb.proven_share(bounder, shape(), places=2000, side=2.0**-4, boxes=300_000, seconds=600)
    assert all_of_it - 0.02 <= some.volume <= 1 + 1e-12
    again = wb.proven_share(bounder, shape(), places=2000, side=2.0**-4, boxes=300_000, seconds=600)
    assert again[:2] == some[:2]


def test_what_has_no_share():
    bounder = attested()
    with pytest.raises(BounderError, match="single bounders of points"):
        wb.proven_share(wb.cascade(wb.fit(shape(), method="aabb", device="cpu", progress=False), bounder), shape())
    with pytest.raises(BounderError, match="the shape is 2D"):
        wb.proven_share(bounder, shape().piece([0, 1]))
    for options in ({"places": 0}, {"places": 5, "side": 0.0}, {"places": 5, "side": 2.0}):
        with pytest.raises(BounderError, match="at least one place"):
            wb.proven_share(bounder, shape(), **options)
    with pytest.raises(BounderError, match="certificate must be one of"):
        wb.fit(shape(), device="cpu", certificate="none")
    with pytest.raises(BounderError, match="thresholds of parts are proven"):
        wb.fit(shape(), device="cpu", certificate="statistical", thresholds=16, steps=2, progress=False)
    with pytest.raises(BounderError):
        wb.fit(shape(), "box", device="cpu", certificate="statistical")
