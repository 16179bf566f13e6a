"""Segments: what is cleared meets the object nowhere, and most of what is free is cleared."""

from functools import cache, partial

import numpy as np
import pytest
from bounding_shapes import CONSERVATIVE, DEEP, fitted_query, random_mlp, shape
from bounding_shapes import fitted as hardly_fitted
from distances import far
from edges import COUNT, check_until, met

import warp_bounding as wb
from warp_bounding.bounders import DISTANCES, METHODS
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.proof import prove
from warp_bounding.shapes import Grid

CASES = [("mlp", "c"), *((m, "blob") for m in ("mlp", "mlp&deep", "kdop", "bvh"))]


@cache
def fitted(method: str, name: str) -> wb.Bounder:
    if "&" in method:
        return wb.cascade(*[fitted(part, name) for part in method.split("&")])
    if method == "deep":
        return wb.fit(shape(name), hidden=DEEP, steps=100, device="cpu")
    return fitted_query(name, method, "point", 1.0, 100) if method.startswith("mlp") else hardly_fitted(method, name)


def segments(grid: Grid, count: int, rng) -> tuple[np.ndarray, np.ndarray]:
    """From everywhere to everywhere, also outside the domain; some short, along an axis, without a length."""
    size = grid.upper - grid.lower
    starts = grid.lower + (rng.random((count, grid.ndim)) * 1.4 - 0.2) * size
    way = rng.normal(size=starts.shape) * size * 10.0 ** rng.uniform(-3, 0, (count, 1))
    way[: count // 10, 1:] = 0.0
    way[count // 10 : count // 8] = 0.0
    return starts.astype(np.float32), (starts + way).astype(np.float32)


@pytest.mark.parametrize(("method", "name"), CASES)
def test_cleared_segments_meet_no_point_of_the_object(method, name, rng):
    bounder, grid = fitted(method, name), shape(name)
    starts, ends = segments(grid, 20_000, rng)
    clear, until = wb.proof.clear_segments(bounder, starts, ends, first=True)
    quick = wb.proof.clear_segments(bounder, starts, ends)
    first = starts.astype(np.float64)
    begun = until > 0
    for t in np.linspace(0, 1, 101):
        assert not grid.contains(first[quick] + t * (ends - first)[quick]).any()
    for t in np.linspace(0, 1, 100, endpoint=False):  # nothing is said of the very place
        assert not grid.contains(first[begun] + t * until[begun, None] * (ends - first)[begun]).any()
    assert (until[clear] == 1).all()
    assert ((until >= 0) & (until <= 1)).all()
    assert 0 < quick.sum() < len(quick)
    assert (until[~clear] > 0).any()
    assert (quick != clear).mean() < 1e-2  # an end so near to the object that float32 does not deny it


@pytest.mark.parametrize(("method", "name"), [("mlp", "c"), ("mlp&deep", "blob")])
def test_one_segment_at_a_time_is_cleared_as_in_a_batch_or_farther(method, name, rng):
    """A network's lanes share a segment, of which they take shorter pieces."""
    bounder, grid = fitted(method, name), shape(name)
    starts, ends = segments(grid, 400, rng)
    starts[0, 0], ends[1] = np.nan, np.inf
    edge, quick = wb.proof.Segments(bounder), wb.proof.Segments(bounder, first=False)
    found = [edge(starts[i : i + 1], ends[i : i + 1]) for i in range(len(starts))]
    clear, until = (np.concatenate(each) for each in zip(*found, strict=True))
    batch = wb.proof.clear_segments(bounder, starts, ends, first=True)
    assert clear[batch[0]].mean() > 0.99
    assert (until >= batch[1] - 0.01).mean() > 0.99
    assert not clear[:2].any()
    assert ([quick(starts[i : i + 1], ends[i : i + 1])[0][0] for i in range(50)] == clear[:50]).mean() > 0.9
    starts, ends = starts[2:].astype(np.float64), ends[2:]
    for t in np.linspace(0, 1, 101):
        at = starts + t * until[2:, None] * (ends - starts)
        assert not grid.contains(at[(until[2:] > 0) & ((t < 1) | clear[2:])]).any()


@pytest.mark.parametrize("method", [m for m in CONSERVATIVE if not issubclass(METHODS[m], Mlp)])
def test_no_place_is_behind_a_volume(method, rng):
    if method in DISTANCES:
        for bounder in (hardly_fitted(method, "blob"), far(method, "blob")):
            check_until(bounder, shape("blob").contains, *segments(shape("blob"), COUNT, rng))
    else:
        with pytest.raises(BounderError, match="segments need"):
            wb.proof.Segments(hardly_fitted(method, "blob"))


@pytest.mark.parametrize("method", [m for m in DISTANCES if m not in METHODS or issubclass(METHODS[m], Mlp)])
def test_no_place_of_a_distance_is_behind_the_object(method, rng):
    check_until(far(method, "blob"), shape("blob").contains, *segments(shape("blob"), COUNT, rng))


def network(share: float, activation: str, seed: int) -> Mlp:
    """A random one, of small bends, that denies about this share of all points."""
    made = random_mlp(shape("c"), DEEP, activation, seed, gain=8.0)
    return denying(made, share, seed)


def denying(made: Mlp, share: float, seed: int) -> Mlp:
    """With a threshold for that; a little lower, as f of ``relu`` may be the same at many points."""
    f = made.reference(np.random.default_rng(seed).uniform(-1, 1, (1000, 2)) * made.domain.limit)
    return made.freeze(float(np.float32(np.quantile(f, share) - 0.05 * np.ptp(f))), None)


def several(share: float, *kinds):
    """Some of them, put together."""
    return lambda activation, seed: wb.cascade(*[k(share, activation, 10 * seed + i) for i, k in enumerate(kinds)])


OF_NETWORKS = {
    "one": partial(network, 0.8),
    "all": several(0.4, network, network, network),
}


@pytest.mark.parametrize("activation", ["relu", "sin"])
@pytest.mark.parametrize("kind", OF_NETWORKS)
def test_no_place_is_behind_what_networks_do_not_deny(kind, activation, rng):
    for seed in range(2):
        bounder = OF_NETWORKS[kind](activation, seed)
        ends = segments(shape("c"), COUNT, rng)
        check_until(bounder, lambda x, b=bounder: met(b, b.domain.to_local(x)), *ends)


def test_segments_that_end_in_the_object_are_never_cleared(rng):
    bounder, grid = fitted("mlp", "blob"), shape("blob")
    cells = grid.occupied[rng.integers(len(grid.occupied), size=5000)]
    ends = grid.position(cells + rng.choice([-0.5, 0.0, 0.5], cells.shape))
    starts = segments(grid, 5000, rng)[0]
    assert not wb.proof.clear_segments(bounder, starts, ends).any()
    assert not wb.proof.clear_segments(bounder, ends, ends).any()


@pytest.mark.filterwarnings("ignore:.*are they in other units")
def test_segments_through_the_object_from_far_away_are_not_cleared(rng):
    bounder, grid = fitted("mlp", "c"), shape("c")
    through = grid.position(grid.occupied[rng.integers(len(grid.occupied), size=200)]).astype(np.float64)
    for size in (1e3, 1e9, 1e300, 1.7e308):
        way = np.array([[size, 0.0]])
        assert not wb.proof.clear_segments(bounder, through - way, through + way).any()
        assert not wb.proof.clear_segments(bounder, through, through + way).any()


def test_a_network_at_the_very_edge_clears_no_corner_of_the_object(rng):
    """A threshold as high as the proof allows, and segments that end on corners of cells, where f is least."""
    bounder, grid = fitted("mlp", "c").to("cpu"), shape("c")
    prove(bounder, grid, eps=1e-6)
    corners = grid.position(
        (grid.occupied[:, None] + [[-0.5, -0.5], [-0.5, 0.5], [0.5, -0.5], [0.5, 0.5]]).reshape(-1, 2)
    )
    away = corners + rng.normal(size=(20, len(corners), 2)) * 10.0 ** rng.uniform(-6, 0, (20, len(corners), 1))
    for ends in away:
        assert not wb.proof.clear_segments(bounder, corners, ends).any()
        assert not wb.proof.clear_segments(bounder, ends, corners).any()


@pytest.mark.parametrize("activation", ["relu", "sin"])
def test_bounds_along_segments_hold(activation, rng):
    """Up to where a walk has come f stays under threshold + E, in float64: no slack."""
    grid = shape("blob")
    bounder = random_mlp(grid, (9, 7), activation)
    starts, ends = segments(grid, 2000, rng)
    middle = bounder.reference(bounder.domain.to_local((starts + ends) / 2))
    bounder.freeze(float(np.float32(np.quantile(middle, 0.7))), None)
    target = float(bounder.threshold) + bounder.rounding_bound()
    until = wb.proof.clear_segments(bounder, starts, ends, first=True)[1]
    first = starts.astype(np.float64)
    for share in np.linspace(0, 1, 100, endpoint=False):  # nothing is said of the very place
        v = bounder.domain.to_local(first + share * until[:, None] * (ends - first))
        within = (np.abs(v) <= bounder.domain.limit).all(axis=1) & (until > 0)
        assert (bounder.reference(v[within]) < target).all()
    assert ((until > 0) & (until < 1)).any()


def test_bad_input():
    bounder = fitted("mlp", "blob")
    with pytest.raises(BounderError, match="network or a volume of points"):
        wb.proof.clear_segments(hardly_fitted("voxels", "blob"), np.zeros((1, 3)), np.zeros((1, 3)))
    with pytest.raises(QueryError, match=r"\(N, 3\)"):
        wb.proof.clear_segments(bounder, np.zeros((1, 2)), np.zeros((1, 2)))
    bad = np.array([[np.nan, 0, 0], [np.inf, 0, 0]])
    assert not wb.proof.clear_segments(bounder, bad, np.zeros((2, 3))).any()
    with pytest.raises(QueryError, match="depth must be at least 0, got -1"):
        wb.proof.clear_segments(bounder, np.zeros((1, 3)), np.zeros((1, 3)), depth=-1)
    assert len(wb.proof.clear_segments(bounder, np.zeros((0, 3)), np.zeros((0, 3)))) == 0
