"""A clean environment sees what a wheel asks for, and nothing else; the lowest versions are those of the metadata."""

import re
from pathlib import Path

import distributions
import environments
import lowest
import pytest
import resolution

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def wheel(built):
    return built[0]


def test_what_is_not_asked_for_is_not_seen(wheel, tmp_path):
    environment = environments.linked(tmp_path / "env", wheel)
    code = "from importlib.util import find_spec as f; print([n for n in ('numpy', 'warp', 'torch', 'pytest') if f(n)])"
    assert environment.run(["python", "-c", code], tmp_path, seconds=60).stdout.strip() == "['numpy', 'warp']"
    said = environment.run(["warp-bounding", "--version"], tmp_path, seconds=60).stdout
    assert said.startswith("warp-bounding ")
    assert environment.call(["python", "-c", "raise SystemExit(3)"], tmp_path) == 3


def test_extras_and_what_they_ask_for_in_turn_are_needed():
    asked = ["numpy>=1.26", "pytest>=9; extra == 'dev'"]
    assert set(environments.needed(asked)) == {"numpy"}
    assert {"numpy", "pytest", "pluggy"} <= set(environments.needed(asked, ["dev"]))


@pytest.mark.parametrize("wanted", ["no-such-distribution-at-all", "numpy>=999"])
def test_what_is_missing_is_named(wanted):
    with pytest.raises(LookupError, match=re.escape(wanted)):
        environments.needed([wanted])


def test_the_lowest_versions_are_those_that_the_metadata_allow(wheel):
    asked = distributions.metadata_of(distributions.contents(wheel)).get_all("Requires-Dist")
    bounds, pins = lowest.lower_bounds(asked, ("", *lowest.EXTRAS)), lowest.pins(ROOT)
    assert bounds.keys() | set(lowest.TOOLS) == pins.keys()

    def number(text: str) -> list[int]:
        return [int(part) for part in (text + ".0.0").split(".")[:3]]

    differing = {name for name, bound in bounds.items() if number(bound) != number(pins[name])}
    assert differing == set(lowest.RAISED)
    assert all(number(pins[name]) > number(bounds[name]) for name in differing)


def test_the_tests_of_the_lowest_versions_exist():
    assert [test for test in lowest.TESTS if not (ROOT / "tests" / test).exists()] == []


def test_pins_are_of_what_is_asked_for(wheel):
    """``constraints.txt`` names everything that an extra asks for, so that no set-up depends on the day it is made."""
    asked = distributions.metadata_of(distributions.contents(wheel)).get_all("Requires-Dist")
    names = {re.match(r"[\w.-]+", text)[0] for text in asked}
    pinned = set(re.findall(r"^([\w.-]+)==", (ROOT / "constraints.txt").read_text(), re.MULTILINE))
    assert sorted(names - pinned) == []


def test_pythons_and_what_the_resolver_is_told():
    assert resolution.pythons(ROOT) == ["3.10", "3.11", "3.12", "3.13"]
    assert set(resolution.BOUNDS) == {"constraints.txt", "newest", "lowest"}
    options = resolution.BOUNDS["constraints.txt"]
    assert (ROOT / options[-1]).exists()


def test_a_python_without_versions_that_fit_is_told(monkeypatch, capsys):
    def resolve(root, python, options):
        if (python, options) == ("3.12", resolution.BOUNDS["lowest"]):
            raise RuntimeError("no numpy for it")
        return {"numpy": "2.0.0"}

    monkeypatch.setattr(resolution, "resolve", resolve)
    assert resolution.run(ROOT) == 1
    out, err = capsys.readouterr()
    assert "| 3.12 | lowest | none |" in out
    assert "| 3.12 | newest | 1 |  | 2.0.0 |" in out
    assert err == "no numpy for it\n"
    monkeypatch.setattr(resolution, "resolve", lambda *_: {})
    assert resolution.run(ROOT) == 0
