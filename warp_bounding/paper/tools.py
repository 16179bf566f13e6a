"""What the run needs of the library, so that tests can put something quick in its place."""

import platform
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

from warp_bounding.paper.columns import Supports
from warp_bounding.version import __version__

__all__ = ["Tools", "versions"]


@dataclass(frozen=True)
class Tools:
    """Functions of the library.

    Attributes:
        fit: ``wb.fit``.
        evaluate: ``wb.evaluate``.
        save: ``bounder, path``.
        load: ``path, device``.
        load_shape: From a path to an object that has ``ndim`` and ``digest``.
        supports: ``warp_bounding.bounders.supports``.
    """

    fit: Callable[..., Any]
    evaluate: Callable[..., Any]
    save: Callable[..., None]
    load: Callable[..., Any]
    load_shape: Callable[..., Any]
    supports: Supports

    @classmethod
    def of_library(cls) -> "Tools":
        """The real ones; this imports torch."""
        from warp_bounding.bounders import load, save, supports
        from warp_bounding.evaluation import evaluate
        from warp_bounding.indicators import load_indicator
        from warp_bounding.training import fit

        return cls(fit, evaluate, save, load, load_indicator, supports)


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
