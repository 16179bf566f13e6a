"""Moving meshes: every point of the dilated object, at every time, lies in an occupied cell."""

from fractions import Fraction

import numpy as np
import pytest
import trimesh
from hypothesis import example, given
from hypothesis import strategies as st

from warp_bounding.errors import IndicatorError
from warp_bounding.indicators import IndicatorMesh, IndicatorMotion
from warp_bounding.indicators.motion import MAX_TIMES
from warp_bounding.indicators.shape import LEFT, SPARE, time_axis


def turning(mesh, keyframes=9, angle=np.pi, shift=(0.3, 0.0, 0.1)) -> np.ndarray:
    frames = []
    for share in np.linspace(0, 1, keyframes):
        turn = trimesh.transformations.rotation_matrix(share * angle, [1, 2, 3])[:3, :3]
        frames.append(mesh.vertices @ turn.T * (1 + 0.3 * np.sin(3 * share)) + share * np.array(shift))
    return np.array(frames)


SOLIDS = {
    "box": lambda: trimesh.creation.box(extents=(1, 0.6, 0.3)),
    "sphere": lambda: trimesh.creation.icosphere(subdivisions=2, radius=0.5),
    "plate": lambda: trimesh.creation.box(extents=(1, 1, 1e-3)),
}


@pytest.mark.parametrize("margin", [0.0, 0.07])
@pytest.mark.parametrize("name", SOLIDS)
def test_every_point_at_every_time_lies_in_an_occupied_cell(name, margin, rng):
    solid = SOLIDS[name]()
    motion = IndicatorMotion(turning(solid), solid.faces, times=np.linspace(2.0, 3.5, 9), time_cells=7)
    assert motion.watertight
    grid = motion.to_grid(resolution=14, margin=margin)
    assert grid.time
    assert grid.lower[0] == 2.0
    assert grid.upper[0] == 3.5
    ends = grid.position(np.arange(grid.shape[0] + 1)[:, None] - 0.5)[:, 0]
    times = np.unique(np.concatenate([rng.uniform(2.0, 3.5, 20), motion.times, ends]).astype(np.float32))
    for t in times:
        corners = motion.vertices_at(t).astype(np.float64)[solid.faces]
        x = np.einsum("fkc,fcx->fkx", rng.dirichlet(np.ones(3) / 2, size=(len(corners), 30)), corners).reshape(-1, 3)
        x = np.concatenate([x, corners.reshape(-1, 3)])
        inside = rng.uniform(x.min(axis=0), x.max(axis=0), (200, 3))
        at = trimesh.Trimesh(motion.vertices_at(t).astype(np.float64), solid.faces, process=False)
        x = np.concatenate([x, inside[at.contains(inside)]])
        if margin:
            away = rng.normal(size=x.shape)
            x += away / np.linalg.norm(away, axis=1, keepdims=True) * margin * rng.random((len(x), 1))
        assert grid.contains(np.column_stack([np.full(len(x), t, np.float64), x])).all()


@given(
    start=st.floats(-1e3, 1e3, width=32),
    length=st.floats(2.0**-6, 1e3, width=32),
    count=st.integers(1, MAX_TIMES),
)
@example(start=2.0, length=1.5, count=7)
@example(start=-0.3, length=1e-2, count=MAX_TIMES)
def test_cells_of_time_lie_between_the_keyframes(start, length, count):
    start, end = float(np.float32(start)), float(np.float32(start + length))
    rate, begin, cells = time_axis(start, end, count, "motion")
    assert count <= cells <= count + SPARE
    assert float(np.float32(rate)) == rate
    assert (2 * begin).is_integer()
    assert Fraction(start) <= Fraction(begin) / Fraction(rate)
    assert (Fraction(begin) + cells) / Fraction(rate) <= Fraction(end)
    assert (Fraction(end) - Fraction(start)) * Fraction(rate) - cells < 1


@pytest.mark.parametrize("tiny", [2.0**-60, 2.0**-140])
@pytest.mark.parametrize("count", [1, 7, 32, 301])
def test_cells_end_before_a_keyframe_that_is_almost_at_time_0(tiny, count):
    for start, end in ((-5.0, -tiny), (tiny, 5.0), (-5.0, tiny)):
        rate, begin, cells = time_axis(start, end, count, "motion")
        assert count <= cells <= count + SPARE
        assert Fraction(start) <= Fraction(begin) / Fraction(rate)
        assert (Fraction(begin) + cells) / Fraction(rate) <= Fraction(end)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("range_", [(0.0, 2.0**-149), (-(2.0**-140), 2.0**-139)])
def test_a_range_of_time_that_float32_cannot_divide_is_refused(range_):
    with pytest.raises(IndicatorError, match="float32 cells can divide"):
        time_axis(*range_, 32, "motion")


@pytest.mark.parametrize("end", [1.0, 1.25, 3.0, 0.1, 1 / 3])
@pytest.mark.parametrize("count", [1, 3, 32, 50])
def test_a_motion_from_time_0_is_covered(end, count):
    rate, begin, cells = time_axis(0.0, float(np.float32(end)), count, "motion")
    assert (begin, cells) == (0.0, count)
    assert float(np.float32(end)) * rate - cells <= LEFT


def test_a_motion_that_rests_is_a_mesh():
    solid = SOLIDS["sphere"]()
    still = IndicatorMesh(solid.vertices, solid.faces).to_grid(resolution=20)
    grid = IndicatorMotion(np.stack([solid.vertices] * 2), solid.faces, time_cells=3).to_grid(resolution=20)
    assert grid.shape[0] == 3
    moving = grid.occupancy[:, 1:-1, 1:-1, 1:-1]  # room for ways that there are not
    assert moving.sum() == grid.occupancy.sum()
    for cells in grid.occupancy:
        assert cells.sum() <= 1.02 * still.occupancy.sum()
        assert cells.sum() >= still.occupancy.sum()


def test_cells_are_not_much_more_than_the_mesh_meets():
    solid = SOLIDS["sphere"]()
    motion = IndicatorMotion(turning(solid), solid.faces, time_cells=16)
    grid = motion.to_grid(resolution=24)
    for i in range(16):
        middle = motion.vertices_at(float(grid.position(np.array([i, 0, 0, 0]))[0]))
        volume = abs(trimesh.Trimesh(middle, solid.faces, process=False).volume) * grid.cells_per_unit[1] ** 3
        assert grid.occupancy[i].sum() < 2.2 * volume


def test_it_does_not_depend_on_how_often_it_is_asked():
    solid = SOLIDS["box"]()
    motions = [IndicatorMotion(turning(solid), solid.faces) for _ in range(2)]
    assert motions[0].digest == motions[1].digest
    assert motions[0].to_grid(resolution=8).digest == motions[1].to_grid(resolution=8).digest
    assert motions[0].digest != IndicatorMotion(turning(solid, angle=1.0), solid.faces).digest


@pytest.mark.parametrize("behind", [True, False])
def test_a_jump_between_neighbouring_numbers_that_a_face_of_time_cuts(behind):
    solid, end, count = SOLIDS["box"](), 3.0, 7
    rate, begin, cells = time_axis(0.0, end, count, "motion")
    faces = (begin + np.arange(1, cells)) / rate
    rounded = faces.astype(np.float32)
    keyframe = rounded[(rounded > faces) == behind][0]  # the nearest number to a face, on one side of it
    other = np.nextafter(keyframe, np.float32(0.0 if behind else end))
    there = np.array(solid.vertices, dtype=np.float32) + np.float32(10.0)
    frames = [solid.vertices, solid.vertices, there, solid.vertices][:: 1 if behind else -1]
    motion = IndicatorMotion(np.array(frames), solid.faces, np.sort([0.0, keyframe, other, end]), count)
    x = np.column_stack([np.full(len(there), keyframe), motion.vertices_at(keyframe)])
    assert (x[:, 1:] == there).all()
    assert motion.to_grid(resolution=40).contains(x).all()


def test_an_open_mesh_says_so():
    solid = SOLIDS["box"]()
    grid = IndicatorMotion(turning(solid), solid.faces[1:]).to_grid(resolution=6)
    assert "surface only" in grid.note


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"frames": np.zeros((1, 3, 3))}, "K >= 2"),
        ({"frames": np.full((2, 8, 3), np.nan)}, "finite"),
        ({"faces": np.array([[0, 1, 99]])}, "vertices 0 to 7"),
        ({"times": [1.0, 0.0]}, "ascending"),
        ({"times": [0.0, 1.0, 2.0]}, "2 ascending"),
        ({"time_cells": 0}, "time_cells"),
    ],
)
def test_bad_input(change, words):
    solid = SOLIDS["box"]()
    good = {"frames": turning(solid, 2), "faces": solid.faces}
    with pytest.raises(IndicatorError, match=words):
        IndicatorMotion(**(good | change))
