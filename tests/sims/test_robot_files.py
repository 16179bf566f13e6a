"""The bounders of robots' self-collisions are of these robots, miss nothing, and are proven anew."""

import math
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import numpy as np
import pytest

import warp_bounding as wb

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
import robots

FILES = sorted(path.stem for path in robots.KEPT.glob("*.safetensors"))


def shapes(name: str) -> tuple[wb.arms.ArmConfigurations, wb.arms.ArmConfigurations]:
    """The robot as it is, and the shape that is bounded."""
    try:
        robots.robots()
    except SystemExit as missing:
        pytest.skip(str(missing))
    arm = robots.ROBOTS[name].arm()
    return arm.self_collision(), arm.self_collision(revolved=robots.ROBOTS[name].revolved)


@pytest.mark.parametrize("name", FILES)
def test_a_robots_bounder_denies_no_collision(name, rng):
    whole, shape = shapes(name)
    bounder = wb.load(robots.KEPT / f"{name}.safetensors", device="cpu")
    assert bounder.certificate.proven
    assert bounder.certificate.indicator == shape.digest
    arm = robots.ROBOTS[name].arm()
    q = rng.uniform(arm.lower, arm.upper, (20_000, len(arm.free))).astype(np.float32)
    held = whole.contains(q[:, whole.columns])
    maybe = bounder.query(np.ascontiguousarray(q[:, shape.columns])).numpy() == 1
    assert held.any()
    assert maybe[held].all()
    assert maybe.mean() < held.mean() + 0.15


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_a_robots_bounder_is_proven_anew(name):
    bounder = wb.load(robots.KEPT / f"{name}.safetensors", device="cpu")
    assert wb.certify(bounder, shapes(name)[1], budget=math.inf).proven


def test_a_missing_package_is_named(monkeypatch):
    def lacks(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(robots, "distribution", lacks)
    with pytest.raises(SystemExit, match=r"robots need example-robot-data: pip install 'warp-bounding\[robots\]'"):
        robots.robots()
