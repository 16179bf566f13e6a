"""The sources of the site, laid out in one folder as Sphinx wants them.

The pages are read on their own, too, where they lie in the repository: ``README.md`` and ``CHANGELOG.md`` at the top,
``docs``, the notebooks and the pages of ``results`` beside each other, with links between them. Here each gets its
place in the site (``place``), and links are turned to where their targets have gone (``relinked``). A link to
something that the site does not have is an error.
"""

import os
import re
import shutil
from pathlib import Path

from gallery import gallery

__all__ = ["ROOT", "StageError", "place", "relinked", "stage"]

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r"(?P<before>\]\()(?P<target>[^)\s#]*)(?P<anchor>#[^)\s]*)?(?P<after>\))")
ELSEWHERE = re.compile(r"[a-z]+:")  # a scheme: the web, mail
FENCE = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)
TOPS = {
    "README.md": "overview.md",
    "CHANGELOG.md": "changelog.md",
    "CITATION.cff": "CITATION.cff",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
    "LICENSE": "LICENSE",
    "notebooks": "gallery.md",
}
NO_SOURCES = ("site", "conf.py", "_static", "_build", "__pycache__")  # of docs


class StageError(Exception):
    """A page that cannot be a page of the site."""


def place(path: str) -> str:
    """Where a file of the repository stands in the site's sources.

    Args:
        path: From the repository's root, with ``/``.

    Raises:
        StageError: For a file that the site does not have.
    """
    if path in TOPS:
        return TOPS[path]
    top, _, rest = path.partition("/")
    if top == "docs" and rest:
        return rest
    if top == "results" and rest:
        return re.sub(r"README\.md$", "index.md", path)
    if top == "notebooks" and path.endswith(".ipynb"):
        return path
    raise StageError(f"expected a file of docs, results or the notebooks, got {path}")


def relinked(text: str, path: str, root: Path = ROOT) -> str:
    """A page's text with its relative links turned to where their targets stand in the site.

    Args:
        text: Markdown.
        path: The page, from the repository's root.
        root: The repository.

    Raises:
        StageError: For a link that leads nowhere, or out of the site.
    """
    here = os.path.dirname(place(path))

    def turned(found: re.Match) -> str:
        target = found["target"]
        if not target or ELSEWHERE.match(target):
            return found[0]
        name = os.path.normpath(os.path.join(os.path.dirname(path), target))
        if not (root / name).exists():
            raise StageError(f"{path}: a link leads to {target}, which does not exist")
        try:
            moved = os.path.relpath(place(name), here or ".")
        except StageError as error:
            raise StageError(f"{path}: {error}") from error
        return f"{found['before']}{moved}{found['anchor'] or ''}{found['after']}"

    parts = FENCE.split(text)
    return "".join(part if number % 2 else LINK.sub(turned, part) for number, part in enumerate(parts))


def stage(to: Path, root: Path = ROOT) -> None:
    """Lay out the site's sources; what the folder held before is removed.

    Args:
        to: The folder.
        root: The repository.

    Raises:
        StageError: For a page that cannot be one of the site.
    """
    shutil.rmtree(to, ignore_errors=True)
    docs = (path for path in (root / "docs").rglob("*") if path.relative_to(root / "docs").parts[0] not in NO_SOURCES)
    tops = [root / name for name in TOPS]
    paths = [*tops, *docs, *(root / "results").rglob("*"), *(root / "notebooks").glob("*.ipynb")]
    for path in sorted(path for path in paths if path.is_file()):
        name = path.relative_to(root).as_posix()
        if ".lock" in name or "/bounders/" in name:  # of runs that are under way; git ignores them
            continue
        target = to / place(name)
        target.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".md":
            text = path.read_text(encoding="utf-8")
            if name == "README.md":  # the first page of the site has the project's name
                text = text.replace("# warp-bounding\n", "# Overview\n", 1)
            target.write_text(relinked(text, name, root), encoding="utf-8")
        else:
            shutil.copyfile(path, target)
    below = sorted(path.relative_to(to).with_suffix("").as_posix() for path in (to / "results").rglob("index.md"))
    with (to / "results.md").open("a", encoding="utf-8") as page:
        page.write("\n".join(["", "```{toctree}", ":hidden:", "", *below, "```", ""]))
    gallery(sorted((to / "notebooks").glob("*.ipynb")), to)
