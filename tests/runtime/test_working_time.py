"""Limits of the working clock: they end what takes too long, and nothing else."""

import threading

import numpy as np
import pytest

import warp_bounding as wb
from warp_bounding.runtime.launch import OutOfTimeError, limited, working_seconds
from warp_bounding.solids import Box


def test_what_takes_too_long_is_ended():
    def wait(seconds):
        end = working_seconds() + seconds
        while working_seconds() < end:
            pass

    with limited(1e6):
        before = working_seconds()
        with pytest.raises(OutOfTimeError), limited(0.01):
            wait(60.0)
        assert working_seconds() < before + 60.0  # and the outer limit holds again
    wait(0.01)


def test_an_inner_limit_is_no_longer_than_the_outer_one():
    with pytest.raises(OutOfTimeError), limited(-1.0), limited(1e6):
        working_seconds()
    working_seconds()


def test_threads_have_limits_of_their_own():
    told = []
    other = threading.Thread(target=lambda: told.append(working_seconds()))
    with limited(-1.0):
        other.start()
        other.join()
    assert len(told) == 1


def test_a_fit_ends_and_the_next_one_is_as_before():
    box, about = Box([0.0, 0.0, 0.0], [1.0, 0.7, 0.4]), {"method": "aabb", "device": "cpu", "progress": False}
    first = wb.fit(box, **about)
    with pytest.raises(OutOfTimeError), limited(1e-4):
        wb.fit(box, **about)
    again = wb.fit(box, **about)
    assert np.array_equal(first.weights(), again.weights())
    assert first.threshold == again.threshold
