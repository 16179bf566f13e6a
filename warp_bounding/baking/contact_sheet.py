"""The contact sheet: an HTML page with a picture and the figures of every shape, which needs nothing but itself.

A page has up to ``PER_PAGE`` shapes; further ones are pages of their own, and all link to each other. Pictures are in the page, and are only drawn
when they come into view.
"""

from collections.abc import Callable
from pathlib import Path

from warp_bounding.baking.pictures import COLOURS
from warp_bounding.baking.record import Record
from warp_bounding.errors import BoundingError
from warp_bounding.runtime.whole_file import PAGE_FILE, write_whole

__all__ = ["SHEET", "write_sheet"]

SHEET = "contact-sheet.html"
PER_PAGE = 1000  # about 2 MB

TEMPLATE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Contact sheet: {{ total }} shapes</title>
<style>
:root { color-scheme: light dark; --ink: #22303c; --paper: #fbfbfa; --card: #fff; --line: #d9dee2; --faint: #60707c; --bad: #a8323e }
@media (prefers-color-scheme: dark) { :root { --ink: #dfe5ea; --paper: #15191d; --card: #1e242a; --line: #37414a; --faint: #9aa7b2; --bad: #f08c8c } }
body { font: 14px/1.4 system-ui, sans-serif; color: var(--ink); background: var(--paper); margin: 1.5rem }
h1 { font-size: 1.3rem; margin: 0 0 .3rem } p { margin: .3rem 0; color: var(--faint) }
p .said { white-space: nowrap } .key { display: inline-block; width: .8em; height: .8em; margin: 0 .25em 0 .8em; border: 1px solid var(--line) }
form { margin: 1rem 0; display: flex; gap: 1rem; flex-wrap: wrap } input, select { font: inherit }
main { display: grid; gap: .8rem; grid-template-columns: repeat(auto-fill, minmax(250px, 1fr)) }
article { background: var(--card); border: 1px solid var(--line); border-radius: 6px; padding: .7rem; content-visibility: auto; contain-intrinsic-size: 250px 190px }
article img { display: block; max-width: 100%; image-rendering: pixelated; margin-bottom: .4rem }
article h2 { font-size: .95rem; margin: 0; overflow-wrap: anywhere } article.failed { border-color: var(--bad) }
dl { margin: .2rem 0 0; display: grid; grid-template-columns: auto 1fr; gap: 0 .6rem } dt { color: var(--faint) } dd { margin: 0; overflow-wrap: anywhere }
.error { color: var(--bad); overflow-wrap: anywhere }
</style></head><body>
<h1>{{ total }} shapes{% if pages > 1 %}, page {{ page }} of {{ pages }}{% endif %}</h1>
<p>{{ baked }} with a bounder, {{ proven }} of them proven; {{ failed }} failed. Slices through each object, side by side:
<span class="said"><span class="key" style="background:{{ object }}"></span>object</span>
<span class="said"><span class="key" style="background:{{ maybe }}"></span>maybe, though no object is there</span>
<span class="said"><span class="key"></span>certainly no</span></p>
{% if pages > 1 %}<p>Pages:{% for link in links %} <a href="{{ link }}">{{ loop.index }}</a>{% endfor %}</p>{% endif %}
<form><label>Find <input id="find" type="search" placeholder="name, method, error"></label>
<label>Order <select id="order"><option value="name">name</option><option value="fp">false positives, most first</option>
<option value="bytes">bytes, most first</option><option value="seconds">seconds, most first</option></select></label></form>
<main>{% for r in shown %}
<article{% if r.error %} class="failed"{% endif %} data-name="{{ r.source }}" data-fp="{{ r.fp_rate or 0 }}" data-bytes="{{ r.bytes }}" data-seconds="{{ r.seconds }}">
{% if r.picture %}<img src="data:image/png;base64,{{ r.picture }}" alt="Slices of {{ r.name }} and its bound" loading="lazy" decoding="async">{% endif %}
<h2>{{ r.source }}</h2>
{% if r.error %}<p class="error">{{ r.error }}</p>{% endif %}
<dl>{% if r.method %}<dt>method</dt><dd>{{ r.method }}{% if r.query %}, {{ r.query }}{% endif %}</dd>{% endif %}
{% if r.file %}<dt>bytes</dt><dd>{{ "{:,}".format(r.bytes) }}</dd><dt>false positives</dt><dd>{{ "%.2f"|format(r.fp_rate) }} %</dd>
<dt>certificate</dt><dd>{{ r.certificate or "none" }}</dd>{% endif %}
<dt>seconds</dt><dd>{{ "%.1f"|format(r.seconds) }}</dd><dt>hash</dt><dd>{{ r.hash }}</dd>
{% if several %}<dt>settings</dt><dd>{{ r.settings }}</dd>{% endif %}
{% if r.note %}<dt>note</dt><dd>{{ r.note }}</dd>{% endif %}</dl>
</article>{% endfor %}
</main>
<script>
const find = document.getElementById("find"), order = document.getElementById("order"), main = document.querySelector("main")
const cards = [...main.children]
function show() {
  const words = find.value.toLowerCase(), by = order.value
  for (const card of cards) card.hidden = !card.textContent.toLowerCase().includes(words)
  cards.sort((a, b) => by === "name" ? a.dataset.name.localeCompare(b.dataset.name) : b.dataset[by] - a.dataset[by])
  main.append(...cards)
}
find.addEventListener("input", show); order.addEventListener("change", show)
document.querySelector("form").addEventListener("submit", event => event.preventDefault())
</script></body></html>
"""


def write_sheet(folder: Path, records: list[Record], whole: Callable[[Record], Record]) -> None:
    """Write the pages, each whole or not at all, and remove pages of a longer sheet before.

    Args:
        folder: Of the bake.
        records: All of them; pictures may be missing.
        whole: Gives a record with its picture.

    Raises:
        FileFormatError: If a page cannot be written.
        BoundingError: If Jinja2 is not installed.
    """
    try:
        from jinja2 import Environment
    except ImportError as error:
        raise BoundingError("the contact sheet needs Jinja2: pip install 'warp-bounding[bake]'") from error
    template = Environment(autoescape=True, trim_blocks=True).from_string(TEMPLATE)
    records = sorted(records, key=lambda r: (not r.error, r.source, r.settings))
    pages = max(1, -(-len(records) // PER_PAGE))
    links = [SHEET, *(f"contact-sheet-{page}.html" for page in range(2, pages + 1))]
    baked = [r for r in records if r.file]
    about = {
        "total": len(records),
        "baked": len(baked),
        "proven": sum(r.certificate == "proven" for r in baked),
        "failed": sum(bool(r.error) for r in records),
        "several": len({r.settings for r in records}) > 1,
        "pages": pages,
        "links": links,
        **{name: f"rgb{COLOURS[name][:3]}" for name in ("object", "maybe")},
    }
    for page, link in enumerate(links):
        shown = [whole(record) for record in records[page * PER_PAGE : (page + 1) * PER_PAGE]]
        write_whole(folder / link, template.render(page=page + 1, shown=shown, **about).encode(), PAGE_FILE)
    for old in folder.glob("contact-sheet-*.html"):
        if old.name not in links:
            old.unlink()
