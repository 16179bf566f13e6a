"""A part of the tests with the lowest versions of everything that the metadata allow, in an environment of their own.

``constraints-min.txt`` holds these versions. They are installed by pip, which fetches them; the tests are the checkout's.
"""

import re
import tempfile
from collections.abc import Iterable
from pathlib import Path

from distributions import build
from environments import installed
from packaging.requirements import Requirement

__all__ = ["EXTRAS", "RAISED", "TESTS", "lower_bounds", "pins", "run"]

EXTRAS = ("sims", "digits")
RAISED = ("torch", "warp-lang")  # tested in higher versions than the lowest; constraints-min.txt says why
TOOLS = ("pytest", "pytest-xdist", "hypothesis")
TESTS = (
    *("test_package.py", "test_extending.py", "bounders/test_file_format.py", "bounders/test_query_api.py"),
    *(
        "cli/test_commands.py",
        "cli/test_usage.py",
        "evaluation",
        "indicators/test_formats.py",
        "kernels/test_functions.py",
    ),
    *("newton", "proof/test_certify.py", "sims/test_prefitted.py", "training/test_fit.py"),
)
PIN = re.compile(r"^([\w.-]+)==([^\s;]+)", re.MULTILINE)


def lower_bounds(requirements: Iterable[str], extras: Iterable[str]) -> dict[str, str]:
    """The lowest version that is allowed of each distribution, of those that a wheel requires with some extras."""
    wanted = [Requirement(text) for text in requirements]
    asked = [r for r in wanted if not r.marker or any(r.marker.evaluate({"extra": extra}) for extra in extras)]
    return {r.name: spec.version for r in asked for spec in r.specifier if spec.operator == ">="}


def pins(root: Path) -> dict[str, str]:
    """The versions of ``constraints-min.txt``."""
    return dict(PIN.findall((root / "constraints-min.txt").read_text()))


def run(root: Path) -> int:
    """Install the lowest versions and run the tests; their exit status."""
    with tempfile.TemporaryDirectory(prefix="warp-bounding-lowest-") as name:
        place = Path(name)
        wheel, _ = build(root, place / "dist", isolated=True)
        environment = installed(place / "env", wheel, EXTRAS, root / "constraints-min.txt", TOOLS)
        # The folder of the checkout is no place to stand in: it would be imported in place of the wheel.
        tests = [str(root / "tests" / test) for test in TESTS]
        options = ["-m", "pytest", "-p", "no:cacheprovider", "--rootdir", str(root), "-c", str(root / "pyproject.toml")]
        return environment.call(["python", *options, *tests], place)
