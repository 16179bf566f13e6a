"""By how much can a function exceed the distance to a union of boxes, in a box? See ``triangles/excess.py``, whose argument this is, in any dimension.

Here the pieces are solid, so that there is no side to ask for. The distance to a piece is at least ``m (n . x - h)`` for any unit vector n,
with h the piece's support along n, and any m from 0 to 1, since it is at least 0: so a box may reach into the piece, where the
distance has a bend and a smooth function goes through with a slope between both. Taken are m = 1 and the function's own slope along n; n leads from the
piece's nearest point to the centre of the box, or out of the piece's nearest face where the centre lies in it.
"""

from functools import cache

import warp as wp

__all__ = ["excess_kernel"]

DEEPEST = 32  # levels of a hierarchy
ROOM = (
    2.0**-44
)  # relative to all coordinates and values: some hundred times what float64 rounds in these few sums and products
SHORTEST = 2.0**-300  # a piece that is nearer to the centre has no direction


@cache
def excess_kernel(n: int) -> wp.Kernel:
    """``(first, lower, upper, node_lower, node_upper, links, room, box_lower, box_upper, values, least, enough, excess)`` in n dimensions."""
    vector, narrow = wp.types.vector(n, wp.float64), wp.types.vector(n, wp.float32)
    stack_of, corners, count = wp.types.vector(DEEPEST, wp.int32), wp.types.vector(2**n, wp.float64), 2**n

    @wp.func
    def number(low: vector, high: vector, centre: vector, half: vector, values: corners, room: wp.float64):
        """The least bound of the values less multiples of the plane under the distance to a piece; and that distance at the centre."""
        normal, length, support = vector(), wp.float64(0.0), wp.float64(0.0)
        for k in range(n):
            normal[k] = -wp.max(low[k] - centre[k], wp.min(high[k] - centre[k], wp.float64(0.0)))
            length += normal[k] * normal[k]
        length = wp.sqrt(length)
        if length > wp.float64(SHORTEST):
            for k in range(n):
                normal[k] = normal[k] / length
                support += wp.max(normal[k] * (low[k] - centre[k]), normal[k] * (high[k] - centre[k]))
        else:  # the plane of the face that is nearest
            nearest, side = wp.int32(0), wp.float64(1.0)
            support = wp.float64(wp.inf)
            for k in range(n):
                normal[k] = wp.float64(0.0)
                if high[k] - centre[k] < support:
                    nearest, side, support = k, wp.float64(1.0), high[k] - centre[k]
                if centre[k] - low[k] < support:
                    nearest, side, support = k, wp.float64(-1.0), centre[k] - low[k]
            normal[nearest] = side
        rise, run = wp.float64(0.0), wp.float64(0.0)
        for i in range(count):
            along = wp.float64(0.0)
            for k in range(n):
                along += wp.where((i >> k) & 1, half[k], -half[k]) * normal[k]
            rise += values[i] * along
            run += along * along
        share = wp.float64(1.0)
        if run > wp.float64(0.0):
            share = wp.clamp(rise / run, wp.float64(0.0), wp.float64(1.0))
        whole, part = -wp.float64(wp.inf), -wp.float64(wp.inf)
        for i in range(count):
            along = wp.float64(0.0)
            for k in range(n):
                along += wp.where((i >> k) & 1, half[k], -half[k]) * normal[k]
            whole = wp.max(whole, values[i] - along)
            part = wp.max(part, values[i] - share * along)
        return wp.min(whole + support, part + share * support) + room, length

    @wp.func
    def wide(x: narrow) -> vector:
        y = vector()
        for k in range(n):
            y[k] = wp.float64(x[k])
        return y

    @wp.kernel(enable_backward=False, module="unique")
    def find(
        first: int,
        # inputs
        lower: wp.array(dtype=vector),
        upper: wp.array(dtype=vector),
        node_lower: wp.array(dtype=narrow),
        node_upper: wp.array(dtype=narrow),
        links: wp.array(dtype=wp.vec3i),
        slack: wp.float64,
        box_lower: wp.array(dtype=vector),
        box_upper: wp.array(dtype=vector),
        values: wp.array(dtype=corners),
        least: wp.float64,
        enough: wp.array(dtype=wp.float64),
        # outputs
        excess: wp.array(dtype=wp.float64),
    ):
        item = first + wp.tid()
        low, high, f = box_lower[item], box_upper[item], values[item]
        centre, half, size = vector(), vector(), slack
        for k in range(n):
            centre[k] = low[k] * wp.float64(0.5) + high[k] * wp.float64(0.5)
            half[k] = wp.max(high[k] - centre[k], centre[k] - low[k])
            size += wp.abs(centre[k]) + half[k]
        highest = f[0]
        for i in range(count):
            highest = wp.max(highest, f[i])
            size = wp.max(size, wp.abs(f[i]))
        room = size * wp.float64(ROOM)
        known = wp.min(least, highest)
        stack, depth, node = stack_of(), wp.int32(0), wp.int32(0)
        while node >= 0 and known < highest and known <= enough[item]:
            own, _at = number(wide(node_lower[node]), wide(node_upper[node]), centre, half, f, room)
            while own > known and links[node][1] == 0:
                near = node + 1
                other = links[near][2]
                near_own, near_at = number(wide(node_lower[near]), wide(node_upper[near]), centre, half, f, room)
                other_own, other_at = number(wide(node_lower[other]), wide(node_upper[other]), centre, half, f, room)
                swap = other_at < near_at
                node = wp.where(swap, other, near)
                own = wp.where(swap, other_own, near_own)
                if wp.where(swap, near_own, other_own) > known:
                    stack[depth] = wp.where(swap, near, other)
                    depth += 1
            if own > known:
                for box in range(links[node][0], links[node][1]):
                    told, _away = number(lower[box], upper[box], centre, half, f, room)
                    known = wp.max(known, wp.min(highest, told))
            node = wp.int32(-1)
            if depth > 0:
                depth -= 1
                node = stack[depth]
        if known > enough[item]:
            known = highest  # the walk has not seen all pieces
        excess[item] = wp.max(known, least)

    return find
