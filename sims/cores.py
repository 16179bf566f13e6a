"""Launching a kernel over all cores: on a CPU, Warp runs a launch on one core.

The items are dealt out to as many Python threads as there are cores (Warp releases the GIL while a kernel runs). This
is sound for kernels whose items write to disjoint places and use no tiles. The library does the same with its batch
queries, so that a broad phase and a narrow phase that are compared have the same number of threads.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise

import warp as wp

import warp_bounding as wb

__all__ = ["cores", "device_of", "launch_on_all_cores"]

SMALLEST_SHARE = 256  # items per thread under which waking a thread costs more than it saves


def device_of(name: str | None) -> wp.Device:
    """The Warp device of this name; the default device if ``None``.

    Raises:
        QueryError: If there is none.
    """
    try:
        return wp.get_device(name)
    except (ValueError, RuntimeError) as error:
        names = ", ".join(str(device) for device in wp.get_devices())
        raise wb.QueryError(f"device must be one of {names}, got {name!r}") from error


def cores() -> int:
    """Threads for launches on a CPU: the cores this process may run on, or ``WARP_BOUNDING_THREADS`` as in the library."""
    wanted = os.environ.get("WARP_BOUNDING_THREADS", "")
    if wanted.isdigit():
        return max(1, int(wanted))
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="sims")


def launch_on_all_cores(kernel: wp.Kernel, count: int, inputs: list, outputs: list, device: wp.Device) -> None:
    """Launch ``count`` items of a kernel whose first input is the number of its first item.

    Args:
        kernel: Its item is ``first + wp.tid()``; its outputs are disjoint.
        count: Items.
        inputs: All inputs but ``first``.
        outputs: Outputs.
        device: Where.
    """
    threads = max(1, min(cores(), count // SMALLEST_SHARE)) if device.is_cpu else 1
    edges = [count * t // threads for t in range(threads + 1)]
    commands = [  # recorded here, on the calling thread, which also loads the module
        wp.launch(kernel, last - first, [first, *inputs], outputs, device=device, record_cmd=True)
        for first, last in pairwise(edges)
        if last > first
    ]
    waiting = [_pool(threads - 1).submit(command.launch) for command in commands[1:]]
    for command in commands[:1]:
        command.launch()
    for future in waiting:
        future.result()
