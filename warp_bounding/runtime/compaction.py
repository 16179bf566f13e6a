"""Compaction on the device: the ascending indices of a mask's set entries, and their number. Nothing is read back.

There are three steps: count per block, scan the counts, write. A single block is only written. On a CPU both passes
over the mask use several threads.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
import warp as wp

from warp_bounding.errors import QueryError
from warp_bounding.runtime.launch import BlockLaunch, ready
from warp_bounding.runtime.native import named

__all__ = ["Compaction", "compact"]

CPU_BLOCK, CUDA_BLOCK = 16384, 64  # mask entries that one thread of a kernel goes through


@named("wb_count_in_blocks").block_kernel("""
const int begin = block * size; const int end = begin + size < count ? begin + size : count;
int sum = 0;
for (int i = begin; i < end; ++i) sum += mask.data[i] != 0;
counts.data[block] = sum;
""")
def _count(mask: wp.array(dtype=wp.uint8), count: int, size: int, block: int, counts: wp.array(dtype=wp.int32)): ...


@named("wb_write_indices").block_kernel("""
const int begin = block * size; const int end = begin + size < count ? begin + size : count;
int at = block > 0 ? ends.data[block - 1] : 0;
const int last = ends.data[block];
int i = begin;
for (; i + 8 <= end && at < last; i += 8) {
    unsigned long long word;
    memcpy(&word, mask.data + i, 8);
    if (!word) continue;  // where little is set, most of eight entries in a row are none
    for (int l = i; l < i + 8 && at < last; ++l) { indices.data[at] = l; at += mask.data[l] != 0; }
}
for (; i < end && at < last; ++i) { indices.data[at] = i; at += mask.data[i] != 0; }
if (end == count) total.data[0] = at;
""")
def _write(
    mask: wp.array(dtype=wp.uint8),
    count: int,
    size: int,
    block: int,
    ends: wp.array(dtype=wp.int32),
    indices: wp.array(dtype=wp.int32),
    total: wp.array(dtype=wp.int32),
): ...


class Compaction:
    """The compaction of one mask, its memory made once.

    Attributes:
        indices: ``(N,)`` int32; after ``launch`` its first ``n`` entries are the ascending indices of what is not zero.
        count: ``n`` as a 1-element int32 array.
    """

    def __init__(self, mask: wp.array):
        """Make the memory for a ``(N,)`` uint8 mask, which is read at every launch; ``QueryError`` for another one."""
        if not isinstance(mask, wp.array) or mask.dtype != wp.uint8 or mask.ndim != 1 or not mask.is_contiguous:
            got = f"{mask.dtype.__name__} of shape {mask.shape}" if isinstance(mask, wp.array) else type(mask).__name__
            raise QueryError(f"mask must be a contiguous wp.array of uint8 of shape (N,), got {got}")
        device, count = mask.device, mask.shape[0]
        self.indices = wp.empty(count, dtype=wp.int32, device=device)
        self.count = wp.zeros(1, dtype=wp.int32, device=device)
        self._steps: list[Callable[[], None]] = []
        self._recorded: list[Callable[[], None]] = []  # the same as a graph can hold them
        if count == 0:
            return
        size = CPU_BLOCK if device.is_cpu else CUDA_BLOCK
        blocks = -(-count // size)
        items = count if device.is_cpu else blocks  # one launch item a block on CUDA
        options = {"device": device, "first_index": 3, "block": size}
        ends = wp.full(blocks, count, dtype=wp.int32, device=device)
        if blocks > 1:  # a single block begins to write at 0
            counts = wp.empty(blocks, dtype=wp.int32, device=device)
            scanning = scanned = partial(wp.utils.array_scan, counts, ends, inclusive=True)
            if device.is_cpu:  # the same without Warp's checks, which take longer than the sum
                scanning = partial(np.cumsum, counts.numpy(), out=ends.numpy())
            counting = BlockLaunch(_count, items, [mask, count, size, 0], [counts], **options)
            self._steps += [counting.launch, scanning]
            self._recorded += [counting.launch_whole, scanned]
            ready(_count, device)
        outputs = [self.indices, self.count]
        writing = BlockLaunch(_write, items, [mask, count, size, 0, ends], outputs, **options)
        self._steps.append(writing.launch)
        self._recorded.append(writing.launch_whole)
        ready(_write, device)

    def launch(self) -> tuple[wp.array, wp.array]:
        """Fill ``indices`` and ``count``, and return them."""
        for step in self._steps:
            step()
        return self.indices, self.count

    def launch_recorded(self) -> tuple[wp.array, wp.array]:
        """As ``launch``, by nothing but launches of Warp's, for a graph that is being captured; on one core of a CPU."""
        for step in self._recorded:
            step()
        return self.indices, self.count


def compact(mask: wp.array) -> tuple[wp.array, wp.array]:
    """Indices of what is not zero in a mask.

    Args:
        mask: ``(N,)`` uint8.

    Returns:
        ``(N,)`` int32, ascending indices in its first ``n`` entries, and ``n`` as a 1-element int32 array.

    Raises:
        QueryError: For another type or shape.

    Example:
        >>> indices, count = wb.compact(bounder.query(points))
        >>> int(count.numpy()[0]) == int(bounder.query(points).numpy().sum())
        True
    """
    return Compaction(mask).launch()
