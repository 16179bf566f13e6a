"""The CUDA branches of the native sources compile, also where there is no CUDA device to run them on."""

import sys

import pytest
import warp as wp
from asking import check_compiles
from bounding_shapes import random_bounder, random_mlp, shape

from warp_bounding.bounders import METHODS
from warp_bounding.kernels.functions import Data, batch_kernel
from warp_bounding.networks.bounds import NetworkShape, PlainChart
from warp_bounding.networks.bounds import _kernel as bound_kernel
from warp_bounding.networks.charts import BoxChart, RayChart
from warp_bounding.proof.search import depth_first_kernel

pytestmark = [
    pytest.mark.skipif(not hasattr(wp, "compile_aot_module"), reason="this Warp cannot compile ahead of time"),
    pytest.mark.skipif(sys.platform == "darwin", reason="Warp has no CUDA compiler on macOS"),
]


@pytest.mark.parametrize("method", METHODS)
def test_batch_kernels_compile(method, tmp_path):
    check_compiles(batch_kernel(random_bounder(method, "blob").source, True, False), tmp_path)


@pytest.mark.parametrize("method", METHODS)
def test_functions_compile(method, tmp_path):
    test = random_bounder(method, "blob").func

    @wp.kernel(module="unique", enable_backward=False)
    def ask(data: Data, q: wp.array(dtype=wp.vec3), answer: wp.array(dtype=wp.uint8)):
        i = wp.tid()
        answer[i] = wp.uint8(test(data, q[i]))

    check_compiles(ask, tmp_path)


@pytest.mark.parametrize("activation", ["sin", "relu", "tanh"])
def test_kernels_of_networks_compile(activation, tmp_path):
    network = random_mlp(shape("blob"), (8,), activation, 1)
    check_compiles(batch_kernel(network.source, False, True), tmp_path)
    check_compiles(bound_kernel(network.network.kernel_shape()), tmp_path)


@pytest.mark.parametrize("chart", [PlainChart(3), RayChart(6), RayChart(4), BoxChart(6)], ids=repr)
def test_searches_compile(chart, tmp_path):
    shape = NetworkShape(chart.inputs, ((chart.inputs, 5, "sin", 0), (5, 4, "tanh", 0)), chart)
    check_compiles(bound_kernel(shape), tmp_path / "bound")
    check_compiles(depth_first_kernel(shape), tmp_path / "search")
