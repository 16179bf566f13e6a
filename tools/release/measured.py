"""``python tools/release/measured.py [PAGE ...]``: which pages of ``results/`` are older than the code they measure.

For each page it prints the commits at which its rows were measured and, if code that the page measures has changed
since, which files, and the command that measures it anew. Exit status 1 if a page is older, or cannot say of what
commit it is.

What a page measures stands in ``PAGES``; the program of its command counts as well, and a header of ``native/`` counts
where one of the Python files names it. A change counts unless it cannot change an answer or a time: of Python only the
syntax tree without docstrings is compared, of headers the lines that are no comments, of other files every byte. A
function ``draw`` that returns nothing makes a picture: its body does not count. Pages measured on a GPU are shown and
never fail: a card is not always at hand.
"""

import argparse
import ast
import re
import subprocess
import sys
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

__all__ = ["PAGES", "Measured", "Page", "alike", "measured"]

ROOT = Path(__file__).resolve().parents[2]
RESULTS, NATIVE = "results", "warp_bounding/native"
COMMIT = re.compile(r"warp-bounding [\w.]+ \(([0-9a-f]{7,40})(, changed)?\)|\"commit\": \"([0-9a-f]{7,40})\"")
COMMAND = re.compile(r"^`?(python (?:-m )?([\w./]+)[^`\n]*)", re.MULTILINE)  # as it stands on a page
HEADER = re.compile(r'native_text\("(\w+\.h)"\)')
SHOWN = 4  # names of files in a line


@dataclass(frozen=True)
class Page:
    """What a page of ``results/`` measures.

    Attributes:
        code: Folders and files that it exercises, of the repository.
        gpu: Whether it needs a card, so that it may be older than its code.
        without: Files of its folder that hold no rows.
    """

    code: tuple[str, ...]
    gpu: bool = False
    without: tuple[str, ...] = ()


def _package(*names: str) -> tuple[str, ...]:
    return tuple(f"warp_bounding/{name}" for name in names)


QUERY = _package("activations.py", "bounders", "kernels", "networks", "queries", "rounding.py", "runtime")
SHAPES = _package("shapes", "geometry.py", "rigid.py")
FIT = (*QUERY, *SHAPES, *_package("certificates", "evaluation.py", "proof", "training"))
MOTIONS = (*SHAPES, *_package("arms", "runtime"))
ARMS, PAIRS, NEWTON = (*FIT, *_package("arms")), (*FIT, *_package("pairs")), (*QUERY, *_package("newton", "pairs"))
CLOTH, ARM_DEMO = ("sims/bounders", "sims/cloth"), ("sims/arm", "sims/planning")
PAPER = (  # its tables, not its figures
    *("cells.py", "comparisons.py", "data.py", "drawing.py", "labels.py", "paper.csv", "parametric.py", "proofs.py"),
    *("recipes.py", "regions.py", "results.py", "speed.py", "table.py", "table1.py"),
)
TABLES = (*FIT, *(f"paper/{name}" for name in PAPER))
PAGES = {
    "arm": Page((*ARMS, *ARM_DEMO)),
    "bake": Page((*FIT, *_package("baking.py"))),
    "chosen": Page((*TABLES, *_package("choice.py"))),
    "demos": Page((*ARMS, *NEWTON, "sims")),
    "distances": Page(FIT),
    "export": Page((*FIT, "examples/cpp")),
    "figures": Page((*FIT, "paper"), without=("settings.json",)),
    "gpu": Page((*QUERY, *NEWTON), gpu=True),
    "meshes": Page(FIT),
    "motions": Page(MOTIONS),
    "newton": Page((*NEWTON, *CLOTH)),
    "newton/cuda": Page((*NEWTON, *CLOTH), gpu=True),
    "newton/rigid": Page((*NEWTON, *SHAPES)),
    "newton/surfaces": Page((*NEWTON, *CLOTH)),
    "own-queries": Page((*FIT, "sims/particles")),
    "pairs": Page(PAIRS),
    "parts": Page(FIT),
    "planners": Page((*MOTIONS, "benchmarks/motions.py")),
    "predicted": Page((*FIT, *_package("choice.py"))),
    "proofs": Page(TABLES, without=("settings.json",)),
    "robot-balls": Page((*MOTIONS, *_package("pairs"))),
    "robots": Page(ARMS),
    "scan": Page((*MOTIONS, *FIT)),
    "speed": Page(TABLES, without=("settings.json",)),
    "speed/cuda": Page(TABLES, gpu=True),
    "speed/rivals": Page((*FIT, *NEWTON, *CLOTH)),
    "speed/rivals-cuda": Page(QUERY, gpu=True),
    "table1": Page(TABLES, without=("settings.json",)),
    "table1/recipes": Page(TABLES, without=("settings.json",)),
    "verifier": Page(("verifier", *_package("proof"), *CLOTH)),
}


def alike(name: str, before: bytes, now: bytes) -> bool:
    """Whether two texts of a file cannot differ in an answer or a time; see the rule above."""
    if before == now:
        return True
    if name.endswith(".py"):
        return _alike(_tree(before), _tree(now))
    return name.endswith(".h") and _statements(before) == _statements(now)


@cache
def _tree(content: bytes) -> ast.Module:
    return ast.parse(content)


def _alike(one: object, other: object) -> bool:
    """Whether two syntax trees are the same but for docstrings, pictures and places in their files."""
    if type(one) is not type(other):
        return False
    if isinstance(one, ast.AST):
        return all(map(_alike, _parts(one), _parts(other)))  # equal types have equally many
    if isinstance(one, list):
        return len(one) == len(other) and all(map(_alike, one, other))
    return one == other


def _parts(node: ast.AST) -> list[object]:
    """The fields of a node; a body without its docstring, and none of what makes a picture."""
    parts = {name: getattr(node, name, None) for name in node._fields}
    held = isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef))
    if held and ast.get_docstring(node, clean=False) is not None:
        parts["body"] = parts["body"][1:]
    match node:
        case ast.FunctionDef(name="draw", returns=ast.Constant(value=None)):
            parts["body"] = []
    return list(parts.values())


def _statements(content: bytes) -> list[str]:
    """The lines of C that are not comments; names of parts stay, and comments that the next line might belong to."""
    lines = map(str.strip, content.decode().splitlines())
    part = re.compile(r"/// [A-Z0-9_]+:?")
    return [line for line in lines if line and (not line.startswith("//") or part.fullmatch(line) or line[-1] == "\\")]


class Measured:
    """A page of results and its age.

    Args:
        root: The repository.
        name: The page's folder in ``results/``.
        page: What it measures.
    """

    def __init__(self, root: Path, name: str, page: Page):
        self.root, self.name, self.page, self.folder = root, name, page, root / RESULTS / name

    def _git(self, *words: str, given: str = "") -> bytes:
        done = subprocess.run(["git", *words], cwd=self.root, input=given.encode(), capture_output=True, check=False)
        return b"" if done.returncode else done.stdout

    @cached_property
    def commands(self) -> list[str]:
        """How to measure it anew, as its page says."""
        return list(dict.fromkeys(found[1] for found in self._said))

    @cached_property
    def _said(self) -> list[re.Match]:
        return list(COMMAND.finditer((self.folder / "README.md").read_text(encoding="utf-8")))

    @cached_property
    def _rows(self) -> list[tuple[str, str]]:
        """Rows with the name of their file: lines of tables, other JSON files whole."""
        rows = []
        for path in sorted(self.folder.iterdir()):
            if path.suffix in (".csv", ".jsonl", ".json") and path.name not in self.page.without:
                text = path.read_text(encoding="utf-8")
                lines = [text] if path.suffix == ".json" else text.splitlines()[path.suffix == ".csv" :]
                rows += [(path.name, line) for line in lines]
        return rows or [("README.md", (self.folder / "README.md").read_text(encoding="utf-8"))]

    @cached_property
    def commits(self) -> list[str]:
        """The commits at which its rows were measured."""
        found = (match for _, row in self._rows for match in COMMIT.finditer(row))
        return list(dict.fromkeys((match[1] or match[3])[:9] for match in found))

    @cached_property
    def faults(self) -> list[str]:
        """Why it cannot say what it measured, a line each."""
        faults = [] if self.commands else ["the page has no command"]
        for file in dict.fromkeys(file for file, _ in self._rows):
            rows = [list(COMMIT.finditer(row)) for other, row in self._rows if other == file]
            without = sum(not found for found in rows)
            faults += [f"{file}: {without} of {len(rows)} rows name no commit"] * bool(without)
            if any(match[2] for found in rows for match in found):
                faults.append(f"{file}: rows were measured with changes that were not committed")
        lost = [each for each in self.commits if not self._git("merge-base", each, "HEAD")]
        return faults + [f"this history has no commit {', '.join(lost)}"] * bool(lost)

    @property
    def code(self) -> tuple[str, ...]:
        """Folders and files that it measures, its program among them."""
        said = {found[2] for found in self._said}
        programs = {name if "/" in name else f"{name.partition('.')[0]}/__main__.py" for name in said}
        shared = ("benchmarks/shared.py",) if any(each.startswith("benchmarks/") for each in programs) else ()
        paths = tuple(dict.fromkeys((*self.page.code, *sorted(programs))))
        texts = (self.root / name for name in self._git("ls-files", *paths).decode().split() if name.endswith(".py"))
        named = {header for path in texts for header in HEADER.findall(path.read_text(encoding="utf-8"))}
        return (*paths, *shared, *(f"{NATIVE}/{header}" for header in sorted(named)))

    @cached_property
    def changed(self) -> list[str]:
        """Files of its code that differ from one of its commits, in what may change an answer or a time."""
        found = set()
        for commit in self.commits:
            names = self._git("diff", "--no-renames", "--name-only", commit, "--", *self.code).decode().split()
            old = self._contents(commit, names)
            for name in set(names) - found:
                now = self.root / name
                if name not in old or not now.exists() or not alike(name, old[name], now.read_bytes()):
                    found.add(name)
        return sorted(found)

    def _contents(self, commit: str, names: list[str]) -> dict[str, bytes]:
        """Files as they were at a commit, by name; those that it has not are left out."""
        out = self._git("cat-file", "--batch", given="".join(f"{commit}:{name}\n" for name in names))
        contents, at = {}, 0
        for name in names:
            head, at = out[at : out.index(b"\n", at)], out.index(b"\n", at) + 1
            if not head.endswith(b" missing"):
                size = int(head.split()[-1])
                contents[name], at = out[at : at + size], at + size + 1
        return contents

    @property
    def older(self) -> bool:
        """Whether it must be measured anew."""
        return not self.page.gpu and bool(self.faults or self.changed)

    def __str__(self) -> str:
        age = f"{len(self.changed)} files changed since" if self.changed else "of this code"
        age = age if self.changed or not self.faults else "of unknown age"
        note = "; on a GPU, which may be older" if self.page.gpu else ""
        lines = [
            f"{'OLDER' if self.older else 'ok':<6}{self.name}: {', '.join(self.commits) or 'no commit'}, {age}{note}"
        ]
        lines += [f"      {fault}" for fault in self.faults]
        if self.changed:
            more = f" and {len(self.changed) - SHOWN} more" * (len(self.changed) > SHOWN)
            lines.append(f"      {', '.join(self.changed[:SHOWN])}{more}")
        return "\n".join([*lines, *(f"      $ {command}" for command in self.commands if self.older)])


def measured(root: Path = ROOT, pages: dict[str, Page] = PAGES) -> list[Measured]:
    """All pages of ``results/``.

    Raises:
        LookupError: If a page is in only one of ``results/`` and the table.
    """
    there = {path.parent.relative_to(root / RESULTS).as_posix() for path in (root / RESULTS).rglob("README.md")}
    if odd := sorted(there ^ pages.keys()):
        raise LookupError(f"expected the same pages in results/ and in tools/release/measured.py, not {', '.join(odd)}")
    return [Measured(root, name, page) for name, page in sorted(pages.items())]


def main() -> int:
    """Print the age of pages; 1 if one is older than its code."""
    parser = argparse.ArgumentParser(description="Which pages of results/ are older than the code they measure.")
    parser.add_argument("pages", nargs="*", metavar="PAGE", help="folders in results/; all if none is named")
    chosen = parser.parse_args().pages
    pages = [page for page in measured() if not chosen or page.name in chosen]
    for page in pages:
        print(page, flush=True)
    older = sum(page.older for page in pages)
    print(
        f"{older} of {len(pages)} pages are older than their code; a program goes on with rows: remove old ones first"
    )
    return int(older > 0)


if __name__ == "__main__":
    sys.exit(main())
