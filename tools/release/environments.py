"""Environments in which a wheel is installed as a stranger would have it, without the checkout.

``installed`` lets pip do it, with all that it fetches. ``linked`` takes a second: an environment that sees, of all that
is installed beside this check, only those distributions that the wheel's metadata ask for, and what these ask for in
turn. What the package imports and does not ask for is missing in it.
"""

import os
import subprocess
import sys
import venv
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from distributions import metadata_of
from packaging.requirements import Requirement

__all__ = ["Environment", "installed", "linked", "needed"]


@dataclass(frozen=True)
class Environment:
    """A virtual environment.

    Attributes:
        folder: Where it is.
    """

    folder: Path

    @property
    def programs(self) -> Path:
        """The folder of its commands."""
        return self.folder / ("Scripts" if os.name == "nt" else "bin")

    def run(self, words: Iterable[object], here: Path, *, seconds: float) -> subprocess.CompletedProcess:
        """Run one of its commands in a folder; nothing of the caller's Python is seen.

        Raises:
            subprocess.TimeoutExpired: If it takes longer.
        """
        program, *arguments = map(str, words)
        command = [str(self.programs / program), *arguments]
        options = {"cwd": here, "env": self._variables(), "timeout": seconds}
        return subprocess.run(command, **options, capture_output=True, text=True, check=False)

    def call(self, words: Iterable[object], here: Path) -> int:
        """Run one of its commands as ``run`` does, for as long as it takes, and let it print; its exit status."""
        program, *arguments = map(str, words)
        return subprocess.run(
            [str(self.programs / program), *arguments], cwd=here, env=self._variables(), check=False
        ).returncode

    def _variables(self) -> dict[str, str]:
        return _variables() | {"PATH": f"{self.programs}{os.pathsep}{os.environ.get('PATH', '')}", "COLUMNS": "120"}


def _variables() -> dict[str, str]:
    """The variables of this process without those by which Python would find modules outside an environment."""
    kept = {
        name: value for name, value in os.environ.items() if not name.startswith("PYTHON") and name != "VIRTUAL_ENV"
    }
    return kept | {"PYTHONNOUSERSITE": "1"}


def needed(requirements: Iterable[str], extras: Iterable[str] = ()) -> dict[str, metadata.Distribution]:
    """The distributions that are requested, directly or in turn, by name, as they are installed beside this.

    Args:
        requirements: As in ``Requires-Dist``.
        extras: Of whom they are requested.

    Raises:
        LookupError: If one is not installed here, or not in a version that will do.
    """
    found, seen = {}, set()
    left = [(Requirement(text), frozenset(extras)) for text in requirements]
    while left:
        wanted, chosen = left.pop()
        if wanted.marker and not any(wanted.marker.evaluate({"extra": extra}) for extra in (chosen or {""})):
            continue
        key = (wanted.name.lower().replace("_", "-"), frozenset(wanted.extras))
        try:
            distribution = found.setdefault(key[0], metadata.distribution(wanted.name))
        except metadata.PackageNotFoundError as error:
            raise LookupError(f"{wanted} is asked for and not installed: make .venv/.dev") from error
        if not wanted.specifier.contains(distribution.version, prereleases=True):
            raise LookupError(f"{wanted} is asked for, {distribution.version} is installed: make .venv/.dev")
        if key not in seen:
            seen.add(key)
            left += [(Requirement(text), key[1]) for text in distribution.requires or ()]
    return found


def linked(folder: Path, wheel: Path, extras: Iterable[str] = ()) -> Environment:
    """An environment with a wheel installed, and links to what it asks for and nothing else.

    Raises:
        LookupError: If something that it asks for is not installed here.
        RuntimeError: If pip refuses the wheel.
    """
    asked = needed(metadata_of(wheel).get_all("Requires-Dist") or (), extras)
    venv.create(folder, with_pip=False, symlinks=os.name != "nt")
    environment = Environment(folder)
    said = environment.run(
        ["python", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], folder, seconds=60
    )
    packages = Path(said.stdout.strip())
    for distribution in asked.values():
        for top in {file.parts[0] for file in distribution.files or ()} - {"..", "__pycache__"}:
            place = packages / top
            if not place.exists():
                place.symlink_to(Path(distribution.locate_file(top)).resolve())
    return _with_wheel(environment, ["--no-deps", "--no-index", str(wheel)])


def installed(
    folder: Path, wheel: Path, extras: Iterable[str], constraints: Path, more: Iterable[str] = ()
) -> Environment:
    """An environment in which pip has installed a wheel, with its extras and all that they ask for, and more.

    Raises:
        RuntimeError: If pip fails.
    """
    if not folder.exists():
        venv.create(folder, with_pip=False, symlinks=os.name != "nt")
    named = f"{wheel}[{','.join(extras)}]" if extras else str(wheel)
    return _with_wheel(Environment(folder), ["--constraint", str(constraints), named, *more])


def _with_wheel(environment: Environment, arguments: list[str]) -> Environment:
    """Let the pip that is installed here install into an environment."""
    python = environment.programs / ("python.exe" if os.name == "nt" else "python")
    pip = [sys.executable, "-m", "pip", "--python", str(python)]
    for command in (["install", "--disable-pip-version-check", *arguments], ["check"]):
        done = subprocess.run([*pip, *command], env=_variables(), capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"pip {command[0]} failed:\n{done.stdout[-2000:]}\n{done.stderr[-500:]}")
    return environment
