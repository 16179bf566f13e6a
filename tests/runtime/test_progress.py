"""Who is told of progress: the caller's function, a bar where people look, or nobody."""

import io
import sys

import pytest

from warp_bounding.errors import BounderError
from warp_bounding.runtime.progress import reported


class Terminal(io.StringIO):
    """Standard error that people look at."""

    def isatty(self) -> bool:
        return True


def test_a_function_is_called_as_it_is():
    seen = []
    with reported(lambda *given: seen.append(given), "fit") as report:
        report(0.5, 1.0, "half")
    assert seen == [(0.5, 1.0, "half")]


@pytest.mark.parametrize("terminal", [True, False])
@pytest.mark.parametrize("progress", [None, False])
def test_a_bar_is_shown_on_a_terminal_unless_it_is_not_wanted(monkeypatch, terminal, progress):
    monkeypatch.setenv("TERM", "xterm")
    shown = Terminal() if terminal else io.StringIO()
    monkeypatch.setattr(sys, "stderr", shown)
    with reported(progress, "fit mlp") as report:
        assert (report is not None) == (terminal and progress is None)
        if report:
            report(0.5, 1.0, "half way")
    assert ("fit mlp" in shown.getvalue()) == (terminal and progress is None)


def test_without_standard_error_there_is_no_bar(monkeypatch):
    monkeypatch.setattr(sys, "stderr", None)
    with reported(None, "fit") as report:
        assert report is None


@pytest.mark.parametrize("progress", [5, True, "bar"])
def test_anything_else_is_refused(progress):
    with (
        pytest.raises(BounderError, match="progress must be a function, None or False, got"),
        reported(progress, "fit"),
    ):
        pass
