"""Worlds: the generated ones, and those of users' files, read whole or refused."""

import numpy as np
import pytest

import warp_bounding as wb
from sims.path.moving_ai import read_map, read_scen, scen_beside
from sims.path.worlds import problems_of, worlds_at

MAP = "type octile\nheight 3\nwidth 4\nmap\n.@..\nGTSW\n...O\n"
SCEN = "version 1\n0\tm.map\t4\t3\t0\t0\t2\t2\t4.0\n1\tm.map\t4\t3\t3\t0\t1\t2\t3.5\n"


@pytest.fixture
def map_file(tmp_path):
    path = tmp_path / "m.map"
    path.write_text(MAP)
    return path


def test_a_map(map_file):
    grid = read_map(map_file)
    assert grid.occupancy.tolist() == [
        [False, True, False, False],
        [False, True, False, True],
        [False, False, False, True],
    ]
    np.testing.assert_array_equal(grid.cells_per_unit, [3, 3])  # cells are squares
    np.testing.assert_array_equal(grid.contains(np.float32([[0, 1 / 3], [0, 0], [1 / 3, 1]])), [True, False, True])


@pytest.mark.parametrize("name", ["m.map.scen", "m.scen"])
def test_a_scenario(map_file, name):
    path = map_file.with_name(name)
    assert scen_beside(map_file) is None
    path.write_text(SCEN)
    assert scen_beside(map_file) == path
    (world,) = worlds_at(map_file)
    np.testing.assert_allclose(world.problems * 3, [[[0, 0], [2, 2]], [[0, 3], [2, 1]]], atol=1e-6)
    assert world.problems.dtype == np.float32
    assert problems_of(world, 1, 0).shape == (1, 2, 2)
    np.testing.assert_array_equal(problems_of(world, 10, 0), world.problems)


BAD = (  # which text, what is replaced in it, and what is said
    (MAP, "type octile", "type hex", "line 1: expected 'type octile'"),
    (MAP, "GTSW\n", "", "expected 3 rows, got 2"),
    (MAP, "GTSW", "GT?W", r"line 6: expected cells of .*, got '\?'"),
    (MAP, ".@..\nGTSW\n...O", "....\n....\n....", "nothing to bound"),
    (SCEN, "\t4.0", "", "line 2: expected 9 fields, got 8"),
    (SCEN, "m.map\t4\t3\t0", "m.map\t3\t4\t0", "line 2: expected a map of 4 x 3 cells, got 3 x 4"),
    (SCEN, "\t2\t2\t", "\t4\t2\t", "line 2: expected cells of the map"),
    (SCEN, SCEN, "version 1\n", "at least one problem"),
)


@pytest.mark.parametrize(("text", "old", "new", "message"), BAD)
def test_what_is_no_map_and_no_scenario(map_file, text, old, new, message):
    changed = text.replace(old, new, 1)
    (map_file if text is MAP else map_file.with_name("m.scen")).write_text(changed, encoding="utf-8")
    with pytest.raises(wb.ShapeError, match=message) as caught:
        read_scen(map_file.with_name("m.scen"), read_map(map_file))
    assert "\n" not in str(caught.value)


def test_what_is_no_world(tmp_path):
    np.save(tmp_path / "solid.npy", np.eye(4, dtype=bool)[None].repeat(2, 0))
    for name, message in (("nothing.png", "no such file"), ("solid.npy", "expected a 2D world, got 3 dimensions")):
        with pytest.raises(wb.ShapeError, match=message):
            worlds_at(tmp_path / name)
