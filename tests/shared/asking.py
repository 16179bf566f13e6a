"""A bounder's function in a kernel as a user would write it, and its compilation for a CUDA device that is not there."""

from functools import cache

import numpy as np
import warp as wp

from warp_bounding.kernels.functions import Data
from warp_bounding.runtime.native import vector_type

ARCHITECTURE = 86


@cache
def asking_kernel(test, ndim: int) -> wp.Kernel:
    """A kernel as a user would write it."""
    vector = vector_type(ndim)

    @wp.kernel(module="unique", enable_backward=False)
    def ask(data: Data, q: wp.array(dtype=vector), answer: wp.array(dtype=wp.uint8)):
        i = wp.tid()
        if test(data, q[i]):
            answer[i] = wp.uint8(1)

    return ask


def ask(bounder, x: np.ndarray) -> np.ndarray:
    """Answers of ``bounder.func`` inside a user's kernel."""
    answer = wp.zeros(len(x), dtype=wp.uint8, device=bounder.device)
    q = wp.array(x, dtype=vector_type(bounder.ndim), device=bounder.device)
    wp.launch(asking_kernel(bounder.func, bounder.ndim), len(x), [bounder.data, q], [answer], device=bounder.device)
    return answer.numpy()


def check_compiles(kernel, folder):
    wp.compile_aot_module(kernel.module, device=None, arch=ARCHITECTURE, module_dir=folder)
    assert [*folder.rglob("*.ptx"), *folder.rglob("*.cubin")]
