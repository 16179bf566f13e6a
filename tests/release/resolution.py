"""Which versions each supported Python would get of all that every extra asks for, by ``uv``: no such Python is needed, and nothing is installed."""

import re
import subprocess
import sys
from pathlib import Path

__all__ = ["BOUNDS", "pythons", "resolve", "run"]

BOUNDS = {  # by its name, what ``uv pip compile`` is told
    "constraints.txt": ("--constraint", "constraints.txt"),
    "newest": (),
    "lowest": ("--resolution", "lowest-direct"),
}
SHOWN = ("warp-lang", "numpy", "scipy", "torch", "newton", "usd-core")
PINNED = re.compile(r"^([\w.-]+)==(\S+)", re.MULTILINE)


def pythons(root: Path) -> list[str]:
    """The versions of Python that the metadata name."""
    return re.findall(r'"Programming Language :: Python :: (3\.\d+)"', (root / "pyproject.toml").read_text())


def resolve(root: Path, python: str, options: tuple[str, ...]) -> dict[str, str]:
    """The version of each distribution that a Python would get, with all extras.

    Raises:
        RuntimeError: If there is none that fit together, with what the resolver said.
    """
    command = [sys.executable, "-m", "uv", "pip", "compile", "--quiet", "--no-header", "--no-annotate", "--all-extras"]
    command += ["--python-version", python, *options, "pyproject.toml"]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr.strip())
    return dict(PINNED.findall(done.stdout))


def run(root: Path) -> int:
    """Print a table of every supported Python, in Markdown; exit status 1 if one has no versions that fit together."""
    print(f"| Python | versions | packages | {' | '.join(SHOWN)} |")
    print(f"|---|---|---|{'---|' * len(SHOWN)}")
    failed = 0
    for python in pythons(root):
        for name, options in BOUNDS.items():
            try:
                found = resolve(root, python, options)
            except RuntimeError as error:
                failed += 1
                print(f"| {python} | {name} | none |{' |' * len(SHOWN)}", flush=True)
                print(error, file=sys.stderr)
                continue
            versions = " | ".join(found.get(package, "") for package in SHOWN)
            print(f"| {python} | {name} | {len(found)} | {versions} |", flush=True)
    return bool(failed)
