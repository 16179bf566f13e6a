"""Pairs of placed meshes: a distance bounder of one against balls that hold the other."""

from warp_bounding.pairs.balls import Balls
from warp_bounding.pairs.kernels import PairData
from warp_bounding.pairs.pair import Pair

__all__ = ["Balls", "Pair", "PairData"]
