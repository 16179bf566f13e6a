"""``kdop``: discretely oriented polytopes (Klosowski et al. 1998; the paper's kDOP), k half-spaces in k/2 slabs.

By default k = 4 m as in the paper: the m axes and the m normals that are all ones but for one zero. In 2D those would
be the axes again, so the diagonals take their place; 6 half-spaces in 2D are a hexagon's. In 3D the usual 14, 18 and 26
are offered too.
"""

from itertools import combinations, product

import numpy as np

from warp_bounding.bounders.options import Option
from warp_bounding.bounders.slabs.base import SlabBounder
from warp_bounding.errors import BounderError
from warp_bounding.geometry.checked_inverse import MOST_VERTEX_DIMENSIONS

__all__ = ["BY_VERTICES", "Kdop", "kdop_directions"]

HEXAGON = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)], [-0.5, np.sqrt(0.75)]])  # unit normals of the slabs of a hexagon
BY_VERTICES = ("plane",)  # kinds of query that are tested against the polytope's vertices


class Kdop(SlabBounder):
    """k-DOP with fixed normals in object space."""

    method = "kdop"
    options = (
        Option(
            "k", None, "half-spaces, 4 for each dimension by default; in 2D also 6, in 3D 6, 14, 18 or 26", parse=int
        ),
    )

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        """See ``Bounder``; planes are tested against the vertices, whose number grows quickly."""
        return super().supports(query, ndim) and (query not in BY_VERTICES or ndim <= MOST_VERTEX_DIMENSIONS)

    @classmethod
    def sampled_directions(cls, samples: np.ndarray, k: int | None = None) -> np.ndarray:
        return kdop_directions(samples.shape[1], k)


def kdop_directions(ndim: int, k: int | None = None) -> np.ndarray:
    """``(k / 2, n)`` float64, unit slab normals of a k-DOP: k is ``None`` for 4 n half-spaces, or in 2D 6, in 3D 6, 14, 18 or 26.

    Raises:
        BounderError: If ``k`` is not offered in this dimension.
    """
    if ndim == 2 and k == len(HEXAGON) * 2:
        return HEXAGON
    axes = np.eye(ndim)
    edges = [axes[a] + s * axes[b] for a, b in combinations(range(ndim), 2) for s in (1, -1)]
    edges = np.array(edges).reshape(-1, ndim)
    if k is None or k == 4 * ndim:
        more = edges if ndim == 2 else 1 - axes if ndim > 2 else axes[:0]
    elif ndim == 3 and k in (6, 14, 18, 26):
        corners = np.array([(1, *s) for s in product((1, -1), repeat=2)])
        more = np.concatenate([corners] * (k in (14, 26)) + [edges] * (k in (18, 26)) + [axes[:0]])
    else:
        offered = {2: "8 and 6", 3: "12, 6, 14, 18 and 26"}.get(ndim, str(4 * ndim))
        raise BounderError(f"kdop offers k = {offered} in {ndim}D, got k={k!r}")
    directions = np.concatenate([axes, more])
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)
