"""Bounders by *and* and *or* answer as these words say, on every path; they are proven part by part, and a lie is found out."""

import numpy as np
import pytest
import warp as wp
from asking import ask, check_compiles
from bounding_shapes import domain_points, fitted, object_points, shape

import warp_bounding as wb
from warp_bounding.bounders import compose
from warp_bounding.bounders.composition.composition import Composition
from warp_bounding.bounders.composition.cover import split_regions
from warp_bounding.errors import BounderError
from warp_bounding.indicators.clipped import part_of
from warp_bounding.kernels.functions import batch_kernel
from warp_bounding.kernels.source import DENIED, Lanes
from warp_bounding.proof import prove

FORMS = {
    "(a&b)|(c&d)": lambda a, b, c, d: (a & b) | (c & d),
    "a&(b|c)&d": lambda a, b, c, d: a & (b | c) & d,
    "(a|b)&(c|d)": lambda a, b, c, d: (a | b) & (c | d),
    "a|b|c|d": lambda a, b, c, d: a | b | c | d,
    "a&(b|(c&d))": lambda a, b, c, d: a & (b | (c & d)),
}
METHODS = ("aabb", "mlp", "kdop", "mlp-early")


def raised(method: str, name: str, share: float, x: np.ndarray) -> wb.Bounder:
    """A bounder that denies a share of some points, so that every part has something to do."""
    bounder = fitted(method, name)
    values = bounder.values(x).numpy()
    return bounder.to("cpu").freeze(float(np.quantile(values[np.isfinite(values)], share)), None)


@pytest.mark.parametrize("name", ["blob", pytest.param("animated", marks=pytest.mark.slow)])
@pytest.mark.parametrize("form", FORMS)
def test_answers_are_those_of_the_words(form, name, device, rng):
    x = domain_points(shape(name), 5000, rng)
    parts = [raised(method, name, 0.3 + 0.1 * i, x) for i, method in enumerate(METHODS)]
    whole = FORMS[form](*parts).to(device)
    assert isinstance(whole, Composition)
    near = [np.abs(p.values(x).numpy() - float(p.threshold)) <= 2 * p.rounding_bound() for p in parts]
    x = x[~np.any(near, axis=0)]  # kernels may differ within rounding of a threshold
    assert len(x) > 4000
    expected = FORMS[form](*(part.to(device).query(x).numpy().astype(bool) for part in parts))
    assert 0.05 < expected.mean() < 0.95
    assert (whole.query(x).numpy() == expected).all()
    assert (ask(whole, x) == expected).all()
    assert (whole.to(device, native=False).query(x).numpy() == expected).all()
    values = whole.values(x).numpy()
    assert (values[expected] >= 1.0).all()  # infinite where the time is outside the range
    assert (values[~expected] <= DENIED).all()
    for count in (1, 17, 300):  # the ends of blocks
        assert (whole.query(x[:count]).numpy() == expected[:count]).all()


@pytest.mark.parametrize("name", ["blob", "c"])
def test_a_split_sends_each_point_one_way(name, device, rng):
    x = domain_points(shape(name), 5000, rng)
    parts = [raised(method, name, 0.3 + 0.1 * i, x) for i, method in enumerate(METHODS)]
    tree = ["split", 0, 0.25, ["and", 0, ["split", 1, -0.5, 1, 2]], 3]
    whole = Composition.of(tree, parts).freeze(0.0, None).to(device)
    near = [np.abs(p.values(x).numpy() - float(p.threshold)) <= 2 * p.rounding_bound() for p in parts]
    v = whole.domain.to_local(x)
    near += [np.abs(v[:, 0] - 0.25) < 1e-5, np.abs(v[:, 1] + 0.5) < 1e-5]
    x, v = x[~np.any(near, axis=0)], v[~np.any(near, axis=0)]
    a, b, c, d = (part.to(device).query(x).numpy().astype(bool) for part in parts)
    expected = np.where(v[:, 0] < 0.25, a & np.where(v[:, 1] < -0.5, b, c), d)
    assert (whole.query(x).numpy() == expected).all()
    assert (ask(whole, x) == expected).all()
    assert (whole.to(device, native=False).query(x).numpy() == expected).all()
    low = rng.uniform(-1, 1, (500, v.shape[1]))
    high = low + 10 ** rng.uniform(-4, 0, (500, 1))
    bounds = whole.bound(low, high)
    for t in rng.random((20, 1, 1)):
        assert (whole.reference(low + t[0] * (high - low)) >= bounds.lower).all()


def test_halves_of_a_split_must_hold_what_may_come_to_them():
    ball = wb.solids.Sphere((0.2, 0.1, 0.0), 0.7)
    domain, place = fitted_ball(ball).domain, 0.125
    below, above = split_regions(domain, 0, place)
    assert below[1][0] > above[0][0]  # they overlap by what may be rounded
    for room, covers in ((0.0, True), (1e-6, False)):
        regions = [(below[0], below[1] - [room, 0, 0]), above]
        parts = []
        for region in regions:
            own = part_of(ball, np.float32(region).astype(np.float64))
            parts.append(wb.METHODS["aabb"].fit(own, domain, device="cpu"))
            prove(parts[-1], own, eps=1e-2, boxes=50_000)
        if covers:
            whole = compose(["split", 0, place, 0, 1], parts, regions, ball)
            assert whole.certificate.proven
            assert wb.certify(whole, ball).proven
        else:
            with pytest.raises(BounderError, match="do not cover"):
                compose(["split", 0, place, 0, 1], parts, regions, ball)


@pytest.mark.parametrize("form", FORMS)
def test_what_is_proven_of_the_parts_is_proven_of_all(form, tmp_path, rng):
    grid, whole = shape("blob"), FORMS[form](*(fitted(method, "blob") for method in METHODS))
    assert whole.certificate.proven
    inside = object_points(grid, rng)
    assert whole.query(inside).numpy().all()
    assert ask(whole, inside).all()
    whole.save(tmp_path / "c.safetensors")
    again = wb.load(tmp_path / "c.safetensors", device="cpu")
    assert again.certificate == whole.certificate
    x = domain_points(grid, 3000, rng)
    assert (again.query(x).numpy() == whole.query(x).numpy()).all()
    assert wb.certify(again, grid).proven
    assert wb.evaluate(again, grid, samples=20_000).fn == 0


def test_bounds_hold_over_boxes_of_any_size(rng):
    parts = [fitted(method, "blob") for method in METHODS]
    whole = (parts[0] & parts[1]) | parts[2]
    low = rng.uniform(-1, 1, (500, 3))
    high = low + 10 ** rng.uniform(-4, 0, (500, 1))
    bounds = whole.bound(low, high)
    assert (bounds.lower > 0).any()
    for t in rng.random((20, 1, 1)):
        assert (whole.reference(low + t[0] * (high - low)) >= bounds.lower).all()


def in_two(ball: wb.solids.Sphere, cut: float, first_end: float | None = None) -> tuple[list, list, list]:
    """Two boxes around both halves of a ball: tree, parts and regions; the first may end before the cut."""
    ends = np.float32(cut if first_end is None else first_end), np.float32(cut)
    regions = [([-np.inf] * 3, [ends[0], np.inf, np.inf]), ([ends[1], -np.inf, -np.inf], [np.inf] * 3)]
    domain, parts = fitted_ball(ball).domain, []
    for region in regions:
        own = part_of(ball, np.array(region))
        parts.append(wb.METHODS["aabb"].fit(own, domain, device="cpu"))
        prove(parts[-1], own, eps=1e-2, boxes=50_000)
    return ["or", 0, 1], parts, regions


def fitted_ball(ball: wb.solids.Sphere) -> wb.Bounder:
    return wb.fit(ball, method="aabb", device="cpu", progress=False)


def test_parts_of_an_object_hold_all_of_it_together(rng):
    ball = wb.solids.Sphere((0.2, 0.1, 0.0), 0.7)
    whole = compose(*in_two(ball, 0.25), ball)
    assert whole.certificate.proven
    assert wb.certify(whole, ball).proven
    x = rng.uniform(-1, 1, (20_000, 3)).astype(np.float32)
    assert whole.query(x[ball.contains(x)]).numpy().all()
    part = whole.parts[0]
    assert not part.query(x[ball.contains(x)]).numpy().all()
    assert wb.certify(part.freeze(part.threshold, None), ball).kind == "refuted"


def test_parts_that_do_not_cover_the_object_are_refused_with_a_point():
    ball = wb.solids.Sphere((0.2, 0.1, 0.0), 0.7)
    tree, parts, regions = in_two(ball, 0.25, first_end=0.2)
    with pytest.raises(BounderError, match=r"do not cover the object, which is at \(0\.2"):
        compose(tree, parts, regions, ball)
    whole = Composition.of(tree, parts, regions).freeze(0.0, None)
    certificate = wb.certify(whole, ball)
    assert certificate.kind == "undecided"
    assert "do not cover" in certificate.message


def test_both_must_hold_a_part_that_stands_under_and():
    ball = wb.solids.Sphere((0.2, 0.1, 0.0), 0.7)
    _, parts, regions = in_two(ball, 0.25)
    with pytest.raises(BounderError, match="do not cover"):
        compose(["and", 0, 1], parts, regions, ball)


def test_a_part_that_denies_a_part_of_the_object_is_found_out(rng):
    x = object_points(shape("blob"), rng)
    wrong = raised("kdop", "blob", 0.5, x)
    whole = (wrong & fitted("mlp", "blob")) | wrong
    assert whole.certificate is None
    certificate = wb.certify(whole, shape("blob"))
    assert certificate.kind == "refuted"


def test_a_hierarchy_is_proven_and_tighter_than_its_boxes(tmp_path, rng):
    ball = wb.solids.Torus((0.0, 0.0, 0.0), 0.7, 0.2)
    tree = wb.hierarchy(ball, method="kdop", levels=3, device="cpu", progress=False)
    assert tree.certificate.proven
    tree.save(tmp_path / "t.safetensors")
    again = wb.load(tmp_path / "t.safetensors", device="cpu")
    assert wb.certify(again, ball).proven
    rates, single = wb.evaluate(again, ball, 50_000), wb.evaluate(fitted_ball(ball), ball, 50_000)
    assert rates.fn == 0
    assert rates.fp_rate < 0.8 * single.fp_rate
    x = rng.uniform(-1, 1, (20_000, 3)).astype(np.float32)
    assert again.query(x[ball.contains(x)]).numpy().all()


def test_a_hierarchy_of_cells_is_cut_through_them():
    cells = np.zeros((24, 24), dtype=bool)
    cells[2:11, 3:9], cells[13:22, 12:23] = True, True
    tree = wb.hierarchy(wb.IndicatorGrid(cells), method="kdop", levels=2, device="cpu", progress=False)
    cuts, found = [tree.tree], []
    while cuts:
        node = cuts.pop()
        if len(node) == 5:  # the axis and the place, in v, of a split, and its halves
            axis, place = node[1:3]
            x = place / float(tree.domain.scale[axis]) + float(tree.domain.center[axis])
            found.append(23 * x)
            cuts += node[3:]
    assert len(found) == 3
    assert np.abs(np.array(found) - np.rint(found)).max() < 1e-3
    assert tree.certificate.proven


def test_a_union_of_learned_half_spaces_is_proven_and_tighter_than_one():
    ring = wb.solids.Sphere((0.0, 0.0), 0.9) - wb.solids.Sphere((0.0, 0.0), 0.6)
    told = {"method": "learned-kdop", "steps": 60, "device": "cpu", "progress": False}
    tree, single = wb.hierarchy(ring, leaves=5, **told), wb.fit(ring, **told)
    assert [part.method for part in tree.parts] == ["aabb", "learned-kdop"] * 5
    assert tree.certificate.proven
    assert wb.certify(tree, ring).proven
    rates, alone = wb.evaluate(tree, ring, 50_000), wb.evaluate(single, ring, 50_000)
    assert rates.fn == 0
    assert rates.fp_rate < 0.6 * alone.fp_rate


@pytest.mark.parametrize("thresholds", [1, 9])
def test_a_hierarchy_of_networks_is_proven(thresholds):
    ball = wb.solids.Sphere((0.2, 0.1), 0.7)
    told = {"levels": 1, "hidden": (8,), "steps": 100, "thresholds": thresholds}
    tree = wb.hierarchy(ball, **told, device="cpu", progress=False)
    assert {part.method for part in tree.parts} == {"aabb", "local" if thresholds > 1 else "mlp"}
    assert tree.certificate.proven
    assert wb.certify(tree, ball).proven
    assert wb.evaluate(tree, ball, 50_000).fn == 0


@pytest.mark.parametrize(
    ("told", "message"),
    [
        ({"query": "ray"}, "point queries"),
        ({"levels": 0}, "levels"),
        ({"levels": 2.0}, "levels"),
        ({"levels": 20}, "levels"),
        ({"method": "voxels"}, "cannot be a leaf"),
        ({"method": "occupancy"}, "cannot be a leaf"),
        ({"method": "mlb"}, "method must be one of"),
        ({"budget": -1.0}, "budget"),
        ({"budget": None}, "budget"),
        ({"seed": -1}, "seed"),
        ({"margin": float("nan")}, "margin"),
        ({"leaves": 1}, "leaves"),
        ({"leaves": 3.0}, "leaves"),
        ({"leaves": 257}, "leaves"),
        ({"levels": 1, "k": 8}, "takes"),
    ],
)
def test_what_a_hierarchy_refuses(told, message):
    with pytest.raises(wb.BoundingError, match=message):
        wb.hierarchy(wb.solids.Sphere((0.0, 0.0), 1.0), **told, device="cpu", progress=False)


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


def test_several_parts_may_have_bit_fields(tmp_path, device, rng):
    x, box = domain_points(shape("blob"), 5000, rng), fitted("aabb", "blob")
    first = fitted("voxels", "blob")
    parts = [lost_bits(first, 2, rng), raised("kdop", "blob", 0.4, x), lost_bits(first, 5, rng), first]
    a, b, c, d = (part.query(x).numpy() for part in parts)
    assert len({v.tobytes() for v in (a, b, c, d)}) == 4
    whole, expected = ((parts[0] & box) | (parts[1] & parts[2])) & parts[3], (a | (b & c)) & d
    assert 0 < expected.sum() < d.sum()
    whole.save(tmp_path / "c.safetensors")
    for each in (whole, wb.load(tmp_path / "c.safetensors", device=device), whole.to(device, native=False)):
        assert (each.query(x).numpy() == expected).all()
    assert (ask(whole.to(device), x) == expected).all()
    assert wb.certify(whole, shape("blob")).kind == "refuted"
    honest = (first & box) | (first & fitted("mlp", "blob"))
    assert honest.certificate.proven
    assert wb.certify(honest, shape("blob")).proven


def lost_bits(bounder: wb.Bounder, every: int, rng: np.random.Generator) -> wb.Bounder:
    """A bit field of which some words are lost, so that it denies some of the object."""
    bits = bounder.tensors["bits"] * (rng.integers(every, size=len(bounder.tensors["bits"])) > 0).astype(np.uint32)
    changed = type(bounder)(bounder.domain, bounder.tensors | {"bits": bits}, bounder.sizes, "cpu")
    changed.info = bounder.info
    return changed.freeze(bounder.threshold, None)


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


def test_exits_of_a_part_are_proven_too():
    grid = shape("c")
    early = wb.fit(grid, "plane", "mlp-early", hidden=(6, 5), steps=3, device="cpu", progress=False)
    exits = early.tensors | {"exits.thresholds": np.float32([1e5])}
    lying = type(early)(early.domain, exits, early.sizes, "cpu").freeze(early.threshold, None)
    whole = Composition.of(["or", 0], [lying]).freeze(0.0, None)
    whole.info = early.info
    assert wb.certify(whole, grid).kind == "refuted"
    honest = Composition.of(["or", 0], [early]).freeze(0.0, None)
    honest.info = early.info
    assert wb.certify(honest, grid).proven


def test_hierarchies_can_be_put_together_and_are_no_part_of_a_cascade(rng):
    ball = wb.solids.Sphere((0.2, 0.1), 0.7)
    tree, box = wb.hierarchy(ball, method="kdop", levels=2, device="cpu", progress=False), fitted_ball(ball)
    x = rng.uniform(-1, 1, (5000, 2)).astype(np.float32)
    a, b = tree.query(x).numpy(), box.query(x).numpy()
    for whole, expected in ((tree | box, a | b), (box & tree, a & b), (box | tree, a | b)):
        assert (whole.query(x).numpy() == expected).all()
        assert whole.certificate.proven
        assert wb.certify(whole, ball).proven
    for parts in ((box, tree), (tree, box)):
        with pytest.raises(BounderError, match="no part of a cascade"):
            wb.cascade(*parts)


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


def test_a_composition_is_asked_about_lanes_by_a_way_of_its_own():
    whole = fitted("aabb", "blob") | fitted("kdop", "blob")
    with pytest.raises(TypeError, match="ask"):
        whole.source.body(Lanes(vector=True))


def test_cuda_source_compiles(tmp_path):
    if not hasattr(wp, "compile_aot_module"):
        pytest.skip("this Warp cannot compile ahead of time")
    whole = (fitted("aabb", "blob") & fitted("mlp", "blob")) | fitted("kdop", "blob")
    check_compiles(batch_kernel(whole.source, False, False), tmp_path)
