"""Plain Warp kernels say what the native text says, but for rounding."""

import numpy as np
import pytest
import warp as wp
from bounding_shapes import domain_points, fitted, random_mlp, shape

from warp_bounding.activations import ACTIVATIONS
from warp_bounding.kernels.plain import kdop_kernel, mlp_kernel


def asked(bounder, kernel, x: np.ndarray, numbers: list[np.ndarray]) -> np.ndarray:
    domain, f = bounder.domain, wp.empty(len(x), dtype=wp.float32, device=bounder.device)
    given = [x, domain.center, domain.scale, domain.limit, *numbers]
    inputs = [wp.array(np.ascontiguousarray(each).reshape(-1), device=bounder.device) for each in given]
    wp.launch(kernel, len(x), inputs, [f], device=bounder.device)
    return f.numpy().astype(np.float64)


def check(bounder, plain: np.ndarray, x: np.ndarray) -> None:
    native, v = bounder.values(x).numpy().astype(np.float64), bounder.domain.to_local(x)
    inside, error = np.isfinite(native), bounder.rounding_bound()
    assert (np.isfinite(plain) == inside).all()
    assert inside.sum() > 1000
    assert (np.abs(plain[inside] - native[inside]) <= 2 * error).all()
    assert (np.abs(plain - bounder.reference(v))[inside] <= 2 * error + 1e-3).all()


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_networks(activation, device, rng):
    bounder = random_mlp(shape("blob"), (9, 6), activation, device=device)
    x, layers = domain_points(shape("blob"), 3000, rng), range(3)
    numbers = [bounder.tensors[f"layers.{i}.{part}"].reshape(-1) for i in layers for part in ("bias", "weight")]
    sizes = np.array([3, 9, 6, 1], np.int32)
    check(bounder, asked(bounder, mlp_kernel(9, activation), x, [sizes, np.concatenate(numbers)]), x)


def test_half_spaces(device, rng):
    bounder, x = fitted("kdop", "blob").to(device), domain_points(shape("blob"), 3000, rng)
    slabs = bounder.shape
    numbers = [np.float32(each) for each in (slabs.directions, slabs.low, slabs.high)]
    check(bounder, asked(bounder, kdop_kernel, x, numbers), x)
