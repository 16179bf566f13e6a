"""Batch kernels and functions for other kernels against the reference, within the proven rounding bound and no more."""

import numpy as np
import pytest
from asking import ask
from bounding_shapes import (
    NETWORKS,
    SHAPES,
    crossed,
    device_coordinates,
    domain_points,
    object_points,
    random_bounder,
    random_mlp,
    rounding_of_answers,
    shape,
)

from warp_bounding.bounders import METHODS

COUNTS = (1, 511, 513, 2049)
DEEP = ("bvh", "learned-kdop", "relu-field", "voxels", "mlp")  # in other dimensions than three


def check_values(bounder, x: np.ndarray) -> None:
    """``f`` of the batch kernel is within the bound of the exact ``f`` at the very coordinates that the device has."""
    v, values = device_coordinates(bounder, x), bounder.values(x).numpy().astype(np.float64)
    inside = (np.abs(v) <= bounder.domain.limit).all(axis=1)
    away = np.inf if bounder.domain.time else -np.inf
    in_time = np.abs(v[:, 0]) <= bounder.domain.limit[0]
    assert (values[~inside & ~in_time] == away).all()
    assert (values[~inside & in_time] == -np.inf).all()
    assert inside.any()
    v, values = v[inside], values[inside]
    assert (values >= bounder.bound(v, v).lower - bounder.rounding_bound()).all()
    if bounder.method == "voxels":  # which cells are near is itself decided in float32
        twin = bounder.reference(v)
        wider = np.stack([bounder.reference(v + s * 1e-5 / bounder.tensors["factor"]) for s in (-1, 1)]).max(axis=0)
        assert (values <= np.maximum(twin, wider)).all()
    else:
        assert (np.abs(values - bounder.reference(v)) <= bounder.rounding_bound()).all()


def check_func(bounder, x: np.ndarray) -> None:
    """The function agrees with the batch kernel wherever rounding cannot matter, and both with the exact ``f``."""
    v, error = device_coordinates(bounder, x), rounding_of_answers(bounder)
    exact = bounder.reference(v)
    inside = (np.abs(v) <= bounder.domain.limit).all(axis=1)
    in_time = np.abs(v[:, 0]) <= bounder.domain.limit[0] if bounder.domain.time else np.ones(len(v), bool)
    for quantile in (0.1, 0.5, 0.9):
        bounder.freeze(float(np.float32(np.quantile(exact[inside], quantile))), None)
        sure = np.abs(exact - float(bounder.threshold)) > error
        expected = np.where(inside, exact >= bounder.threshold, ~in_time)
        for answers in (ask(bounder, x), bounder.query(x).numpy()):
            assert (answers == expected)[sure | ~inside].all()


@pytest.mark.parametrize(("method", "name"), crossed(METHODS, ["c", "blob", "animated"], kinds=DEEP))
def test_batch_kernel_is_its_reference(method, name, device, rng):
    bounder, grid = random_bounder(method, name, device), shape(name)
    check_values(bounder, np.concatenate([domain_points(grid, 6000, rng), object_points(grid, rng, 1000)]))


@pytest.mark.parametrize("method", METHODS)
def test_function_for_kernels_is_the_batch_kernel(method, device, rng):
    bounder, grid = random_bounder(method, "blob", device), shape("blob")
    x = np.concatenate([domain_points(grid, 4000, rng), object_points(grid, rng, 1000)])
    if method != "voxels":
        check_func(bounder, x)
        return
    bounder.freeze(0.5, None)
    values = bounder.values(x).numpy()
    certain = np.abs(values) <= 1
    assert (bounder.query(x).numpy()[certain] == values[certain]).all()
    assert (ask(bounder, x) == bounder.query(x).numpy()).mean() > 0.999  # cells within a rounding error of the reach
    assert ask(bounder, object_points(grid, rng, 500)).all()


@pytest.mark.parametrize(("hidden", "activation"), NETWORKS)
def test_networks_of_any_width(hidden, activation, device, rng):
    grid = shape("blob")
    x = domain_points(grid, 4000, rng)
    bounder = random_mlp(grid, hidden, activation, device=device)
    check_values(bounder, x)
    check_func(bounder, x)


@pytest.mark.parametrize("method", ["voxels", "mlp"])
def test_answers_do_not_depend_on_the_number_of_queries(method, device, monkeypatch, rng):
    bounder = random_bounder(method, "blob", device)
    x = domain_points(shape("blob"), 40 * 512 + 77, rng)
    x[::97] = np.nan
    bounder.freeze(float(np.float32(np.median(bounder.reference(device_coordinates(bounder, x[1:90]))))), None)
    monkeypatch.setenv("WARP_BOUNDING_THREADS", "2")
    everything, values = bounder.query(x).numpy(), bounder.values(x).numpy()
    assert everything[::97].all()
    for count in COUNTS:
        start = int(rng.integers(1000))
        part = x[start : start + count]
        assert (bounder.query(part).numpy() == everything[start : start + count]).all()
        assert (bounder.values(part).numpy() == values[start : start + count]).all()


@pytest.mark.parametrize("method", METHODS)
def test_special_numbers(method, device):
    bounder = random_bounder(method, "blob", device)
    bounder.freeze(np.inf, None)  # whatever reaches the comparison is answered with no
    special = np.float32([np.nan, np.inf, -np.inf])
    x = np.full((9, 3), 0.5, np.float32)
    x[np.arange(9), np.arange(9) % 3] = np.repeat(special, 3)
    assert bounder.query(x).numpy().all()
    assert ask(bounder, x).all()
    assert (bounder.values(x).numpy() == np.inf).all()
    far = np.float32([[3.4e38, 0.5, 0.5], [-3.4e38] * 3, [0.5, 0.5, 7.0], [1e-45, -1e-45, -7.0]])
    assert not bounder.query(far).numpy().any()
    assert not ask(bounder, far).any()


@pytest.mark.parametrize("name", SHAPES)
def test_the_map_moves_points_by_less_than_delta(name, rng):
    bounder, grid = random_bounder("aabb", name), shape(name)
    exact = grid.lower + rng.random((5000, grid.ndim)) * (grid.upper - grid.lower)
    computed = device_coordinates(bounder, exact.astype(np.float32))
    assert (np.abs(computed - bounder.domain.to_local(exact)) <= bounder.domain.delta / 4).all()
    space = slice(int(grid.time), None)
    assert (np.abs(computed) <= bounder.domain.limit)[:, space].all()
