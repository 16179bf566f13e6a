"""The plain twin in Warp's own Python: within the rounding bound of the exact f, the oracle of the native text, and no false negative."""

from functools import cache

import numpy as np
import pytest
import warp as wp
from asked_functions import ask as ask_a_foreigner
from asked_functions import asking_kernel, bounders, network, remade
from bounding_shapes import (
    CONSERVATIVE,
    domain_points,
    fitted,
    object_points,
    random_bounder,
    random_mlp,
    shape,
    told_of,
)
from region_cases import VOLUMES, cases, fitted_region, ray_length

import warp_bounding as wb
from warp_bounding.activations import ACTIVATIONS
from warp_bounding.bounders import METHODS, supports
from warp_bounding.bounders.cascade import Cascade
from warp_bounding.bounders.neural.mlp import Mlp
from warp_bounding.coordinates.region_domain import domain_of
from warp_bounding.kernels.functions import Data
from warp_bounding.kernels.plain import Numbers, Words, plain_value, vector_type
from warp_bounding.queries import QUERIES, sample
from warp_bounding.queries.positives import draw_positives

REGIONS = tuple(name for name, kind in QUERIES.items() if kind.is_region)
CLASSICS = tuple(m for m in VOLUMES if supports(m, "ray", 2, "parametric"))


def names_of(query: str) -> list[str]:
    """Of every method, two cascades, volumes of a region's own numbers, and a network of every activation."""
    found = [m for m in METHODS if supports(m, query, 2)] + ["aabb+mlp"]
    if query in REGIONS:
        return found + [f"parametric {m}" for m in CLASSICS]
    return [*found, "voxels+mlp", *(f"activation {a}" for a in ACTIVATIONS)]


@cache
def bounder_of(query: str, name: str) -> wb.Bounder:
    kind, _, choice = name.rpartition(" ")
    if "+" in choice:
        return Cascade.of([bounder_of(query, part) for part in choice.split("+")])
    if kind == "activation":
        return random_mlp(shape("c"), (9, 6), choice, octaves=list(ACTIVATIONS).index(choice))
    method, space = METHODS[choice], kind or "geometric"
    domain = domain_of(shape("c"), query, space=space)
    if issubclass(method, Mlp):
        return network(method, query, "cpu")
    if domain.tested_as_region or not kind:
        return method.fit(shape("c"), domain, device="cpu")
    positives = next(draw_positives(query, shape("c"), 500, 7, "cpu"))
    return method.fit_parametric(shape("c"), domain, domain.to_local(positives), device="cpu")


EVERYONE = pytest.mark.parametrize(("query", "name"), [(query, name) for query in QUERIES for name in names_of(query)])


def coordinates(bounder, count: int, rng) -> np.ndarray:
    """Random ``v`` that the domain lets through, float32."""
    v, n = rng.uniform(-1, 1, (count, bounder.domain.ndim)) * bounder.domain.limit, bounder.ndim
    if bounder.query_kind == "box":
        v = np.concatenate([np.minimum(v[:, :n], v[:, n:]), np.maximum(v[:, :n], v[:, n:])], axis=1)
    if bounder.query_kind == "plane" and bounder.domain.tested_as_region:
        v[:, :n] /= np.abs(v[:, :n]).max(axis=1, keepdims=True)
    return v.astype(np.float32)


@cache
def value_kernel(source) -> wp.Kernel:
    vector, f, start = vector_type(source.coordinates), plain_value(source), source.start

    @wp.kernel(module="unique", enable_backward=False)
    def compute(parameters: Numbers, words: Words, v: wp.array(dtype=vector), value: wp.array(dtype=wp.float32)):
        i = wp.tid()
        value[i] = f(parameters, words, start, v[i])

    return compute


def values_at(bounder, v: np.ndarray) -> np.ndarray:
    """f of the twin at coordinates, without the way there."""
    value = wp.empty(len(v), dtype=wp.float32, device=bounder.device)
    inputs = [bounder.data.parameters, bounder.data.words]
    inputs.append(wp.array(v, dtype=vector_type(v.shape[1]), device=bounder.device))
    wp.launch(value_kernel(bounder.source), len(v), inputs, [value], device=bounder.device)
    return value.numpy().astype(np.float64)


def undecided(bounder, v: np.ndarray) -> np.ndarray:
    """Where rounding decides whether an early test lets a query through."""
    near = [np.abs(p.reference(v) - float(p.threshold)) <= p.rounding_bound() for p in bounder.parts[:-1]]
    return np.any(near, axis=0) if near else np.zeros(len(v), bool)


def ask(bounder, x: np.ndarray) -> np.ndarray:
    """Answers of ``bounder.func`` in somebody's kernel."""
    answer = wp.zeros(len(x), dtype=wp.uint8, device=bounder.device)
    first, second = x[:, : bounder.ndim], x[:, -bounder.ndim :]
    a, b = (wp.array(part, dtype=vector_type(bounder.ndim), device=bounder.device) for part in (first, second))
    wp.launch(
        asking_kernel(bounder.func, bounder.query_kind), len(x), [bounder.data, a, b], [answer], device=bounder.device
    )
    return answer.numpy()


@EVERYONE
def test_f_is_within_its_rounding_bound(query, name, device, rng):
    bounder = bounder_of(query, name).to(device)
    v = coordinates(bounder, 5000, rng)
    v = v[~undecided(bounder, v)]
    values, exact, error = values_at(bounder, v), bounder.reference(v), bounder.rounding_bound()
    if error:
        assert (np.abs(values - exact) <= error).all()
    elif bounder.volume is None:  # of cells and boxes: what rounds is paid for by room around them, and decides
        assert (values >= bounder.bound(v.astype(np.float64), v.astype(np.float64)).lower).all()
        assert (values == exact).mean() > 0.99
    else:
        assert (values >= exact).all()
        assert (values == exact).mean() > 0.99


@EVERYONE
def test_it_is_the_oracle_of_the_native_text(query, name, device, rng):
    native = bounder_of(query, name).to(device)
    plain, grid = native.to(native=False), shape("c")
    x = sample(query, grid, 3000, rng) * 1.1 - 0.05
    if query == "box":
        x = np.concatenate([np.minimum(x[:, :2], x[:, 2:]), np.maximum(x[:, :2], x[:, 2:])], axis=1)
    x[:4, 0], x[4:8, -1], x[8:12] = np.nan, np.inf, 1e30
    ours, theirs = plain.values(x).numpy(), native.values(x).numpy()
    known = ~np.isfinite(theirs)
    assert (ours[known] == theirs[known]).all()
    assert np.isfinite(ours[~known]).all()
    error = 2 * native.rounding_bound()
    same = np.abs(ours[~known].astype(np.float64) - theirs[~known]) <= error
    assert same.mean() > 0.995  # of 0 and 1, of exits and of parts: rounding may decide
    assert same.all() or not error or len(native.parts) > 1
    middle = float(np.sort(theirs[~known])[(~known).sum() // 2])
    for threshold in (middle, np.inf, float(native.threshold)):
        native.freeze(threshold, None)
        plain.freeze(threshold, None)
        sure = np.abs(np.where(known, 0, theirs) - threshold) > error
        sure[~known] &= same
        for answers in (plain.query(x).numpy(), ask(plain, x)):
            assert (answers == native.query(x).numpy())[sure | known].all()


@pytest.mark.parametrize("method", [m for m in METHODS if supports(m, "point", 4)])
def test_it_is_the_oracle_where_time_passes(method, device, rng):
    native = random_bounder(method, "animated", device)
    x = domain_points(shape("animated"), 3000, rng)
    ours, theirs = native.to(native=False).values(x).numpy(), native.values(x).numpy()
    known = ~np.isfinite(theirs)
    assert (ours[known] == theirs[known]).all()
    assert (np.abs(ours[~known] - theirs[~known]) <= 2 * native.rounding_bound()).mean() > 0.999


@pytest.mark.parametrize("query", QUERIES)
@pytest.mark.parametrize("method", ["kdop", "oriented-ellipsoid", "bvh"])
def test_shapes_are_placed_as_the_native_text_places_them(method, query, device, rng):
    grid = shape("animated")
    native = METHODS[method].fit(grid, domain_of(grid, query), device=device)
    xform = wp.transform((0.3, -0.2, 0.1), wp.quat_from_axis_angle(wp.vec3(0.6, 0.0, 0.8), 0.5))
    x = sample(query, grid, 3000, rng)
    x[0], x[1, 0], x[2] = 1e38, np.nan, 3e38
    ours, theirs = (b.values(x, xform=xform, scale=1.5).numpy() for b in (native.to(native=False), native))
    known = ~np.isfinite(theirs)
    assert (ours[known] == theirs[known]).mean() > 0.999
    assert known.any()
    same = np.isfinite(ours) & ~known
    assert same.any()
    slack = 2 * native.rounding_bound() + 1e-4  # v itself is rounded on the way from the world
    assert (np.abs(ours.astype(np.float64)[same] - theirs[same]) <= slack).mean() > 0.99


@pytest.mark.parametrize("method", CONSERVATIVE)
@pytest.mark.parametrize("name", ["c", "blob", "animated"])
def test_no_point_of_the_object_is_denied(method, name, device, rng):
    grid, bounder = shape(name), fitted(method, name).to(device, native=False)
    inside = object_points(grid, rng)
    assert bounder.query(inside).numpy().all()
    indices, count = bounder.candidates(inside)
    assert count.numpy()[0] == len(inside) == len(indices)


@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize("name", ["c", "blob", "animated"])
@pytest.mark.parametrize("method", VOLUMES)
def test_no_region_that_meets_the_object_is_denied(method, query, name, device, rng):
    grid = shape(name)
    q, meets = cases(query, grid, rng)
    bounder = fitted_region(method, query, grid).to(device, native=False)
    assert bounder.query(q[meets]).numpy().all()
    if grid.ndim == 2:
        assert ask(bounder, q[meets]).all()


LEARNED = ("mlp", "learned-kdop", "relu-field", "monotone-mlp")


@pytest.mark.parametrize(("method", "query"), [(m, q) for m in LEARNED for q in REGIONS if supports(m, q, 2)])
def test_no_region_is_denied_that_a_learned_bounder_is_proven_for(method, query, device, rng):
    grid = shape("c")
    told = told_of(method, query, hidden=(6,), steps=3, length=ray_length(grid))
    bounder = wb.fit(grid, query=query, method=method, device="cpu", **told)
    assert bounder.certificate.proven
    q, meets = cases(query, grid, rng)
    assert bounder.to(device, native=False).query(q[meets]).numpy().all()


@pytest.mark.parametrize("query", QUERIES)
def test_foreign_data_are_answered_with_maybe(query, device):
    everyone = [b.to(device, native=False) for b in bounders(query, "cpu").values()]
    everything = slice(None)
    for bounder, other in zip(everyone, everyone[1:] + everyone[:1], strict=True):
        data, ask_for = bounder.data, ask_a_foreigner
        assert (ask_for(bounder, data) == 0).all()
        assert (ask_for(bounder, other.data) == 1).all()
        assert (ask_for(bounder, Data()) == 1).all()
        assert (ask_for(bounder, remade(data, slice(len(data.parameters) - 1), everything)) == 1).all()
        assert (ask_for(bounder, remade(data, everything, slice(len(data.words) - 1))) == 1).all()


def test_it_is_chosen_by_moving_a_bounder(device, rng):
    native = fitted("kdop", "blob")
    plain = native.to(device, native=False)
    assert native.native
    assert not plain.native
    assert not plain.to(device).native
    assert plain.to(native=True).func is native.func
    assert plain.func is not native.func
    assert plain.certificate is native.certificate
    x = domain_points(shape("blob"), 1000, rng)
    assert (plain.query(x).numpy() == native.query(x).numpy()).all()
    held = wp.array(x, dtype=wp.vec3, device=device)
    assert (plain.prepare(held).launch().numpy() == native.query(x).numpy()).all()
    assert plain.query(x[:0]).shape == (0,)
