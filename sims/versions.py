"""What a row of results was measured with."""

import contextlib
import platform
import subprocess
from functools import cache
from importlib import metadata
from pathlib import Path

from warp_bounding.version import __version__

__all__ = ["versions"]

CODE = ("warp_bounding", "sims", "paper", "benchmarks", "examples", "verifier")  # folders of a checkout


@cache
def versions() -> str:
    """Versions of this library and of what it stands on.

    In a checkout the library's has its commit, and ``changed`` where the code is not as it was committed:
    ``tools/release/measured.py`` refuses such rows.
    """
    commit, others = "", []
    with contextlib.suppress(OSError, subprocess.SubprocessError):  # no git there
        commit = f" ({_git('rev-parse', '--short=9', 'HEAD')}{', changed' * bool(_git('status', '--short', *CODE))})"
    for name, package in (("warp", "warp-lang"), ("torch", "torch")):
        with contextlib.suppress(metadata.PackageNotFoundError):
            others.append(f"{name} {metadata.version(package)}")
    return f"warp-bounding {__version__}{commit}, {', '.join(others)}, Python {platform.python_version()}"


def _git(*words: str) -> str:
    own = {"cwd": Path(__file__).parents[1], "capture_output": True, "text": True, "timeout": 10, "check": True}
    return subprocess.run(["git", *words], **own).stdout.strip()
