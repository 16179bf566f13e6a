"""Where the links of an arm are, in float64 kernels, and what that rounds.

With u = 2^-53, n joints, and S the size of all (how far from the origin any corner, joint or obstacle can be): sine and cosine err by
4 u, say, a product of two rotations by 3 u an entry, so that a rotation is off by 32 u for each joint before it, in the operator norm, and a place by
40 n u S. The first derivatives of a corner are cross products of such numbers, off by 100 n u S at most. A linear bound over a box takes
each of them times half the box's side, at most 1, and twice n of them. With n up to 16 all that is under 2^13 u S. A configuration
that is computed from weighted coordinates is off by 2^-50 of its numbers, up to ``FARTHEST``, which moves corners by no more than 16 times 2^-46 S. What is
allowed is far more than all of it, and far less than anything that matters.
"""

from functools import cache
from typing import Any

import warp as wp

from warp_bounding.indicators.arms.separation import Place
from warp_bounding.runtime.native import named

__all__ = ["ALLOWANCE", "Chain", "Kinematics", "kinematics_of"]

ALLOWANCE = 2.0**-36  # of the size of all: by how much a gap may be off; see above


@wp.struct
class Chain:
    """The joints: each one's origin in the frame of the one before, z being the axis."""

    turn: wp.array(dtype=wp.mat33d)
    at: wp.array(dtype=wp.vec3d)
    slides: wp.array(dtype=wp.int32)


class Kinematics:
    """Warp types and functions for arms of n joints.

    Attributes:
        values: The type of n joint values.
        turns: The type of all links' rotations, three rows each.
        places: The type of all links' origins.
        place: ``place(chain, q, turns, places)`` fills in both, ``turns`` and ``places`` being variables of the caller.
        link: ``link(turns, places, i) -> Place``; of the base where i is below 0.
        rate: ``rate(chain, turns, places, i, x) -> vec3d``, how the place x of a corner changes with joint i.
    """

    def __init__(self, n: int):
        self.values = values = wp.types.vector(length=n, dtype=wp.float64)
        self.turns = turns = wp.types.matrix(shape=(3 * n, 3), dtype=wp.float64)
        self.places = places = wp.types.matrix(shape=(n, 3), dtype=wp.float64)
        zero, one = wp.constant(wp.float64(0.0)), wp.constant(wp.float64(1.0))

        @named(f"arm_rotations_{n}").func
        def rotations(chain: Chain, q: values) -> turns:
            found, before = turns(), wp.identity(n=3, dtype=wp.float64)
            for i in range(n):
                before = before * chain.turn[i]
                if chain.slides[i] == 0:
                    c, s = wp.cos(q[i]), wp.sin(q[i])
                    before = before * wp.mat33d(c, -s, zero, s, c, zero, zero, zero, one)
                for row in range(3):
                    for column in range(3):
                        found[3 * i + row, column] = before[row, column]
            return found

        @named(f"arm_link_{n}").func
        def link(rotations: turns, origins: places, i: int) -> Place:
            found = Place()
            found.turn = wp.identity(n=3, dtype=wp.float64)
            if i >= 0:
                for row in range(3):
                    for column in range(3):
                        found.turn[row, column] = rotations[3 * i + row, column]
                found.at = wp.vec3d(origins[i, 0], origins[i, 1], origins[i, 2])
            return found

        @named(f"arm_origins_{n}").func
        def origins(chain: Chain, q: values, rotations: turns) -> places:
            found = places()
            for i in range(n):
                before = link(rotations, found, i - 1)
                at = before.at + before.turn * chain.at[i]
                if chain.slides[i] != 0:
                    at += wp.vec3d(rotations[3 * i, 2], rotations[3 * i + 1, 2], rotations[3 * i + 2, 2]) * q[i]
                for k in range(3):
                    found[i, k] = at[k]
            return found

        @named(f"arm_rate_{n}").func
        def rate(chain: Chain, rotations: turns, origins: places, i: int, x: wp.vec3d) -> wp.vec3d:
            axis = wp.vec3d(rotations[3 * i, 2], rotations[3 * i + 1, 2], rotations[3 * i + 2, 2])
            if chain.slides[i] != 0:
                return axis
            return wp.cross(axis, x - wp.vec3d(origins[i, 0], origins[i, 1], origins[i, 2]))

        self.rotations, self.origins, self.link, self.rate = rotations, origins, link, rate


@cache
def kinematics_of(n: int) -> Any:
    """The kinematics of n joints."""
    return Kinematics(n)
