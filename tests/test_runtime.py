"""Blocks are dealt out without a gap or an overlap, whatever interrupts; the clock; compaction; progress."""

import os
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

import warp_bounding as wb
from warp_bounding.errors import BounderError
from warp_bounding.networks.tensor_cores import MOST_THREADS
from warp_bounding.runtime import launch
from warp_bounding.runtime.arrays import MOST_NUMBERS
from warp_bounding.runtime.launch import BLOCK, BlockLaunch, OutOfTimeError, launch_blocks, limited, run_shares
from warp_bounding.runtime.progress import reported, slow


@wp.kernel(enable_backward=False)
def _visit(first: int, size: int, count: int, out: wp.array(dtype=wp.int32)):
    block = first + wp.tid()
    for i in range(block * size, wp.min(block * size + size, count)):
        out[i] = out[i] + 1


# --- launches --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("threads", ["1", "2", "7"])
@pytest.mark.parametrize("count", [0, 1, BLOCK, BLOCK + 1, 200 * BLOCK])
def test_every_item_is_visited_once(monkeypatch, threads, count):
    monkeypatch.setenv("WARP_BOUNDING_THREADS", threads)
    out = wp.zeros(max(count, 1), dtype=wp.int32, device="cpu")
    launch_blocks(_visit, count, [0, BLOCK, count], [out], wp.get_device("cpu"), first_index=0)
    assert (out.numpy()[:count] == 1).all()


@pytest.fixture
def three(monkeypatch):
    """Three threads, of which every launch is worth waking two."""
    monkeypatch.setenv("WARP_BOUNDING_THREADS", "3")
    monkeypatch.setattr(launch, "WORTH_WAKING", 1e-12)


def visits(count=200 * BLOCK):
    out = wp.zeros(count, dtype=wp.int32, device="cpu")
    return BlockLaunch(_visit, count, [0, BLOCK, count], [out], wp.get_device("cpu"), first_index=0), out


def test_what_a_share_raises_is_raised_where_it_was_asked_for(three):
    def fail() -> None:
        raise ZeroDivisionError

    for shares in ([fail, int, int], [int, fail, int], [fail] * 3):
        with pytest.raises(ZeroDivisionError):
            run_shares(shares)
    recorded, out = visits()
    for number in range(1, 100):  # woken again and again
        recorded.launch()
        assert (out.numpy() == number).all()


def test_whoever_is_interrupted_leaves_nobody_at_work(three):
    caller, begun, working, ended = threading.current_thread(), threading.Event(), [], []

    def share() -> None:
        if threading.current_thread() is caller:
            begun.wait()
            raise KeyboardInterrupt
        working.append(1)
        begun.set()
        time.sleep(0.05)
        ended.append(working.pop())

    with pytest.raises(KeyboardInterrupt):
        run_shares([share] * 4)
    assert working == []
    assert ended
    done = []
    run_shares([lambda: done.append(1)] * 3)
    assert len(done) == 3


def test_a_share_may_launch_and_other_callers_need_not_wait(three):
    inner = []
    run_shares([lambda: run_shares([lambda: inner.append(1)] * 3)] * 3)
    assert len(inner) == 9
    held = threading.Event()
    busy = threading.Thread(target=run_shares, args=([held.wait, held.wait, int],))
    busy.start()
    recorded, out = visits()
    recorded.launch()
    assert (out.numpy() == 1).all()
    held.set()
    busy.join()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_a_forked_process_has_threads_of_its_own(three):
    recorded, out = visits()
    recorded.launch()
    before = launch._threads
    child = os.fork()
    if child == 0:
        try:
            recorded.launch()
            os._exit(int((out.numpy() != 2).any() or launch._threads is before or len(launch._threads) != 2))
        finally:
            os._exit(3)
    for _ in range(600):
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            break
        time.sleep(0.1)
    else:
        os.kill(child, 9)
        os.waitpid(child, 0)
        pytest.fail("the child waits for threads that it does not have")
    assert os.waitstatus_to_exitcode(status) == 0


# --- the working clock -----------------------------------------------------------------------------------------------


def test_limits_end_what_takes_too_long_and_nothing_else():
    def wait(seconds):
        end = launch.working_seconds() + seconds
        while launch.working_seconds() < end:
            pass

    with limited(1e6):
        before = launch.working_seconds()
        with pytest.raises(OutOfTimeError), limited(0.01):
            wait(60.0)
        assert launch.working_seconds() < before + 60.0  # and the outer limit holds again
    with pytest.raises(OutOfTimeError), limited(-1.0), limited(1e6):
        launch.working_seconds()
    told = []
    other = threading.Thread(target=lambda: told.append(launch.working_seconds()))
    with limited(-1.0):  # threads have limits of their own
        other.start()
        other.join()
    assert len(told) == 1


# --- compaction ------------------------------------------------------------------------------------------------------


def test_a_kernel_is_loaded_for_each_size_of_blocks(monkeypatch):
    """A graph that is being captured may load nothing."""
    loaded = []
    monkeypatch.setattr(wp, "load_module", lambda module, device, block_dim: loaded.append(block_dim))
    monkeypatch.setattr(launch, "_ready", set())
    cuda = SimpleNamespace(alias="cuda:0", is_cpu=False)
    for device, block_dim in [(cuda, 128), (cuda, 256), (wp.get_device("cpu"), 256), (cuda, 128), (cuda, 256)]:
        launch.ready(_visit, device, block_dim)
    assert loaded == [128, 256, None]


def test_no_count_of_queries_overflows():
    """On tensor cores a thread's next query is as many as there are threads behind its last one."""
    assert MOST_NUMBERS + MOST_THREADS + 32 <= 2**31


@pytest.mark.parametrize("count", [0, 1, 65, 16383, 16384, 16385, 100_003])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 1.0])
def test_indices_of_what_is_true(device, count, share):
    rng = np.random.default_rng(count)
    mask = ((rng.random(count) < share) * rng.integers(1, 256, count)).astype(np.uint8)  # bytes of others' memory
    indices, found = wb.compact(wp.array(mask, dtype=wp.uint8, device=device).view(wp.bool))
    total = int(found.numpy()[0])
    assert len(indices) == count
    assert (indices.numpy()[:total] == np.flatnonzero(mask)).all()
    assert total == np.count_nonzero(mask)


def test_other_arrays_are_refused():
    gaps = wp.ones((6, 2), dtype=wp.bool, device="cpu")[:, 0]
    for mask in (np.ones(3, bool), wp.ones(3, dtype=wp.uint8, device="cpu"), gaps):
        with pytest.raises(wb.QueryError, match=r"mask must be a contiguous wp.array of bool of shape \(N,\), got"):
            wb.compact(mask)


# --- progress --------------------------------------------------------------------------------------------------------


def test_a_function_is_called_as_it_is_and_anything_else_is_refused():
    seen = []
    with reported(lambda *given: seen.append(given), "fit") as report:
        report(0.5, 1.0, "half")
    assert seen == [(0.5, 1.0, "half")]
    with reported(False, "fit") as report:
        assert report is None
    for wrong in (5, True, "bar"):
        with pytest.raises(BounderError, match="progress must be a function, None or False, got"), reported(wrong, ""):
            pass


@pytest.mark.parametrize("terminal", [True, False])
def test_slow_work_is_reported_while_it_runs_on_a_terminal_only(monkeypatch, terminal):
    written, lines = threading.Event(), []

    class Screen:
        """Standard error that wakes the work as soon as a line comes."""

        def isatty(self):
            written.set()
            return terminal

        def write(self, text):
            lines.append(text)

        def flush(self): ...

    monkeypatch.setattr("sys.stderr", Screen())
    with slow("reading a.obj", after=0.0):
        assert written.wait(60)
    with slow("reading b.obj", after=600.0):
        pass
    for timer in [thread for thread in threading.enumerate() if isinstance(thread, threading.Timer)]:
        timer.join()
    assert "".join(lines) == "warp-bounding: reading a.obj\n" * terminal
