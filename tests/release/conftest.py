"""The distributions of this checkout, built once for all tests of them; where the tools of a release are not installed, these tests are left out."""

from importlib.util import find_spec
from pathlib import Path

import pytest

TOOLS = ("build", "hatchling", "hatch_fancy_pypi_readme", "packaging", "readme_renderer", "twine", "uv")
MISSING = [name for name in TOOLS if not find_spec(name)]
collect_ignore_glob = ["test_*.py"] if MISSING else []  # what they import would fail


def pytest_report_header() -> str:
    return f"tests/release: left out, not installed: {', '.join(MISSING)} (pip install '.[release]')" if MISSING else ""


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The wheel and the sdist."""
    from distributions import build

    return build(Path(__file__).resolve().parents[2], tmp_path_factory.mktemp("dist"), isolated=False)
