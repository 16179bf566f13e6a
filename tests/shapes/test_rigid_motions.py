"""Rigid motions are the same on every CPU: nothing of BLAS, LAPACK or a C library's sines is in a digest."""

import os
import platform
import subprocess
import sys
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from warp_bounding import rigid

PRINT_DIGESTS = """
import numpy as np, pathlib, sys, tempfile
import warp_bounding as wb

folder, rng = pathlib.Path(tempfile.mkdtemp()), np.random.default_rng(0)
points = rng.normal(size=(3000, 3)) / 10  # more corners than a body has: it is simplified
np.savetxt(folder / "link.obj", points, fmt="v %.17g %.17g %.17g")
with open(folder / "link.obj", "a") as file:
    file.writelines(f"f {i} {i + 1} {i + 2}\\n" for i in range(1, 2999))
links = "".join(
    f'<link name="l{i}"><collision><origin xyz="0.1 0 {i}" rpy="0.3 {i} -1.1"/><geometry>{solid}</geometry>'
    "</collision></link>"
    for i, solid in enumerate(
        [
            '<mesh filename="link.obj"/>',
            '<cylinder radius="0.1" length="1"/>',
            '<box size="0.1 0.2 1"/>',
            '<sphere radius="0.1"/>',
        ]
    )
)
joints = "".join(
    f'<joint name="j{i}" type="revolute"><origin xyz="0 0.2 1" rpy="1.7 {i} 0.4"/>'
    f'<parent link="l{i}"/><child link="l{i + 1}"/>'
    '<axis xyz="1 0.3 -0.2"/><limit lower="-3" upper="4"/></joint>'
    for i in range(3)
)
(folder / "arm.urdf").write_text(f'<robot name="arm">{links}{joints}</robot>')
pose = [[0.6, -0.8, 0, 1], [0.8, 0.6, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
table = wb.arms.Body.box([-1, -1, -1], [1, 1, 0], pose=pose)
for held in ({}, {"j1": 0.7}):
    arm = wb.arms.load_urdf(folder / "arm.urdf", held=held)
    print(wb.arms.ArmConfigurations(arm, [table], weights=arm.reaching).digest)
print(wb.arms.load_urdf(folder / "arm.urdf").self_collision(revolved=["l0", "l3"]).digest)
"""


def _digests(**environment: str) -> list[str]:
    command = [sys.executable, "-W", "ignore", "-c", PRINT_DIGESTS]
    done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=True)
    return [line for line in done.stdout.splitlines() if len(line) == 64]


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the names of OpenBLAS's kernels are those of x86-64")
def test_digests_of_arms_are_those_of_other_cpus():
    digests = _digests()
    assert len(set(digests)) == 3
    assert _digests(OPENBLAS_CORETYPE="Nehalem") == digests
    assert _digests(OPENBLAS_CORETYPE="Haswell", NPY_DISABLE_CPU_FEATURES="AVX512F AVX512_SKX X86_V4") == digests


def _series(x: Fraction, first: int) -> Fraction:
    """A sine (1) or cosine (0) of a small angle, to 2^-200."""
    total, term, k = Fraction(0), Fraction(1) if first == 0 else x, first
    while abs(term) > Fraction(1, 2**200):
        total, term, k = total + term, -term * x * x / ((k + 1) * (k + 2)), k + 2
    return total


@given(st.floats(-13, 13))
def test_sines_and_cosines_are_rounded_once(angle):
    sine, cosine = rigid.sine_cosine(angle)
    assert abs(sine - float(_series(Fraction(angle), 1))) < 1e-45
    assert abs(cosine - float(_series(Fraction(angle), 0))) < 1e-45


def test_products_lengths_and_turns(rng):
    a, b = rng.normal(size=(5, 4, 3)), rng.normal(size=(5, 3, 2))
    assert np.allclose(rigid.matmul(a, b), a @ b, rtol=0, atol=1e-14)
    assert np.allclose(rigid.lengths(a), np.linalg.norm(a, axis=-1), rtol=1e-15)
    assert np.array_equal(rigid.about(2, 0.0), np.eye(3))
    assert np.allclose(rigid.about(0, np.pi / 2) @ [0, 1, 0], [0, 0, 1], atol=1e-15)
    assert np.allclose(rigid.about(1, np.pi / 2) @ [0, 0, 1], [1, 0, 0], atol=1e-15)


def test_the_nearest_rotation(rng):
    turn = rigid.about(0, 0.3) @ rigid.about(1, -1.2) @ rigid.about(2, 2.5)
    near = rigid.nearest_rotation(turn + rng.uniform(-4e-7, 4e-7, (3, 3)), 1e-6)
    assert np.abs(near.T @ near - np.eye(3)).max() < 1e-15
    for none in (turn * 1.001, turn * 1e200, turn[::-1], np.zeros((3, 3)), turn + 1e-5, np.diag([1.0, 1, -1])):
        assert rigid.nearest_rotation(none, 1e-6) is None
