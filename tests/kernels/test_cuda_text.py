"""The CUDA branches of all native texts compile, also where there is no CUDA device to run them on."""

import sys

import pytest
import warp as wp
from asking import asking_kernel, check_compiles
from bounding_shapes import random_bounder, random_mlp, random_network, random_supports, shape
from distances import far

from warp_bounding.bounders import DISTANCES, METHODS
from warp_bounding.kernels.distances import box_kernel, lanes_kernel, lines_kernel
from warp_bounding.kernels.functions import batch_kernel
from warp_bounding.networks.bounds import NetworkShape, PlainParametrization
from warp_bounding.networks.bounds import _kernel as bound_kernel
from warp_bounding.networks.parametrizations import BoxParametrization, RayParametrization, SegmentParametrization
from warp_bounding.proof.search import depth_first_kernel
from warp_bounding.proof.segments import _kernel as walk_kernel
from warp_bounding.proof.taylor import _kernel as checked_kernel
from warp_bounding.queries import QUERIES, registry

pytestmark = [
    pytest.mark.skipif(not hasattr(wp, "compile_aot_module"), reason="this Warp cannot compile ahead of time"),
    pytest.mark.skipif(sys.platform == "darwin", reason="Warp has no CUDA compiler on macOS"),
]
REGIONS = ("ray", "plane", "box")


@pytest.mark.parametrize("method", METHODS)
def test_batches_and_functions(method, tmp_path):
    bounder = random_bounder(method, "blob")
    check_compiles(batch_kernel(bounder.source, True, False), tmp_path / "batch")
    check_compiles(asking_kernel(bounder.func, 3), tmp_path / "function")


@pytest.mark.parametrize("query", REGIONS)
def test_regions_and_their_truth(query, tmp_path):
    grid = shape("blob")
    network = random_supports(grid) if query == "plane" else random_network(query, grid)
    check_compiles(batch_kernel(network.source, True, False), tmp_path / "placed")
    check_compiles(QUERIES[query].kernel(3), tmp_path / "exact")
    check_compiles(registry._kernel(query, 3), tmp_path / "sampled")


@pytest.mark.parametrize("activation", ["sin", "relu"])
def test_networks(activation, tmp_path):
    network = random_mlp(shape("blob"), (8,), activation)
    check_compiles(batch_kernel(network.source, False, True), tmp_path / "batch")
    check_compiles(bound_kernel(network.network.kernel_shape()), tmp_path / "bound")
    check_compiles(checked_kernel(network.network.kernel_shape()), tmp_path / "checked")
    check_compiles(walk_kernel(network.network.kernel_shape(SegmentParametrization(3))), tmp_path / "walk")


@pytest.mark.parametrize(
    "parametrization", [PlainParametrization(3), RayParametrization(6), BoxParametrization(6)], ids=repr
)
def test_searches(parametrization, tmp_path):
    shape = NetworkShape(parametrization.inputs, ((parametrization.inputs, 5, "sin"), (5, 4, "relu")), parametrization)
    check_compiles(bound_kernel(shape), tmp_path / "bound")
    check_compiles(depth_first_kernel(shape), tmp_path / "search")


@pytest.mark.parametrize("method", DISTANCES)
def test_distances(method, tmp_path):
    source = far(method, "blob").source
    kernels = [batch_kernel(source, True, False)]
    if method == "kdop":
        kernels += [batch_kernel(source, False, True), lanes_kernel(source)]
        kernels += [box_kernel(source), lines_kernel(source, True)]
    for number, kernel in enumerate(kernels):
        check_compiles(kernel, tmp_path / str(number))
