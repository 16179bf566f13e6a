"""Float32 for real, where it matters: at a proof's lowest points no evaluation leaves the rounding bound, with zero
slack.

The points are those where the search for the least f ended, as float32 queries, neighbours in the last place, and the
lowest positives around. There what is deployed (batch kernel; function in a user's kernel, whose threshold is moved;
CPU, CUDA; placed in the world) and float32 in NumPy in several orders, fused or not, meet f in extended precision, by a
forward pass of its own, at the coordinates that the device has: a network that hands on one of them reads them out.
"""

from functools import cache, partial

import numpy as np
import pytest
from asking import ask
from bounding_shapes import random_mlp, reader, shape
from fused_activations import FUSED, PLAIN
from region_cases import placed

from warp_bounding.bounders.mlp import Mlp
from warp_bounding.networks import tensor_cores
from warp_bounding.proof import least_value, settle
from warp_bounding.proof.stress import Walk
from warp_bounding.queries import oracle
from warp_bounding.rounding import round_down, round_up

F32, EXACT = np.float32, np.longdouble
CASES = {  # shape, and a network with random weights
    "point": ("blob", partial(random_mlp, activation="relu", seed=2)),
    "point-deep": ("blob", partial(random_mlp, hidden=(13, 30, 5))),
}
ORDERS = ("forwards", "backwards", "sorted", "pairs", "fused", "fused backwards")


@cache
def critical(case: str) -> tuple[Mlp, np.ndarray, np.ndarray]:
    """A proven bounder, never to be changed; queries around its lowest points; the lowest positives of them."""
    grid, rng = shape(CASES[case][0]), np.random.default_rng(6)
    bounder = CASES[case][1](grid)
    search = least_value(bounder, grid, eps=1e-3, boxes=60_000)
    settle(bounder, grid, search)
    q = [bounder.domain.to_object(search.worst[:120]).astype(F32)]
    for _ in range(4):
        q.append(np.nextafter(q[-1], np.where(rng.random(q[0].shape) < 0.5, F32(np.inf), F32(-np.inf))))
    q = np.concatenate(q)
    positives = Walk(bounder, grid).around(q)[0]
    return bounder, np.concatenate([q, positives[:200]]), positives


def coordinates(bounder, q: np.ndarray) -> np.ndarray:
    """``v`` ``(N, domain.ndim)`` float32 as the device has it; infinite where a query is not asked."""
    domain, device = bounder.domain, str(bounder.device)
    return np.stack([reader(domain, k, device).values(q).numpy() for k in range(domain.ndim)], axis=1)


def forward(bounder, v: np.ndarray, kind, affine, functions) -> np.ndarray:
    """The network from its tensors: numbers of type ``kind``, sums by ``affine``."""
    tensors, layers, h = bounder.tensors, [f"layers.{i}" for i in range(len(bounder.hidden) + 1)], v.astype(kind)
    for name in layers:
        z = affine(h, tensors[f"{name}.weight"].astype(kind), tensors[f"{name}.bias"].astype(kind))
        h = z if name == layers[-1] else functions[bounder.activation](z)
    return h[:, 0]


def exact(bounder, v: np.ndarray) -> np.ndarray:
    functions = {"sin": np.sin, "relu": lambda z: np.maximum(z, 0)}
    return forward(bounder, v, EXACT, lambda h, w, b: (h[:, None] * w).sum(axis=2) + b, functions)


def float32_affine(h: np.ndarray, weight: np.ndarray, bias: np.ndarray, how: str) -> np.ndarray:
    """``(N, H)``, each operation rounded to float32; "fused" keeps products exact."""
    h, weight = (h[:, ::-1], weight[:, ::-1]) if "backwards" in how else (h, weight)
    if "fused" in how:
        total = np.tile(bias, (len(h), 1))
        for k in range(h.shape[1]):
            total = (total.astype(float) + h[:, k, None].astype(float) * weight[:, k].astype(float)).astype(F32)
        return total
    terms = np.concatenate([h[:, None] * weight, np.broadcast_to(bias[:, None], (len(h), len(bias), 1))], axis=2)
    while how == "pairs" and terms.shape[2] > 1:
        terms = np.concatenate([terms, np.zeros_like(terms[..., : terms.shape[2] % 2])], axis=2)
        terms = terms[..., ::2] + terms[..., 1::2]
    terms = np.sort(terms, axis=2) if how == "sorted" else terms
    return np.add.accumulate(terms, axis=2)[..., -1]  # one after the other


def moved(bounder, q: np.ndarray, rotated, shift, factors, back: bool = False) -> np.ndarray:
    """Queries from object space to the world, or back, in extended precision."""
    return placed(bounder.query_kind, q, bounder.ndim, rotated, shift, factors, back, dtype=EXACT)


def placement(n: int, seed: int, turned: bool):
    """Rotation, shift, factors, and the matrix ``xform``; by right angles and powers of two if not ``turned``."""
    rng = np.random.default_rng(seed)
    rotated, factors = np.eye(n)[rng.permutation(n)] * rng.choice([-1.0, 1.0], n), 2.0 ** rng.integers(-2, 3, n)
    if turned:
        rotated, factors = np.linalg.qr(rng.normal(size=(n, n)))[0], rng.uniform(0.5, 2, n)
    shift = (rng.uniform(8, 12, n) * rng.choice([-1, 1], n)).astype(F32).astype(float)
    return rotated, shift, factors, np.block([[rotated, shift[:, None]], [np.zeros(n), 1.0]])


def known(bounder, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which queries are asked, nearly all; of these ``v``, and the exact f."""
    v = coordinates(bounder, q)
    queried = np.isfinite(v).all(axis=1)
    assert queried.mean() > 0.8
    return queried, v[queried], exact(bounder, v[queried])


def check_values(compute, bounder, q: np.ndarray) -> None:
    queried, v, f = known(bounder, q)
    assert (computed := compute(bounder, q[queried], v)).dtype == F32
    assert (np.abs(computed - f) <= bounder.rounding_bound()).all()


def in_order(how: str, bounder, _, v: np.ndarray) -> np.ndarray:
    functions = FUSED if "fused" in how else PLAIN
    return forward(bounder, v, F32, partial(float32_affine, how=how), functions)


def on_tensor_cores(bounder) -> float:
    """How far f may lie below a threshold that batches there do not deny: both are off by more than in float32."""
    if getattr(bounder, "tensor_numbers", None) is None:
        return 0.0
    more = (tensor_cores.rounding(bounder.network) - bounder.network.rounding) * (1 + 1e-6)
    return float(bounder.threshold - bounder.tensor_numbers.numpy()[0]) + more


def check_decisions(answer, bounder, q: np.ndarray) -> None:
    """A threshold as high as a proof may set it for the point, which must pass; and one above all that E allows."""
    (queried, _, f), error = known(bounder, q), bounder.rounding_bound()
    for at in np.unique(np.quantile(f.astype(float), np.linspace(0, 1, 12), method="nearest")):
        for threshold in (round_down(np.nextafter(at - error, -np.inf)), round_up(np.nextafter(at + error, np.inf))):
            answers = answer(bounder.freeze(float(threshold), None), q)[queried].astype(bool)
            assert answers[f - error >= threshold].all()
            assert not answers[f + error < threshold - on_tensor_cores(bounder)].any()


def check_placed(bounder, q: np.ndarray) -> None:
    """Maps that round nothing: what is asked in the world is the same query in object space."""
    for seed in range(3):
        *move, xform = placement(bounder.ndim, seed, turned=False)
        world = moved(bounder, q, *move).astype(F32)
        home = moved(bounder, world, *move, back=True)
        same = (home == home.astype(F32)).all(axis=1)
        assert same.mean() > 0.5
        place = {"xform": xform, "scale": move[2]}
        answer = partial(lambda x, place, b, _: b.query(x, **place).numpy(), world[same], place)
        check_decisions(answer, bounder, home[same].astype(F32))


CHECKS = {
    "values": partial(check_values, lambda bounder, q, _: bounder.values(q).numpy()),
    "batch": partial(check_decisions, lambda bounder, q: bounder.query(q).numpy()),
    "func": partial(check_decisions, ask),
    "placed": check_placed,
} | {how: partial(check_values, partial(in_order, how)) for how in ORDERS}


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize("case", CASES)
def test_no_evaluation_leaves_the_rounding_bound(case, check, device):
    bounder, q, _ = critical(case)
    CHECKS[check](bounder.to(device), q)


NOTICED = [(case, check) for case in CASES for check in CHECKS]
for decision in ("batch", "func", "placed"):  # a few thresholds: of a deep network its values tell more
    NOTICED.remove(("point-deep", decision))


@pytest.mark.parametrize(("case", "check"), NOTICED)
def test_a_bound_that_is_too_small_would_be_caught(case, check, monkeypatch):
    (bounder, q, _), true = critical(case), Mlp.rounding_bound
    monkeypatch.setattr(Mlp, "rounding_bound", lambda self: true(self) / 1000)
    with pytest.raises(AssertionError):
        CHECKS[check](bounder.to("cpu"), q)


@pytest.mark.parametrize("case", CASES)
def test_positives_are_never_denied(case, device):
    """The lowest ones, by the bounder as it was proven: batch, function, and anywhere in the world."""
    bounder, _, positives = critical(case)
    truth = oracle(bounder.query_kind, shape(CASES[case][0]), "cpu", bounder.domain.oracle_length)
    bounder = bounder.to(device)
    assert len(positives) > 100
    assert bounder.certificate.proven
    assert bounder.query(positives).numpy().all()
    assert ask(bounder, positives).all()
    for seed in range(4):
        *move, xform = placement(bounder.ndim, seed, turned=seed > 1)
        world = moved(bounder, positives, *move).astype(F32)
        back = moved(bounder, world, *move, back=True)
        near = [(back * (1 + EXACT(k) / 2**22)).astype(F32) for k in (-1, 0, 1)]
        sure = np.all([truth(x) for x in near], axis=0)  # around what that rounded
        assert sure.mean() > 0.1
        assert bounder.query(world[sure], xform=xform, scale=move[2]).numpy().all()
    above = np.nextafter(bounder.values(positives).numpy().max(), F32(np.inf))
    if more := on_tensor_cores(bounder):
        above += F32(1.001 * more + 2 * bounder.rounding_bound())
    bounder.freeze(float(above), None)  # and they would be, by a threshold above f
    assert not bounder.query(positives).numpy().any()
