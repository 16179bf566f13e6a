"""Headers of motions answer as ``Motions`` does, under every compiler and language; nothing is free that collides."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest
from arm_cases import posed, random_arm
from commands import ROOT
from plain_shapes import TETRAHEDRON
from snippets import FENCED

import warp_bounding as wb
from warp_bounding.arms import Arm, Body, Cylinder, DistanceField, Joint, Motions, Scan

COUNT, JOINTS = 2000, 4
STRICT = ("-Wall", "-Wextra", "-Werror", "-shared", "-fPIC")
COMPILERS = ("gcc -x c -std=c99 -pedantic", "g++ -x c++ -std=gnu++11")
COMPILERS += ("clang -x c -std=c99 -pedantic", "clang++ -x c++ -std=gnu++11")
ASK = f"""
#include "arm.h"
#include "other.h"
#ifdef __cplusplus
extern "C"
#endif
void ask(const double *, const double *, int, const int *, const double *, int *, double *);
void ask(const double *a, const double *b, int count, const int *whole, const double *numbers, int *found, double *s) {{
    for (int i = 0; i < count; ++i, a += {JOINTS}, b += {JOINTS}, found += 6) {{
        found[0] = arm_segment(a, b, &s[i]), found[1] = arm_segment(a, b, 0), found[2] = arm_configuration(a);
        found[3] = arm_segment_in(whole, numbers, a, b, 0), found[4] = arm_configuration_in(whole, numbers, a);
        found[5] = other_configuration(a);
    }}
}}
"""


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """Two headers and a source that asks both; motions of both scenes, and their ends."""
    rng, folder = np.random.default_rng(7), tmp_path_factory.mktemp("headers")
    arm = random_arm(rng, JOINTS)[0]
    triangles = rng.normal(size=(30, 1, 3)) * 0.8 + rng.normal(size=(30, 3, 3)) * 0.1
    values = np.maximum(wb.rigid.lengths(np.indices((9, 9, 9)).reshape(3, -1).T / 8 - 0.5) - 0.3, 0.0).reshape(9, 9, 9)
    field = DistanceField(values, [0, 0, 0], [0.5] * 3, [0.125] * 3, pose=posed(rng, 0.8))
    boxes = [Body.box(-size, size, pose=posed(rng, 0.8)) for size in rng.uniform(0.05, 0.2, (2, 3))]
    obstacles = [*boxes, Cylinder(0.1, 0.4, posed(rng, 0.8)), Scan(triangles, 0.01, np.eye(4), "scan"), field]
    scenes = [Motions(arm, each, self_collision=False) for each in (obstacles, obstacles[1:4])]
    scenes[0].export(folder / "arm.h")
    Motions(arm).export(folder / "some.h")
    Motions(arm).export(folder / "other.h")  # over nothing, and below over an export
    Motions(arm, self_collision=False).export(folder / "other.h")
    (folder / "ask.c").write_text(ASK)
    q0 = rng.uniform(arm.lower, arm.upper, (COUNT, JOINTS))
    q1 = np.clip(q0 + rng.normal(size=q0.shape) * rng.uniform(0, 0.6, (COUNT, 1)), arm.lower, arm.upper)
    q0[0, 1], q1[1, 2], q0[2, 0], q1[3, 3] = np.nan, np.inf, arm.upper[0] + 1e-9, arm.lower[3] - 1e-9
    q0[4] = q1[5] = np.nextafter(arm.upper, np.inf)  # what rounds beyond limits counts as the limit
    return folder, scenes, q0, q1


@pytest.mark.parametrize("options", ["-O0", "-O3 -march=native"])
@pytest.mark.parametrize("compiler", COMPILERS)
def test_answers_are_those_of_motions(compiler, options, case, tmp_path):
    """Equal, but where rounding decides; there they are as safe."""
    folder, scenes, q0, q1 = case
    if shutil.which(compiler.split()[0]) is None:
        pytest.skip(f"there is no {compiler.split()[0]}")
    line = [*compiler.split(), *options.split(), *STRICT, folder / "ask.c", "-o", tmp_path / "ask.so", "-lm"]
    made = subprocess.run(line, capture_output=True, text=True, check=False)
    assert made.stderr == ""
    found, shares, (whole, numbers) = np.empty((COUNT, 6), np.int32), np.empty(COUNT), scenes[1].cell()
    pointers = [x.ctypes.data_as(ctypes.c_void_p) for x in (q0, q1, whole, numbers, found, shares)]
    ctypes.CDLL(str(tmp_path / "ask.so")).ask(*pointers[:2], COUNT, *pointers[2:])
    clear, share = scenes[0].segments(q0, q1, until=True)
    assert np.array_equal(found[:, 0] == 1, shares == 1.0)
    assert (np.abs(shares - share) > 0).mean() < 2e-3
    for columns, motions in (((0, 1, 2), scenes[0]), ((3, 4), scenes[1])):
        clear, states = motions.segments(q0, q1)[0], motions.configurations(q0)
        ends = np.maximum(states, motions.configurations(q1))
        assert 0.1 < clear.mean() < 0.9
        for free in found.T[list(columns[:-1])]:
            assert (free != clear).mean() < 2e-3
            assert (ends[free == 1] != 2).all()
        assert (found[:, columns[-1]] != states).mean() < 2e-3
        assert (states[found[:, columns[-1]] == 0] != 2).all()
    assert (found[:4, :2] == 0).all()
    assert not shares[:4].any()
    assert found[[0, 2], 2].tolist() == [1, 1]
    assert (found[4:, 5] == 0).all()  # of an arm alone


def test_an_other_arm_and_fast_math_are_refused(case, tmp_path):
    folder, _, q0, _ = case
    joints = [Joint() for _ in range(JOINTS)]
    whole, numbers = Motions(Arm(joints, [Body.sphere([0, 0, 0], 0.1, link=0)])).cell()
    whole.tofile(tmp_path / "whole"), numbers.tofile(tmp_path / "numbers")
    text = f"""#include "{folder}/arm.h"
#include <stdio.h>
int main(void) {{
    static int whole[{len(whole)}];
    static double numbers[{len(numbers)}];
    const double q[] = {{{", ".join(map(str, q0[9]))}}};
    FILE *a = fopen("whole", "rb"), *b = fopen("numbers", "rb");
    if (fread(whole, sizeof *whole, {len(whole)}, a) != {len(whole)}) return 3;
    if (fread(numbers, sizeof *numbers, {len(numbers)}, b) != {len(numbers)}) return 3;
    return arm_segment_in(whole, numbers, q, q, NULL) == 0 && arm_configuration_in(whole, numbers, q) == 1 ? 7 : 1;
}}
"""
    (tmp_path / "main.c").write_text(text)
    line = ["gcc", "main.c", "-o", "main", "-lm"]
    assert subprocess.run(line, cwd=tmp_path, check=False).returncode == 0
    assert subprocess.run([tmp_path / "main"], cwd=tmp_path, check=False).returncode == 7
    made = subprocess.run([*line, "-ffast-math"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "leave it out" in made.stderr


def test_what_cannot_be_exported(case, tmp_path):
    motions = case[1][0]
    for name in ("2d", "a b", ""):
        with pytest.raises(wb.BounderError, match="letters"):
            motions.export(tmp_path / "arm.h", name)
    (tmp_path / "other.h").write_text("int main(void);\n")
    with pytest.raises(wb.FileFormatError, match="is no header"):
        motions.export(tmp_path / "other.h")
    closed = Motions(motions.arm, Scan.of_mesh(wb.shapes.Mesh(*TETRAHEDRON)))
    with pytest.raises(wb.ShapeError, match="closed scan"):
        closed.export(tmp_path / "closed.h")
    assert not (tmp_path / "closed.h").exists()
    text = (case[0] / "arm.h").read_text()
    assert motions.digest in text
    assert "scan" in text[:500]


def test_the_guide_compiles(tmp_path):
    code = dict(FENCED.findall((ROOT / "docs/guide/in-cpp.md").read_text()))["c"]  # the last one
    Motions(random_arm(np.random.default_rng(0), 7)[0]).export(tmp_path / "panda.h")
    (tmp_path / "guide.c").write_text(code)
    assert subprocess.run(["gcc", *STRICT, "guide.c", "-o", "guide.so"], cwd=tmp_path, check=False).returncode == 0


def test_cuda(case, tmp_path):
    if shutil.which("nvcc") is None:
        pytest.skip("there is no nvcc")
    ask = "__global__ void ask(const double *q, int *found) { *found = other_segment(q, q, 0); }\n"
    (tmp_path / "all.cu").write_text(f'#include "{case[0]}/other.h"\n{ask}')
    line = ["nvcc", "-arch=sm_90", "-cubin", tmp_path / "all.cu", "-o", tmp_path / "all.cubin"]
    assert subprocess.run(line, capture_output=True, text=True, check=False).returncode == 0
