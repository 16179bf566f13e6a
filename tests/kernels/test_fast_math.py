"""A module's options do not change what a bounder's function computes: not ``fast_math``, and flags that would are refused."""

import sys
from itertools import pairwise

import numpy as np
import pytest
import warp as wp
from bounding_shapes import shape

import warp_bounding as wb
from warp_bounding.bounders import METHODS
from warp_bounding.kernels.functions import Data
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.runtime.native import vector_type

ARCHITECTURE = 86
FAST = "-march=native -mreassociate -freciprocal-math"  # the parts of -ffast-math that no macro tells of
QUERIES = ("point", "ray", "plane", "box")


def bounder_of(method: str, query: str) -> wb.Bounder:
    """Of a network with random weights and tanh, which divides; all networks are made of the same text."""
    if method != "mlp":
        options = {"steps": 2} if method in ("learned-kdop", "relu-field") else {}
        return wb.fit(shape("c"), query=query, method=method, device="cpu", **options)
    domain, rng, tensors = domain_of(shape("c"), query, 0.5), np.random.default_rng(5), {}
    widths = (2 if query == "plane" else domain.ndim, 4, 4, 2 if query == "plane" else 1)
    for index, (k, h) in enumerate(pairwise(widths)):
        tensors[f"layers.{index}.weight"] = rng.normal(size=(h, k)).astype(np.float32)
        tensors[f"layers.{index}.bias"] = rng.normal(size=h).astype(np.float32)
    return wb.METHODS["mlp"](domain, tensors, {"hidden": [4, 4], "activation": "tanh", "octaves": 0}, "cpu")


def asking_kernel(bounder: wb.Bounder, module: wp.Module) -> wp.Kernel:
    """A kernel as a user would write it."""
    test, vector = bounder.func, vector_type(bounder.ndim)

    def ask_point(data: Data, q: wp.array(dtype=vector), answer: wp.array(dtype=wp.uint8)):
        i = wp.tid()
        if wp.static(test)(data, q[i]):
            answer[i] = wp.uint8(1)

    def ask_region(data: Data, q: wp.array2d(dtype=vector), answer: wp.array(dtype=wp.uint8)):
        i = wp.tid()
        if wp.static(test)(data, q[i, 0], q[i, 1]):
            answer[i] = wp.uint8(1)

    ask = ask_point if bounder.query_kind == "point" else ask_region
    ask.__qualname__ = ask.__name__ = f"ask_{bounder.method.replace('-', '_')}"
    return wp.kernel(ask, module=module, enable_backward=False)


def module_of(name: str, **options) -> wp.Module:
    module = wp.get_module(f"test_fast_math_{name}")
    module.options.update(options)
    return module


def ask(bounder: wb.Bounder, x: np.ndarray, **options) -> np.ndarray:
    module = module_of("_".join([bounder.method, bounder.query_kind, *options]), **options)
    answer = wp.zeros(len(x), dtype=wp.uint8, device="cpu")
    q = x if bounder.query_kind == "point" else x.reshape(len(x), 2, bounder.ndim)
    inputs = [bounder.data, wp.array(q, dtype=vector_type(bounder.ndim), device="cpu")]
    wp.launch(asking_kernel(bounder, module), len(x), inputs, [answer], device="cpu")
    return answer.numpy()


@pytest.mark.skipif(not hasattr(wp, "compile_aot_module"), reason="this Warp cannot compile ahead of time")
@pytest.mark.skipif(sys.platform == "darwin", reason="Warp has no CUDA compiler on macOS")
@pytest.mark.parametrize("query", [q if q == "point" else pytest.param(q, marks=pytest.mark.slow) for q in QUERIES])
def test_on_cuda_fast_math_approximates_nothing_in_it(query, tmp_path):
    """Read in the machine code of all methods' functions: quotients and roots stay rounded to nearest."""
    module = module_of(f"cuda_{query}", fast_math=True)
    names = [n for n, kind in METHODS.items() if (kind.exact_on_cells or n == "mlp") and kind.supports(query, 2)]
    kernels = [asking_kernel(bounder_of(name, query), module) for name in names]
    wp.compile_aot_module(module, device=None, arch=ARCHITECTURE, module_dir=tmp_path, use_ptx=True)
    (code,) = (path.read_text() for path in tmp_path.rglob("*.ptx"))
    assert all(kernel.key in code for kernel in kernels)
    assert "fma.rn.ftz.f32" in code  # the option is in force
    assert "div.rn.ftz.f32" in code  # at least tanh divides
    assert ("sqrt.rn.ftz.f32" in code) == (query == "ray")
    assert ".approx" not in code
    assert "div.full" not in code


@pytest.mark.parametrize(
    ("method", "query"), [("kdop", "point"), ("kdop", "ray"), ("mlp", "point"), ("mlp", "plane"), ("mlp", "box")]
)
def test_on_a_cpu_its_numbers_are_not_reordered(method, query, rng):
    bounder = bounder_of(method, query)
    x = rng.uniform(-0.2, 1.2, (20_000, bounder.domain.columns)).astype(np.float32)
    if query == "box":
        x = np.concatenate([np.minimum(x[:, :2], x[:, 2:]), np.maximum(x[:, :2], x[:, 2:])], axis=1)
    x[:5, 0] = np.nan, np.inf, -np.inf, np.nan, np.inf
    expected = ask(bounder, x)
    assert expected[:5].all()
    assert (ask(bounder, x, cpu_compiler_flags=FAST) == expected).all()
    assert (ask(bounder, x, fast_math=True) == expected).all()


def test_on_a_cpu_finite_math_is_refused(capfd):
    bounder = bounder_of("aabb", "point")
    with pytest.raises(Exception, match="build failed"):
        ask(bounder, np.zeros((3, 2), np.float32), cpu_compiler_flags="-march=native -ffast-math")
    assert "warp_bounding: proofs are about IEEE arithmetic" in capfd.readouterr().err
