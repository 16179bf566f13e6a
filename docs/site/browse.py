"""The built site in a browser without a window: ``python docs/site/browse.py build/docs [--out out/docs]``.

Every page is served on this machine alone and opened in Debian's Chromium or another one (``--browser``, ``--driver``).
What it must not do: write an error to its console, ask another host for anything, link to what is not there, be wider
than a telephone. The search box is tried, formulae must have become pictures, and the main pages are photographed,
wide, narrow and dark. Where there is no browser, that is said, and nothing is checked.
"""

import argparse
import functools
import json
import shutil
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import urlsplit

__all__ = ["Browser", "browse", "main", "served"]

WIDE, NARROW = (1440, 1000), (390, 844)  # pixels: a desk, a telephone
PHOTOGRAPHED = (
    "index", "overview", "get-started", "which-bounder", "gallery", "guide", "guide/distances", "proofs", "claims",
        "simulations", "tables",
    "architecture", "api/index", "api/bounders", "notebooks/05_proofs", "results/meshes/index",
        "changelog",
)  # fmt: skip
SEARCHES = {
    "candidates": "api/bounders.html",
    "margin": "guide/newton.html",
}  # words, and a page that must be among the hits
SECONDS = 20  # for a search to find something, and a page its formulae
OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--no-first-run",
        "--disable-component-update", "--disable-sync",
    "--hide-scrollbars", "--disable-dev-shm-usage",
)  # fmt: skip


class _Quiet(SimpleHTTPRequestHandler):
    """A server of files that does not write a line for each of them."""

    def log_message(self, *_) -> None:
        """Say nothing."""


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """The address of a server of a folder, on this machine alone, at a free port."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Quiet, directory=str(folder)))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class Browser:
    """A browser without a window, and what it complained of.

    Args:
        browser: The browser's program.
        driver: Its driver's program.
        home: An empty folder, for all that the browser keeps.
    """

    def __init__(self, browser: str, driver: str, home: Path):
        from selenium import webdriver
        from selenium.webdriver.chrome.service import Service

        options = webdriver.ChromeOptions()
        options.binary_location = browser
        for option in (*OPTIONS, f"--user-data-dir={home}"):
            options.add_argument(option)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        self.driver = webdriver.Chrome(options=options, service=Service(driver))
        self.driver.set_page_load_timeout(60)

    def size(self, size: tuple[int, int]) -> None:
        """Show pages in a window of so many pixels."""
        metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)

    def dark(self, on: bool) -> None:
        """Prefer dark pages, as a reader's system may, or light ones."""
        features = [{"name": "prefers-color-scheme", "value": "dark" if on else "light"}]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})

    def complaints(self, address: str) -> list[str]:
        """Errors that were written to the console, and requests to other hosts, since the last call."""
        logged = [entry for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"]
        found = [f"console: {entry['message']}" for entry in logged]
        for entry in self.driver.get_log("performance"):
            message = json.loads(entry["message"])["message"]
            if message["method"] != "Network.requestWillBeSent":
                continue
            queried = message["params"]["request"]["url"]
            if queried.startswith("http") and not queried.startswith(address):
                found.append(f"asks another host: {queried}")
        return found

    def photograph(self, path: Path, *, whole: bool = False) -> None:
        """A picture of what the window shows, or of the whole page, up to 6,000 pixels of it."""
        import base64

        options = {"format": "png"}
        if whole:
            width, height = self.driver.execute_script(
                "const e = document.documentElement; return [e.clientWidth, e.scrollHeight]"
            )
            clip = {"x": 0, "y": 0, "width": width, "height": min(height, 6000), "scale": 1}
            options |= {"captureBeyondViewport": True, "clip": clip}
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(base64.b64decode(self.driver.execute_cdp_cmd("Page.captureScreenshot", options)["data"]))

    def wait(self, script: str) -> bool:
        """Whether a script's answer becomes true within ``SECONDS``."""
        from selenium.common.exceptions import TimeoutException
        from selenium.webdriver.support.ui import WebDriverWait

        try:
            WebDriverWait(self.driver, SECONDS).until(lambda driver: driver.execute_script(script))
        except TimeoutException:
            return False
        return True


FORMULAE = "return [...document.querySelectorAll('.math')].every(e => e.querySelector('mjx-container'))"
WRONG_FORMULAE = (
    "return [...document.querySelectorAll('mjx-merror, [data-mjx-error]')].map(e => e.title || e.textContent)"
)
BROKEN_PICTURES = "return [...document.images].filter(e => e.complete && !e.naturalWidth).map(e => e.src)"
WIDER = "const e = document.documentElement; return e.scrollWidth > e.clientWidth + 1 ? e.scrollWidth : 0"
LINKS = "return [...document.querySelectorAll('a[href]')].map(e => e.href)"
ANCHORS = (
    "return [...document.querySelectorAll('[id], a[name]')].flatMap(e => [e.id, e.getAttribute('name')]).filter(e => e)"
)
HITS = "return [...document.querySelectorAll('#search-results li a')].map(e => e.href)"


def _look(browser: Browser, address: str, name: str) -> tuple[list[str], list[str], set[str]]:
    """What is wrong with a page, its links, and the names that links may lead to."""
    browser.driver.get(f"{address}/{name}")
    found = [] if browser.wait(FORMULAE) else ["a formula is not set"]
    ask = browser.driver.execute_script
    found += [f"formula: {text}" for text in ask(WRONG_FORMULAE)] + [
        f"no picture: {source}" for source in ask(BROKEN_PICTURES)
    ]
    if width := ask(WIDER):
        found.append(f"is {width} pixels wide in a window of {WIDE[0]}")
    links, anchors = ask(LINKS), set(ask(ANCHORS))
    browser.size(NARROW)
    if width := ask(WIDER):
        found.append(f"is {width} pixels wide in a window of {NARROW[0]}")
    browser.size(WIDE)
    return found + browser.complaints(address), links, anchors


def _dead_links(links: dict[str, list[str]], anchors: dict[str, set[str]], address: str, site: Path) -> Iterator[str]:
    """Links that lead to no file or to no place in a page."""
    for name, targets in links.items():
        for target in dict.fromkeys(targets):
            if not target.startswith(address):
                continue
            parts = urlsplit(target)
            to = parts.path.lstrip("/") or "index.html"
            if not (site / to).is_file():
                yield f"{name}: a link leads to {to}, which does not exist"
            elif parts.fragment and to in anchors and parts.fragment not in anchors[to]:
                yield f"{name}: a link leads to {to}#{parts.fragment}, which is no place in it"


def _search(browser: Browser, address: str) -> Iterator[str]:
    """Type words into the search box of the first page, as a reader does."""
    from selenium.webdriver.common.keys import Keys

    for words, page in SEARCHES.items():
        browser.driver.get(f"{address}/index.html")
        box = browser.driver.find_element("css selector", ".sidebar-search")
        box.send_keys(words, Keys.ENTER)
        expected = f"return (() => {{ {HITS} }})().some(e => e.split(/[?#]/)[0].endsWith({json.dumps('/' + page)}))"
        if not browser.wait(expected):
            hits = len(browser.driver.execute_script(HITS))
            yield f"search for {words!r}: expected {page} among the hits, got {hits} others"
        yield from (f"search for {words!r}: {line}" for line in browser.complaints(address))


def browse(browser: Browser, site: Path, out: Path) -> list[str]:
    """Open every page of a site, try its search, and photograph its main pages.

    Args:
        browser: To look with.
        site: The folder of the built site.
        out: Where the pictures go.

    Returns:
        What is wrong, in a line each.
    """
    names = sorted(path.relative_to(site).as_posix() for path in site.rglob("*.html") if "_static" not in path.parts)
    found, links, anchors = [], {}, {}
    with served(site) as address:
        browser.size(WIDE)
        browser.dark(False)
        browser.driver.get("about:blank")
        browser.complaints(address)  # of what was open before
        for number, name in enumerate(names, start=1):
            wrong, links[name], anchors[name] = _look(browser, address, name)
            found += [f"{name}: {line}" for line in wrong]
            print(f"\r{number} of {len(names)} pages", end="", file=sys.stderr, flush=True)
        print(file=sys.stderr)
        found += _dead_links(links, anchors, address, site)
        found += _search(browser, address)
        browser.photograph(out / "search.png")
        for name in (name for name in PHOTOGRAPHED if (site / f"{name}.html").exists()):
            for kind, size, dark in (("wide", WIDE, False), ("narrow", NARROW, False), ("dark", WIDE, True)):
                browser.size(size)
                browser.dark(dark)
                browser.driver.get(f"{address}/{name}.html")
                browser.wait(FORMULAE)
                browser.photograph(out / f"{name.replace('/', '-')}-{kind}.png", whole=True)
    return found


def main(arguments: list[str] | None = None) -> int:
    """Check a built site in a browser; 0 for no fault or no browser, 1 for a fault, 2 for bad usage."""
    parser = argparse.ArgumentParser(
        prog="python docs/site/browse.py", description="Check the built site in a browser without a window."
    )
    parser.add_argument("site", type=Path, help="the folder of the built site")
    parser.add_argument("--out", type=Path, default=Path("out/docs"), help="where the pictures go")
    programs = {"browser": ("chromium", "chromium-browser", "google-chrome"), "driver": ("chromedriver",)}
    for option, names in programs.items():
        found = next(filter(None, map(shutil.which, names)), None)
        parser.add_argument(f"--{option}", default=found, help=f"its program; found by itself: {found or 'none'}")
    given = parser.parse_args(arguments)
    if not (given.site / "index.html").is_file():
        parser.error(f"expected the folder of a built site, with an index.html, got {given.site}")
    if not given.browser or not given.driver:
        print("skipped: no browser (chromium and chromedriver) is installed", file=sys.stderr)
        return 0
    try:
        import selenium  # noqa: F401
    except ImportError:
        print("skipped: selenium is not installed: pip install '.[docs]'", file=sys.stderr)
        return 0
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as home:
        browser = Browser(given.browser, given.driver, Path(home))
        try:
            found = browse(browser, given.site.resolve(), given.out)
        finally:
            browser.driver.quit()
    for line in found:
        print(f"error: {line}", file=sys.stderr)
    if not found:
        print(f"nothing is wrong; pictures are in {given.out}")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
