"""Sizes and targets of docs/architecture.md: ``python tools/size.py`` prints the table, ``--write`` puts it there.

Counts lines and files that git tracks, and the modules that ``load`` and one ``query`` bring along, in a process of
their own.
"""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "architecture.md"
BEGIN, END = "<!-- sizes -->\n", "<!-- end of sizes -->"
ASK = """
import sys, numpy as np, warp_bounding as wb
b = wb.load({path!r}, device="cpu")
b.query(np.zeros((4, b.domain.columns), np.float32))
print(sum(name.split(".")[0] == "warp_bounding" for name in sys.modules))
"""


def tracked(folder: str) -> list[Path]:
    """Python, native and template files of a folder that git tracks."""
    found = subprocess.run(["git", "ls-files", folder], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [ROOT / name for name in found.split() if name.endswith((".py", ".h", ".html", ".css", ".js"))]


def lines(files: list[Path]) -> int:
    """Of all of them together."""
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files)


def loaded() -> int:
    """Modules of the package after a file was loaded and asked."""
    path = str(next((ROOT / "sims" / "bounders").glob("*-mlp.safetensors")))
    done = subprocess.run(
        [sys.executable, "-c", ASK.format(path=path)], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return int(done.stdout.split()[-1])


def reading_path() -> int:
    """Lines of the files that the page names in reading order."""
    section = PAGE.read_text(encoding="utf-8").partition("## Reading path")[2].partition("\n## ")[0]
    return lines(
        [ROOT / "warp_bounding" / name for name in re.findall(r"^\d+\. `([\w/]+\.py)`", section, re.MULTILINE)]
    )


def table() -> str:
    """The rows."""
    package, tests = tracked("warp_bounding"), tracked("tests")
    rows = [
        ("package: lines of Python, native text and templates", "59,135", f"{lines(package):,}", "37,000"),
        ("package: files", "480", f"{len(package):,}", "150"),
        ("reading path: lines", "none", f"{reading_path():,}", "9,500"),
        ("modules loaded by `wb.load` and one `query`", "205", f"{loaded():,}", "60"),
        ("tests: lines", "34,123", f"{lines(tests):,}", "17,000"),
        ("paper: lines", "in the package", f"{lines(tracked('paper')):,}", "3,000"),
    ]
    head = "| | before | now | target, at most |\n|---|--:|--:|--:|\n"
    return head + "".join(f"| {' | '.join(row)} |\n" for row in rows)


def main() -> None:
    """Print the table, and write it where it belongs if that is requested."""
    text = table()
    print(text, end="")
    if "--write" in sys.argv[1:]:
        page = PAGE.read_text(encoding="utf-8")
        before, _, rest = page.partition(BEGIN)
        PAGE.write_text(before + BEGIN + text + END + rest.partition(END)[2], encoding="utf-8")


if __name__ == "__main__":
    main()
