"""What cannot be put together by *and* and *or*, or is no composition, is refused in one line."""

import pytest
from bounding_shapes import fitted, in_two, shape

import warp_bounding as wb
from warp_bounding.bounders import compose
from warp_bounding.bounders.composition.composition import Composition
from warp_bounding.errors import BounderError
from warp_bounding.proof import prove


def test_what_cannot_be_put_together():
    a, other = fitted("aabb", "blob"), fitted("aabb", "c")
    with pytest.raises(BounderError, match="same"):
        a | other
    with pytest.raises(BounderError, match="not conservative"):
        a | fitted("occupancy", "blob")
    with pytest.raises(TypeError):
        a | 3


@pytest.mark.parametrize(
    ("told", "message"),
    [
        ({"query": "box"}, "same queries and domain"),
        ({"query": "ray", "length": 0.5}, "same queries and domain"),
        ({"query": "ray", "length": 1.0}, "same queries and domain"),
        ({"margin": 0.05}, "of the same"),
        ({"name": "c"}, "of the same"),  # of another dimension
    ],
)
def test_parts_of_another_query_length_margin_or_dimension_are_refused(told, message):
    told = dict(told)
    other = wb.fit(shape(told.pop("name", "blob")), method="aabb", device="cpu", progress=False, **told)
    like = {"query": "ray", "length": 2.0} if "length" in told else {}
    own = wb.fit(shape("blob"), method="aabb", device="cpu", progress=False, **like)
    for join in (lambda: own | other, lambda: own & other, lambda: (own | own) & other):
        with pytest.raises(BounderError, match=message) as raised:
            join()
        assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    "tree",
    [
        ["or", 0, 0],
        ["or", 1, 0],
        ["or", 0],
        ["xor", 0, 1],
        ["or", 0, [1]],
        "or",
        0,
        ["or", 0, 2],
        ["or", 0, True],
        ["split", 0, 0.5, 0],
        ["split", 3, 0.5, 0, 1],
        ["split", 0, 0.0, 0, 1],
        ["split", 0, 0.1, 0, 1],
        ["split", "x", 0.5, 0, 1],
    ],
)
def test_trees_that_are_none_are_refused(tree):
    whole = fitted("aabb", "blob") | fitted("kdop", "blob")
    with pytest.raises(BounderError, match="expected a tree"):
        Composition(whole.domain, whole.tensors, whole.sizes | {"tree": tree}, "cpu")


def test_a_composition_has_no_threshold_of_its_own():
    whole = fitted("aabb", "blob") | fitted("kdop", "blob")
    with pytest.raises(BounderError, match="its parts have thresholds"):
        whole.freeze(2.0, None)


def test_each_part_needs_a_certificate_for_its_own_region():
    ball = wb.solids.Sphere((0.2, 0.1, 0.0), 0.7)
    tree, parts, regions = in_two(ball, 0.25)
    with pytest.raises(BounderError, match="part 0 has no certificate for its region"):
        compose(tree, parts[::-1], regions, ball)


def test_certificates_of_different_margins_are_not_joined():
    ball = wb.solids.Sphere((0.2, 0.1), 0.7)
    wide = ball.dilated(0.5)
    domain, parts = wb.fit(ball, method="aabb", margin=0.5, device="cpu", progress=False).domain, []
    for own in (ball, wide):
        parts.append(wb.METHODS["aabb"].fit(own, domain, device="cpu"))
        prove(parts[-1], own, eps=1e-2)
    for join in (lambda: parts[0] | parts[1], lambda: wb.cascade(*parts)):
        with pytest.raises(BounderError, match="margin"):
            join()
    with pytest.raises(BounderError, match="part 0 has no certificate"):
        compose(["and", 0, 1], parts, [None, None], wide)


def test_regions_upside_down_are_refused():
    whole = fitted("aabb", "blob") | fitted("kdop", "blob")
    turned = {"regions": whole.tensors["regions"][:, ::-1].copy()}
    with pytest.raises(BounderError, match="lower corner"):
        Composition(whole.domain, whole.tensors | turned, whole.sizes, "cpu")


def test_a_composition_cannot_hold_itself():
    whole = fitted("aabb", "blob") | fitted("kdop", "blob")
    sizes = whole.sizes | {"parts": [{"method": "composition", "sizes": whole.sizes}, *whole.sizes["parts"][1:]]}
    with pytest.raises(BounderError, match="no bounder that can be a part"):
        Composition(whole.domain, whole.tensors, sizes, "cpu")
