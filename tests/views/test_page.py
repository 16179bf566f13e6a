"""Pages: one file, nothing outside it, and in a browser they draw, slide and hide without an error."""

import base64
import json
import re
import shutil
import zlib
from html.parser import HTMLParser

import numpy as np
import pytest
from bounding_shapes import shape

import warp_bounding as wb
from warp_bounding.views import view_of
from warp_bounding.views.draw import page
from warp_bounding.views.view import facts_of, title_of

pytest.importorskip("pyvista")
pytest.importorskip("plotly")
pytest.importorskip("PIL")
RADII = [0.0, 0.1, 0.3]


def made(name: str, query: str = "point", method: str = "aabb", **options):
    """A view, and its page."""
    bounder, indicator = wb.fit(shape(name), query, method, device="cpu"), shape(name)
    view = view_of(bounder, indicator, resolution=12, samples=1000, **options)
    view.facts = facts_of(bounder, indicator, view)
    return view, page(view, title_of(bounder, indicator), "y")


class Tags(HTMLParser):
    """The tags of a page with their attributes."""

    def __init__(self, text: str):
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))


def embedded(text: str) -> dict:
    return json.loads(re.search(r'<script type="application/json" id="view">(.*?)</script>', text, re.S)[1])


def numbers(packed: str, kind: str) -> np.ndarray:
    return np.frombuffer(zlib.decompress(base64.b64decode(packed)), kind)


def test_a_page_is_whole_in_itself():
    view, text = made("star", "distance", radii=RADII)
    for tag, attributes in Tags(text).found:
        for name in ("src", "href"):
            assert not attributes.get(name) or attributes[name].startswith("data:"), tag
    for fact in view.facts:
        assert f"<dt>{fact}</dt>" in text
    assert "bytes" in view.facts["Bounder"]
    assert view.facts["Certificate"].startswith("Proven")


def test_surfaces_come_back_as_they_were():
    view, text = made("star", "distance", radii=RADII)
    told = embedded(text)
    assert [state["label"] for state in told["states"]] == ["0", "0.1", "0.3"]
    assert len({state["object"] for state in told["states"]}) == 1  # it is stored once
    step = (view.upper - view.lower) / 65535
    for state, seen in zip(told["states"], view.states, strict=True):
        packed = told["surfaces"][state["bound"]]
        axes = numbers(packed["vertices"], "<u2").reshape(3, -1).T * step + view.lower
        np.testing.assert_allclose(axes.min(axis=0), seen.bound.vertices.min(axis=0), atol=step.max())
        np.testing.assert_allclose(axes.max(axis=0), seen.bound.vertices.max(axis=0), atol=step.max())
        assert numbers(packed["faces"], "<u4").reshape(3, -1).shape == seen.bound.faces.T.shape


def test_names_are_text_not_markup():
    view, _ = made("star")
    view.facts = {"Bounder": "</script><b>"}
    text = page(view, "<i>&", "y")
    assert "<title>&lt;i&gt;&amp;</title>" in text
    assert "<dd>&lt;/script&gt;&lt;b&gt;</dd>" in text


def test_another_shape_is_told():
    bounder = wb.fit(shape("c"), method="aabb", device="cpu")
    other = wb.load_indicator(~shape("c").occupancy)
    facts = facts_of(bounder, other, view_of(bounder, other, resolution=8, samples=100))
    assert "is not the shape that the bounder was fitted to" in facts["Another shape"]
    assert "Another shape" not in facts_of(bounder, shape("c"), view_of(bounder, shape("c"), resolution=8, samples=100))


@pytest.fixture(scope="module")
def browser():
    """Headless Chromium; tests of pages are skipped where there is none."""
    webdriver = pytest.importorskip("selenium.webdriver")
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    driver = shutil.which("chromedriver")
    if not chromium or not driver:
        pytest.skip("there is no Chromium with its driver")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for argument in ("--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    found = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    found.set_script_timeout(30)
    yield found
    found.quit()


SLIDE = """
const [name, value, done] = arguments, control = document.getElementById(name);
if (control.type === "checkbox") control.click();
else { control.value = value; control.dispatchEvent(new Event("input")); }
setTimeout(done, 1500);
"""


def opened(browser, path) -> None:
    """Open a page and wait until it has drawn."""
    from selenium.webdriver.support.ui import WebDriverWait

    browser.get_log("performance")
    browser.get(path.as_uri())
    WebDriverWait(browser, 60).until(lambda b: b.execute_script("return document.getElementById('plot').dataset.state"))


def state(browser, expression: str):
    return browser.execute_script(f"return {expression}")


def check_quiet(browser) -> None:
    """No error on the console, and nothing asked of a network."""
    assert [e["message"] for e in browser.get_log("browser") if e["level"] == "SEVERE"] == []
    told = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    urls = [e["params"]["request"]["url"] for e in told if e["method"] == "Network.requestWillBeSent"]
    assert urls
    assert all(url.startswith(("file:", "data:", "blob:")) for url in urls), urls


@pytest.mark.slow
@pytest.mark.parametrize("width", [1200, 420])
def test_a_page_of_a_distance_in_a_browser(browser, tmp_path, width):
    path = tmp_path / "page.html"
    path.write_text(made("star", "distance", radii=RADII)[1], encoding="utf-8")
    browser.set_window_size(width, 900)
    opened(browser, path)
    bound = "Math.max(...document.getElementById('plot').data.find(t => t.name === 'bound').x)"
    before = state(browser, bound)
    browser.execute_async_script(SLIDE, "state", 2)
    assert state(browser, bound) == pytest.approx(before + 0.3, abs=0.01)
    assert state(browser, "document.getElementById('value').textContent") == "0.3"
    browser.execute_async_script(SLIDE, "cut", 50)
    middle = "document.getElementById('plot').data.find(t => t.name === 'bound').z"
    low, high = state(browser, f"[Math.min(...{middle}), Math.max(...{middle})]")
    kept = state(
        browser,
        "(() => { const t = document.getElementById('plot').data.find(t => t.name === 'bound');"
        "return Math.max(...[...t.i, ...t.j, ...t.k].map(v => t.z[v])); })()",
    )
    assert kept == pytest.approx(0.5, abs=0.05)
    assert low < kept <= high
    for name in ("object", "bound"):
        browser.execute_async_script(SLIDE, f"show {name}", 0)
    names = state(browser, "document.getElementById('plot').data.map(t => t.type)")
    assert "mesh3d" not in names
    wide = "document.documentElement.scrollWidth <= window.innerWidth"
    assert state(browser, wide)
    check_quiet(browser)


@pytest.mark.slow
def test_a_page_of_an_image_in_a_browser(browser, tmp_path):
    path = tmp_path / "page.html"
    path.write_text(made("c")[1], encoding="utf-8")
    opened(browser, path)
    source = "document.getElementById('plot').layout.images[0].source"
    whole = state(browser, source)
    browser.execute_async_script(SLIDE, "show bound", 0)
    assert state(browser, source) != whole
    browser.execute_async_script(SLIDE, "show denied", 0)
    assert state(browser, "document.getElementById('plot').data.map(t => t.type)")[0] == "scatter"
    check_quiet(browser)
