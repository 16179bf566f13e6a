"""For ``test_functions``: a module that defines a kernel and a name twice, as README says and by a global name."""

import numpy as np
import warp as wp
from bounding_shapes import shape

import warp_bounding as wb
from warp_bounding.bounders import METHODS
from warp_bounding.queries.domain import Domain

# What the first lets through and the second denies would be lost, were the first one's kernel to ask the second.
BOUNDERS = [METHODS[method].fit(shape("star"), Domain.of(shape("star")), device="cpu") for method in ("aabb", "sphere")]


def launch(kernel: wp.Kernel, bounder, x: np.ndarray) -> np.ndarray:
    """What a kernel answers with the data of this bounder."""
    answer = wp.empty(len(x), dtype=wp.bool, device="cpu")
    inputs = [bounder.data, wp.array(x, dtype=wp.vec3, device="cpu")]
    wp.launch(kernel, dim=len(x), inputs=inputs, outputs=[answer], device="cpu")
    return answer.numpy()


bounder = BOUNDERS[0]
test = bounder.func


@wp.kernel(enable_backward=False)
def step(data: wb.Data, q: wp.array(dtype=wp.vec3), answer: wp.array(dtype=wp.bool)):
    i = wp.tid()
    answer[i] = wp.static(bounder.func)(data, q[i])


@wp.kernel(enable_backward=False)
def step_by_name(data: wb.Data, q: wp.array(dtype=wp.vec3), answer: wp.array(dtype=wp.bool)):
    i = wp.tid()
    answer[i] = test(data, q[i])


first, first_by_name = step, step_by_name
launch(first, bounder, np.zeros((1, 3), np.float32))

bounder = BOUNDERS[1]
test = bounder.func


@wp.kernel(enable_backward=False)
def step(data: wb.Data, q: wp.array(dtype=wp.vec3), answer: wp.array(dtype=wp.bool)):
    i = wp.tid()
    answer[i] = wp.static(bounder.func)(data, q[i])


@wp.kernel(enable_backward=False)
def step_by_name(data: wb.Data, q: wp.array(dtype=wp.vec3), answer: wp.array(dtype=wp.bool)):
    i = wp.tid()
    answer[i] = test(data, q[i])


second, second_by_name = step, step_by_name
STEPS, STEPS_BY_NAME = [first, second], [first_by_name, second_by_name]
