"""Threads of batch queries, for a while."""

import os

import pytest

from sims.threads import VARIABLE, threads_of


@pytest.mark.parametrize("before", [None, "3"])
def test_threads_are_given_back(monkeypatch, before):
    if before is None:
        monkeypatch.delenv(VARIABLE, raising=False)
    else:
        monkeypatch.setenv(VARIABLE, before)
    with threads_of(2):
        assert os.environ[VARIABLE] == "2"
    assert os.environ.get(VARIABLE) == before
    with pytest.raises(ZeroDivisionError), threads_of(1):
        1 / 0  # noqa: B018
    assert os.environ.get(VARIABLE) == before
