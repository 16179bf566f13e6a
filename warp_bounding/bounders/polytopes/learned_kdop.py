"""``learned-kdop``: a k-DOP whose k half-spaces are free and learned by gradient descent (the paper's OurkDOP).

As many half-spaces as ``kdop`` has, but each with a normal of its own instead of pairs on given axes. Learned are the normals
only (``training.learned_kdop``): every face is set to a certified upper bound of the support of what is bounded, so any
normals make a conservative volume, and any step of training can be the last. f is ``min_k (offset_k - normal_k . v)``.
Rays, planes and boxes are tested against the polytope (``half_spaces``).
"""

import numpy as np

from warp_bounding.arithmetic import round_up
from warp_bounding.bounders.options import STEPS, Option
from warp_bounding.bounders.polytopes.half_spaces import TESTS, HalfSpacesSource
from warp_bounding.bounders.slabs.base import FaceBounder
from warp_bounding.bounders.slabs.kdop import BY_VERTICES, kdop_directions
from warp_bounding.bounders.slabs.regions import Slabs
from warp_bounding.coordinates.object_support import ObjectSupport
from warp_bounding.coordinates.region_domain import AnyDomain
from warp_bounding.errors import BounderError
from warp_bounding.geometry.checked_inverse import MOST_VERTEX_DIMENSIONS
from warp_bounding.indicators.grid import IndicatorGrid

__all__ = ["LearnedKdop", "classic_normals"]


def classic_normals(domain: AnyDomain, k: int | None = None) -> np.ndarray:
    """``kdop``'s half-spaces, where training starts from: ``(k, n)`` float64 normals in local space."""
    scale = domain.scale.astype(np.float64)
    directions = kdop_directions(len(scale), k) / scale  # because v = (x - center) scale
    return np.concatenate([directions, -directions])


class LearnedKdop(FaceBounder):
    """k free half-spaces; see module.

    Tensors: ``normals`` ``(k, n)`` and ``offsets`` ``(k,)``, in the coordinates of points.
    """

    method = "learned-kdop"
    tests = TESTS
    options = (
        Option(
            "k", None, "half-spaces, 128 at most; by default as many as kdop's, or 40 in front of a network", parse=int
        ),
        STEPS,
    )

    @classmethod
    def supports(cls, query: str, ndim: int) -> bool:
        return super().supports(query, ndim) and (query not in BY_VERTICES or ndim <= MOST_VERTEX_DIMENSIONS)

    @classmethod
    def fit(
        cls, grid: IndicatorGrid, domain: AnyDomain, *, k: int | None = None, device: str | None = None
    ) -> "LearnedKdop":
        """Where training starts: the half-spaces of ``kdop``, each on its own; ``k`` as ``kdop`` offers it."""
        return cls.of_normals(grid, domain, classic_normals(domain, k), device=device)

    @classmethod
    def of_normals(
        cls,
        grid: IndicatorGrid,
        domain: AnyDomain,
        normals: np.ndarray,
        *,
        support: ObjectSupport | None = None,
        device: str | None = None,
    ) -> "LearnedKdop":
        """The tightest half-spaces with these normals ``(k, n)`` of any length; ``support`` is the object's."""
        normals = np.asarray(normals, dtype=np.float64)
        largest = np.abs(normals).max(axis=1, keepdims=True)
        normals = (normals / np.where(largest > 0, largest, 1)).astype(np.float32)
        if not (np.isfinite(normals).all() and (largest > 0).all()):
            raise BounderError("learned-kdop: a normal is zero or not finite")
        reach = (support or ObjectSupport(grid, domain.base))(normals.astype(np.float64))
        tight = cls(domain.base, {"normals": normals, "offsets": round_up(reach)}, {}, device)
        # The least f is about 2 E then, and the threshold, which lies E below it, at zero or a little above.
        offsets = round_up(reach + 2 * tight.rounding_bound())
        return cls(domain, {"normals": normals, "offsets": offsets}, {}, device)

    def check_tensors(self) -> None:
        columns, count = self.volume_domain.ndim, max(len(self.tensors.get("offsets", ())), 1)
        self.expect_shapes({"normals": (count, columns), "offsets": (count,)})
        self.check_range()

    @property
    def shape(self) -> Slabs:
        normals, offsets = (self.tensors[name].astype(np.float64) for name in ("normals", "offsets"))
        return Slabs(normals, np.full(len(offsets), -np.inf), offsets, False)

    @property
    def source(self) -> HalfSpacesSource:
        return self.source_of(HalfSpacesSource, len(self.tensors["offsets"]))
