"""Tests of distributions are left out where the tools of a release are not installed."""

from importlib.util import find_spec

TOOLS = ("build", "hatchling", "hatch_fancy_pypi_readme", "packaging", "readme_renderer", "twine")
MISSING = [name for name in TOOLS if not find_spec(name)]
collect_ignore_glob = ["test_*.py"] if MISSING else []  # what they import would fail
