"""How far the positive regions of an object reach in the space of their own numbers, proven from above.

In parametric space a ray is the point ``v = (a, w)`` of R^2n, a plane ``(u, a)``, a box ``(low, high)``
(``coordinates``), and P is the set of all v that the pipeline can make of a region that meets the object S, rounding
included. A volume around P needs ``max g . v`` over P for its faces, and ``max |A v + b|^2`` for its radius. How each
is bounded is said in the file of the kind: for boxes exactly, for rays and planes by duality, and branch and bound
over directions.

Every number is a bound, whatever a search finds: a bad search costs tightness, never soundness. Squared lengths are
convex, so they are largest at corners of what holds P; these bounds are coarser.
"""

import numpy as np

from warp_bounding.arithmetic import UNIT64, gamma
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.errors import BounderError
from warp_bounding.indicators.grid import IndicatorGrid
from warp_bounding.support_functions.base import ObjectSupport, RegionSupport
from warp_bounding.support_functions.box import BoxSupport
from warp_bounding.support_functions.plane import PlaneSupport
from warp_bounding.support_functions.ray import RaySupport

__all__ = ["SUPPORTS", "ParametricSupport"]

ROUNDING = gamma(256, UNIT64)  # more roundings than any sum goes through, over 2n numbers with n <= 64

SUPPORTS: dict[str, type[RegionSupport]] = {kind.name: kind for kind in (RaySupport, PlaneSupport, BoxSupport)}


class ParametricSupport:
    """Certified maxima over P of linear functions and of squared lengths.

    Args:
        grid: The object.
        domain: Of a kind of region, ``space="parametric"``.

    Attributes:
        ndim: Dimension n of the object.
        object_support: ``h``, the support of the widened object.
        points: ``(C, n)``, those of ``object_support``.
        region: The bounds of this kind of region.
        reach: ``(2 n,)``: P lies in the box ``|v| <= reach``.
    """

    def __init__(self, grid: IndicatorGrid, domain: RegionDomain):
        if not domain.parametric or domain.query not in SUPPORTS:
            raise BounderError(f"expected regions in parametric space, got {domain.query}, {domain.space}")
        self.domain, self.ndim, self.reach = domain, domain.base.ndim, domain.limit.astype(np.float64)
        self.object_support = ObjectSupport(grid, domain.base)
        self.points = self.object_support.points
        self.region = SUPPORTS[domain.query](self.object_support, domain)

    def __call__(self, functionals: np.ndarray) -> np.ndarray:
        """Upper bounds of ``g . v`` over P.

        Args:
            functionals: ``(K, 2 n)`` float64.

        Returns:
            ``(K,)`` float64, rounding of this evaluation included.
        """
        g = np.asarray(functionals, dtype=np.float64)
        x, y = g[:, : self.ndim], g[:, self.ndim :]
        value = self.region.linear(x, y)
        plain = np.abs(g) @ self.reach  # P lies inside this box
        if not (np.isfinite(value) & np.isfinite(plain)).all():
            raise BounderError("numbers are so large that a support cannot be bounded")
        return np.minimum(value, plain) + ROUNDING * (1 + np.abs(value) + plain)

    def square(self, matrix: np.ndarray, offset: np.ndarray) -> float:
        """Upper bound of ``|A v + b|^2`` over P, the rounding of this evaluation included.

        Args:
            matrix: ``(r, 2 n)`` float64, A.
            offset: ``(r,)`` float64, b.
        """
        most = self.region.square(matrix, offset)
        reach = np.abs(matrix) @ self.reach + np.abs(offset)
        size = float(reach @ reach)
        return most + ROUNDING * (1 + size)
