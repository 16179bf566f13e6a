"""Depth-first branch and bound over boxes of a chart, inside one native kernel.

A block (a thread on CUDA) has a stack of boxes in global memory. It takes as many as it has lanes, bounds them, closes
those whose bound reaches the target and halves the others, until the stack is empty, its work is done, or a positive
lies under the target; if that is -infinity, all are closed, without a limit, those with bound NaN at -infinity. What is
left on the stack is the caller's. A box that has become too small to be halved is closed, too: the least bound of a
closed box then lies below the target, and that is what can be proven.
"""

import re
from functools import cache

import warp as wp

from warp_bounding.activations.base import constant
from warp_bounding.networks.bound_source import NetworkSizes, body, lanes_text, load_text
from warp_bounding.networks.bound_text import AXIS
from warp_bounding.networks.inference import constants
from warp_bounding.runtime.native import named, unique_name

__all__ = ["KEPT", "STACK", "depth_first_kernel"]

STACK = 1024  # boxes that a block can hold; a stack grows by one box a lane and level, about 60 levels deep
RARELY = 4  # f is tried once in so many steps: it takes a quarter of the time of a bound, and seldom tells anything new
SMALLEST = 1e-8  # a box that is no wider than this is closed as it is: what it falls short of the target by, no halving will mend
KEPT = 8  # low points that a block returns


# A block's search; BODY bounds the boxes of all lanes, SPLIT sets where one is halved.
_SEARCH = """
double* stack = stacks.data + (long long)block * (STACK * ROW);
double* kept_value = low_value.data + block * KEPT; double* kept_point = low_point.data + (long long)block * (KEPT * BOX);
for (int k = 0; k < KEPT; ++k) kept_value[k] = INFINITY;
int held = heights.data[block], first = firsts.data[block], turn = 0, rounds = 0;
long long done = 0; double closed = INFINITY;
bool broken = false; // whether a positive lies under the target
const bool last = isinf(target) && target < 0.0;
while (held > 0 && (last || (done < most && held + L <= STACK && !broken))) {
    const int taken = held < L ? held : L;
    held -= taken; first = held < first ? held : first;
    const bool tried = !isfinite(target) || rounds++ % RARELY == 0; turn = (turn + tried) % KEPT;
    V low[BOX], high[BOX];
    for (int l = 0; l < L; ++l) { const int j = held + (l < taken ? l : 0); LOAD }
    BODY
    done += taken;
    for (int l = 0; l < taken; ++l) {
        if (LANE(dead) != 0.0) continue;
        if (LANE(valid) != 0.0 && LANE(value) < kept_value[turn]) {
            kept_value[turn] = LANE(value); broken = broken || LANE(value) < target;
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
heights.data[block] = held; firsts.data[block] = first; done_out.data[block] = done; closed_out.data[block] = closed;
"""


def _snippet(sizes: NetworkSizes) -> str:
    names = "const double* w = weights.data; const double* padding = paddings.data;\n"
    names += constants(BOX=sizes.chart.size, ROW=2 * sizes.chart.size, STACK=STACK, RARELY=RARELY, KEPT=KEPT)
    names += f" constexpr double SMALLEST = {constant(SMALLEST)};"
    cpu, cuda = lanes_text(sizes, names)
    parts = {"LOAD": load_text("stack", "j"), "BODY": body(sizes, "tried"), "AXIS": AXIS, "SPLIT": sizes.chart.split()}
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
def depth_first_kernel(sizes: NetworkSizes) -> wp.Kernel:
    """The kernel for a network and a chart; a thread searches the block ``first + wp.tid()``.

    Arrays: ``stacks`` ``(blocks, STACK, 2, Z)`` float64, ``heights`` ``(blocks,)`` int32 and ``firsts``, how many of
    the lowest have waited from the start, in and out; ``done_out`` int64 boxes bounded, ``closed_out`` the least bound
    of a closed box, ``low_value`` ``(blocks, KEPT)`` and ``low_point`` low positives.
    """
    name = named(unique_name(sizes, "descent"))

    @name.func_native(_snippet(sizes))
    def descend_block(
        block: int,
        target: wp.float64,
        most: int,
        weights: wp.array(dtype=wp.float64),
        paddings: wp.array(dtype=wp.float64),
        numbers: wp.array(dtype=wp.float64),
        table: wp.array(dtype=wp.int32),
        stacks: wp.array(dtype=wp.float64),
        heights: wp.array(dtype=wp.int32),
        firsts: wp.array(dtype=wp.int32),
        done_out: wp.array(dtype=wp.int64),
        closed_out: wp.array(dtype=wp.float64),
        low_value: wp.array(dtype=wp.float64),
        low_point: wp.array(dtype=wp.float64),
    ): ...

    @name.kernel
    def descend(
        # inputs
        first: int,
        target: wp.float64,
        most: int,
        weights: wp.array(dtype=wp.float64),
        paddings: wp.array(dtype=wp.float64),
        numbers: wp.array(dtype=wp.float64),
        table: wp.array(dtype=wp.int32),
        # outputs
        stacks: wp.array(dtype=wp.float64),
        heights: wp.array(dtype=wp.int32),
        firsts: wp.array(dtype=wp.int32),
        done_out: wp.array(dtype=wp.int64),
        closed_out: wp.array(dtype=wp.float64),
        low_value: wp.array(dtype=wp.float64),
        low_point: wp.array(dtype=wp.float64),
    ):
        descend_block(
            first + wp.tid(),
            target,
            most,
            weights,
            paddings,
            numbers,
            table,
            stacks,
            heights,
            firsts,
            done_out,
            closed_out,
            low_value,
            low_point,
        )

    return descend
