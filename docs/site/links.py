"""What is wrong with links of built pages: those that lead nowhere, and what a browser fetches from elsewhere.

Pages are read as they lie in a folder; no browser and no web is needed. A link to another host that a reader may follow
is allowed, a script, a style, a font or a picture from there is not.
"""

import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

__all__ = ["Page", "problems"]

LOADED = {
    "script": "src",
    "img": "src",
    "iframe": "src",
    "source": "src",
    "video": "src",
    "audio": "src",
    "embed": "src",
    "object": "data",
}
FETCHING = {
    "stylesheet",
    "icon",
    "shortcut",
    "preload",
    "prefetch",
    "modulepreload",
    "preconnect",
    "dns-prefetch",
    "manifest",
    "apple-touch-icon",
}
IN_STYLE = re.compile(r"(?:@import\s+(?:url\()?|url\()\s*['\"]?((?:https?:)?//[^'\")\s]+)")


class Page(HTMLParser):
    """A page's anchors, its links and what it loads.

    Attributes:
        anchors: Names that a link may lead to.
        links: Targets of links.
        loads: Addresses of scripts, styles, pictures and whatever else a browser fetches by itself.
    """

    def __init__(self, text: str):
        super().__init__(convert_charrefs=True)
        self.anchors, self.links, self.loads = set(), [], []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        """Note what a tag names, links to and loads."""
        given = {name: value or "" for name, value in attributes}
        self.anchors |= {given[name] for name in ("id", "name") if given.get(name)}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if tag == "link":
            kinds = set(given.get("rel", "").lower().split())
            (self.loads if kinds & FETCHING else self.links).append(given.get("href", ""))
        if given.get(LOADED.get(tag, "")):
            self.loads.append(given[LOADED[tag]])
        self.loads += [part.split()[0] for part in given.get("srcset", "").split(",") if part.split()]
        self.loads += IN_STYLE.findall(given.get("style", ""))


def problems(folder: Path) -> list[str]:
    """One line for each link that leads nowhere and each thing that would be loaded from another host.

    Args:
        folder: Of the built site.
    """
    pages = {path.resolve(): Page(path.read_text(encoding="utf-8")) for path in sorted(folder.rglob("*.html"))}
    found = [] if pages else [f"no page in {folder}"]
    for path, page in pages.items():
        name = path.relative_to(folder.resolve()).as_posix()
        found += [f"{name} loads {target} from another host" for target in page.loads if _away(target)]
        for target in [*page.links, *(load for load in page.loads if not _away(load))]:
            why = _dead(path, target, pages)
            found += [f"{name}: {target} {why}"] if why else []
    for path in sorted(folder.rglob("*.css")):
        found += [
            f"{path.relative_to(folder).as_posix()} loads {target}"
            for target in IN_STYLE.findall(path.read_text(encoding="utf-8"))
        ]
    return found


def _away(target: str) -> bool:
    """Whether an address is on another host."""
    return bool(urlsplit(target).netloc)


def _dead(path: Path, target: str, pages: dict[Path, Page]) -> str:
    """Why a link leads nowhere; empty if it does not, or leads to another host."""
    parts = urlsplit(target)
    if parts.scheme or parts.netloc:
        return ""
    file = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if file.is_dir():
        file /= "index.html"
    if not file.exists():
        return "leads to no file"
    anchor = unquote(parts.fragment)
    if anchor and file in pages and anchor not in pages[file].anchors and not anchor.startswith(":~:"):
        return "leads to no such place in the page"
    return ""
