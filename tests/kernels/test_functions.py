"""A function answers *maybe* to data that are not its own or not all there; options of modules change nothing."""

import re
import sys
from functools import cache
from importlib.resources import files

import numpy as np
import pytest
import rebound
import warp as wp
from asking import asking_kernel
from bounding_shapes import HIDDEN, random_mlp, shape

import warp_bounding as wb
from warp_bounding.bounders import METHODS
from warp_bounding.bounders.cascade import Cascade
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.kernels.functions import Data
from warp_bounding.kernels.source import LABEL
from warp_bounding.queries.region_domain import domain_of
from warp_bounding.runtime.native import native_text, vector_type

QUERIES = ("point", "ray", "plane", "box")
FEW = ("aabb", "bvh", "mlp")  # methods of regions: what tells data apart is the same text for all
FAR = 1e3  # outside of every domain


def network(kind: type[Mlp], query: str, device: str) -> Mlp:
    domain = domain_of(shape("c"), query)
    made = random_mlp(None, HIDDEN, domain=domain)
    return kind(domain, made.tensors, made.sizes, device)


@cache
def bounders(query: str, device: str) -> dict:
    """One of every method of points, of a few of regions, and cascades; equal sources once."""
    found = {}
    for method, kind in METHODS.items():
        if not kind.supports(query, 2) or (query != "point" and method not in FEW):
            continue
        if issubclass(kind, Mlp):
            found[method] = network(kind, query, device)
        else:
            found[method] = kind.fit(shape("c"), domain_of(shape("c"), query), device=device)
    found["cascade"] = Cascade.of([found["aabb"], found.get("mlp", found["bvh"])])
    if query == "point":
        found["voxels+mlp"] = Cascade.of([found["voxels"], found["mlp"]])
    return {bounder.source: bounder for bounder in found.values()}


def ask(bounder, data: Data) -> np.ndarray:
    """Answers of a bounder's function, given some data, to queries far away: with its own it certainly says no."""
    query, device = bounder.query_kind, bounder.device
    first = {"point": [FAR, FAR], "ray": [FAR, FAR], "plane": [1.0, 1.0], "box": [FAR, FAR]}[query]
    second = {"point": [FAR, FAR], "ray": [1.0, 1.0], "plane": [4.0, 4.0], "box": [FAR + 1, FAR + 1]}[query]
    a, b = (wp.array(np.float32([row] * 3), dtype=wp.vec2, device=device) for row in (first, second))
    answer, given = wp.zeros(3, dtype=wp.bool, device=device), [a] if query == "point" else [a, b]
    wp.launch(asking_kernel(bounder.func, 2, query != "point"), 3, [data, *given], [answer], device=device)
    return answer.numpy()


def remade(data: Data, parameters: slice, words: slice) -> Data:
    """The data in memory of their own that holds no more than a part of them."""
    part = Data()
    part.parameters = wp.array(data.parameters.numpy()[parameters], dtype=wp.float32, device=data.parameters.device)
    part.words = wp.array(data.words.numpy()[words], dtype=wp.uint32, device=data.words.device)
    return part


@pytest.mark.parametrize("query", QUERIES)
def test_data_of_another_source_are_answered_with_maybe(query, device):
    everyone = bounders(query, device)
    for source, bounder in everyone.items():
        assert (ask(bounder, bounder.data) == 0).all()
        for other, foreign in everyone.items():
            assert (ask(bounder, foreign.data) == (source != other)).all(), f"{source} took data of {other}"


@pytest.mark.parametrize("query", QUERIES)
def test_data_that_are_too_short_are_answered_with_maybe(query, device):
    everything = slice(None)
    for bounder in bounders(query, device).values():
        data, source = bounder.data, bounder.source
        assert (ask(bounder, remade(data, everything, everything)) == 0).all()
        assert (ask(bounder, Data()) == 1).all()
        lengths = {0, 1, LABEL - 1, LABEL, source.start - 1, source.start, len(data.parameters) - 1}
        for length in sorted(lengths):
            assert (ask(bounder, remade(data, slice(length), everything)) == 1).all()
        for length in {0, len(data.words) - 1}:
            assert (ask(bounder, remade(data, everything, slice(length))) == 1).all()
        for name, dtype in (("parameters", wp.float32), ("words", wp.uint32)):
            strided = remade(data, everything, everything)
            twice = np.repeat(getattr(data, name).numpy(), 2)
            setattr(strided, name, wp.array(twice, dtype=dtype, device=bounder.device)[::2])
            assert (ask(bounder, strided) == 1).all()


def test_data_of_an_equal_source_are_taken(device):
    """Functions are compiled for sizes: bounders of the same sizes share one, each with its own data."""
    grid, domain = shape("c"), domain_of(shape("c"))
    small, large = (METHODS["bvh"].fit(grid, domain, leaves=leaves, device=device) for leaves in (2, 9))
    assert large.func is small.func
    assert len(large.data.parameters) != len(small.data.parameters)
    assert (ask(small, large.data) == 0).all()
    assert (ask(large, small.data) == 0).all()


def test_a_kernel_keeps_its_function_when_the_module_gets_another(rng):
    """README's kernel, twice in one module with the same names; and with a global function, which is rebound."""
    x = (rng.random((4000, 3)) * 1.2 - 0.1).astype(np.float32)
    expected = [bounder.query(x).numpy() for bounder in rebound.BOUNDERS]
    assert (expected[0] > expected[1]).any()
    for kernels, kept in ((rebound.STEPS, True), (rebound.STEPS_BY_NAME, False)):
        for _ in range(2):  # the second time from a module that was built anew
            answers = [rebound.launch(k, b, x) for k, b in zip(kernels, rebound.BOUNDERS, strict=True)]
            for answer, right in zip(answers, expected, strict=True):
                assert (answer >= right).all()
                assert (answer == right).all() or not kept
            assert (answers[0].all()) == (not kept)
            kernels[0].module.unload()


ARCHITECTURE = 86
FAST = "-march=native -mreassociate -freciprocal-math"  # the parts of -ffast-math that no macro tells of


def bounder_of(method: str, query: str) -> wb.Bounder:
    """A network with random weights: all networks share one text, so one stands for all."""
    if method != "mlp":
        options = {"steps": 2} if method in ("learned-kdop", "relu-field") else {}
        return wb.fit(shape("c"), query=query, method=method, device="cpu", **options)
    return random_mlp(None, (4, 4), "sin", seed=5, domain=domain_of(shape("c"), query))


def kernel_in(bounder: wb.Bounder, module: wp.Module) -> wp.Kernel:
    """A kernel as a user would write it."""
    test, vector = bounder.func, vector_type(bounder.ndim)

    def query_point(data: Data, q: wp.array(dtype=vector), answer: wp.array(dtype=wp.bool)):
        i = wp.tid()
        if wp.static(test)(data, q[i]):
            answer[i] = True

    def query_region(data: Data, q: wp.array2d(dtype=vector), answer: wp.array(dtype=wp.bool)):
        i = wp.tid()
        answer[i] = wp.static(test)(data, q[i, 0], q[i, 1])

    ask = query_point if bounder.query_kind == "point" else query_region
    ask.__qualname__ = ask.__name__ = f"ask_{bounder.method.replace('-', '_')}"
    return wp.kernel(ask, module=module, enable_backward=False)


def module_of(name: str, **options) -> wp.Module:
    module = wp.get_module(f"test_fast_math_{name}")
    module.options.update(options)
    return module


def asked_in_module(bounder: wb.Bounder, x: np.ndarray, **options) -> np.ndarray:
    module = module_of("_".join([bounder.method, bounder.query_kind, *options]), **options)
    answer = wp.zeros(len(x), dtype=wp.bool, device="cpu")
    q = x if bounder.query_kind == "point" else x.reshape(len(x), 2, bounder.ndim)
    inputs = [bounder.data, wp.array(q, dtype=vector_type(bounder.ndim), device="cpu")]
    wp.launch(kernel_in(bounder, module), len(x), inputs, [answer], device="cpu")
    return answer.numpy()


@pytest.mark.skipif(not hasattr(wp, "compile_aot_module"), reason="this Warp cannot compile ahead of time")
@pytest.mark.skipif(sys.platform == "darwin", reason="Warp has no CUDA compiler on macOS")
@pytest.mark.parametrize("query", ["point", pytest.param("ray", marks=pytest.mark.slow)])
def test_on_cuda_fast_math_approximates_nothing_in_it(query, tmp_path):
    """Read in the machine code of all methods' functions: quotients and roots stay rounded to nearest."""
    module = module_of(f"cuda_{query}", fast_math=True)
    names = [n for n, kind in METHODS.items() if (kind.exact_on_cells or n == "mlp") and kind.supports(query, 2)]
    kernels = [kernel_in(bounder_of(name, query), module) for name in names]
    wp.compile_aot_module(module, device=None, arch=ARCHITECTURE, module_dir=tmp_path, use_ptx=True)
    (code,) = (path.read_text() for path in tmp_path.rglob("*.ptx"))
    assert all(kernel.key in code for kernel in kernels)
    assert "fma.rn.ftz.f32" in code  # the option is in force
    assert ("div.rn.ftz.f32" in code) == (query == "ray")
    assert ("sqrt.rn.ftz.f32" in code) == (query == "ray")
    assert ".approx" not in code
    assert "div.full" not in code


@pytest.mark.parametrize(("method", "query"), [("kdop", "ray"), ("mlp", "point"), ("kdop", "plane")])
def test_on_a_cpu_its_numbers_are_not_reordered(method, query, rng):
    bounder = bounder_of(method, query)
    x = rng.uniform(-0.2, 1.2, (20_000, bounder.domain.columns)).astype(np.float32)
    x[:5, 0] = np.nan, np.inf, -np.inf, np.nan, np.inf
    expected = asked_in_module(bounder, x)
    assert expected[:5].all()
    assert (asked_in_module(bounder, x, cpu_compiler_flags=FAST) == expected).all()
    assert (asked_in_module(bounder, x, fast_math=True) == expected).all()


def test_on_a_cpu_finite_math_is_refused(capfd):
    bounder = bounder_of("aabb", "point")
    with pytest.raises(Exception, match="build failed"):
        asked_in_module(bounder, np.zeros((3, 2), np.float32), cpu_compiler_flags="-march=native -ffast-math")
    assert "warp_bounding: proofs are about IEEE arithmetic" in capfd.readouterr().err


@pytest.mark.parametrize("name", [file.name for file in files("warp_bounding").joinpath("native").iterdir()])
def test_errors_of_the_compiler_name_lines_of_a_file(name):
    whole = files("warp_bounding").joinpath("native", name).read_text().splitlines()
    for text in vars(native_text(name)).values():
        lines, number = text.splitlines()[1:], None
        for line in lines:
            if place := re.fullmatch(rf'#line (\d+) "warp_bounding/native/{name}"', line):
                number = int(place[1])
            elif number <= len(whole):
                assert line == whole[number - 1]
                number += 1
