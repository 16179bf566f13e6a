"""What ``fit`` does not take, and what each method takes: every wrong option is one clear line, before anything is
fitted."""

import warnings
from importlib import import_module

import numpy as np
import pytest
import trimesh
from bounding_shapes import few, shape

import warp_bounding as wb
from warp_bounding.errors import BounderError, BoundingError, QueryError, ShapeError
from warp_bounding.shapes import MovingMesh

WRONG = {
    "query": "cone",
    "method": ["magic", None, 5],
    "hidden": [0, (0,), (), (8, -1), (2.5,), (True,), (1025,), "eight", (8,) * 9, (1024,) * 3, None],
    "activation": ["softplus", "", None],
    "budget": [0, float("nan"), float("inf"), "long", None, True],
    "seed": [-1, 1.5, 2**63, None],
    "margin": [-1, float("nan"), float("inf"), "wide", None],
    "length": [0, -1, float("nan"), "long"],
    "steps": [0, -1, 1.5, "many", True],
    "device": ["cuda:99", "nowhere"],
    "resolution": [7, "fine"],
    "progress": [5, True],
}


@pytest.mark.parametrize(
    ("option", "value"), [(k, v) for k, vs in WRONG.items() for v in (vs if isinstance(vs, list) else [vs])]
)
def test_wrong_options(option, value):
    with pytest.raises(BoundingError) as error:
        few(**{option: value})
    assert isinstance(error.value, BounderError | QueryError | ShapeError)
    assert "\n" not in str(error.value)
    assert str(error.value).count("got") == 1


TOLD = {"hidden": (8,), "activation": "relu", "k": 12, "leaves": 7, "steps": 3, "length": 0.5}
TAKEN = {
    ("aabb", "point"): set(),
    ("kdop", "point"): {"k"},
    ("kdop", "ray"): {"k", "length"},
    ("bvh", "point"): {"leaves", "hidden"},
    ("mlp", "point"): {"hidden", "activation", "parts", "steps"},
    ("mlp-early", "point"): {"hidden", "activation", "steps"},
    ("mlp", "box"): {"hidden", "activation", "steps"},
    ("kdop+mlp", "point"): {"k", "hidden", "activation", "parts", "steps"},
}


@pytest.mark.parametrize(("method", "query"), TAKEN)
def test_options_that_a_method_does_not_take_are_refused(method, query, monkeypatch):
    """Every option, with a value that makes sense: refused before anything is fitted, or on its way to the fit."""

    class BegunError(Exception):
        """The options were taken."""

    def begin(*_, **__):
        raise BegunError

    monkeypatch.setattr(import_module("warp_bounding.training.fit"), "Problem", begin)
    for option, value in {**TOLD, "speed": 9}.items():
        reported = {option: value}
        expected = BegunError if option in TAKEN[method, query] else BounderError
        with pytest.raises(expected) as error:
            wb.fit(shape("blob"), query, method, device="cpu", **reported)
        if expected is BounderError:
            assert option in str(error.value)


def test_what_cannot_be_statistical():
    grid = shape("c")
    for options in ({"statistical": "yes"}, {"statistical": True, "parts": 16}, {"statistical": True, "query": "box"}):
        with pytest.raises(BounderError):
            wb.fit(grid, **options, steps=2, device="cpu")


def test_a_name_that_is_typed_wrong_is_told_with_the_one_that_was_meant(tmp_path):
    with pytest.raises(BounderError, match="there is no option 'marign'; did you mean 'margin'"):
        wb.fit(shape("blob"), method="kdop", device="cpu", marign=2.0)
    with pytest.raises(BounderError, match="did you mean 'levels'"):
        wb.hierarchy(shape("blob"), method="kdop", device="cpu", level=1)
    with pytest.raises(BounderError, match="there is no option 'sample'"):
        wb.baking.bake(tmp_path, tmp_path / "out", method="kdop", sample=1000)


def test_wrong_numbers_of_half_spaces_shapes_and_places_of_arguments():
    for k in (0, 7, 2.5):
        with pytest.raises(BounderError, match="kdop offers"):
            few(method="kdop", k=k)
    for source in ("nowhere.npy", None, np.zeros((3, 3)), np.ones((3, 3)), np.array(["a"])):
        with pytest.raises(ShapeError):
            wb.fit(source, method="aabb")
    with pytest.raises(QueryError, match="'mlp' is a method, which comes after the query: method='mlp'"):
        wb.fit(shape("blob"), "mlp")
    with pytest.raises(BounderError, match="python -m paper table1"):
        wb.fit(shape("c"), "ray", "kdop", space="parametric")


BOX = trimesh.creation.box(extents=(1, 2, 0.5))
BALL = np.linalg.norm(np.mgrid[-1:1:9j, -1:1:9j], axis=0) < 0.5


def motion():
    return MovingMesh(np.stack([BOX.vertices, BOX.vertices + 0.1]), BOX.faces, time_cells=2)


@pytest.mark.parametrize(
    ("given", "extent"), [(BOX, 2), (motion(), 2.1), (BALL, 1.125)], ids=["mesh", "motion", "grid"]
)
def test_a_margin_beyond_the_extent_is_an_error_unless_forced(given, extent, monkeypatch):
    shape = wb.load_shape(given)
    too_large = extent * 1.01
    with monkeypatch.context() as patch:
        patch.setattr(type(shape), "to_grid", lambda *_, **__: pytest.fail("work was begun"))
        with pytest.raises(wb.BounderError) as caught:
            wb.fit(shape, method="aabb", margin=too_large)
        assert f"the object's extent, {extent:.4g}, got {too_large:g}; force=True" in str(caught.value)
    options = {} if isinstance(shape, wb.shapes.Grid) else {"resolution": 6}
    assert wb.fit(shape, method="aabb", margin=too_large, force=True, **options).certificate.proven
    assert wb.fit(shape, method="aabb", margin=extent * 0.99, **options).certificate.proven


def test_a_margin_under_a_cell_is_warned_of_once():
    with pytest.warns(wb.BoundingWarning, match="margin 0.1 is under the size of a cell.*resolution 6") as caught:
        wb.fit(BOX, method="aabb", margin=0.1, resolution=6)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    finer = int(str(caught[0].message).rpartition("resolution=")[2].split()[0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wb.fit(BOX, method="aabb", margin=0.1, resolution=finer + 2)
