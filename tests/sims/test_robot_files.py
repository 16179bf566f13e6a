"""The bounders of robots' self-collisions are of these robots, miss nothing, and are proven anew."""

import math
from importlib.metadata import PackageNotFoundError

import numpy as np
import pytest

import warp_bounding as wb
from sims.arm.demo import robot_places
from sims.arm.robots import KEPT, ROBOTS, robots, ur5

FILES = sorted(path.stem for path in KEPT.glob("*.safetensors"))


def shapes(name: str) -> dict[str, wb.arms.ArmConfigurations]:
    """What a robot's bounders bound, by the names of their files."""
    try:
        return ROBOTS[name].shapes()
    except wb.BoundingError as missing:
        pytest.skip(str(missing))


def test_every_file_is_of_a_robot():
    assert sorted(file for robot in ROBOTS.values() for file in robot.networks) == FILES


@pytest.mark.parametrize("name", ROBOTS)
def test_a_robots_bounders_deny_no_collision(name, rng):
    own, arm = shapes(name), ROBOTS[name].arm()
    whole = arm.self_collision()
    pairs = np.concatenate([shape.pairs for shape in own.values()])
    assert sorted(map(tuple, pairs)) == sorted(map(tuple, whole.pairs))
    q = rng.uniform(arm.lower, arm.upper, (20_000, len(arm.free))).astype(np.float32)
    held, maybe = whole.contains(q[:, whole.columns]), np.zeros(len(q), dtype=bool)
    for file, shape in own.items():
        bounder = wb.load(KEPT / f"{file}.safetensors", device="cpu")
        assert bounder.certificate.proven
        assert bounder.certificate.indicator == shape.digest
        maybe |= bounder.query(np.ascontiguousarray(q[:, shape.columns])).numpy() == 1
    assert held.any()
    assert maybe[held].all()
    assert maybe.mean() < held.mean() + 0.08


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_a_robots_bounders_are_proven_anew(name):
    for file, shape in shapes(name).items():
        bounder = wb.load(KEPT / f"{file}.safetensors", device="cpu")
        assert wb.certify(bounder, shape, budget=math.inf).proven


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
