"""Launching batch kernels: on a CPU, Warp runs a launch on one core, so the blocks are dealt out to several threads.

Only launches whose outputs are disjoint and that use no tiles are threaded; modules are loaded on the calling thread.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise

import warp as wp

__all__ = ["BLOCK", "cpu_threads", "launch_blocks"]

BLOCK = 512  # queries that one CPU thread of a batch kernel works on; CUDA: one
SMALLEST_SHARE = 16  # blocks per thread under which waking a thread costs more than it saves


def cpu_threads() -> int:
    """Threads that batch launches use on a CPU: the cores this process may run on, or ``WARP_BOUNDING_THREADS``."""
    wanted = os.environ.get("WARP_BOUNDING_THREADS", "")
    if wanted.isdigit():
        return max(1, int(wanted))
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="warp_bounding")


def launch_blocks(
    kernel: wp.Kernel, count: int, inputs: list, outputs: list, device, *, first_index: int, block: int = BLOCK
) -> None:
    """Launch a kernel over the blocks of ``count`` items.

    Args:
        kernel: Takes the number of its first block at ``inputs[first_index]`` and adds ``wp.tid()``.
        count: Items; on a CPU a thread of the kernel handles ``block`` of them, on CUDA one.
        inputs: Kernel inputs; ``inputs[first_index]`` is replaced.
        outputs: Kernel outputs.
        device: A ``wp.Device``.
        first_index: Where the first block's number stands.
        block: Items per CPU block.
    """
    if count == 0:
        return
    if not device.is_cpu:
        wp.launch(kernel, dim=count, inputs=inputs, outputs=outputs, device=device)
        return
    blocks = -(-count // block)
    threads = min(cpu_threads(), blocks // SMALLEST_SHARE)
    if threads < 2:
        wp.launch(kernel, dim=blocks, inputs=inputs, outputs=outputs, device=device)
        return
    edges = [blocks * t // threads for t in range(threads + 1)]
    commands = []
    for begin, end in pairwise(edges):
        inputs = [*inputs[:first_index], begin, *inputs[first_index + 1 :]]
        commands.append(
            wp.launch(kernel, dim=end - begin, inputs=inputs, outputs=outputs, device=device, record_cmd=True)
        )
    waiting = [_pool(threads - 1).submit(command.launch) for command in commands[1:]]
    commands[0].launch()
    for future in waiting:
        future.result()
