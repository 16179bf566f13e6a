"""A bounder's function in a kernel as a user would write it, its compilation for CUDA, and native texts run alone."""

from functools import cache

import numpy as np
import warp as wp

from warp_bounding.kernels.functions import Data
from warp_bounding.runtime.native import named, vector_type

ARCHITECTURE = 86
Floats = wp.array(dtype=wp.float32)


@cache
def asking_kernel(test, ndim: int, region: bool = False) -> wp.Kernel:
    """A kernel as a user would write it."""
    vector = vector_type(ndim)

    @wp.kernel(module="unique", enable_backward=False)
    def ask(data: Data, q: wp.array(dtype=vector), answer: wp.array(dtype=wp.bool)):
        i = wp.tid()
        if test(data, q[i]):
            answer[i] = True

    @wp.kernel(module="unique", enable_backward=False)
    def query_region(data: Data, a: wp.array(dtype=vector), b: wp.array(dtype=vector), answer: wp.array(dtype=wp.bool)):
        i = wp.tid()
        answer[i] = test(data, a[i], b[i])

    return query_region if region else ask


def ask(bounder, x: np.ndarray) -> np.ndarray:
    """Answers of ``bounder.func`` inside a user's kernel."""
    n, region, device = bounder.ndim, bounder.query_kind != "point", bounder.device
    answer = wp.zeros(len(x), dtype=wp.bool, device=device)
    parts = [x[:, :n], x[:, n:]] if region else [x]
    given = [wp.array(np.ascontiguousarray(part), dtype=vector_type(n), device=device) for part in parts]
    wp.launch(asking_kernel(bounder.func, n, region), len(x), [bounder.data, *given], [answer], device=device)
    return answer.numpy()


def check_compiles(kernel, folder):
    wp.compile_aot_module(kernel.module, device=None, arch=ARCHITECTURE, module_dir=folder)
    assert [*folder.rglob("*.ptx"), *folder.rglob("*.cubin")]


@cache
def _text_kernel(name: str, text: str) -> wp.Kernel:
    @named(name).block_kernel(text)
    def compute(x: Floats, numbers: Floats, block: int, out: Floats): ...

    return compute


def run_text(name: str, text: str, count: int, x: np.ndarray, numbers, shape, device="cpu") -> np.ndarray:
    """What a text writes to ``out`` when it is run for each ``block`` of ``count``; arrays are of float32."""
    given = [wp.array(np.ravel(a).astype(np.float32), dtype=wp.float32, device=device) for a in (x, numbers)]
    out = wp.zeros(int(np.prod(shape)), dtype=wp.float32, device=device)
    wp.launch(_text_kernel(name, text), (count, 1), [*given, 0], [out], device=device)
    return out.numpy().reshape(shape)
