"""Sdist and wheel hold what they must and nothing else; what is wrong with one is found."""

import re
import zipfile
from pathlib import Path

import distributions
import pytest

ROOT = Path(__file__).resolve().parents[2]


def rewritten(wheel: Path, folder: Path, change) -> Path:
    """A copy of a wheel whose files a function has changed."""
    files = distributions.contents(wheel)
    change(files)
    copy = folder / wheel.name
    with zipfile.ZipFile(copy, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return copy


def test_what_is_built_is_well(built):
    assert distributions.problems(*built, ROOT) == []
    assert distributions.told_by_twine(*built) == []


def test_a_build_is_repeatable(built, tmp_path):
    again = distributions.build(ROOT, tmp_path, isolated=False)
    assert [path.read_bytes() for path in again] == [path.read_bytes() for path in built]


def test_what_twine_has_against_a_wheel_is_told(built, tmp_path):
    def change(files):
        (name,) = (name for name in files if name.endswith("/METADATA"))
        files[name] = files[name].replace(b"Version: 0", b"Version: none-0")

    (told,) = distributions.told_by_twine(rewritten(built[0], tmp_path, change))
    assert "none-0" in told


def test_a_build_that_fails_says_why(tmp_path):
    (tmp_path / "pyproject.toml").write_text("[project]\nname = 3\n")
    with pytest.raises(RuntimeError, match="building failed"):
        distributions.build(tmp_path, tmp_path / "dist", isolated=False)


def test_the_metadata_say_who_what_and_for_whom(built):
    metadata = distributions.metadata_of(distributions.contents(built[0]))
    cited = re.search(r"authors:\n  - name: (.*)", (ROOT / "CITATION.cff").read_text())[1]
    assert metadata["Author"] == metadata["Maintainer"] == cited
    assert metadata["License-Expression"] == "Apache-2.0"
    pythons = [c.rpartition(" ")[2] for c in metadata.get_all("Classifier") if c.startswith("Programming Language :: Python :: 3.")]  # fmt: skip
    assert pythons == ["3.10", "3.11", "3.12", "3.13"]
    core = {re.match(r"[\w-]+", r)[0] for r in metadata.get_all("Requires-Dist") if "extra ==" not in r}
    assert core == {"numpy", "rich", "safetensors", "scipy", "typer", "warp-lang"}


def test_pictures_and_links_of_the_readme_become_words(built):
    text = distributions.metadata_of(distributions.contents(built[0])).get_payload()
    assert "docs/guide.md" in (ROOT / "README.md").read_text()
    assert "](docs/" not in text
    assert "*Picture in the repository: " in text


def without(name):
    return lambda files: files.pop(name)


def added(name, content):
    return lambda files: files.update({name: content})


def described_as(words):
    def change(files):
        (name,) = (name for name in files if name.endswith("/METADATA"))
        files[name] += words

    return change


SPOILT = {
    "no py.typed": (without("warp_bounding/py.typed"), "the wheel lacks warp_bounding/py.typed"),
    "a demo": (added("sims/base.py", b""), "sims/base.py does not belong in the wheel"),
    "no module": (without("warp_bounding/choice.py"), "the wheel lacks warp_bounding/choice.py"),
    "a test": (added("tests/test_package.py", b""), "tests/test_package.py does not belong in the wheel"),
    "a result": (added("sims/rows.jsonl", b""), "sims/rows.jsonl does not belong in the wheel"),
    "a benchmark": (added("benchmarks/points.py", b""), "benchmarks/points.py does not belong in the wheel"),
    "another version": (added("warp_bounding/version.py", b""), "warp_bounding/version.py is not the checkout's"),
    "a folder": (added("warp_bounding/a.py", b"'/" + b"home/me/x'"), "warp_bounding/a.py names a folder of a machine"),
    "the checkout": (added("warp_bounding/a.py", str(ROOT).encode()), "warp_bounding/a.py names a folder of a machine"),
    "too large": (added("warp_bounding/a.py", b"#" * distributions.LARGEST), "bytes, 2,000,000 at most"),
    "a link": (described_as(b"\n[there](docs/guide.md)\n"), "the description leads to 'docs/guide.md'"),
    "a picture": (described_as(b"\n![p](docs/rain.png)\n"), "the description leads to 'docs/rain.png'"),
    "other code": (described_as(b"\n```python\n1\n```\n"), "the code in the description is not the README's"),
}


@pytest.mark.parametrize("what", SPOILT)
def test_what_is_wrong_with_a_wheel_is_found(built, tmp_path, what):
    change, said = SPOILT[what]
    spoilt = rewritten(built[0], tmp_path, change)
    assert any(said in line for line in distributions.problems(spoilt, built[1], ROOT))


def test_a_wheel_without_its_licence_is_found(built, tmp_path):
    (licence,) = (name for name in distributions.contents(built[0]) if "/licenses/" in name)
    spoilt = rewritten(built[0], tmp_path, without(licence))
    assert "the wheel lacks the licence" in distributions.problems(spoilt, built[1], ROOT)
