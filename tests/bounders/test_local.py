"""Thresholds of the parts of a domain: every device finds the same part, each part is proven, and a part that lies is found out."""

from functools import cache
from itertools import product

import numpy as np
import pytest
import warp as wp
from asking import ask, check_compiles
from bounding_shapes import domain_points, fitted, object_points, random_mlp, shape

import warp_bounding as wb
from warp_bounding.bounders.mlp import CERTAIN, EVERYWHERE, NOWHERE, Lattice, Local
from warp_bounding.errors import BounderError
from warp_bounding.kernels.functions import batch_kernel
from warp_bounding.kernels.source import DENIED

PARTS = 30
CLOSE = {"blob": (3, 4, 2), "c": (5, 3), "animated": (2, 3, 2, 2)}


@cache
def fit(name: str) -> wb.Bounder:
    return wb.fit(shape(name), method="mlp", hidden=(8,), steps=300, thresholds=PARTS, device="cpu", progress=False)


def some_local(name: str, seed: int = 0) -> Local:
    """A random network at random thresholds, parts that are denied or not asked among them."""
    rng, member = np.random.default_rng(seed), random_mlp(shape(name))
    limit = member.domain.limit.astype(np.float64)
    lattice = Lattice.of(-0.8 * limit, 0.7 * limit, CLOSE[name])
    thresholds = rng.normal(size=lattice.count)
    thresholds[rng.random(lattice.count) < 0.2] = np.inf
    thresholds[rng.random(lattice.count) < 0.2] = -np.inf
    return Local.of(member, lattice, thresholds, 2.0**-6)


@pytest.mark.parametrize("name", list(CLOSE))
def test_devices_compute_f_less_the_threshold_of_the_part(name, device, rng):
    bounder, x = some_local(name).to(device), domain_points(shape(name), 5000, rng)
    v = bounder.domain.to_local(x)
    on_edges = rng.random(v.shape) < 0.1  # points whose float32 v is close to an edge, or on it
    for k, axis in enumerate(bounder.lattice.edges):
        v[on_edges[:, k], k] = rng.choice(axis, int(on_edges[:, k].sum()))
    x = bounder.domain.to_object(v).astype(np.float32)
    v = bounder.domain.to_local(x)
    x, v = (each[(np.abs(v) <= bounder.domain.limit * (1 - 1e-6)).all(axis=1)] for each in (x, v))
    around = [bounder.lattice.place(v + 1e-5 * np.array(way)) for way in product((-1, 1), repeat=v.shape[1])]
    f = bounder.member.reference(v)
    allowed = np.stack([np.clip(f - bounder.thresholds[place], DENIED, CERTAIN) for place in around])
    clear = np.ptp(around, axis=0) == 0  # elsewhere the computed v may lie in a part beside
    assert (allowed[0, clear] == bounder.reference(v)[clear]).all()
    assert clear.sum() > 1500
    assert (np.ptp(allowed, axis=0) > 2 * bounder.rounding_bound()).sum() > 100
    found = bounder.values(x).numpy().astype(np.float64)
    assert np.abs(allowed - found).min(axis=0).max() <= bounder.rounding_bound()
    assert {DENIED, CERTAIN} <= set(found[clear])
    sure = clear & (np.abs(found - float(bounder.threshold)) > 2 * bounder.rounding_bound())
    assert (ask(bounder, x)[sure] == bounder.query(x).numpy()[sure]).all()


@pytest.mark.parametrize("name", list(CLOSE))
def test_a_fit_is_proven_part_by_part_and_no_looser(name, tmp_path, rng):
    bounder, grid = fit(name), shape(name)
    assert bounder.method == "local"
    assert bounder.certificate.proven
    assert bounder.lattice.count <= PARTS
    assert bounder.info["training"]["thresholds"] == bounder.lattice.count
    inside = object_points(grid, rng)
    assert bounder.query(inside).numpy().all()
    assert ask(bounder, inside).all()
    assert wb.evaluate(bounder, grid, samples=20_000).fn == 0
    one = bounder.member.to("cpu").freeze(0.0, None)
    one.info = bounder.info
    lowest = bounder.thresholds[np.isfinite(bounder.thresholds)].min() + float(bounder.threshold)
    x = domain_points(grid, 20_000, rng)
    single = one.freeze(lowest, None).query(x).numpy()
    finite = np.isfinite(bounder.thresholds)[bounder.lattice.place(bounder.domain.to_local(x))]
    assert (bounder.query(x).numpy() <= single)[finite].all()
    bounder.save(tmp_path / "local.safetensors")
    again = wb.load(tmp_path / "local.safetensors", device="cpu")
    assert again.certificate == bounder.certificate
    assert (again.query(x).numpy() == bounder.query(x).numpy()).all()
    assert wb.certify(again, grid).proven


def test_a_shape_without_cells():
    ball = wb.solids.Sphere((0.1, 0.2, 0.3), 0.4)
    bounder = wb.fit(ball, hidden=(8,), steps=200, thresholds=27, device="cpu", progress=False)
    assert bounder.certificate.proven
    assert wb.certify(bounder, ball).proven
    assert wb.evaluate(bounder, ball, samples=20_000).fn == 0


@pytest.mark.parametrize("name", ["blob", "c"])
def test_a_part_that_denies_a_part_of_the_object_is_found_out(name):
    bounder, grid = fit(name), shape(name)
    levels = bounder.tensors["levels"].view(np.uint8)[: bounder.lattice.count]
    cells = grid.position(grid.occupied.astype(np.float64))
    places = np.bincount(bounder.lattice.place(bounder.domain.to_local(cells)), minlength=bounder.lattice.count)
    told = (places > 0) & (levels < EVERYWHERE)  # parts with positives and a threshold
    lowest = np.argmin(np.where(told, levels, NOWHERE))
    for part, wrong in ((np.argmax(places), NOWHERE), (lowest, NOWHERE), (lowest, EVERYWHERE - 1)):
        assert levels[part] != wrong
        changed = levels.copy()
        changed[part] = wrong
        words = np.pad(changed, (0, -len(changed) % 4)).view(np.uint32)
        lying = Local(bounder.domain, bounder.tensors | {"levels": words}, bounder.sizes, "cpu")
        lying.freeze(bounder.threshold, None).info = bounder.info
        assert lying.thresholds[part] > bounder.thresholds[part] + 0.1
        certificate = wb.certify(lying, grid)
        assert certificate.kind == "refuted"
        assert grid.contains(np.float64([certificate.counterexample])).all()


def test_what_a_level_denies_is_denied_at_any_threshold():
    bounder, grid = fit("c"), shape("c")
    nowhere = np.full_like(bounder.tensors["levels"], 0xFFFFFFFF)
    lying = Local(bounder.domain, bounder.tensors | {"levels": nowhere}, bounder.sizes, "cpu")
    lying.freeze(-(2.0**127.5), None).info = bounder.info
    assert wb.certify(lying, grid).kind != "proven"


@pytest.mark.parametrize("name", list(CLOSE))
def test_pieces_cover_a_box_and_lie_in_one_part_each(name, rng):
    lattice = some_local(name).lattice
    n = len(lattice.shape)
    lower = rng.uniform(-1, 1, (300, n))
    upper = lower + rng.uniform(0, 1, (300, n)) * (rng.random((300, 1)) < 0.9)
    for k, axis in enumerate(lattice.edges):  # boxes that begin and end on edges
        upper[k::7, k] = np.maximum(rng.choice(axis, len(upper[k::7])), lower[k::7, k])
        lower[k::5, k] = np.minimum(rng.choice(axis, len(lower[k::5])), upper[k::5, k])
    low, high, owner = lattice.cut(lower, upper)
    assert (low <= high).all()
    assert (low >= lower[owner]).all()
    assert (high <= upper[owner]).all()
    for share in (0.0, 0.3, 1.0):
        v = lower + share * (upper - lower)
        v = np.where(share == 1.0, upper, v)
        parts = lattice.place(v)
        held = [
            ((low <= p) & (high >= p)).all(axis=1)[owner == i] & (lattice.place(low)[owner == i] == part)
            for i, (p, part) in enumerate(zip(v, parts, strict=True))
        ]
        assert all(each.any() for each in held)  # each point lies in a piece that counts to the point's part
    inside = low + 0.5 * (high - low)
    assert (lattice.place(inside) == lattice.place(low)).all()


@pytest.mark.parametrize("name", list(CLOSE))
def test_bounds_hold_over_boxes_of_any_size(name, rng):
    bounder = some_local(name)
    low = rng.uniform(-1, 1, (2000, shape(name).ndim))
    high = low + 10 ** rng.uniform(-4, 0, (2000, 1))
    bounds = bounder.bound(low, high)
    for t in rng.random((20, 1, 1)):
        assert (bounder.reference(low + t[0] * (high - low)) >= bounds.lower).all()


def test_a_cascade_may_end_with_local_thresholds(rng):
    whole = wb.cascade(fitted("aabb", "blob"), replaced_info(fit("blob"), fitted("aabb", "blob")))
    x = domain_points(shape("blob"), 4000, rng)
    answers = fitted("aabb", "blob").query(x).numpy() & fit("blob").query(x).numpy()
    assert (whole.query(x).numpy() == answers).all()
    assert (ask(whole, x) == answers).all()
    assert whole.certificate.proven
    assert wb.certify(whole, shape("blob")).proven
    with pytest.raises(BounderError, match="only the last part"):
        wb.cascade(fit("blob"), fitted("aabb", "blob"))


def replaced_info(bounder: wb.Bounder, like: wb.Bounder) -> wb.Bounder:
    """A copy that was fitted to the same object as another one."""
    copy = bounder.to("cpu")
    copy.info = bounder.info | {key: like.info.get(key) for key in ("indicator", "margin", "resolution")}
    return copy


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"edges": lambda e: e[::-1].copy()}, "ascend"),
        ({"edges": lambda e: e * 0}, "ascend"),
        ({"scale": lambda s: np.array([0.5, 0.25], np.float32)}, "whole number"),
        ({"scale": lambda s: np.array([0.0, 0.3], np.float32)}, "power of two"),
        ({"scale": lambda s: np.array([2.0**23, 0.25], np.float32)}, "whole number"),
        ({"scale": lambda s: np.array([4.0, 2.0**112], np.float32)}, "whole number"),
        ({"scale": lambda s: np.array([4.0, 2.0**-130], np.float32)}, "whole number"),
        ({"levels": lambda t: t[:-1].copy()}, "expected tensors"),
    ],
)
def test_numbers_that_no_fit_writes_are_refused(change, message):
    bounder = some_local("blob")
    tensors = bounder.tensors | {name: turn(bounder.tensors[name]) for name, turn in change.items()}
    with pytest.raises(BounderError, match=message):
        Local(bounder.domain, tensors, bounder.sizes, "cpu")


@pytest.mark.parametrize("shape_", [[3, 4], [3, 4, 0], "abc", [3, 4, 2.0], [100, 100, 100]])
def test_shapes_that_are_none_are_refused(shape_):
    bounder = some_local("blob")
    with pytest.raises(BounderError, match="counts"):
        Local(bounder.domain, bounder.tensors, bounder.sizes | {"shape": shape_}, "cpu")


def test_what_fit_refuses():
    for count in (0, 1.5, 1 << 20):
        with pytest.raises(BounderError, match="thresholds"):
            wb.fit(shape("c"), thresholds=count, steps=1, device="cpu", progress=False)
    with pytest.raises(BounderError, match="thresholds"):
        wb.fit(shape("c"), "plane", thresholds=4, steps=1, device="cpu", progress=False)


def test_cuda_source_compiles(tmp_path):
    if not hasattr(wp, "compile_aot_module"):
        pytest.skip("this Warp cannot compile ahead of time")
    check_compiles(batch_kernel(some_local("blob").source, False, False), tmp_path)
