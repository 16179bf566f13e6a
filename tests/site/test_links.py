"""Dead links of built pages, and whatever would be loaded from another host, are found without a browser."""

import pytest
from links import problems

HEAD = '<html><head><link rel="stylesheet" href="style.css"></head><body><h1 id="top">A page</h1>'


def site(folder, body: str, style: str = "body { color: black }"):
    folder.mkdir(exist_ok=True)
    (folder / "style.css").write_text(style)
    (folder / "other.html").write_text(f'{HEAD}<p id="here">x</p></body></html>')
    (folder / "index.html").write_text(f"{HEAD}{body}</body></html>")
    return folder


WHOLE = [
    '<a href="other.html#here">a</a>',
    '<a href="#top">a</a>',
    '<a href="https://example.org/x.html">a</a>',
    '<a href="mailto:nobody">a</a>',
    '<img src="data:image/png;base64,AAAA">',
]
BROKEN = [
    ('<a href="nothing.html">a</a>', "leads to no file"),
    ('<a href="other.html#there">a</a>', "no such place"),
    ('<a href="#there">a</a>', "no such place"),
    ('<img src="nothing.png">', "leads to no file"),
    ('<img src="https://example.org/a.png">', "from another host"),
    ('<img src="//example.org/a.png">', "from another host"),
    ('<img srcset="https://example.org/a.png 2x">', "from another host"),
    ('<script src="https://example.org/a.js"></script>', "from another host"),
    ('<link rel="preconnect" href="https://example.org">', "from another host"),
    ("<p style=\"background: url('https://example.org/a.png')\">", "from another host"),
]


def test_a_whole_site_has_no_problems(tmp_path):
    assert problems(site(tmp_path, "".join(WHOLE))) == []


@pytest.mark.parametrize(("body", "why"), BROKEN)
def test_what_is_broken_is_found(body, why, tmp_path):
    (found,) = problems(site(tmp_path, body))
    assert found.startswith("index.html")
    assert why in found
