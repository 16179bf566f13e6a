"""Depth-first branch and bound over boxes of a chart, inside one native kernel.

A block (a thread on CUDA) has a stack of boxes in global memory. It takes as many as it has lanes, bounds them, closes
those whose bound reaches the target and halves the others, until the stack is empty or full, the block has bounded as
many boxes as it may, or a positive lies under the target. What is then left on the stack waits for the next launch. If
the target is -infinity, all boxes are bounded once and closed, however many there are, and a bound that is NaN counts
as -infinity. A box that is too narrow to be halved is closed, too: the least bound of a closed box then lies below the
target, and is what can be proven.
"""

import re
from functools import cache

import warp as wp

from warp_bounding.activations import constant, constants
from warp_bounding.networks.bounds import AXIS, NetworkShape, body, lanes_text, load_text
from warp_bounding.runtime.native import named, unique_name

__all__ = ["KEPT", "STACK", "depth_first_kernel"]

STACK = 1024  # boxes that a block can hold; a stack grows by one box for each lane and level, of about 60 levels
RARELY = 4  # f is tried once in so many steps: it takes a quarter of the time of a bound, and seldom tells anything new
SMALLEST = 1e-8  # in the chart's numbers: a box no wider than this is closed, since halving would not raise its bound
KEPT = 8  # low points that a block returns


# A block's search; BODY bounds the boxes of all lanes, SPLIT sets where one is halved.
_SEARCH = """
double* stack = stacks.data + (long long)block * (STACK * ROW);
double* kept_value = low_value.data + block * KEPT; double* kept_point = low_point.data + (long long)block * (KEPT * BOX);
for (int k = 0; k < KEPT; ++k) kept_value[k] = INFINITY;
int held = heights.data[block], initial = initials.data[block], turn = 0, rounds = 0;
long long done = 0; double closed = INFINITY;
bool refuted = false; // whether a positive lies under the target
const bool last = isinf(target) && target < 0.0;
while (held > 0 && (last || (done < most && held + L <= STACK && !refuted))) {
    const int taken = held < L ? held : L;
    held -= taken; initial = held < initial ? held : initial;
    const bool tried = !isfinite(target) || rounds++ % RARELY == 0; turn = (turn + tried) % KEPT;
    V low[BOX], high[BOX];
    for (int l = 0; l < L; ++l) { const int j = held + (l < taken ? l : 0); LOAD }
    BODY
    done += taken;
    for (int l = 0; l < taken; ++l) {
        if (LANE(dead) != 0.0) continue;
        if (LANE(valid) != 0.0 && LANE(value) < kept_value[turn]) {
            kept_value[turn] = LANE(value); refuted = refuted || LANE(value) < target;
            for (int k = 0; k < BOX; ++k) kept_point[turn * BOX + k] = LANE(z[k]);
        }
        const double bound = LANE(least);
        if (last) { const double b = bound == bound ? bound : target; closed = b < closed ? b : closed; continue; }
        if (bound >= target) { closed = bound < closed ? bound : closed; continue; }
        AXIS
        double* one = stack + (long long)held * ROW; double* two = one + ROW;
        for (int k = 0; k < BOX; ++k) { one[k] = two[k] = LANE(low[k]); one[BOX + k] = two[BOX + k] = LANE(high[k]); }
        if (one[BOX + axis] - one[axis] < SMALLEST)
            for (int k = 0; k < BOX; ++k) if (one[BOX + k] - one[k] > one[BOX + axis] - one[axis]) axis = k;
        if (one[BOX + axis] - one[axis] < SMALLEST) {
            const double b = bound == bound ? bound : -INFINITY; closed = b < closed ? b : closed; continue;
        }
        held += 2;
        const double a = one[axis], b = one[BOX + axis]; double middle;
        SPLIT
        one[BOX + axis] = middle; two[axis] = middle;
    }
}
heights.data[block] = held; initials.data[block] = initial; done_out.data[block] = done; closed_out.data[block] = closed;
"""


def _snippet(shape: NetworkShape) -> str:
    names = "const double* w = weights.data; const double* padding = paddings.data;\n"
    names += constants(BOX=shape.chart.size, ROW=2 * shape.chart.size, STACK=STACK, RARELY=RARELY, KEPT=KEPT)
    names += f" constexpr double SMALLEST = {constant(SMALLEST)};"
    cpu, cuda = lanes_text(shape, names)
    parts = {"LOAD": load_text("stack", "j"), "BODY": body(shape, "tried"), "AXIS": AXIS, "SPLIT": shape.chart.split}
    search = re.sub(r"\b(LOAD|BODY|AXIS|SPLIT)\b", lambda part: parts[part.group()], _SEARCH)
    return f"""
#if !defined(__CUDA_ARCH__)
{cpu}
{search}
#else
{cuda}
{search}
#endif
#undef LANE
"""


@cache
def depth_first_kernel(shape: NetworkShape) -> wp.Kernel:
    """The kernel for a network and a chart; a thread searches the block ``block + wp.tid()``.

    It reads and writes ``stacks`` ``(blocks, STACK, 2, Z)`` float64, ``heights`` ``(blocks,)`` int32, the number of
    boxes on each stack, and ``initials`` ``(blocks,)`` int32, how many of the lowest of these are initial boxes. It
    writes ``done_out``, the number of boxes bounded (int64), ``closed_out``, the least bound of a box that it has
    closed, ``low_value`` ``(blocks, KEPT)`` and ``low_point`` ``(blocks, KEPT, Z)``, low positives.
    """
    name = named(unique_name(shape, "descent"))

    @name.block_kernel(_snippet(shape))
    def descend(
        block: int,
        target: wp.float64,
        most: int,
        weights: wp.array(dtype=wp.float64),
        paddings: wp.array(dtype=wp.float64),
        numbers: wp.array(dtype=wp.float64),
        table: wp.array(dtype=wp.int32),
        stacks: wp.array(dtype=wp.float64),
        heights: wp.array(dtype=wp.int32),
        initials: wp.array(dtype=wp.int32),
        done_out: wp.array(dtype=wp.int64),
        closed_out: wp.array(dtype=wp.float64),
        low_value: wp.array(dtype=wp.float64),
        low_point: wp.array(dtype=wp.float64),
    ): ...

    return descend
