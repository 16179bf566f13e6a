"""The CUDA branches of all native texts compile, also where there is no CUDA device to run them on."""

import re
import sys

import numpy as np
import pytest
import warp as wp
from asking import ARCHITECTURE, asking_kernel, check_compiles
from bounding_shapes import domain_points, random_bounder, random_mlp, shape
from distances import far, points_around
from region_cases import REGIONS, fitted_region

from warp_bounding.arms.motions import _kernels as _motions
from warp_bounding.bounders import DISTANCES, METHODS
from warp_bounding.kernels.distances import box_kernel, lanes_kernel, lines_kernel
from warp_bounding.kernels.functions import batch_kernel, batch_snippet
from warp_bounding.kernels.source import LABEL
from warp_bounding.networks.bounds import _kernel as bound_kernel
from warp_bounding.networks.inference import MlpSource
from warp_bounding.proof.segments import SegmentParametrization
from warp_bounding.proof.segments import _kernel as walk_kernel
from warp_bounding.proof.taylor import _kernel as checked_kernel
from warp_bounding.queries import QUERIES
from warp_bounding.queries.placement import Placement
from warp_bounding.runtime.native import Numbers, named, unique_name

pytestmark = [
    pytest.mark.skipif(not hasattr(wp, "compile_aot_module"), reason="this Warp cannot compile ahead of time"),
    pytest.mark.skipif(sys.platform == "darwin", reason="Warp has no CUDA compiler on macOS"),
]


@pytest.mark.parametrize("method", METHODS)
def test_batches_and_functions(method, tmp_path):
    bounder = random_bounder(method, "blob")
    check_compiles(batch_kernel(bounder.source, True, False), tmp_path / "batch")
    check_compiles(asking_kernel(bounder.func, 3), tmp_path / "function")


@pytest.mark.parametrize("query", REGIONS)
def test_regions_and_their_truth(query, tmp_path):
    grid = shape("blob")
    bounder = fitted_region("bvh", query, grid)
    check_compiles(batch_kernel(bounder.source, True, False), tmp_path / "placed")
    check_compiles(QUERIES[query].kernel(3), tmp_path / "exact")


@pytest.mark.parametrize("activation", ["sin", "relu"])
def test_networks(activation, tmp_path):
    network = random_mlp(shape("blob"), (8,), activation)
    check_compiles(batch_kernel(network.source, False, True), tmp_path / "batch")
    check_compiles(bound_kernel(network.network.kernel_shape()), tmp_path / "bound")
    check_compiles(checked_kernel(network.network.kernel_shape()), tmp_path / "checked")
    check_compiles(walk_kernel(network.network.kernel_shape(SegmentParametrization(3))), tmp_path / "walk")


@pytest.mark.parametrize("method", DISTANCES)
def test_distances(method, tmp_path):
    source = far(method, "blob").source
    kernels = [batch_kernel(source, True, False)]
    if method == "kdop":
        kernels += [batch_kernel(source, False, True), lanes_kernel(source)]
        kernels += [box_kernel(source), lines_kernel(source, True)]
    for number, kernel in enumerate(kernels):
        check_compiles(kernel, tmp_path / str(number))


def test_motions(tmp_path):
    check_compiles(_motions().segments, tmp_path)


def on_cpu(source, placed: bool, values: bool, x: np.ndarray, parameters: wp.array, placement: list) -> np.ndarray:
    """What the CUDA text of a batch writes, run on a CPU, thread by thread and without fused operations."""
    snippet = batch_snippet(source, placed, values).replace("!defined(__CUDA_ARCH__)", "0", 1)
    dtype = wp.float32 if values else wp.bool

    @named(unique_name(source, f"cuda_{source.several}_{placed}_{values}")).block_kernel(
        f"#pragma clang fp contract(off)\n#define __device__\n{snippet}"
    )
    def kernel(
        x: Numbers,
        count: int,
        block: int,
        parameters: Numbers,
        words: wp.array(dtype=wp.uint32),
        placement: Numbers,
        out: wp.array(dtype=dtype),
    ): ...

    out, words = wp.full(len(x), 7, dtype=dtype, device="cpu"), wp.zeros(1, dtype=wp.uint32, device="cpu")
    given = [wp.array(each, dtype=float, device="cpu") for each in (x.reshape(-1), placement)]
    wp.launch(kernel, source.threads(len(x)), [given[0], len(x), 0, parameters, words, given[1]], [out], device="cpu")
    return out.numpy()


@pytest.mark.parametrize(
    ("kind", "placed", "values"),
    [("point", True, False), ("point", False, True), ("distance", True, False), ("distance", False, True)],
)
def test_threads_with_several_queries_answer_as_those_with_one(kind, placed, values, monkeypatch, rng):
    grid = shape("blob")
    if kind == "distance":
        bounder, x = far("mlp", "blob"), points_around(grid, 500, rng)
        placement = rng.uniform(0, 2 * grid.extent.max(), 1000)  # radii
    else:
        bounder, x = random_mlp(grid, (24, 24), gain=2.0), domain_points(grid, 1000, rng)
        placement = Placement.of(bounder.domain, [0.1, 0.0, 0.0, 0.0, 0.0, 0.6, 0.8], None).values
    source, parameters = bounder.source, wp.clone(bounder.data.parameters)
    threshold = LABEL + (8 if kind == "distance" else 9)
    parameters.numpy()[threshold] = 1.0 if kind == "distance" else -0.5  # so that few neurons make a difference
    x[::50], x[7] = 1e3, np.nan
    for count in (1, 95, 1000):
        given = placed, values, np.ascontiguousarray(x[:count], np.float32), parameters, placement
        assert source.several == 3
        several = on_cpu(source, *given)
        with monkeypatch.context() as patched:
            patched.setattr(MlpSource, "several", 1)
            one = on_cpu(source, *given)
        assert np.array_equal(several, one)
    assert len(np.unique(one)) > 250 if values else 0.1 < one.mean() < 0.9


@pytest.mark.parametrize(("hidden", "blocks", "most"), [((24, 24), 3, 250), ((32, 32), 4, 415), ((50, 50), 5, 1420)])
def test_numbers_that_a_query_loads(hidden, blocks, most, tmp_path):
    source = MlpSource(3, False, hidden, "sin")
    wp.compile_aot_module(
        batch_kernel(source, False, False).module, arch=[ARCHITECTURE], module_dir=tmp_path, use_ptx=True
    )
    text = next(tmp_path.glob("*.ptx")).read_text()
    assert ".local" not in text
    # Two loops are left: Warp's over threads, and in it that over blocks of neurons of the last layer.
    starts = {label[1]: label.end() for label in re.finditer(r"^(\$\w+):", text, re.MULTILINE)}
    jumps = re.finditer(r"bra(?:\.uni)?\s+(\$\w+);", text)
    loops = [text[starts[jump[1]] : jump.start()] for jump in jumps if starts[jump[1]] < jump.start()]
    assert len(loops) == 2
    inner = min(loops, key=len)
    loads = (text.count("ld.global") + (blocks - 1) * inner.count("ld.global")) / source.several
    assert loads <= most
