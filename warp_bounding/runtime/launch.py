"""Launching batch kernels. Warp runs a launch on one core of a CPU; here several threads share its blocks.

Only launches whose outputs are disjoint and that use no tiles are threaded; the calling thread loads modules and
records launches. The threads sleep between launches. Any thread that is awake takes the next share, so a launch never
waits for a thread to wake: the caller then does everything itself. The time that a kernel's block took in the last
launch decides whether waking threads pays. (A ``ThreadPoolExecutor`` in their place makes batches of 0.3 ms a tenth
slower.)

A *block* is what one item of a CPU launch (one ``wp.tid()``) handles; *threads* are those of the operating system.

A kernel is compiled, or loaded from Warp's cache, before its first launch; ``working_seconds`` stands still meanwhile.
"""

import contextlib
import math
import os
import re
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from queue import SimpleQueue
from threading import Thread, Timer, local
from time import perf_counter

import warp as wp

from warp_bounding.errors import DeviceError


def device_of(name: str | wp.Device | None) -> wp.Device:
    """The Warp device of this name; the default device if ``None``.

    Raises:
        DeviceError: If this machine has none of this name.

    Example:
        >>> wb.device_of("cpu").is_cpu
        True
    """
    try:
        if name == "cuda" and not wp.get_cuda_device_count():  # Warp would print errors of the driver
            raise ValueError("no CUDA device")
        return wp.get_device(name)
    except (TypeError, ValueError, RuntimeError) as reason:
        names = [str(device) for device in wp.get_devices()]
        known = f"one of {', '.join(names)}" if len(names) > 1 else ", ".join(names)
        raise DeviceError(f"there is no such device on this machine: expected {known}, got {name!r}") from reason


class OutOfTimeError(Exception):
    """Work in ``limited`` has taken longer than it may."""


class _Own(local):
    """Numbers of each thread: another thread's compiling must not turn its clock back."""

    compiling = 0.0  # seconds that it has spent on compiling
    end = math.inf  # of its work, by its own clock


_own = _Own()


def compiled_for(seconds: float) -> None:
    """Take seconds that this thread has just spent on compiling off its clock."""
    _own.compiling += seconds


def compile_seconds() -> float:
    """Time that this thread has spent on compiling and loading the library's kernels."""
    return _own.compiling


def working_seconds() -> float:
    """The clock of budgets: ``time.perf_counter``, but it stands still while this thread compiles kernels.

    Raises ``OutOfTimeError`` in ``limited``, after its time.
    """
    now = time.perf_counter() - _own.compiling
    if now > _own.end:
        raise OutOfTimeError
    return now


@contextlib.contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Work of this thread that may take so many ``working_seconds``, for proofs that have no limit of their own.

    After this time its next look at that clock, or its next ``launch_once``, raises ``OutOfTimeError``. A limit within
    another one ends no later than the outer one.
    """
    before = _own.end
    _own.end = min(before, working_seconds() + seconds)
    try:
        yield
    finally:
        _own.end = before


BLOCK = 512  # queries of a block of a batch kernel; on CUDA one
BLOCK_DIM = 256  # threads of a block on CUDA, as Warp launches them
SMALLEST_SHARE = 16  # blocks: with fewer of them per thread, waking a thread costs more than it saves
WORTH_WAKING = 30e-6  # seconds: with less work per thread no thread is woken, because that takes 10 to 30 us

REPORT_AFTER = 1.0  # seconds of compiling after which it is reported
_reported: list[str] = []  # the module that was reported

_pace: dict[wp.Kernel, float] = {}  # seconds that a block of a kernel took the last time, on one thread


def cpu_threads() -> int:
    """Threads that batch launches use on a CPU: the cores this process may run on, or ``WARP_BOUNDING_THREADS``."""
    wanted = os.environ.get("WARP_BOUNDING_THREADS", "")
    if wanted.isdigit():
        return max(1, int(wanted))
    return len(os.sched_getaffinity(0))


class _Job:
    """The shares of one launch."""

    def __init__(self, shares: Sequence[Callable[[], None]]):
        self.error: BaseException | None = None
        self._open = list(shares)
        self._joined: list[None] = []  # one of each helper; appending is atomic
        self._gone: list[None] = []  # one of each helper that has ended
        self._news: SimpleQueue[None] = SimpleQueue()  # a helper has ended

    @property
    def over(self) -> bool:
        """Whether no share is open, and none that a helper has taken is still running."""
        return not self._open and len(self._gone) >= len(self._joined)

    def work(self) -> None:
        """Do shares until there are none left; popping from a list is atomic."""
        while self._open:
            try:
                share = self._open.pop()
            except IndexError:  # another thread was faster
                return
            try:
                share()
            except BaseException as error:  # raised where the launch was requested
                self.error = error

    def help(self) -> None:
        """``work``, by a thread that ``finish`` waits for."""
        self._joined.append(None)
        self.work()
        self._gone.append(None)
        self._news.put(None)

    def finish(self) -> None:
        """``work``, and wait for helpers."""
        self.work()
        while not self.over:
            self._news.get()


_jobs: SimpleQueue[_Job] = SimpleQueue()  # one entry for each thread that is to help
_threads: list[Thread] = []  # they sleep until there is a job


def _serve(jobs: SimpleQueue) -> None:
    while True:
        jobs.get().help()


def run_shares(shares: Sequence[Callable[[], None]]) -> None:
    """Do all shares, one a thread, and return when none is running any more, even after an interrupt.

    That matters because shares write to memory that the caller may free afterwards. A signal's handler may raise
    between any two steps: when a share has been taken but not begun, or an entry of the queue taken but not used. So
    the interrupted thread relies on nothing that it did before, and looks anew which helpers are at work. What a share
    or a handler has raised is raised at the end; some shares may then not have been done.
    """
    job = _Job(shares)
    try:
        while len(_threads) < len(shares) - 1:
            thread = Thread(target=_serve, args=(_jobs,), name=f"warp_bounding-{len(_threads)}", daemon=True)
            thread.start()
            _threads.append(thread)
        for _ in shares[1:]:
            _jobs.put(job)
    except BaseException as error:  # go on without the threads that could not be started
        job.error = error
    over = False
    while not over:
        try:
            job.finish()
            over = True
        except BaseException as error:
            job.error = error
    if job.error is not None:
        raise job.error


def _forget_threads() -> None:
    """Give a forked process threads of its own, because threads do not live on in it."""
    global _jobs, _threads
    _jobs, _threads = SimpleQueue(), []


os.register_at_fork(after_in_child=_forget_threads)


_ready: set[tuple[wp.Kernel, str, int | None]] = set()  # kernels that are loaded, by device and ``block_dim``


def ready(kernel: wp.Kernel, device: wp.Device, block_dim: int = BLOCK_DIM) -> None:
    """Compile and load a kernel's module, once; reports on standard error what takes more than a second.

    ``block_dim`` is what it is launched with on CUDA: Warp compiles it for each.
    """
    dim = None if device.is_cpu else block_dim
    if (kernel, device.alias, dim) not in _ready:
        slow = Timer(REPORT_AFTER, _report, [kernel.module.name])
        slow.daemon = True
        slow.start()
        started = time.perf_counter()
        try:
            wp.load_module(kernel.module, device, block_dim=dim)
        finally:
            slow.cancel()
        compiled_for(time.perf_counter() - started)
        _ready.add((kernel, device.alias, dim))


def _report(module: str) -> None:
    """Report what is being compiled, once; not if standard error is replaced, as in a notebook."""
    err = sys.stderr
    if err is None or _reported or not (err is sys.__stderr__ or err.isatty()):
        return
    _reported.append(module)
    name = re.sub(r"^warp_bounding\.|^wb_|_[0-9a-f]{8,}", "", module)
    print(f"warp-bounding: compiling kernels, once on this machine; the first is {name}", file=err)


class BlockLaunch:
    """A launch over the blocks of some items, recorded once with its memory, to be run many times."""

    def __init__(
        self,
        kernel: wp.Kernel,
        count: int,
        inputs: list,
        outputs: list,
        device,
        first_index: int,
        block: int = BLOCK,
        block_dim: int = BLOCK_DIM,
    ):
        """Define a launch; nothing runs yet.

        Args:
            kernel: Takes the number of its first block at ``inputs[first_index]`` and adds ``wp.tid()``.
            count: Number of items; on a CPU a thread of the kernel handles ``block`` of them, on CUDA one.
            inputs: Kernel inputs; ``inputs[first_index]`` is replaced.
            outputs: Kernel outputs.
            device: A ``wp.Device``.
            first_index: The input that is the number of the first block.
            block: Items per block on a CPU.
            block_dim: Threads of a block on CUDA.
        """
        self._kernel, self._inputs, self._outputs, self._device = kernel, inputs, outputs, device
        self._first_index, self._block_dim = first_index, block_dim
        self._blocks = -(-count // block) if device.is_cpu else count
        self._most = max(1, self._blocks // SMALLEST_SHARE) if device.is_cpu else 1  # threads
        self._recorded: dict[int, list[Callable[[], None]]] = {}  # shares, by how many there are

    def launch(self) -> None:
        """Run the launch; on a CPU it has ended when this returns."""
        if self._blocks == 0:
            return
        threads = 1
        if self._most > 1:
            threads = min(self._most, cpu_threads())
            if self._kernel in _pace:
                threads = max(1, min(threads, int(self._blocks * _pace[self._kernel] / WORTH_WAKING)))
        shares = self._recorded.get(threads) or self._record(threads)
        if threads == 1:
            shares[0]()
        else:
            run_shares(shares)

    def launch_once(self) -> None:
        """Run a launch that is needed once.

        One thread launches directly: recording first would add half of the launch's time. Several threads need a
        recording, since only the calling thread may call Warp.
        """
        working_seconds()
        if self._most == 1:
            self.launch_whole()
        else:
            self.launch()

    def launch_whole(self) -> None:
        """Run the launch on one thread by one call of Warp, so that a CUDA graph can capture it."""
        if self._blocks:
            self._warp_launch(0, self._blocks)

    def _warp_launch(self, begin: int, end: int, **options) -> "wp.Launch | None":
        ready(self._kernel, self._device, self._block_dim)
        inputs = [*self._inputs[: self._first_index], begin, *self._inputs[self._first_index + 1 :]]
        return wp.launch(
            self._kernel, end - begin, inputs, self._outputs, device=self._device, block_dim=self._block_dim, **options
        )

    def _record(self, threads: int) -> list[Callable[[], None]]:
        edges = [self._blocks * t // threads for t in range(threads + 1)]
        shares = [self._warp_launch(*ends, record_cmd=True).launch for ends in pairwise(edges)]
        if self._most > 1:
            kernel, first, blocks = self._kernel, shares[0], edges[1]

            def timed() -> None:
                start = perf_counter()
                first()
                _pace[kernel] = (perf_counter() - start) / blocks

            shares[0] = timed
        self._recorded[threads] = shares
        return shares


def launch_blocks(
    kernel: wp.Kernel, count: int, inputs: list, outputs: list, device, *, first_index: int, block: int = BLOCK
) -> None:
    """Launch a kernel over the blocks of ``count`` items; arguments as in ``BlockLaunch``."""
    BlockLaunch(kernel, count, inputs, outputs, device, first_index=first_index, block=block).launch_once()


def launch_on_cores(
    kernel: wp.Kernel, count: int, inputs: list, outputs: list, device: str | wp.Device | None = None
) -> None:
    """Launch a kernel of your own on all cores of a CPU, as batch queries are; Warp itself uses one core.

    So a broad phase and the narrow phase behind it have the same number of threads, ``WARP_BOUNDING_THREADS`` of them
    or one a core. On CUDA it is an ordinary launch.

    Args:
        kernel: Its first input is an int, the number of the launch's first item; its own item is ``first + wp.tid()``.
            Items write to disjoint places and use no tiles.
        count: Number of items.
        inputs: All inputs but the first.
        outputs: All outputs.
        device: Warp device; the default device if ``None``.

    Example:
        >>> @wp.kernel
        ... def double(first: int, x: wp.array(dtype=float), y: wp.array(dtype=float)):
        ...     i = first + wp.tid()
        ...     y[i] = 2.0 * x[i]
        >>> x = wp.full(5, 3.0, dtype=float, device="cpu")
        >>> y = wp.empty_like(x)
        >>> wb.launch_on_cores(double, 5, [x], [y], "cpu")
        >>> y.numpy()
        array([6., 6., 6., 6., 6.], dtype=float32)
    """
    launch_blocks(kernel, count, [0, *inputs], outputs, wp.get_device(device), first_index=0, block=1)
