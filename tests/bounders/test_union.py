"""Unions answer as any of their parts does, on every path; they are proven part by part, and a lie is found out."""

from functools import cache

import numpy as np
import pytest
import warp as wp
from asking import ask, check_compiles
from bounding_shapes import domain_points, fitted, fitted_ball, object_points, shape
from rewriting import rewrite

import warp_bounding as wb
from warp_bounding.bounders import Union, united
from warp_bounding.bounders.cascade import Cascade
from warp_bounding.errors import BounderError, FileFormatError, IndicatorError
from warp_bounding.indicators.parts import part_of
from warp_bounding.indicators.shape import Pieces
from warp_bounding.kernels.functions import batch_kernel
from warp_bounding.kernels.source import DENIED, Lanes
from warp_bounding.proof import prove

METHODS = ("aabb", "mlp", "kdop", "mlp-early")
STEPS, COUNT = 400, 60_000
BALL = wb.solids.Sphere((0.2, 0.1, 0.0), 0.7)


def raised(method: str, name: str, share: float, x: np.ndarray) -> wb.Bounder:
    """A bounder that denies a share of some points, so that every part has something to do."""
    bounder = fitted(method, name)
    values = bounder.values(x).numpy()
    return bounder.to("cpu").freeze(float(np.quantile(values[np.isfinite(values)], share)), None)


def in_two(cut: float, first_end: float | None = None) -> tuple[list, list]:
    """Two boxes around both halves of a ball: parts and regions; the first may end before the cut."""
    ends = np.float32(cut if first_end is None else first_end), np.float32(cut)
    regions = [([-np.inf] * 3, [ends[0], np.inf, np.inf]), ([ends[1], -np.inf, -np.inf], [np.inf] * 3)]
    domain, parts = fitted_ball(BALL).domain, []
    for region in regions:
        own = part_of(BALL, np.array(region))
        parts.append(wb.METHODS["aabb"].fit(own, domain, device="cpu"))
        prove(parts[-1], own, eps=1e-2, boxes=50_000)
    return parts, [tuple(map(np.array, region)) for region in regions]


@pytest.mark.parametrize("name", ["blob", pytest.param("animated", marks=pytest.mark.slow)])
def test_answers_are_those_of_the_parts(name, device, rng):
    x = domain_points(shape(name), 5000, rng)
    parts = [raised(method, name, 0.6 + 0.1 * i, x) for i, method in enumerate(METHODS)]
    parts.append(Cascade.of([raised("aabb", name, 0.3, x), raised("mlp", name, 0.5, x)]))
    whole = Union.of(parts).freeze(0.0, None).to(device)
    near = [np.abs(p.values(x).numpy() - float(p.threshold)) <= 2 * p.rounding_bound() for p in parts[:4]]
    near += [np.abs(p.values(x).numpy() - float(p.threshold)) <= 2 * p.rounding_bound() for p in parts[4].parts]
    x = x[~np.any(near, axis=0)]  # kernels may differ within rounding of a threshold
    assert len(x) > 4000
    expected = np.any([part.to(device).query(x).numpy() for part in parts], axis=0)
    assert 0.05 < expected.mean() < 0.95
    assert (whole.query(x).numpy() == expected).all()
    assert (ask(whole, x) == expected).all()
    values = whole.values(x).numpy()
    assert (values[expected] >= 1.0).all()  # infinite where the time is outside the range
    assert (values[~expected] <= DENIED).all()
    for count in (1, 17, 300):  # the ends of blocks
        assert (whole.query(x[:count]).numpy() == expected[:count]).all()
    low = rng.uniform(-1, 1, (500, whole.ndim))
    high = low + 10 ** rng.uniform(-4, 0, (500, 1))
    bounds = whole.bound(low, high)
    for t in rng.random((20, 1, 1)):
        assert (whole.reference(low + t[0] * (high - low)) >= bounds.lower).all()


def test_what_is_proven_of_the_parts_is_proven_of_all(tmp_path, rng):
    grid, whole = shape("blob"), wb.union(*(fitted(method, "blob") for method in METHODS))
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
    assert wb.union(whole, fitted("obb", "blob")).certificate.proven  # parts of a union are parts of the next


def test_parts_in_regions_hold_all_of_it_together(tmp_path, rng):
    whole = united(*in_two(0.25), BALL)
    whole.save(tmp_path / "w.safetensors")
    for each in (whole, wb.load(tmp_path / "w.safetensors", device="cpu")):
        assert each.certificate.proven
        assert wb.certify(each, BALL).proven
        x = rng.uniform(-1, 1, (20_000, 3)).astype(np.float32)
        assert each.query(x[BALL.contains(x)]).numpy().all()
    part = whole.parts[0]
    assert not part.query(x[BALL.contains(x)]).numpy().all()
    assert wb.certify(part.freeze(part.threshold, None), BALL).kind == "refuted"


def test_regions_that_do_not_cover_the_object_are_refused_with_a_point():
    parts, regions = in_two(0.25, first_end=0.2)
    with pytest.raises(BounderError, match=r"do not cover the object, which is at \(0\.2"):
        united(parts, regions, BALL)
    certificate = wb.certify(Union.of(parts, regions).freeze(0.0, None), BALL)
    assert certificate.kind == "undecided"
    assert "do not cover" in certificate.message
    parts, regions = in_two(0.25)
    with pytest.raises(BounderError, match="part 0 has no certificate for its region"):
        united(parts[::-1], regions, BALL)


@pytest.mark.parametrize(
    "region",
    [[[1.0] * 3, [0.0] * 3], [[0.0] * 2, [1.0] * 2], [[0.0] * 3], "box", [[0.1] * 3, [1.0] * 3], [["x"] * 3] * 2],
)
def test_regions_that_are_none_are_refused(region):
    whole = united(*in_two(0.25), BALL)
    entries = [whole.sizes["parts"][0] | {"region": region}, whole.sizes["parts"][1]]
    with pytest.raises(BounderError, match="corners of a box"):
        Union(whole.domain, whole.tensors, {"parts": entries}, "cpu")


def test_a_root_and_any_child(device, tmp_path, rng):
    x = domain_points(shape("blob"), 5000, rng)
    parts = [raised(method, "blob", 0.5 + 0.1 * i, x) for i, method in enumerate(METHODS[:3])]
    root, children = parts[0], Union.of(parts[1:]).freeze(0.0, None)
    expected = root.query(x).numpy() & children.query(x).numpy()
    assert 0.05 < expected.mean() < 0.95
    whole = Cascade.of([root, children]).to(device)
    assert (whole.query(x).numpy() == expected).all()
    assert (ask(whole, x) == expected).mean() > 0.999
    assert ((whole.values(x).numpy() >= 0) == expected).all()
    whole.info = fitted("mlp", "blob").info
    assert wb.certify(whole, shape("blob")).kind == "refuted"
    honest = wb.cascade(fitted("mlp", "blob"), wb.union(fitted("kdop", "blob"), fitted("mlp-early", "blob")))
    assert honest.certificate.proven
    honest.save(tmp_path / "c.safetensors")
    again = wb.load(tmp_path / "c.safetensors", device="cpu")
    assert wb.certify(again, shape("blob")).proven
    assert again.query(object_points(shape("blob"), rng)).numpy().all()


def test_a_part_that_denies_a_part_of_the_object_is_found_out(rng):
    x = object_points(shape("blob"), rng)
    whole = Union.of([raised("kdop", "blob", 0.5, x), fitted("mlp", "blob")])
    whole.info = fitted("mlp", "blob").info
    assert wb.certify(whole.freeze(0.0, None), shape("blob")).kind == "refuted"


def test_several_parts_may_have_bit_fields(tmp_path, device, rng):
    x, first = domain_points(shape("blob"), 5000, rng), fitted("voxels", "blob")
    parts = [lost_bits(first, every, rng) for every in (2, 3)]
    whole = Union.of([raised("kdop", "blob", 0.7, x), *parts]).freeze(0.0, None)
    whole.info = first.info
    expected = np.any([part.query(x).numpy() for part in whole.parts], axis=0)
    whole.save(tmp_path / "c.safetensors")
    for each in (whole, wb.load(tmp_path / "c.safetensors", device=device)):
        assert (each.query(x).numpy() == expected).all()
    assert (ask(whole.to(device), x) == expected).all()
    assert wb.certify(whole, shape("blob")).kind == "refuted"


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
    for part, kind in ((lying, "refuted"), (early, "proven")):
        whole = Union.of([part]).freeze(0.0, None)
        whole.info = early.info
        assert wb.certify(whole, grid).kind == kind


@pytest.mark.parametrize(
    ("told", "message"),
    [
        ({"query": "box"}, "same queries and domain"),
        ({"query": "ray", "length": 0.5}, "same queries and domain"),
        ({"margin": 0.05}, "of the same"),
        ({"name": "c"}, "of the same"),  # of another dimension
    ],
)
def test_parts_of_another_query_length_margin_or_dimension_are_refused(told, message):
    told = dict(told)
    other = wb.fit(shape(told.pop("name", "blob")), method="aabb", device="cpu", progress=False, **told)
    like = {"query": "ray", "length": 2.0} if "length" in told else {}
    own = wb.fit(shape("blob"), method="aabb", device="cpu", progress=False, **like)
    with pytest.raises(BounderError, match=message) as refused:
        wb.union(own, other)
    assert "\n" not in str(refused.value)


def test_what_cannot_be_put_together():
    a, whole = fitted("aabb", "blob"), wb.union(fitted("aabb", "blob"), fitted("kdop", "blob"))
    for parts, message in (
        ((a,), "at least 2"),
        ((a, 3), "got int"),
        ((a, fitted("occupancy", "blob")), "not conserv"),
    ):
        with pytest.raises(BounderError, match=message):
            wb.union(*parts)
    with pytest.raises(BounderError, match="its parts have thresholds"):
        whole.freeze(2.0, None)
    with pytest.raises(BounderError, match="only the last part may have"):
        wb.cascade(whole, a)
    sizes = {"parts": [{"method": "union", "sizes": whole.sizes}, *whole.sizes["parts"][1:]]}
    with pytest.raises(BounderError, match="no bounder that can be a part"):
        Union(whole.domain, whole.tensors, sizes, "cpu")
    with pytest.raises(TypeError, match="ask"):
        whole.source.body(Lanes(vector=True))


def test_cuda_source_compiles(tmp_path):
    if not hasattr(wp, "compile_aot_module"):
        pytest.skip("this Warp cannot compile ahead of time")
    whole = Union.of([Cascade.of([fitted("aabb", "blob"), fitted("mlp", "blob")]), fitted("kdop", "blob")])
    check_compiles(batch_kernel(whole.source, False, False), tmp_path)


# --- pieces of a shape, each in its own, smaller dimension ---------------------------------------------------------------


@cache
def arm() -> wb.arms.ArmConfigurations:
    """A planar arm of three joints among posts, that may touch itself."""
    step = np.eye(4)
    step[0, 3] = 0.5
    joints = [wb.arms.Joint(step if i else np.eye(4), lower=-2.5, upper=2.5) for i in range(3)]
    links = [wb.arms.Body.capsule([0, 0, 0], [0.5, 0, 0], 0.1, link=i) for i in range(3)]
    posts = [wb.arms.Body.sphere(place, 0.2) for place in ([0.6, 0.7, 0], [-0.7, 0.6, 0], [0.4, -1.0, 0])]
    own = wb.arms.Arm(joints, links)
    return wb.arms.ArmConfigurations(own, posts, self_collision=True, weights=own.reaching)


@cache
def of_piece(held: tuple[int, ...], method: str = "mlp") -> wb.Bounder:
    options = {"hidden": (8, 8), "steps": STEPS} if method == "mlp" else {}
    return wb.fit(arm().piece(held), method=method, device="cpu", progress=False, **options)


def asked(count: int = COUNT) -> np.ndarray:
    own = arm()
    return np.random.default_rng(1).uniform(own.lower - 0.1, own.upper + 0.1, (count, own.ndim)).astype(np.float32)


def maybe(bounder, x) -> np.ndarray:
    return bounder.query(x).numpy() == 1


def test_pieces_are_the_whole(rng):
    own = arm()
    x = rng.uniform(own.lower, own.upper, (20_000, 3))
    pieces = [own.piece([i]) for i in (1, 2)]
    assert [piece.ndim for piece in pieces] == [2, 3]
    found = [piece.contains(x[:, : piece.ndim]) for piece in pieces]
    assert (np.any(found, axis=0) == own.contains(x)).all()
    assert all((each & ~own.contains(x)).sum() == 0 and each.any() for each in found)
    both = own.piece([0, 1])
    assert (both.contains(x[:, :2]) == found[0]).all()  # link 0 meets nothing
    assert own.piece([0, 1, 2]) is own
    assert own.piece([2, 1]).piece([1]).digest == pieces[0].digest
    assert len({each.digest for each in (own, both, *pieces)}) == 4
    lower = x[:4000]
    upper = lower + rng.uniform(0, 0.3, lower.shape)
    free = np.all([piece.empty(lower[:, : piece.ndim], upper[:, : piece.ndim]) for piece in pieces], axis=0)
    assert (free == own.empty(lower, upper)).mean() > 0.99


def test_links_that_touch_each_other_belong_to_the_later_one():
    alone = wb.arms.ArmConfigurations(arm().arm)
    folded = np.array([[0.0, 2.5, 2.5]])
    assert alone.contains(folded)
    assert alone.piece([2]).contains(folded)
    with pytest.raises(IndicatorError, match="nothing that could touch"):
        alone.piece([1])


@pytest.mark.parametrize("held", [[], [3], [-1], [0.0], [True], ["0"]])
def test_numbers_of_no_pieces(held):
    with pytest.raises(IndicatorError, match="expected some of the pieces 0 to 2"):
        arm().piece(held)
    with pytest.raises(IndicatorError, match="it has no pieces"):
        wb.load_indicator(np.pad(np.ones((4, 4), bool), 2)).piece(held)
    with pytest.raises(IndicatorError, match="has no links"):
        arm().piece([1]).piece([2])


@pytest.mark.parametrize("methods", [("mlp", "mlp"), ("mlp", "learned-kdop"), ("aabb", "sphere")])
def test_bounders_of_pieces_together(methods, tmp_path):
    one, other, x = of_piece((0, 1), methods[0]), of_piece((2,), methods[1]), asked()
    assert (one.ndim, other.ndim) == (2, 3)
    for whole in (wb.union(one, other), wb.union(other, one))[: 2 if methods == ("mlp", "mlp") else 1]:
        assert whole.ndim == 3
        assert whole.certificate.proven
        assert whole.certificate.indicator == arm().digest
        assert whole.info["pieces"] is None
        found = maybe(whole, x)
        assert not (arm().contains(x) & ~found).any()
        within = (np.abs(whole.domain.to_local(x)) <= whole.domain.limit * (1 - 1e-6)).all(axis=1)
        want = maybe(one, x[:, :2].copy()) | maybe(other, x)
        assert (found[within] == want[within]).mean() > 0.9999  # but for rounding
        assert (ask(whole, x[:5000]).astype(bool) == found[:5000]).mean() > 0.9999
        assert wb.certify(whole, arm(), seconds=120).proven
        whole.save(tmp_path / "whole.safetensors")
        again = wb.load(tmp_path / "whole.safetensors", device="cpu")
        assert (maybe(again, x) == found).all()
        assert again.certificate == whole.certificate
        assert wb.evaluate(again, arm(), samples=20_000).fn == 0


def test_whole_segments(rng):
    whole, own = wb.union(of_piece((0, 1)), of_piece((2,))), arm()
    starts, ends = (rng.uniform(own.lower, own.upper, (4000, 3)).astype(np.float32) for _ in range(2))
    ends = starts + np.float32(0.05) * (ends - starts)
    clear = wb.clear_segments(whole, starts, ends)
    assert clear.mean() > 0.01
    for t in np.linspace(0, 1, 33):
        assert not own.contains((1 - t) * starts[clear].astype(np.float64) + t * ends[clear]).any()


def test_some_pieces_are_not_the_whole(tmp_path):
    part = of_piece((2,))
    part.save(tmp_path / "part.safetensors")
    again = wb.load(tmp_path / "part.safetensors", device="cpu")
    assert again.info["pieces"] == {"whole": arm().digest, "count": 3, "held": [2]}
    assert wb.certify(again, arm().piece([2]), seconds=120).proven
    assert wb.certify(of_piece((0, 1)), arm(), seconds=20).kind == "inapplicable"
    some = wb.union(of_piece((1,)), of_piece((2,)))  # link 0 could touch nothing, but nobody has shown that
    assert Pieces.from_dict(some.info["pieces"]).held == (1, 2)
    assert some.certificate.indicator == arm().piece([1, 2]).digest
    found = wb.certify(some, arm(), seconds=20)
    assert found.kind == "undecided"
    assert "no part holds the pieces [0]" in found.message
    assert wb.certify(some, arm().piece([1, 2]), seconds=120).proven
    whole = wb.union(some, of_piece((0, 1)))
    assert whole.info["pieces"] is None
    assert wb.certify(whole, arm(), seconds=120).proven


def test_pieces_that_do_not_go_together():
    other = wb.arms.ArmConfigurations(arm().arm, arm().obstacles[:2], weights=arm().weights)
    foreign = wb.fit(other.piece([0, 1]), method="aabb", device="cpu", progress=False)
    with pytest.raises(BounderError, match="pieces of the same shape"):
        wb.union(foreign, of_piece((2,)))
    with pytest.raises(BounderError, match="same queries and domain"):
        wb.cascade(of_piece((0, 1)), of_piece((2,)))
    with pytest.raises(BounderError, match="same object"):
        wb.union(of_piece((0, 1)), wb.fit(arm(), method="aabb", device="cpu", progress=False))


def test_a_file_that_lies_about_pieces(tmp_path):
    """A part that is said to hold what it was not fitted to is found out, whatever the digests say."""
    whole, file = wb.union(of_piece((0, 1)), of_piece((2,))), tmp_path / "w.safetensors"
    whole.save(file)

    def lie(document):
        document["sizes"]["parts"][0]["pieces"], document["sizes"]["parts"][1]["pieces"] = [0], [1, 2]

    rewrite(file, lie)
    assert not wb.certify(wb.load(file, device="cpu"), arm(), seconds=20).proven

    def nothing(document):
        del document["sizes"]["parts"][0]["pieces"]

    rewrite(file, nothing)
    with pytest.raises(FileFormatError, match="that holds no pieces"):
        wb.load(file, device="cpu")

    def none(document):
        document["sizes"]["parts"][0]["pieces"] = ["x"]

    rewrite(file, none)
    with pytest.raises(FileFormatError, match="expected numbers of pieces"):
        wb.load(file, device="cpu")


def test_a_part_in_other_coordinates_is_refused(tmp_path):
    whole, file = wb.union(of_piece((0, 1)), of_piece((2,))), tmp_path / "w.safetensors"
    whole.save(file)

    def other(document):
        document["sizes"]["parts"][0]["domain"]["scale"] = [
            x / 2 for x in document["sizes"]["parts"][0]["domain"]["scale"]
        ]

    rewrite(file, other)
    with pytest.raises(FileFormatError, match=r"expected parts in the coordinates of the whole|the domain of part 0"):
        wb.load(file, device="cpu")
