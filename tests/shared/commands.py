"""The command line in this process, and what a mistake of a user's must look like."""

import pytest

from warp_bounding.cli import main


def run(capsys, *arguments):
    """Status, standard output and standard error of a command in this process."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return stop.value.code, out, err


def check_bad(status, out, err):
    assert status == 2, err
    assert out == ""
    assert len(err.strip().splitlines()) == 1, err
    assert err.startswith("warp-bounding: ")
    assert "Traceback" not in err
