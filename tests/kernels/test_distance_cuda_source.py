"""The CUDA branches of distances compile, also where there is no CUDA device to run them on."""

import sys

import pytest
import warp as wp
from asking import check_compiles
from distances import far

from warp_bounding.bounders import DISTANCES
from warp_bounding.kernels.distance_batch import (
    box_kernel,
    distance_kernel,
    lanes_kernel,
    lines_kernel,
)

pytestmark = [
    pytest.mark.skipif(not hasattr(wp, "compile_aot_module"), reason="this Warp cannot compile ahead of time"),
    pytest.mark.skipif(sys.platform == "darwin", reason="Warp has no CUDA compiler on macOS"),
]


@pytest.mark.parametrize("method", DISTANCES)
def test_distances_compile(method, tmp_path):
    source = far(method, "blob").source
    check_compiles(distance_kernel(source, False), tmp_path / "radius")
    check_compiles(lanes_kernel(source), tmp_path / "lanes")


def test_all_kernels_compile(tmp_path):
    source = far("oriented-ellipsoid", "blob").source
    kernels = [
        distance_kernel(source, True),
        box_kernel(source),
        lines_kernel(source, True),
    ]
    for number, kernel in enumerate(kernels):
        check_compiles(kernel, tmp_path / str(number))
