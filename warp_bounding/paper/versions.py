"""What measured a row: versions of this library and of what it stands on."""

import platform
import subprocess
from functools import lru_cache
from importlib import metadata
from pathlib import Path

from warp_bounding.version import __version__

__all__ = ["versions"]


@lru_cache
def _commit() -> str | None:
    """Of the checkout that this is run from, if it is one."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return None
    try:
        found = subprocess.run(
            ["git", "rev-parse", "--short=9", "HEAD"], cwd=root, capture_output=True, text=True, timeout=10, check=True
        )
    except (OSError, subprocess.SubprocessError):  # no git there
        return None
    return found.stdout.strip() or None


@lru_cache
def versions() -> str:
    """Of this library and what it stands on."""

    def version(package: str) -> str:
        try:
            return metadata.version(package)
        except metadata.PackageNotFoundError:
            return "none"

    commit = _commit()
    own = f"warp-bounding {__version__}{f' ({commit})' if commit else ''}"
    parts = (own, f"warp {version('warp-lang')}", f"torch {version('torch')}")
    return ", ".join((*parts, f"Python {platform.python_version()}"))
