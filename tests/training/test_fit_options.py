"""What ``fit`` does not take, and what each method takes: every wrong option is one clear line, before anything is fitted."""

from importlib import import_module

import numpy as np
import pytest
from bounding_shapes import few, shape

import warp_bounding as wb
from warp_bounding.errors import BounderError, BoundingError, IndicatorError, QueryError

WRONG = {
    "query": "cone",
    "method": ["magic", None, 5],
    "hidden": [0, (0,), (), (8, 0), (8, -1), (2.5,), (True,), (1025,), "eight", (8,) * 9, (1024,) * 3, None],
    "activation": ["softplus", "", None],
    "budget": [0, -1, float("nan"), float("inf"), "long", None, True],
    "seed": [-1, 1.5, 2**63, "a", None, True],
    "margin": [-1, float("nan"), float("inf"), "wide", None],
    "length": [0, -1, float("nan"), "long"],
    "octaves": [-1, 11, 1.5, "many", None, True],
    "steps": [0, -1, 1.5, "many", True],
    "recipe": ["soup", None],
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
    assert isinstance(error.value, BounderError | QueryError | IndicatorError)
    assert "\n" not in str(error.value)
    assert str(error.value).count("got") == 1


TOLD = {
    "hidden": (8,),
    "activation": "relu",
    "octaves": 2,
    "recipe": "paper",
    "k": 12,
    "leaves": 7,
    "steps": 3,
    "length": 0.5,
}
TAKEN = {
    ("aabb", "point"): set(),
    ("voxels", "point"): set(),
    ("kdop", "point"): {"k"},
    ("kdop", "ray"): {"k", "length"},
    ("learned-kdop", "plane"): {"k", "steps"},
    ("relu-field", "point"): {"steps"},
    ("bvh", "point"): {"leaves", "hidden"},
    ("mlp", "point"): {"hidden", "activation", "octaves", "recipe", "thresholds", "steps"},
    ("mlp", "plane"): {"hidden", "activation", "steps"},
    ("mlp-early", "point"): {"hidden", "activation", "octaves", "steps"},
    ("mlp-early", "ray"): {"hidden", "activation", "octaves", "recipe", "steps", "length"},
    ("monotone-mlp", "box"): {"hidden", "activation", "steps"},
    ("occupancy", "point"): {"hidden", "activation", "octaves", "steps"},
    ("kdop+mlp", "point"): {"k", "hidden", "activation", "octaves", "recipe", "thresholds", "steps"},
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
        told = {option: value}
        expected = BegunError if option in TAKEN[method, query] else BounderError
        with pytest.raises(expected) as error:
            wb.fit(shape("blob"), query, method, device="cpu", **told)
        if expected is BounderError:
            if option == "length":
                assert f"got {option}" in str(error.value)
            else:
                assert f"option {option!r}" in str(error.value)
                assert f"beside the arguments of fit, {method} takes " in str(error.value).lower()
                assert all(name in str(error.value) for name in TAKEN[method, query] - {"length"})


def test_volumes_around_numbers_of_queries_are_gone():
    with pytest.raises(BounderError, match="python -m paper table1"):
        wb.fit(shape("c"), "ray", "kdop", space="parametric")


TYPED_WRONG = {  # what was meant, and what the message says at its end
    ("kdop", "point", "marign"): ("margin", "Beside the arguments of fit, kdop takes k for point queries"),
    ("aabb", "ray", "lenght"): (
        "length",
        "Beside the arguments of fit, aabb takes no options of its own for ray queries",
    ),
    ("mlp", "point", "hiden"): ("hidden", None),
    ("mlp", "distance", "hiden"): ("hidden", None),
    ("aabb", "distance", "metrik"): ("metric", "Beside the arguments of fit, aabb takes metric for distances"),
    ("mlp", "distance", "bugdet"): ("budget", None),
}


@pytest.mark.parametrize(("method", "query", "typed"), TYPED_WRONG)
def test_a_name_that_is_typed_wrong_is_told_with_the_one_that_was_meant(method, query, typed):
    meant, end = TYPED_WRONG[method, query, typed]
    with pytest.raises(BounderError) as error:
        wb.fit(shape("blob"), query, method, device="cpu", **{typed: 2.0})
    assert str(error.value).startswith(
        f"there is no option {typed!r}; did you mean {meant!r}? Beside the arguments of fit"
    )
    assert end is None or str(error.value).endswith(end)


def test_so_are_those_of_a_hierarchy_and_of_a_bake(tmp_path):
    with pytest.raises(BounderError, match=r"did you mean 'levels'\? Beside the arguments of hierarchy, kdop takes k"):
        wb.hierarchy(shape("blob"), method="kdop", device="cpu", level=1)
    with pytest.raises(
        BounderError, match=r"did you mean 'samples'\? Beside the arguments of fit and bake, kdop takes k"
    ):
        wb.bake(tmp_path, tmp_path / "out", method="kdop", sample=1000)
    with pytest.raises(BounderError, match=r"there is no option 'overhead_n'; did you mean 'overhead_ns'"):
        wb.bake(tmp_path, tmp_path / "out", narrow_ns=50.0, overhead_n=1.0)


@pytest.mark.parametrize("hidden", [24, 24.0, None, "24", b"24"])
def test_hidden_are_the_widths_of_the_layers_and_no_number(hidden):
    for query, method in (("point", "mlp"), ("distance", "mlp"), ("point", "bvh"), ("box", "monotone-mlp")):
        with pytest.raises(BounderError) as error:
            wb.fit(shape("blob"), query, method, hidden=hidden, device="cpu")
        assert str(error.value) == f"hidden must be the widths of the layers, such as (24, 24), got {hidden!r}"


@pytest.mark.parametrize("networks", [24, (24, 24), "24-24", [None]])
def test_networks_of_a_choice_are_several_widths(networks, tmp_path):
    with pytest.raises(
        BounderError, match=r"networks must be widths of the hidden layers, one tuple for each|hidden must"
    ):
        wb.choose(shape("blob"), narrow_ns=50.0, networks=networks, device="cpu")
    with pytest.raises(
        BounderError, match=r"networks must be widths of the hidden layers, one tuple for each|hidden must"
    ):
        wb.bake(tmp_path, tmp_path / "out", narrow_ns=50.0, networks=networks)


def test_every_method_states_its_options_and_a_cascade_hands_each_part_its_own():
    from warp_bounding.bounders import METHODS
    from warp_bounding.bounders.bounder import settled

    for kind in METHODS.values():
        names = [option.name for option in kind.options]
        assert len(set(names)) == len(names)
        assert all(option.help for option in kind.options)
        assert all(option.default is None or option.check(option.default) == option.default for option in kind.options)
    told = settled([METHODS["kdop"], METHODS["mlp"]], "point", {"k": 14, "octaves": 2})
    assert told[0] == {"k": 14}
    own = {"hidden": (50, 50), "activation": "sin", "octaves": 2, "recipe": "default", "thresholds": 1}
    own |= {"certificate": "proven", "steps": None}
    assert told[1] == own
    assert settled([METHODS["bvh"]], "point", {"leaves": None}) == [{"leaves": None, "hidden": (50, 50)}]


@pytest.mark.parametrize("k", [0, 7, -1, 2.5, "many"])
def test_wrong_k(k):
    with pytest.raises(BounderError, match="kdop offers"):
        few(method="kdop", k=k)


@pytest.mark.parametrize("k", [None, 6, 12, 14, 18, 26])
def test_right_k(k):
    assert few(method="kdop", k=k).directions.shape == ((k or 12) // 2, 3)


@pytest.mark.parametrize(
    "source", ["nowhere.npy", None, 5, np.zeros((3, 3)), np.ones((3, 3)), np.zeros(0), np.array(["a"])], ids=str
)
def test_what_is_no_shape(source):
    with pytest.raises(IndicatorError):
        wb.fit(source, method="aabb")


def test_a_method_in_the_place_of_the_query_is_told():
    with pytest.raises(wb.QueryError, match="'mlp' is a method, which comes after the query: method='mlp'"):
        wb.fit(shape("blob"), "mlp")
