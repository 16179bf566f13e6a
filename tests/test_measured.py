"""Whether a page of results is older than the code that it measures: a script of ``tools/release``."""

import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "tools/release"))

from measured import PAGES, Page, alike, measured

PY, H = "warp_bounding/a.py", "warp_bounding/native/a.h"
PAGE = "# Times\n\n`python benchmarks/times.py --out results/times`, on a busy machine.\n"


@pytest.fixture
def place(tmp_path):
    """A repository with one page, and what commits all of it and returns the commit."""

    def git(*words: str) -> str:
        named = ["-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false"]
        return subprocess.run(["git", *named, *words], cwd=tmp_path, capture_output=True, text=True, check=True).stdout

    def commit() -> str:
        git("add", "-A")
        git("commit", "-qm", "a", "--allow-empty", "--no-verify")
        return git("rev-parse", "--short=9", "HEAD").strip()

    git("init", "-q")
    for name, text in {
        PY: 'text = native_text("a.h")\n',
        H: "/// BODY\nint a = 1;\n",
        "warp_bounding/other.py": "",
        "benchmarks/times.py": "",
        "results/times/README.md": PAGE,
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path, commit


def page_of(place: Path, *rows: str, gpu: bool = False):
    (place / "results/times/times.jsonl").write_text("".join(f"{row}\n" for row in rows))
    return measured(place, {"times": Page((PY,), gpu)})[0]


def row(commit: str, more: str = "") -> str:
    return f'{{"ns": 1, "versions": "warp-bounding 0.2.0 ({commit}{more}), warp 1.19.0"}}'


def test_what_changed_since_a_page_was_measured(place):
    folder, commit = place
    first = commit()
    for name, text, changed in (
        (PY, '"""Prose."""\n\n# more\ntext = native_text("a.h")\n', []),
        (H, "/// BODY\n// a\nint a = 1;\n", []),
        ("warp_bounding/other.py", "b = 1\n", []),
        (H, "/// BODY\nint a = 2;\n", [H]),
        ("benchmarks/times.py", "count = 2\n", ["benchmarks/times.py", H]),
    ):
        (folder / name).write_text(text)
        page = page_of(folder, row(first))
        assert page.changed == changed
        assert page.older == bool(changed)
    assert not page_of(folder, row(commit())).older
    assert page_of(folder, row(first), row(commit())).older  # some of its rows
    assert "$ python benchmarks/times.py --out results/times" in str(page_of(folder, row(first)))
    card = page_of(folder, row(first), gpu=True)
    assert card.changed
    assert not card.older
    assert "GPU" in str(card)


def test_rows_that_do_not_say_what_they_measured(place):
    folder, commit = place
    known = commit()
    for rows, said in (
        ((row(known), '{"ns": 1}'), "1 of 2 rows name no commit"),
        ((row("0" * 9),), "this history has no commit"),
        ((row(known, ", changed"),), "not committed"),
    ):
        page = page_of(folder, *rows)
        assert page.older
        assert said in str(page)


def test_every_page_is_in_the_table(place):
    folder, _ = place
    with pytest.raises(LookupError, match="other"):
        measured(folder, {"times": Page(()), "other": Page(())})
    assert {page.name for page in measured()} == set(PAGES)


@pytest.mark.parametrize(
    ("name", "before", "now", "same"),
    [
        ("a.py", "def f():\n    '''A.'''\n    return 1\n", "def f():\n    return 1  # one\n", True),
        ("a.py", "def draw() -> None:\n    a()\n", "def draw() -> None:\n    b()\n", True),
        ("a.py", "def draw():\n    return 1\n", "def draw():\n    return 2\n", False),
        ("a.py", "a = 1\n", "a = 1.0\n", False),
        ("a.py", "a = 'x'\n", "a = 'y'\n", False),
        ("a.py", "def f(a): return a\n", "def f(a, b): return a\n", False),
        ("a.h", "// a\nint b;\n", "int b;\n", True),
        ("a.h", "int b;  // a\n", "int b;\n", False),  # it may be within a string: only whole lines are comments
        ("a.h", "// a \\\nint b;\n", "int b;\n", False),
        ("a.h", "/// A\nint b;\n", "/// B\nint b;\n", False),
        ("a.csv", "1\n", "2\n", False),
    ],
)
def test_prose_is_no_change(name, before, now, same):
    assert alike(name, before.encode(), now.encode()) == same
