"""Networks: thresholds by parts, exits and grants; proven, the same on every path, and refused where they are wrong."""

from functools import cache
from itertools import product

import numpy as np
import pytest
import warp as wp
from asking import ask, check_compiles
from bounding_shapes import (
    EARLY,
    domain_points,
    fitted,
    object_points,
    random_mlp,
    reloaded,
    rounding_of_answers,
    shape,
)
from rewriting import changed, check_refuted

import warp_bounding as wb
from warp_bounding.bounders import METHODS, Cascade, Union
from warp_bounding.bounders.cascade import CERTAIN, EVERYWHERE, NOWHERE, Lattice, Local
from warp_bounding.bounders.mlp import Mlp, Occupancy
from warp_bounding.bounders.mlp_early import MlpEarly, grant_of
from warp_bounding.certificates import Certificate
from warp_bounding.errors import BounderError
from warp_bounding.kernels.functions import batch_kernel
from warp_bounding.kernels.source import DENIED, GRANTED
from warp_bounding.queries import sample
from warp_bounding.queries.hard import draw_positives
from warp_bounding.queries.region_domain import domain_of

PARTS = 30
CLOSE = {"blob": (3, 4, 2), "c": (5, 3)}


@cache
def fit_points(name: str) -> wb.Bounder:
    return wb.fit(shape(name), method="mlp", hidden=(8,), steps=300, parts=PARTS, device="cpu", progress=False)


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
def test_linear_bounds_lie_under_f_less_the_threshold_of_the_part(name, rng):
    bounder = some_local(name)
    limit, share = bounder.domain.limit.astype(np.float64), rng.uniform(size=(30, 500, bounder.ndim))
    middle, radius = rng.uniform(-limit, limit, (500, bounder.ndim)), 10 ** rng.uniform(-4, 0, (500, 1)) * limit
    lower, upper = np.maximum(middle - radius, -limit), np.minimum(middle + radius, limit)
    bounds = bounder.bound(lower, upper)
    assert 50 < (bounds.slope != 0).any(axis=1).sum() < 500
    for at in share:
        v = lower + at * (upper - lower)
        f, way = bounder.reference(v), ((v - (lower + upper) / 2) * bounds.slope).sum(axis=1)
        assert (f >= bounds.lower).all()
        assert (f >= bounds.level + way).all()


@pytest.mark.parametrize("name", list(CLOSE))
def test_a_fit_is_proven_part_by_part_and_no_looser(name, tmp_path):
    grid, bounder = shape(name), fit_points(name)
    assert bounder.method == "local"
    assert bounder.certificate.proven
    assert 1 < bounder.lattice.count <= PARTS
    assert bounder.info["training"]["thresholds"] == bounder.lattice.count
    assert bounder.query(object_points(grid, np.random.default_rng(0))).numpy().all()
    assert wb.evaluate(bounder, grid, samples=20_000).fn == 0
    finite = np.isfinite(bounder.thresholds)
    single = bounder.member.to("cpu").freeze(bounder.thresholds[finite].min() + float(bounder.threshold), None)
    x = sample("point", grid, 20_000, np.random.default_rng(3)).astype(np.float32)
    queried = finite[bounder.lattice.place(bounder.domain.to_local(x))]
    assert (bounder.query(x).numpy() <= single.query(x).numpy())[queried].all()
    again = reloaded(bounder, tmp_path)
    assert (again.query(x).numpy() == bounder.query(x).numpy()).all()
    assert wb.certify(again, grid).proven


def relevelled(bounder: Local, levels: np.ndarray) -> Local:
    """The same bounder at other levels."""
    return changed(bounder, {"levels": np.pad(levels, (0, -len(levels) % 4)).view(np.uint32)})


def test_a_cascade_may_end_with_local_thresholds(rng):
    first, last = fitted("aabb", "blob"), fit_points("blob").to("cpu")
    last.info = last.info | {key: first.info.get(key) for key in ("indicator", "margin", "resolution")}
    whole, x = wb.cascade(first, last), domain_points(shape("blob"), 4000, rng)
    answers = first.query(x).numpy() & last.query(x).numpy()
    assert (whole.query(x).numpy() == answers).all()
    assert (ask(whole, x) == answers).all()
    assert whole.certificate.proven
    assert wb.certify(whole, shape("blob")).proven
    with pytest.raises(BounderError, match="only the last part"):
        wb.cascade(last, first)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"edges": lambda e: e[::-1].copy()}, "ascend"),
        ({"edges": lambda e: e * 0}, "ascend"),
        ({"scale": lambda s: np.array([0.5, 0.25], np.float32)}, "whole number"),
        ({"scale": lambda s: np.array([0.0, 0.3], np.float32)}, "power of two"),
        ({"scale": lambda s: np.array([2.0**23, 0.25], np.float32)}, "whole number"),
        ({"scale": lambda s: np.array([4.0, 2.0**112], np.float32)}, "whole number"),
        ({"levels": lambda t: t[:-1].copy()}, "expected tensors"),
    ],
)
def test_numbers_that_no_fit_writes_are_refused(change, message):
    bounder = some_local("blob")
    tensors = bounder.tensors | {name: turn(bounder.tensors[name]) for name, turn in change.items()}
    with pytest.raises(BounderError, match=message):
        Local(bounder.domain, tensors, bounder.sizes, "cpu")
    for shape_ in ([3, 4], [3, 4, 0], "abc", [3, 4, 2.0], [100, 100, 100]):
        with pytest.raises(BounderError, match="counts"):
            Local(bounder.domain, bounder.tensors, bounder.sizes | {"shape": shape_}, "cpu")


def test_cuda_source_compiles(tmp_path):
    if not hasattr(wp, "compile_aot_module"):
        pytest.skip("this Warp cannot compile ahead of time")
    parts = [Cascade.of([fitted("aabb", "blob"), some_local("blob")]), fitted("kdop", "blob")]
    check_compiles(batch_kernel(Union.of(parts).source, False, False), tmp_path)


def test_a_part_that_denies_a_positive_is_found_out():
    bounder, grid = fit_points("c"), shape("c")
    levels = bounder.tensors["levels"].view(np.uint8)[: bounder.lattice.count]
    met = np.concatenate(list(draw_positives("point", grid, 30_000, 7, "cpu")))
    step = float(bounder.tensors["scale"][1])
    places = bounder.lattice.place(bounder.domain.to_local(met))
    count = np.bincount(places, minlength=len(levels))
    reported = (count > 0) & (levels < EVERYWHERE)  # parts with positives and a threshold
    lowest = np.argmin(np.where(reported, levels, NOWHERE))
    tried = [(np.argmax(count), NOWHERE), (lowest, NOWHERE), (lowest, EVERYWHERE - 1)]
    for part in np.flatnonzero(reported):  # raised by just as much as makes it deny a positive that was drawn
        least = bounder.values(met[places == part]).numpy().min()
        raised = int(levels[part]) + int(np.ceil((least - float(bounder.threshold)) / step)) + 1
        tried += [(part, raised)] if raised < EVERYWHERE else []
    assert len(tried) > 3
    for part, wrong in tried:
        changed = levels.copy()
        changed[part] = wrong
        lying = relevelled(bounder, changed)
        assert not lying.query(met[places == part]).numpy().all()
        check_refuted(lying, grid, ("refuted",) if wrong >= EVERYWHERE - 1 else ("refuted", "undecided"))


def test_nothing_is_proven_where_all_is_denied_or_nothing_in_time():
    bounder, grid = fit_points("c"), shape("c")
    lying = relevelled(bounder, np.full(bounder.lattice.count, NOWHERE, np.uint8))
    for threshold in (0.0, -(2.0**127.5), 2.0**127.5):
        lying.freeze(threshold, None).info = bounder.info
        assert wb.certify(lying, grid).kind == "refuted" or threshold < 0
        assert not wb.certify(lying, grid).proven
    assert wb.certify(bounder, grid, budget=0).kind == "undecided"


def test_what_a_fit_refuses():
    for query, count in (("point", 0), ("point", 1.5), ("point", 1 << 20), ("plane", 4)):
        with pytest.raises(BounderError, match="parts"):
            wb.fit(shape("c"), query, "mlp", parts=count, steps=1, device="cpu", progress=False)


EXITS = {  # shape, query, hidden, activation: one exit and two
    "points": ("blob", "point", EARLY, "sin"),
    "points-2d": ("c", "point", (9, 17, 6), "relu"),
    "planes": ("blob", "plane", EARLY, "sin"),
}


@cache
def early(case: str, device: str) -> tuple[MlpEarly, np.ndarray]:
    """A random network with exits, a threshold for each that denies some queries, and queries."""
    name, query, hidden, activation = EXITS[case]
    grid, rng = shape(name), np.random.default_rng(len(case))
    whole, bias = random_mlp(grid, hidden, activation, gain=3.0, domain=domain_of(grid, query)), query == "plane"
    tensors = dict(whole.tensors)
    tensors[f"layers.{len(hidden)}.bias"] = tensors[f"layers.{len(hidden)}.bias"] + np.float32(bias)
    for i, width in enumerate(hidden[:-1]):
        tensors[f"exits.{i}.weight"] = (rng.normal(size=(1 + bias, width)) / np.sqrt(width)).astype(np.float32)
        tensors[f"exits.{i}.bias"] = np.full(1 + bias, bias, np.float32)
    x = sample(query, grid, 5000, rng)
    x[::501] = np.nan
    parts = MlpEarly(whole.domain, tensors, whole.sizes, device).parts
    for part in parts:
        f = part.values(x).numpy()
        part.freeze(float(np.quantile(f[np.isfinite(f)], 0.3)), None)
    return MlpEarly.of(parts), x


def answers_of(part: Mlp, x: np.ndarray) -> np.ndarray:
    """``part.query``, by its values: one kernel less to compile."""
    return ~(part.values(x).numpy() < part.threshold)


@pytest.mark.parametrize("case", EXITS)
def test_it_is_the_conjunction_of_its_parts(case, device):
    bounder, x = early(case, device)
    parts = bounder.parts
    assert len(parts) == len(bounder.hidden) == len(bounder.tensors["exits.thresholds"]) + 1
    assert [type(part) for part in parts] == [Mlp] * len(parts)
    answers = np.array([answers_of(part, x) for part in parts])
    assert (bounder.query(x).numpy() == answers.all(axis=0)).all()
    assert answers[:, ::501].all()
    for i in range(len(parts)):  # every one of them matters
        assert (answers[i] < np.delete(answers, i, 0).all(axis=0)).any()
    values, last = bounder.values(x).numpy(), parts[-1].values(x).numpy()
    passed = answers[:-1].all(axis=0)
    queried = np.isfinite(last)
    assert (values == np.where(passed | ~queried, last, np.float32(DENIED))).all()


@pytest.mark.parametrize("case", EXITS)
def test_the_reference(case, device):
    bounder, x = early(case, device)
    values = bounder.values(x).numpy().astype(np.float64)
    queried = np.isfinite(values)
    v = bounder.domain.to_local(x[queried])
    exact, values = bounder.reference(v), values[queried]
    agreed = (exact == DENIED) == (values == DENIED)
    assert agreed.mean() > 0.999
    assert (exact == DENIED).any() == (len(bounder.parts) > 1)
    slope = 1e-4  # the coordinates themselves are rounded
    assert (np.abs(values - exact)[agreed & (exact > DENIED)] <= bounder.rounding_bound() + slope).all()
    for part in bounder.parts:  # networks of every kind of query, two outputs among them
        values = part.values(x[queried]).numpy()
        assert (np.abs(values - part.reference(v)) <= part.rounding_bound() + slope).all()


@cache
def granting(case: str, device: str) -> MlpEarly:
    """The same with random grants, each of which grants a fifth of all queries."""
    bounder, x = early(case, device)
    rng, outputs = np.random.default_rng(3), bounder.head.outputs
    grants = [(rng.normal(size=(outputs, width)), np.zeros(outputs)) for width in bounder.hidden[:-1]]
    untold = bounder.granting(grants, [GRANTED] * len(grants))
    values = [grant_part(untold, i).values(x).numpy() for i in range(len(grants))]
    return bounder.granting(grants, [np.quantile(f[np.isfinite(f)], 0.8) for f in values])


def grant_part(bounder: MlpEarly, index: int) -> Mlp:
    return Mlp(bounder.domain, *grant_of(bounder.tensors, bounder.sizes, index), bounder._device)


@pytest.mark.parametrize("case", EXITS)
def test_grants_are_told_in_turn_on_every_path(case, device):
    (without, x), bounder = early(case, device), granting(case, device)
    answers, values = bounder.query(x).numpy(), bounder.values(x).numpy()
    last = without.parts[-1].values(x).numpy()
    queried = np.isfinite(last)
    open_, expected = queried.copy(), last.copy()
    for i, part in enumerate(without.parts[:-1]):
        f, sure = part.values(x).numpy(), grant_part(bounder, i).values(x).numpy()
        denied = open_ & (f < part.threshold)
        granted = open_ & ~denied & (sure > bounder.tensors["grants.thresholds"][i])
        assert denied.any()
        assert granted.any()
        expected[denied], expected[granted] = DENIED, GRANTED
        open_ &= ~denied & ~granted
    assert (values == expected).all()
    assert (answers == ~(expected < bounder.threshold)).all()
    assert (answers >= without.query(x).numpy()).all()  # a grant takes no answer back
    assert (answers > without.query(x).numpy()).any()
    near = np.zeros(len(x), bool)
    for i, part in enumerate(without.parts):
        tests = [(part, part.threshold)]
        if i + 1 < len(without.parts):
            tests.append((grant_part(bounder, i), bounder.tensors["grants.thresholds"][i]))
        for own, bar in tests:
            near |= np.abs(own.values(x).numpy().astype(np.float64) - float(bar)) <= 2 * own.rounding_bound()
    assert near.mean() < 0.1
    assert (ask(bounder, x) == answers)[~near].all()


def test_grants_in_unions_and_cascades(device):
    (without, x), bounder = early("points", device), granting("points", device)
    ball = METHODS["sphere"].fit(shape("blob"), bounder.domain, device=device)
    f = ball.values(x).numpy()
    ball.freeze(float(np.quantile(f[np.isfinite(f)], 0.5)), None)
    own, other, before = (each.query(x).numpy() for each in (bounder, ball, without))
    for whole, expected, differs in (
        (wb.cascade(ball, bounder), own & other, before & other),
        (wb.union(bounder, ball), own | other, before | other),
    ):
        assert (expected != differs).any()
        assert (whole.query(x).numpy() == expected).all()


@pytest.mark.parametrize("granted", [False, True])
@pytest.mark.parametrize("case", ["points", "points-2d"])
def test_bounds_hold_and_grants_lower_f_nowhere(case, granted, rng):
    without, _ = early(case, "cpu")
    bounder = granting(case, "cpu") if granted else without
    limit = bounder.domain.limit.astype(np.float64)
    center, radius = rng.uniform(-limit, limit, (400, len(limit))), 10 ** rng.uniform(-4, -1, (400, 1)) * limit
    lower, upper = np.maximum(center - radius, -limit), np.minimum(center + radius, limit)
    bounds, met = bounder.bound(lower, upper), False
    assert (bounds.lower == DENIED).any()
    assert (bounds.lower > DENIED).any()
    assert (bounds.value == bounder.reference(bounds.point)).all()
    for _ in range(50):
        v = rng.uniform(lower, upper)
        v = np.where(rng.random(v.shape) < 0.3, np.where(rng.random(v.shape) < 0.5, lower, upper), v)
        f = bounder.reference(v)
        assert (bounds.lower <= f).all()
        assert (f >= without.reference(v)).all()
        met = met or (f == GRANTED).any()
    assert met == granted


def test_parts_that_do_not_fit_together():
    bounder, _ = early("points", "cpu")
    parts, strangers = bounder.parts, early("points-2d", "cpu")[0].parts
    tensors = {name: value.copy() for name, value in parts[0].tensors.items()}
    tensors["layers.0.bias"] += np.float32(0.1)
    other_layer = Mlp(bounder.domain, tensors, parts[0].sizes, "cpu")
    for wrong in ([parts[1]], [parts[0], *parts], [strangers[0], parts[1]], [other_layer, parts[1]]):
        with pytest.raises(BounderError, match="expected"):
            MlpEarly.of(wrong)
    with pytest.raises(BounderError, match="exits"):
        MlpEarly(bounder.domain, {k: v for k, v in bounder.tensors.items() if "exits.0" not in k}, bounder.sizes, "cpu")


def test_occupancy_never_holds_a_certificate(device, tmp_path):
    part = early("points", device)[0].parts[-1]
    bounder = Occupancy(part.domain, dict(part.tensors), part.sizes, device)
    assert not bounder.conservative
    assert "not conservative" in repr(bounder)
    assert bounder.threshold == 0
    x = early("points", device)[1]
    part.freeze(0.0, None)
    sure = np.abs(part.values(x).numpy()) >= (0.0 if device == "cpu" else rounding_of_answers(part))
    assert (bounder.query(x).numpy() == answers_of(part, x))[sure].all()
    certificate = object.__new__(Certificate)
    with pytest.raises(BounderError, match="not conservative"):
        bounder.freeze(0.0, certificate)
    assert type(reloaded(bounder, tmp_path, device)) is Occupancy
