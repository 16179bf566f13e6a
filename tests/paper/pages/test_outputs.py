"""What is shown of a table: means, the Markdown page, the rank plot."""

import re
import struct

import pytest
from fake_library import make_row, table_rows

from paper.columns import COLUMNS, Column, Variant
from paper.folder import open_folder
from paper.pages.markdown import page, write_outputs
from paper.pages.means import Means
from paper.pages.rank_plot import rank_plot

pytestmark = pytest.mark.usefixtures("fake_supports")

POINT, RAY = Column(2, "point"), Column(2, "ray")
AABB, PARAMETRIC, MLP, EARLY = Variant("aabb"), Variant("aabb", None, True), Variant("mlp"), Variant("mlp-early")
OCCUPANCY, VOXELS, FIELD = Variant("occupancy"), Variant("voxels"), Variant("relu-field")

ROWS = [
    make_row(POINT, AABB, "bunny", fp_rate=20.0),
    make_row(POINT, AABB, "chair", fp_rate=31.0),
    make_row(RAY, AABB, "bunny", fp_rate=40.0),
    make_row(RAY, PARAMETRIC, "bunny", "parametric", fp_rate=44.25),
    make_row(POINT, MLP, "bunny", fp_rate=3.0),
    make_row(POINT, MLP, "chair", fp_rate=4.125),
    make_row(RAY, MLP, "bunny", fp_rate=2.5, certificate="statistical"),
    make_row(POINT, EARLY, "bunny", fp_rate=1.0),
    make_row(RAY, EARLY, "bunny", fp_rate=2.0, certificate="undecided"),
    make_row(POINT, OCCUPANCY, "bunny", fp_rate=0.5, fn=1000),
    make_row(POINT, OCCUPANCY, "chair", fp_rate=0.5, fn=2000),
    make_row(POINT, VOXELS, "bunny", fp_rate=0.0),
    make_row(POINT, VOXELS, "chair", fp_rate=0.0),
]


def opened(path, rows, **given):
    """A closed folder with these rows."""
    with open_folder(path, given, create=True) as folder:
        folder.remember("python -m paper table1 --data D --out O")
        folder.rows = {row.key: row for row in rows}
    return folder


def table(text, protocol="exact"):
    """Cells of the main table by label."""
    part = text.split(f"## False positives, {protocol} protocol")[1].split("\n## ")[0]
    lines = [line.strip("|").split("|") for line in part.splitlines() if line.startswith("|")]
    return {cells[0].strip(): [c.strip() for c in cells[1:]] for cells in lines}


def test_means_and_the_best():
    means = Means(ROWS, "exact")
    cell = means.cells[AABB, POINT]
    assert (cell.fp_rate, cell.objects, cell.complete, cell.proven) == (25.5, 2, True, True)
    assert means.best(POINT) == [MLP]  # voxels and occupancy stand outside, mlp-early has not seen every object
    assert means.best(RAY) == [MLP]  # mlp-early has no certificate
    assert not Means(ROWS, "sampled").cells
    assert means.broken_promises() == []
    broken = Means([*ROWS, make_row(RAY, VOXELS, "bunny", fp_rate=0.0, fn=3)], "exact")
    assert broken.broken_promises() == ["2d-ray bunny: voxels (exact): 3 false negatives"]
    summary = means.to_dict()
    assert summary["2d-point"]["mlp"] == {"fp_rate": 3.5625, "fn": 0, "objects": 2, "proven": True, "paper": 3.2}
    assert list(summary) == ["2d-point", "2d-ray"]


def test_the_page(tmp_path):
    folder = opened(tmp_path / "out", ROWS)
    text = page(folder, ["3d-ray bunny: kdop (exact): no luck"])
    cells = table(text)
    assert cells[""] == ["2D point", "2D ray", "false negatives", "memory, 2D"]
    assert cells["*objects*"][:2] == ["2 (of 9)", "1 (of 9)"]
    assert cells["aabb"] == ["25.50 (28.4)", "40.00", "0 of 3,000,000", "2.0 kB"]
    assert cells["aabb (parametric)"] == ["=", "44.25 (43.9)", "0 of 1,000,000", "2.0 kB"]
    assert cells["mlp"][:2] == ["**3.56** (3.2)", "**2.50**<sup>s</sup> (2.7)"]
    assert cells["mlp-early"][:2] == ["1.00<sup>1/2</sup> (2.8)", "2.00<sup>u</sup> (3.3)"]
    assert cells["occupancy"] == ["0.50", "…", "3,000 of 2,000,000", "2.0 kB"]
    assert cells["occupancy, **false negatives %**"][0] == "0.150"
    labels = list(cells)
    assert labels.index("aabb") < labels.index("mlp") < labels.index("occupancy") < labels.index("voxels")
    assert "python -m paper table1 --data D --out O" in text
    assert all(
        words in text for words in ("60 s for each", "1,000,000 random queries", "CPU threads 2", "Python 3", "no luck")
    )
    assert "sampled protocol" not in text
    details = text.split("<summary>2D point, exact</summary>")[1].split("</details>")[0]
    assert "| mlp | 3.000 | 4.125 | 2.0 kB | 1.00 | 0.25 |" in details
    assert "| mlp-early | 1.000 | … |" in details
    assert "0.500 **(1,000 FN)**" in details


def test_the_line_against_the_paper(tmp_path):
    monotone, box = Variant("monotone-mlp"), Column(3, "box")
    rows = [make_row(RAY, MLP, name, fp_rate=rate) for name, rate in (("bunny", 2.5), ("chair", 2.7))]
    rows += [make_row(box, MLP, fp_rate=7.0), make_row(box, monotone, fp_rate=6.0), make_row(box, AABB, fp_rate=1.0)]
    rows[1] = make_row(RAY, MLP, "chair", fp_rate=2.7, certificate="statistical")
    text = page(opened(tmp_path / "out", rows))
    (line,) = (line for line in text.splitlines() if line.startswith("Our best network"))
    assert "2D ray **2.60**<sup>1s</sup> (2.7, mlp); 3D box 6.00 (5.0, monotone-mlp). Lower in 1 of 2 columns" in line
    assert "0 of them over all" in line
    assert "<sup>2s</sup> proven for all objects but 2" in text
    best = [c.paper_network for c in COLUMNS]
    assert best == [2.8, 2.7, 1.2, 2.2, 2.9, 7.6, 5.6, 5.0, 10.9, 31.0, 3.1, 11.3]


def test_the_page_says_what_does_not_exist_and_what_is_broken(tmp_path):
    ray3 = Column(3, "ray")
    rows = [make_row(POINT, FIELD), make_row(ray3, AABB, fn=2), make_row(Column(3, "point"), FIELD)]
    rows.append(make_row(ray3, MLP, protocol="sampled"))
    text = page(opened(tmp_path / "out", rows))
    cells = table(text)
    assert cells["relu-field"][2] == "–"
    assert cells["aabb"] == ["… (28.4)", "… (28.5)", "12.50", "**2** of 1,000,000, **promise broken**", "– / 2.0 kB"]
    assert table(text, "sampled")["mlp"][0] == "12.50 (7.6)"


def test_every_line_of_a_table_is_as_long_as_its_head(tmp_path, rng):
    folder = opened(tmp_path / "out", table_rows(rng, protocols=("exact", "sampled")))
    widths, inside = [], []
    for line in page(folder).splitlines():
        if line.startswith("|"):
            inside.append(line.count("|"))
        elif inside:
            widths.append(set(inside))
            inside = []
    assert len(widths) == 2 * (1 + 12)
    assert all(len(width) == 1 for width in widths)


def test_an_empty_folder(tmp_path):
    folder = opened(tmp_path / "out", [])
    assert write_outputs(folder) == []
    assert "Nothing has been measured yet" in folder.page.read_text()
    assert not (folder.path / "rank.png").exists()


@pytest.mark.parametrize("objects", [1, 3])
def test_the_rank_plot(tmp_path, rng, objects):
    pytest.importorskip("matplotlib")
    folder = opened(tmp_path / "out", table_rows(rng, objects))
    assert write_outputs(folder) == []
    png, svg = (folder.path / "rank.png").read_bytes(), (folder.path / "rank.svg").read_text()
    width, height = struct.unpack(">II", png[16:24])
    assert png.startswith(b"\x89PNG")
    assert width > 1200
    assert height > 600
    assert len(png) > 40_000
    assert len(re.findall(r"<path ", svg)) > 40
    assert "![" in folder.page.read_text()
    if objects == 1:
        assert rank_plot(folder.rows.values())["svg"] == svg.encode()  # the same rows, the same file


def test_the_rank_plot_of_little(rng):
    pytest.importorskip("matplotlib")
    assert rank_plot([]) == {}
    assert rank_plot([make_row(POINT, VOXELS)]) == {}
    assert set(rank_plot([make_row(POINT, MLP, fp_rate=0.0)])) == {"png", "svg"}
    assert set(rank_plot([make_row(RAY, PARAMETRIC, "a", "parametric", "sampled")])) == {"png", "svg"}


def test_a_page_begins_with_one_line_and_folds_the_rest(tmp_path):
    folder = opened(tmp_path / "out", ROWS)
    folder.commands.append("python -m paper table1 --data D --out O --methods mlp")
    text = page(folder)
    head, *_ = text.split("\n- A cell is")
    title, _, line, _, details, *folded = head.splitlines()
    assert title.startswith("# Table 1")
    assert line.endswith("made with `python -m paper table1 --data D --out O`.")
    assert details == "<details>"
    assert folded[-2:] == ["</details>", ""] or folded[-1] == "</details>"
    assert "python -m paper table1 --data D --out O --methods mlp" in folded
    assert line.startswith(f"{len(ROWS)} cells in [table1.csv](table1.csv), objects: 2 in 2D")
