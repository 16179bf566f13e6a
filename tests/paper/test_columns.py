"""What the tables are made of, what words select, and Eq. 6."""

import pytest

from paper.data import objects_in, select_objects
from paper.table import COLUMNS, VARIANTS, Column, Variant, budget_of, budgets_in, select_columns, select_methods
from warp_bounding.errors import BoundingError

POINT, RAY = Column(2, "point"), Column(3, "ray")


def test_selections():
    assert [c.name for c in select_columns("3d-ray,2d-point, 2D-POINT")] == ["2d-point", "3d-ray"]
    assert [c.name for c in select_columns("box")] == ["2d-box", "3d-box", "4d-box"]
    assert (select_columns(None), select_methods(None)) == (list(COLUMNS), list(VARIANTS))
    assert [v.label for v in select_methods("bvh-16,aabb")] == ["aabb", "aabb (parametric)", "bvh-16"]
    for select in (select_columns, select_methods):
        for word in ("", "5d-point", "magic"):
            with pytest.raises(BoundingError, match="must be among"):
                select(word)


def test_objects(data):
    found = objects_in(data, (2, 4))
    assert [o.label for o in found] == ["2d/disc", "2d/half", "4d/disc"]
    assert [o.label for o in select_objects(found, "half,disc")] == ["2d/half", "2d/disc", "4d/disc"]
    for word in ("", "dd", "4d/half", "/disc"):
        with pytest.raises(BoundingError, match="objects must be among"):
            select_objects(found, word)
    for place, dimensions, told in ((data, (3,), r"no 3D/\*.binvox"), (data / "none", (2,), "no such folder")):
        with pytest.raises(BoundingError, match=told):
            objects_in(place, dimensions)


def test_of_all_budgets_the_last_that_fits_counts():
    s = budgets_in("20, 3D=40,ray=50 ,3d-ray=90.5,3d-ray:mlp=240,occupancy=5,learned-kdop=7", 60.0)
    seconds = {
        name: budget_of(s, RAY, Variant(name)) for name in ("mlp", "occupancy", "relu-field", "mlp-local", "distance")
    }
    assert seconds == {"mlp": 240, "occupancy": 5, "relu-field": 90.5, "mlp-local": 240, "distance": 90.5}
    assert budget_of(s, RAY, Variant("learned-kdop+mlp")) == 240  # what its last part would take
    assert budget_of(s, Column(3, "box"), Variant("mlp")) == 40
    assert budget_of(s, POINT, Variant("mlp")) == 20
    assert budgets_in("3d=1", 60.0) == {"budget": 60.0, "budgets": "3d=1"}
    for text in ("", "a", "0", "nan", "-1", "3,4", "5d=3", "aabb=3", "3d=", "=4", "3d=0", "3,,"):
        with pytest.raises(BoundingError, match="budget must"):
            budgets_in(text, 60.0)
