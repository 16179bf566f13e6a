"""Blocks are dealt out to threads without a gap or an overlap."""

import numpy as np
import pytest
import warp as wp

from warp_bounding.launch import BLOCK, cpu_threads, launch_blocks


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
