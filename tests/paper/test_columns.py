"""What the table is, and what words select."""

import pytest
from fake_library import data_folder

from paper.columns import (
    COLUMNS,
    METHODS,
    PAPER,
    VARIANTS,
    Column,
    Variant,
    select_columns,
    select_methods,
)
from paper.plan import Selection, plan
from paper.shapes import find_shapes, select_shapes
from warp_bounding.errors import BoundingError

pytestmark = pytest.mark.usefixtures("fake_supports")


def test_columns_and_sizes():
    assert [c.name for c in COLUMNS][:5] == ["2d-point", "2d-ray", "2d-plane", "2d-box", "3d-point"]
    assert len(COLUMNS) == 12
    assert {c.ndim: c.hidden for c in COLUMNS} == {2: (25, 25), 3: (50, 50), 4: (75, 75)}
    assert all(len(figures) == 12 for figures in PAPER.values())
    assert len({v.label for v in VARIANTS}) == len({v.slug for v in VARIANTS}) == len(VARIANTS)
    assert {v.name for v in VARIANTS} == set(METHODS)


def test_the_papers_figures_stand_beside_what_the_paper_did():
    point, ray = Column(2, "point"), Column(2, "ray")
    assert Variant("aabb").paper(point) == 28.4
    assert Variant("aabb").paper(ray) is None
    assert Variant("aabb", None, True).paper(ray) == 43.9
    assert Variant("aabb", None, True).paper(point) is None
    assert Variant("mlp").paper(Column(4, "box")) == 11.3
    assert Variant("relu-field").paper(Column(3, "ray")) is None
    assert Variant("bvh", 64).paper(point) is Variant("voxels").paper(point) is None
    assert Variant("bvh").paper(ray) is not None  # there are no parametric ones
    assert Variant("kdop", None, True).paper(ray) == 33.4
    assert Variant("kdop").paper(ray) is None


def test_spaces():
    ray, point = Column(3, "ray"), Column(3, "point")
    assert Variant("aabb").space_in(ray) == "geometric"
    assert Variant("aabb", None, True).space_in(ray) == "parametric"
    assert Variant("aabb", None, True).space_in(point) is None
    assert Variant("relu-field").space_in(ray) is None
    assert Variant("bvh", 16).space_in(ray) == "geometric"


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["3d-ray", "2d-point", "2D-POINT"], ["2d-point", "3d-ray"]),
        (["2d"], ["2d-point", "2d-ray", "2d-plane", "2d-box"]),
        (["box"], ["2d-box", "3d-box", "4d-box"]),
        (None, [c.name for c in COLUMNS]),
    ],
)
def test_select_columns(words, names):
    assert [c.name for c in select_columns(words)] == names


def test_select_methods():
    assert [v.label for v in select_methods(["bvh-16", "aabb"])] == [
        "aabb",
        "aabb (parametric)",
        "bvh-16",
    ]
    assert select_methods(None) == list(VARIANTS)


@pytest.mark.parametrize("select", [select_columns, select_methods])
@pytest.mark.parametrize("word", ["", "5d-point", "magic"])
def test_unknown_words(select, word):
    with pytest.raises(BoundingError, match="must be among"):
        select(["aabb" if select is select_methods else "2d", word])


def test_shapes(tmp_path):
    found = find_shapes(data_folder(tmp_path / "data"), (2, 3, 4))
    assert [s.label for s in found] == ["2d/aa", "2d/bb", "2d/cc", "3d/aa", "3d/bb", "4d/aa"]
    assert [s.label for s in select_shapes(found, ["2d/cc", "bb", "3D/aa"])] == ["2d/cc", "2d/bb", "3d/bb", "3d/aa"]
    for word in ("", "dd", "4d/bb", "5d/aa", "/aa"):
        with pytest.raises(BoundingError, match="objects must be among"):
            select_shapes(found, [word])
    (tmp_path / "data/4D/aa.npy").unlink()
    with pytest.raises(BoundingError, match=r"no 4D/\*.npy"):
        find_shapes(tmp_path / "data", (2, 4))
    with pytest.raises(BoundingError, match="no such folder"):
        find_shapes(tmp_path / "nothing", (2,))


def test_order_of_work(tmp_path):
    shapes = find_shapes(data_folder(tmp_path / "data"), (2, 3))
    columns, variants = select_columns(["2d-point", "3d-ray"]), select_methods(["mlp", "aabb", "relu-field"])
    jobs, total = plan(Selection(columns, variants, shapes, ("exact", "sampled")))
    titles = [j.title for j in jobs]
    assert titles[:6] == [
        "2d-point aa: aabb",
        "3d-ray aa: aabb",
        "3d-ray aa: aabb (parametric)",
        "2d-point aa: relu-field",
        "2d-point aa: mlp",
        "3d-ray aa: mlp",
    ]
    assert total == 2 * len(jobs) == 2 * (3 * 3 + 2 * 3)
    assert len({j.name for j in jobs}) == len(jobs)
    done = {jobs[0].key("exact"), *(jobs[1].key(p) for p in ("exact", "sampled"))}
    rest, total = plan(Selection(columns, variants, shapes, ("exact", "sampled")), done)
    assert total == 30
    assert [j.title for j in rest] == [titles[0], *titles[2:]]
    assert rest[0].protocols == ("sampled",)
    with pytest.raises(BoundingError, match="nothing to measure: relu-field"):
        plan(Selection(select_columns(["3d-ray"]), select_methods(["relu-field"]), shapes, ("exact",)))
