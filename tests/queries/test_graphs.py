"""Queries in a CUDA graph: captured once and replayed for other queries, they answer as calls do."""

import numpy as np
import pytest
import warp as wp

import warp_bounding as wb

pytestmark = pytest.mark.skipif(not wp.get_cuda_device_count(), reason="there is no CUDA device")


def bounder_of(method: str) -> wb.Bounder:
    ball = np.linalg.norm(np.indices((16, 16, 16)) - 7.5, axis=0) < 6
    options = {"budget": 10, "hidden": (24, 24), "progress": False} if method == "mlp" else {}
    return wb.fit(ball, method=method, device="cuda:0", **options)


@pytest.mark.parametrize("method", ["aabb", "bvh", "mlp"])
def test_a_graph_answers_as_a_call(method):
    bounder, rng = bounder_of(method), np.random.default_rng(0)
    first, other = (
        wp.array(rng.uniform(-2, 18, (5000, 3)).astype(np.float32), dtype=wp.vec3, device="cuda:0") for _ in range(2)
    )
    there, (indices, count) = bounder.query(other).numpy(), bounder.candidates(other)
    found = indices.numpy()[: int(count.numpy()[0])]
    x, out = wp.clone(first), wp.zeros(5000, dtype=wp.uint8, device="cuda:0")
    listing, asking = bounder.prepare(x, candidates=True), bounder.prepare(x, out=out)
    listed = listing.launch()
    for call in (lambda: bounder.query(x, out=out), asking.launch, listing.launch):
        wp.copy(x, first)
        with wp.ScopedCapture(device="cuda:0") as capture:
            call()
        out.zero_()
        wp.copy(x, other)
        wp.capture_launch(capture.graph)
        if call == listing.launch:
            indices, count = listed
            assert np.array_equal(indices.numpy()[: int(count.numpy()[0])], found)
        else:
            assert np.array_equal(out.numpy(), there)
