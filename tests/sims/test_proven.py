"""Plans of which every motion is proven."""

import numpy as np

from sims.arm.robots import CELLS
from sims.planning.proven import connect, plan, shortened
from warp_bounding.arms import Motions


def test_a_plan_is_proven_shorter_and_the_same_again():
    cell = CELLS["planar-3"]
    motions = Motions(cell.arm, cell.obstacles, self_collision=False)
    q = np.random.default_rng(1).uniform(cell.arm.lower, cell.arm.upper, (200, 3))
    free = q[motions.configurations(q) == 0]
    found = 0
    for start, goal in zip(free[:8:2], free[1:8:2], strict=True):
        rough = connect(motions, start, goal)
        if rough.path is None:
            continue
        found += 1
        assert (rough.path[[0, -1]] == [start, goal]).all()
        assert motions.path(rough.path).proven
        smooth = shortened(motions, rough.path)
        assert motions.path(smooth.path).proven
        lengths = [np.linalg.norm(np.diff(path, axis=0), axis=1).sum() for path in (smooth.path, rough.path)]
        assert lengths[0] <= lengths[1]
        assert (plan(motions, start, goal).path == smooth.path).all()
    assert found


def test_no_plan_leads_into_what_collides():
    cell = CELLS["planar-2"]
    motions = Motions(cell.arm, cell.obstacles, self_collision=False)
    q = np.random.default_rng(0).uniform(cell.arm.lower, cell.arm.upper, (500, 2))
    states = motions.configurations(q)
    assert connect(motions, q[states == 0][0], q[states == 2][0]).path is None
