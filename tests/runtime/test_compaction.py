import numpy as np
import pytest
import warp as wp

import warp_bounding as wb


@pytest.mark.parametrize("count", [0, 1, 63, 64, 65, 16383, 16384, 16385, 100_003])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 1.0])
def test_indices_of_what_is_not_zero(device, count, share):
    rng = np.random.default_rng(count)
    mask = ((rng.random(count) < share) * rng.integers(1, 256, count)).astype(np.uint8)
    indices, found = wb.compact(wp.array(mask, dtype=wp.uint8, device=device))
    total = int(found.numpy()[0])
    assert len(indices) == count
    assert (indices.numpy()[:total] == np.flatnonzero(mask)).all()
    assert total == np.count_nonzero(mask)


def test_other_arrays_are_refused():
    for mask in (
        np.ones(3, np.uint8),
        wp.ones(3, dtype=wp.int32, device="cpu"),
        wp.ones((3, 2), dtype=wp.uint8, device="cpu"),
    ):
        with pytest.raises(wb.QueryError, match=r"mask must be a contiguous wp.array of uint8 of shape \(N,\)"):
            wb.compact(mask)
    with pytest.raises(wb.QueryError, match="contiguous"):
        wb.compact(wp.ones((6, 2), dtype=wp.uint8, device="cpu")[:, 0])
