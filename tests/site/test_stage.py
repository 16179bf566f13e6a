"""The site's sources: where pages go, where their links lead then, and that what cannot be shown is refused."""

import re

import pytest
from stage import ROOT, StageError, relinked, stage

import warp_bounding as wb

pytest.importorskip("PIL", reason="thumbnails need pillow: pip install '.[train]'")


def test_links_are_turned_to_where_their_targets_are():
    page = (
        "[a](../README.md#how-tight) ![b](rain.png) [c](../results/meshes/README.md) [d](https://example.org/x.md) "
        ""
        "[e](#words)"
    )
    turned = (
        "[a](overview.md#how-tight) ![b](rain.png) [c](results/meshes/index.md) [d](https://example.org/x.md) "
        "[e](#words)"
    )
    assert relinked(page, "docs/tables.md") == turned
    assert relinked("[a](../claims.md) [b](../../notebooks/10_arms.ipynb)", "docs/guide/arms.md") == (
        "[a](../claims.md) [b](../notebooks/10_arms.ipynb)"
    )
    assert relinked("[a](docs/guide.md)", "README.md") == "[a](guide.md)"
    code = "```python\na = b[c](d)\n```\n"
    assert relinked(code, "docs/tables.md") == code


@pytest.mark.parametrize(
    ("link", "why"),
    [("nothing.md", "does not exist"), ("../pyproject.toml", "expected a file"), ("../sims", "expected a file")],
)
def test_links_out_of_the_site_are_refused(link, why):
    with pytest.raises(StageError, match=why):
        relinked(f"[a]({link})", "docs/tables.md")


def test_all_pages_are_laid_out(tmp_path):
    stage(tmp_path / "sources")
    (tmp_path / "sources/stale.md").write_text("gone with the next")
    stage(tmp_path / "sources")
    names = {path.relative_to(tmp_path / "sources").as_posix() for path in (tmp_path / "sources").rglob("*")}
    assert {
        "index.md",
        "overview.md",
        "gallery.md",
        "changelog.md",
        "guide/points.md",
        "results/meshes/index.md",
    } <= names
    assert not [name for name in names if name.endswith(".py") or "stale" in name]


def test_every_public_name_is_on_one_page_of_the_reference():
    pages = "\n".join(path.read_text() for path in (ROOT / "docs/api").glob("*.md"))
    shown = re.findall(r"^\.\. auto\w+:: warp_bounding\.([\w.]+)$", pages, re.MULTILINE)
    assert len(shown) == len(set(shown))
    named = {name for name in ("DISTANCES", "METHODS", "__version__", "arms", "solids") if f"`wb.{name}`" in pages}
    assert set(wb.__all__) - named <= set(shown)
    assert {f"solids.{name}" for name in wb.solids.__all__} <= set(shown)
    assert {f"arms.{name}" for name in wb.arms.__all__} - {"arms.WORLD"} <= set(shown)
