"""Bounders by *and* and *or* answer as these words say, on every path; they are proven part by part, and a lie is found out."""

import numpy as np
import pytest
import warp as wp
from asking import ask, check_compiles
from bounding_shapes import domain_points, fitted, fitted_ball, in_two, object_points, shape

import warp_bounding as wb
from warp_bounding.bounders import compose
from warp_bounding.bounders.composition.composition import Composition
from warp_bounding.bounders.composition.cover import split_regions
from warp_bounding.errors import BounderError
from warp_bounding.indicators.parts.clipped import part_of
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


def test_a_composition_is_asked_about_lanes_by_a_way_of_its_own():
    whole = fitted("aabb", "blob") | fitted("kdop", "blob")
    with pytest.raises(TypeError, match="ask"):
        whole.source.body(Lanes(vector=True))


def test_cuda_source_compiles(tmp_path):
    if not hasattr(wp, "compile_aot_module"):
        pytest.skip("this Warp cannot compile ahead of time")
    whole = (fitted("aabb", "blob") & fitted("mlp", "blob")) | fitted("kdop", "blob")
    check_compiles(batch_kernel(whole.source, False, False), tmp_path)
