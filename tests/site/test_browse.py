"""A browser without a window finds what is wrong with a site, and nothing else; skipped where there is none."""

import shutil

import browse
import pytest

NO_BROWSER = not (shutil.which("chromium") and shutil.which("chromedriver"))
needs_browser = pytest.mark.skipif(NO_BROWSER, reason="no browser: apt-get install chromium chromium-driver")
HEAD = '<html><head><link rel="icon" href="data:,"></head><body><h1 id="top">A page</h1>'


def site(folder, body: str):
    """A site of two pages, whose search box leads to a page that finds everything."""
    box = '<form action="search.html"><input class="sidebar-search" name="q"></form>'
    (folder / "index.html").write_text(f"{HEAD}{box}{body}</body></html>")
    hits = "".join(f'<li><a href="{page}">x</a></li>' for page in browse.SEARCHES.values())
    (folder / "search.html").write_text(f'{HEAD}<ul id="search-results">{hits}</ul></body></html>')
    for page in browse.SEARCHES.values():
        (folder / page).parent.mkdir(exist_ok=True)
        (folder / page).write_text(f"{HEAD}</body></html>")
    return folder


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    pytest.importorskip("selenium", reason="selenium is not installed: pip install '.[docs]'")
    home = tmp_path_factory.mktemp("browser")
    opened = browse.Browser(shutil.which("chromium"), shutil.which("chromedriver"), home)
    yield opened
    opened.driver.quit()


@needs_browser
def test_a_whole_site_is_whole(browser, tmp_path):
    (tmp_path / "site").mkdir()
    assert browse.browse(browser, site(tmp_path / "site", '<a href="search.html#top">a</a>'), tmp_path / "out") == []
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {
        "index-wide.png",
        "index-narrow.png",
        "index-dark.png",
    }


@needs_browser
@pytest.mark.parametrize(
    ("body", "why"),
    [
        ("<script>console.error('oh')</script>", "console"),
        ('<img src="nothing.png">', "console"),
        ('<a href="nothing.html">a</a>', "does not exist"),
        ('<a href="search.html#there">a</a>', "no place in it"),
        ('<div style="width: 2000px">a</div>', "pixels wide"),
        ('<img src="http://127.0.0.2:9/a.png">', "another host"),
    ],
)
def test_what_is_broken_is_found(browser, body, why, tmp_path):
    (tmp_path / "site").mkdir()
    found = browse.browse(browser, site(tmp_path / "site", body), tmp_path / "out")
    assert any(why in line for line in found)
    assert [line for line in found if not line.startswith(("index.html", "search for"))] == []


@needs_browser
def test_a_search_that_finds_nothing_is_found(browser, tmp_path, monkeypatch):
    monkeypatch.setattr(browse, "SEARCHES", {"words": "a.html"})
    monkeypatch.setattr(browse, "SECONDS", 1)
    folder = site(tmp_path, "")
    (folder / "search.html").write_text(f"{HEAD}<ul></ul></body></html>")
    assert browse.browse(browser, folder, tmp_path / "out") == [
        "search for 'words': expected a.html among the hits, got 0 others"
    ]


def test_no_browser_is_said(tmp_path, capsys):
    assert browse.main([str(site(tmp_path, "")), "--browser", ""]) == 0
    assert "skipped: no browser" in capsys.readouterr().err


def test_no_site_is_bad_usage(tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        browse.main([str(tmp_path)])
    assert stop.value.code == 2
    assert "expected the folder of a built site" in capsys.readouterr().err
