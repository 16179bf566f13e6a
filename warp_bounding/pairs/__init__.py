"""Pairs of placed meshes: a distance bounder of one against balls that hold the other; and balls of robots.

Example:
    >>> pair = wb.pairs.Pair(far, wb.pairs.Balls.of(mesh, 8))
    >>> pair.query([[0, 0, 0, 0, 0, 0, 1]], [[9, 0, 0, 0, 0, 0, 1]], gap=0.5).numpy()
    array([False])
"""

from warp_bounding.pairs.balls import Balls
from warp_bounding.pairs.kernels import PairData
from warp_bounding.pairs.pair import Pair
from warp_bounding.pairs.robot_balls import LinkHeld, RobotBalls

__all__ = ["Balls", "LinkHeld", "Pair", "PairData", "RobotBalls"]
