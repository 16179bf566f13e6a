"""``mlp-early``: exits say no as often as their parts do, on every path; what is asked without exits is an ordinary network.

``occupancy`` has the code of ``mlp``; here it is only made sure that it never holds a certificate.
"""

from functools import cache

import numpy as np
import pytest
import warp as wp
from bounding_shapes import rounding_of_answers, shape

import warp_bounding as wb
from warp_bounding.bounders import METHODS
from warp_bounding.bounders.mlp import Mlp, Occupancy
from warp_bounding.bounders.mlp_early import MlpEarly, grant_of
from warp_bounding.certificates import Certificate
from warp_bounding.errors import BounderError
from warp_bounding.kernels.functions import Data
from warp_bounding.kernels.source import DENIED, GRANTED
from warp_bounding.queries import sample
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.runtime.native import vector_type

CASES = {  # shape, query, hidden, activation: 2D to 4D, animated, one exit and two
    "points": ("blob", "point", (13, 10), "sin"),
    "points-2d": ("c", "point", (9, 17, 6), "relu"),
    "rays": ("animated", "ray", (9, 8), "relu"),
    "planes": ("blob", "plane", (9, 8), "sin"),
}


def random_tensors(rng, inputs, hidden, outputs, bias) -> dict[str, np.ndarray]:
    tensors = {}
    for i, (k, h) in enumerate(zip((inputs, *hidden), (*hidden, outputs), strict=True)):
        tensors[f"layers.{i}.weight"] = (rng.normal(size=(h, k)) * (3 if i == 0 else 1.5) / np.sqrt(k)).astype(
            np.float32
        )
        tensors[f"layers.{i}.bias"] = rng.normal(size=h).astype(np.float32) + np.float32(bias * (i == len(hidden)))
    for i, width in enumerate(hidden[:-1]):
        tensors[f"exits.{i}.weight"] = (rng.normal(size=(outputs, width)) / np.sqrt(width)).astype(np.float32)
        tensors[f"exits.{i}.bias"] = np.full(outputs, bias, np.float32)
    return tensors


@cache
def early(case: str, device: str) -> tuple[MlpEarly, np.ndarray]:
    """A random network with exits, a threshold for each that denies some queries, and queries."""
    name, query, hidden, activation = CASES[case]
    grid, rng = shape(name), np.random.default_rng(len(case))
    domain, n = domain_of(grid, query), grid.ndim
    inputs = n if query == "plane" else domain.ndim
    tensors = random_tensors(rng, inputs, hidden, 1 + (query == "plane"), 1.0 if query == "plane" else 0.0)
    sizes = {"hidden": list(hidden), "activation": activation, "octaves": 0}
    x = sample(query, grid, 5000, rng)
    x[::501] = np.nan
    parts = MlpEarly(domain, tensors, sizes, device).parts
    for part in parts:
        f = part.values(x).numpy()
        part.freeze(float(np.quantile(f[np.isfinite(f)], 0.3)), None)
    return MlpEarly.of(parts), x


@cache
def asking_kernel(test, ndim: int, region: bool) -> wp.Kernel:
    vector = vector_type(ndim)

    @wp.kernel(module="unique", enable_backward=False)
    def ask_point(data: Data, q: wp.array(dtype=vector), answer: wp.array(dtype=wp.uint8)):
        i = wp.tid()
        if test(data, q[i]):
            answer[i] = wp.uint8(1)

    @wp.kernel(module="unique", enable_backward=False)
    def ask_region(data: Data, a: wp.array(dtype=vector), b: wp.array(dtype=vector), answer: wp.array(dtype=wp.uint8)):
        i = wp.tid()
        if test(data, a[i], b[i]):
            answer[i] = wp.uint8(1)

    return ask_region if region else ask_point


def ask(bounder, x: np.ndarray) -> np.ndarray:
    """Answers of ``bounder.func`` inside a user's kernel."""
    n, region = bounder.ndim, bounder.query_kind != "point"
    parts = [x[:, :n], x[:, n:]] if region else [x]
    arrays = [wp.array(np.ascontiguousarray(p), dtype=vector_type(n), device=bounder.device) for p in parts]
    answer = wp.zeros(len(x), dtype=wp.uint8, device=bounder.device)
    kernel = asking_kernel(bounder.func, n, region)
    wp.launch(kernel, len(x), [bounder.data, *arrays], [answer], device=bounder.device)
    return answer.numpy()


def answers_of(part: Mlp, x: np.ndarray) -> np.ndarray:
    """``part.query``, by its values: one kernel less to compile."""
    return ~(part.values(x).numpy() < part.threshold)


@pytest.mark.parametrize("case", CASES)
def test_it_is_the_conjunction_of_its_parts(case, device):
    bounder, x = early(case, device)
    parts = bounder.parts
    assert len(parts) == len(bounder.hidden) == len(bounder.exit_thresholds) + 1
    assert [type(part) for part in parts] == [Mlp] * len(parts)
    answers = np.array([answers_of(part, x) for part in parts])
    assert (bounder.query(x).numpy() == answers.all(axis=0)).all()
    assert answers[:, ::501].all()
    for i in range(len(parts)):  # every one of them matters
        assert (answers[i] < np.delete(answers, i, 0).all(axis=0)).any()
    values, last = bounder.values(x).numpy(), parts[-1].values(x).numpy()
    passed = answers[:-1].all(axis=0)
    asked = np.isfinite(last)
    assert (values == np.where(passed | ~asked, last, np.float32(DENIED))).all()


@pytest.mark.parametrize("case", CASES)
def test_function_for_kernels_is_the_batch_kernel(case, device):
    bounder, x = early(case, device)
    near = np.zeros(len(x), bool)
    for part in bounder.parts:
        near |= np.abs(part.values(x).numpy().astype(np.float64) - float(part.threshold)) <= 2 * part.rounding_bound()
    assert near.mean() < 0.1
    assert (ask(bounder, x) == bounder.query(x).numpy())[~near].all()


@pytest.mark.parametrize("case", CASES)
def test_the_reference(case, device):
    bounder, x = early(case, device)
    values = bounder.values(x).numpy().astype(np.float64)
    asked = np.isfinite(values)
    if bounder.query_kind == "ray":  # those that begin inside: `to_local` does not move the others
        asked &= (np.abs(bounder.domain.base.to_local(x[:, : bounder.ndim])) <= 1).all(axis=1)
    v = bounder.domain.to_local(x[asked])
    exact, values = bounder.reference(v), values[asked]
    agreed = (exact == DENIED) == (values == DENIED)
    assert agreed.mean() > 0.999
    assert (exact == DENIED).any() == (len(bounder.parts) > 1)
    slope = 1e-4  # the coordinates themselves are rounded
    assert (np.abs(values - exact)[agreed & (exact > DENIED)] <= bounder.rounding_bound() + slope).all()
    for part in bounder.parts:  # networks of every kind of query, two outputs among them
        values = part.values(x[asked]).numpy()
        assert (np.abs(values - part.reference(v)) <= part.rounding_bound() + slope).all()


@pytest.mark.parametrize("case", ["points", "points-2d"])
def test_bounds_hold(case, rng):
    bounder, _ = early(case, "cpu")
    bounder = MlpEarly(bounder.domain, dict(bounder.tensors), bounder.sizes, "cpu")
    limit = bounder.domain.limit.astype(np.float64)
    center, radius = rng.uniform(-limit, limit, (400, len(limit))), 10 ** rng.uniform(-4, -1, (400, 1)) * limit
    lower, upper = np.maximum(center - radius, -limit), np.minimum(center + radius, limit)
    bounds = bounder.bound(lower, upper)
    assert (bounds.lower == DENIED).any()
    assert (bounds.lower > DENIED).any()
    assert (bounds.value == bounder.reference(bounds.point)).all()
    for _ in range(50):
        v = rng.uniform(lower, upper)
        v = np.where(rng.random(v.shape) < 0.3, np.where(rng.random(v.shape) < 0.5, lower, upper), v)
        assert (bounds.lower <= bounder.reference(v)).all()


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


@pytest.mark.parametrize("case", CASES)
def test_grants_are_told_in_turn_on_every_path(case, device):
    (without, x), bounder = early(case, device), granting(case, device)
    answers, values = bounder.query(x).numpy(), bounder.values(x).numpy()
    last = without.parts[-1].values(x).numpy()
    asked = np.isfinite(last)
    open_, expected = asked.copy(), last.copy()
    for i, part in enumerate(without.parts[:-1]):
        f, sure = part.values(x).numpy(), grant_part(bounder, i).values(x).numpy()
        denied = open_ & (f < part.threshold)
        granted = open_ & ~denied & (sure > bounder.grant_thresholds[i])
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
        tests += [(grant_part(bounder, i), bounder.grant_thresholds[i])] if i + 1 < len(without.parts) else []
        for own, bar in tests:
            near |= np.abs(own.values(x).numpy().astype(np.float64) - float(bar)) <= 2 * own.rounding_bound()
    assert near.mean() < 0.1
    assert (ask(bounder, x) == answers)[~near].all()


@pytest.mark.parametrize("case", ["points", "points-2d"])
def test_grants_lower_f_nowhere(case, rng):
    (without, _), bounder = early(case, "cpu"), granting(case, "cpu")
    limit = bounder.domain.limit.astype(np.float64)
    v = rng.uniform(-limit, limit, (5000, len(limit)))
    f, before = bounder.reference(v), without.reference(v)
    assert (f >= before).all()
    assert (f == GRANTED).any()
    lower, upper = np.maximum(v - 1e-3, -limit), np.minimum(v + 1e-3, limit)
    bounds = bounder.bound(lower, upper)
    assert (bounds.lower <= f).all()
    assert (bounds.value == bounder.reference(bounds.point)).all()


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
        assert (ask(whole, x) == expected).mean() > 0.99


@pytest.mark.parametrize("case", ["points", "rays", "planes"])
def test_round_trip(case, device, tmp_path):
    bounder, x = early(case, device)
    path = tmp_path / "early.safetensors"
    bounder.save(path)
    twin = wb.load(path, device=device)
    assert type(twin) is MlpEarly
    assert twin.threshold == bounder.threshold
    assert (twin.exit_thresholds == bounder.exit_thresholds).all()
    assert twin.values(x).numpy().tobytes() == bounder.values(x).numpy().tobytes()
    assert (twin.query(x).numpy() == bounder.query(x).numpy()).all()


def test_without_thresholds_exits_let_everything_pass():
    bounder, x = early("points", "cpu")
    tensors = {name: value for name, value in bounder.tensors.items() if name != "exits.thresholds"}
    loose = MlpEarly(bounder.domain, tensors, bounder.sizes, "cpu")
    assert (loose.values(x).numpy() == bounder.parts[-1].values(x).numpy()).all()


def test_one_hidden_layer_has_no_exit():
    rng = np.random.default_rng(0)
    sizes = {"hidden": [8], "activation": "sin", "octaves": 0}
    bounder = MlpEarly(domain_of(shape("blob"), "point"), random_tensors(rng, 3, (8,), 1, 0.0), sizes, "cpu")
    assert len(bounder.parts) == 1
    assert (MlpEarly.of(bounder.parts).reference(rng.uniform(-1, 1, (50, 3))) > DENIED).all()


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


def test_answers_do_not_depend_on_the_number_of_queries(device):
    bounder, x = early("points-2d", device)
    everything = bounder.query(x).numpy()
    for count in (1, 3, 31, 33, 511, 512, 513, 2049):
        assert (bounder.query(x[7 : 7 + count]).numpy() == everything[7 : 7 + count]).all()


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
    bounder.save(tmp_path / "o.safetensors")
    assert type(wb.load(tmp_path / "o.safetensors", device=device)) is Occupancy
