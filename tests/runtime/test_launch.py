"""Blocks are dealt out to threads without a gap or an overlap."""

import os
import threading
import time

import numpy as np
import pytest
import warp as wp

from warp_bounding.runtime import launch
from warp_bounding.runtime.launch import BLOCK, BlockLaunch, cpu_threads, launch_blocks


@wp.kernel(enable_backward=False)
def _visit(first: int, size: int, count: int, out: wp.array(dtype=wp.int32)):
    block = first + wp.tid()
    for i in range(block * size, wp.min(block * size + size, count)):
        out[i] = out[i] + 1


@pytest.mark.parametrize("threads", ["1", "2", "3", "7"])
@pytest.mark.parametrize("count", [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 16 * BLOCK, 40 * BLOCK + 3, 200 * BLOCK])
def test_every_item_is_visited_once(monkeypatch, threads, count):
    monkeypatch.setenv("WARP_BOUNDING_THREADS", threads)
    out = wp.zeros(max(count, 1), dtype=wp.int32, device="cpu")
    launch_blocks(_visit, count, [0, BLOCK, count], [out], wp.get_device("cpu"), first_index=0)
    assert (out.numpy()[:count] == 1).all()


@pytest.mark.parametrize(("setting", "expected"), [("1", 1), ("5", 5), ("0", 1)])
def test_threads_follow_the_environment(monkeypatch, setting, expected):
    monkeypatch.setenv("WARP_BOUNDING_THREADS", setting)
    assert cpu_threads() == expected


@pytest.mark.parametrize("setting", ["", "many", "-1", "2.5"])
def test_a_senseless_number_of_threads_is_not_followed(monkeypatch, setting):
    monkeypatch.setenv("WARP_BOUNDING_THREADS", setting)
    assert cpu_threads() >= 1


def test_kernels_do_not_depend_on_threads(monkeypatch):
    from bounding_shapes import domain_points, fitted, shape

    bounder = fitted("mlp", "blob")
    x = domain_points(shape("blob"), 40 * BLOCK + 5, np.random.default_rng(0))
    answers = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("WARP_BOUNDING_THREADS", threads)
        answers.append(bounder.values(x).numpy())
    assert (answers[0] == answers[1]).all()
    assert (answers[0] == answers[2]).all()


@pytest.fixture
def crew(monkeypatch):
    """A crew of its own; and every launch is worth waking it."""
    monkeypatch.setenv("WARP_BOUNDING_THREADS", "3")
    monkeypatch.setattr(launch, "WORTH_WAKING", 1e-12)
    own = launch._Crew()
    monkeypatch.setattr(launch, "_crew", own)
    return own


def visits(count=200 * BLOCK):
    out = wp.zeros(count, dtype=wp.int32, device="cpu")
    return BlockLaunch(_visit, count, [0, BLOCK, count], [out], wp.get_device("cpu"), first_index=0), out


def test_a_recorded_launch_runs_as_often_as_it_is_asked_to(crew):
    recorded, out = visits()
    for number in range(1, 200):
        recorded.launch()
        assert (out.numpy() == number).all()
    assert len(crew._bells) == 2  # woken again and again, not made anew


def test_shares_run_once_each_whoever_is_awake(crew):
    done = []
    for number in range(300):
        crew.run([lambda i=i: done.append(i) for i in range(3)])
        assert len(done) == 3 * (number + 1)
    assert sorted(done[:3]) == [0, 1, 2]
    assert all(sorted(done[i : i + 3]) == [0, 1, 2] for i in range(0, len(done), 3))


def test_a_thread_that_does_not_wake_is_not_waited_for(crew, monkeypatch):
    monkeypatch.setattr(crew, "_serve", lambda bell: None)  # as one that gets no core
    caller, done = threading.get_ident(), []
    crew.run([lambda: done.append(threading.get_ident())] * 3)
    assert done == [caller] * 3


def test_threads_that_have_nothing_to_do_sleep(crew):
    recorded, _ = visits()
    recorded.launch()
    before = time.process_time()
    time.sleep(0.3)
    assert time.process_time() - before < 0.1


def test_what_a_share_raises_is_raised_where_it_was_asked_for(crew):
    def fail() -> None:
        raise ZeroDivisionError

    for shares in ([fail, int, int], [int, fail, int], [fail] * 3):
        with pytest.raises(ZeroDivisionError):
            crew.run(shares)
    recorded, out = visits()
    recorded.launch()
    assert (out.numpy() == 1).all()


@pytest.mark.parametrize("kind", [KeyboardInterrupt, TimeoutError])
@pytest.mark.parametrize("step", ["_open.pop", "_news.get"])
def test_whoever_is_interrupted_leaves_nobody_at_work(crew, monkeypatch, step, kind):
    """A signal's handler raises right behind a step of the caller's, before its result has been looked at."""
    caller, begun, working, ended = threading.current_thread(), threading.Event(), [], []

    class Interrupted:
        def __init__(self, whole, method):
            self._whole, self._method, self._done = whole, method, False

        def __getattr__(self, name):
            return self._call if name == self._method else getattr(self._whole, name)

        def __len__(self):
            return len(self._whole)

        def _call(self):
            if threading.current_thread() is caller and not self._done:
                begun.wait()
                self._done = True
                getattr(self._whole, self._method)()
                raise kind
            return getattr(self._whole, self._method)()

    class Job(launch._Job):
        def __init__(self, shares):
            super().__init__(shares)
            name, method = step.split(".")
            setattr(self, name, Interrupted(getattr(self, name), method))

    def share() -> None:
        if threading.current_thread() is not caller:
            working.append(1)
            begun.set()
            time.sleep(0.05)
            ended.append(working.pop())
        else:
            begun.wait()

    monkeypatch.setattr(launch, "_Job", Job)
    with pytest.raises(kind):
        crew.run([share] * 4)
    assert working == []
    assert ended
    monkeypatch.undo()
    done = []
    crew.run([lambda: done.append(1)] * 3)
    assert len(done) == 3


def test_a_share_may_launch_and_other_callers_need_not_wait(crew):
    inner = []
    crew.run([lambda: crew.run([lambda: inner.append(1)] * 3)] * 3)
    assert len(inner) == 9
    held = threading.Event()
    busy = threading.Thread(target=crew.run, args=([held.wait, int],))
    busy.start()
    recorded, out = visits()
    recorded.launch()
    assert (out.numpy() == 1).all()
    held.set()
    busy.join()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_a_forked_process_has_threads_of_its_own(crew):
    recorded, out = visits()
    recorded.launch()
    child = os.fork()
    if child == 0:
        try:
            recorded.launch()
            os._exit(int((out.numpy() != 2).any() or launch._crew is crew or len(launch._crew._bells) != 2))
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


def test_threads_are_woken_where_that_pays(monkeypatch):
    monkeypatch.setenv("WARP_BOUNDING_THREADS", "4")
    recorded, out = visits()
    shares = []
    monkeypatch.setattr(launch._crew, "run", lambda found: [shares.append(len(found)), [share() for share in found]])
    for pace, expected in ((1e-9, []), (launch.WORTH_WAKING / 100 + 1e-9, [2]), (1.0, [4])):
        monkeypatch.setitem(launch._pace, _visit, pace)
        shares.clear()
        out.zero_()
        recorded.launch()
        assert shares == expected
        assert (out.numpy() == 1).all()
        assert launch._pace[_visit] != pace  # measured anew


def test_the_working_clock_stands_still_while_kernels_are_compiled(monkeypatch):
    now, seconds = [100.0], 7.0

    def load_module(module, device):
        now[0] += seconds

    monkeypatch.setattr(launch.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(launch.wp, "load_module", load_module)
    monkeypatch.setattr(launch, "_ready", set())
    monkeypatch.setattr(launch, "_own", launch._Own())
    before = launch.working_seconds()
    for _ in range(2):
        launch.ready(_visit, wp.get_device("cpu"))
    assert launch.compile_seconds() == seconds  # once
    assert launch.working_seconds() == before
    now[0] += 3.0
    assert launch.working_seconds() == before + 3.0
    monkeypatch.setattr(launch, "_ready", set())
    other = threading.Thread(target=launch.ready, args=(_visit, wp.get_device("cpu")))
    other.start()
    other.join()
    assert launch.compile_seconds() == seconds
    assert launch.working_seconds() == before + 3.0 + seconds  # it goes on, and never back
