"""The bounders of robots' self-collisions are of these robots, miss nothing, and are proven anew."""

import math
from importlib.metadata import PackageNotFoundError

import numpy as np
import pytest

import warp_bounding as wb
from sims.arm.demo import robot_places
from sims.arm.robots import KEPT, ROBOTS, robots, ur5

FILES = sorted(path.stem for path in KEPT.glob("*.safetensors"))


def shapes(name: str) -> tuple[wb.arms.ArmConfigurations, wb.arms.ArmConfigurations]:
    """The robot as it is, and the shape that is bounded."""
    try:
        arm = ROBOTS[name].arm()
    except wb.BoundingError as missing:
        pytest.skip(str(missing))
    return arm.self_collision(), arm.self_collision(revolved=ROBOTS[name].revolved)


@pytest.mark.parametrize("name", FILES)
def test_a_robots_bounder_denies_no_collision(name, rng):
    whole, shape = shapes(name)
    bounder = wb.load(KEPT / f"{name}.safetensors", device="cpu")
    assert bounder.certificate.proven
    assert bounder.certificate.indicator == shape.digest
    arm = ROBOTS[name].arm()
    q = rng.uniform(arm.lower, arm.upper, (20_000, len(arm.free))).astype(np.float32)
    held = whole.contains(q[:, whole.columns])
    maybe = bounder.query(np.ascontiguousarray(q[:, shape.columns])).numpy() == 1
    assert held.any()
    assert maybe[held].all()
    assert maybe.mean() < held.mean() + 0.15


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_a_robots_bounder_is_proven_anew(name):
    bounder = wb.load(KEPT / f"{name}.safetensors", device="cpu")
    assert wb.certify(bounder, shapes(name)[1], budget=math.inf).proven


def test_a_missing_package_is_named(monkeypatch):
    def lacks(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr("sims.arm.robots.distribution", lacks)
    with pytest.raises(
        wb.BoundingError, match=r"robots need example-robot-data: pip install 'warp-bounding\[robots\]'"
    ):
        robots()
    ur5.cache_clear()
    assert robot_places() == (
        [],
        "robots need example-robot-data: pip install 'warp-bounding[robots]'",
    )  # the demo says so
