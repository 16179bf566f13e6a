"""A shape's place in the world: a rigid transform and a scale per axis, given at query time.

World point ``q`` becomes object point ``x = M (q - translation)``. The difference is rounded relatively to *itself*, so
a shape far from the world's origin loses nothing that float32 coordinates had not lost before. The error of the
whole map is bounded here in float64 and must fit into the ``delta`` that the bounder's proof covers.
"""

from dataclasses import dataclass

import numpy as np

from warp_bounding.arithmetic import LARGEST, TINY, UNIT32, UNIT64, gamma
from warp_bounding.bounders.domain import GROWTH, Domain, rounding_of_map
from warp_bounding.errors import QueryError

__all__ = ["Placement"]

UNIT_TOLERANCE = 1e-5  # of a quaternion's norm; it is normalised here, which Warp's own transforms do not do


@dataclass(frozen=True)
class Placement:
    """World-to-object map of one shape instance.

    Attributes:
        values: float32, the ``n`` translations, then the n x n matrix M in row order, as the kernels read them.
        matrix: ``(n, n)`` float64, M before rounding.
        translation: ``(n,)`` float64, before rounding.
    """

    values: np.ndarray
    matrix: np.ndarray
    translation: np.ndarray

    @classmethod
    def of(cls, domain: Domain, xform, scale) -> "Placement | None":
        """Build the map.

        Args:
            domain: The bounder's domain; time, where it has one, is not transformed.
            xform: ``wp.transform`` or 7 numbers (position, quaternion x y z w) for three spatial dimensions, or a
                homogeneous ``(s + 1, s + 1)`` matrix for any number s of spatial dimensions; object to world.
            scale: A positive number, or s of them; applied before ``xform``.

        Returns:
            The map, or ``None`` where nothing was given.

        Raises:
            QueryError: For a wrong shape, a non-finite number, a scale that is not positive, a singular matrix.
        """
        if xform is None and scale is None:
            return None
        if domain.query != "point":
            raise QueryError(f"xform and scale place point queries so far, give {domain.query} queries in object space")
        first = int(domain.time)
        spatial = domain.ndim - first
        try:
            factors = np.ones(spatial) if scale is None else np.asarray(scale, dtype=np.float64).reshape(-1)
        except (TypeError, ValueError) as error:
            raise QueryError(f"scale must be a positive number or {spatial} of them, got {scale!r}") from error
        if factors.size == 1:
            factors = np.repeat(factors, spatial)
        if factors.shape != (spatial,) or not (np.isfinite(factors) & (factors > 0)).all():
            raise QueryError(f"scale must be a positive number or {spatial} of them, got {scale}")
        rotation, position = _rigid(xform, spatial)
        forward = np.eye(domain.ndim)
        forward[first:, first:] = rotation * factors
        translation = np.zeros(domain.ndim)
        translation[first:] = position
        if np.linalg.cond(forward) > 1e6:
            raise QueryError("xform must be a rigid transform, got a matrix that is singular or nearly so")
        matrix = np.eye(domain.ndim)
        matrix[first:, first:] = np.linalg.inv(rotation) / factors[:, None]
        with np.errstate(over="ignore"):
            values = np.concatenate([translation, matrix.reshape(-1)]).astype(np.float32)
        if not np.isfinite(values).all():
            raise QueryError("xform and scale must fit float32")
        return cls(values, matrix, translation)

    def check(self, domain: Domain, *, double: bool) -> None:
        """Refuse a map whose rounding error the bounder's proof does not cover.

        Args:
            domain: The bounder's domain.
            double: Queries come in float64 and are rounded to float32 in world space first.

        Raises:
            QueryError: If the error bound exceeds ``delta`` on an axis.
        """
        n = domain.ndim
        scale = domain.scale.astype(np.float64)
        reach = np.maximum(np.abs(domain.lower), np.abs(domain.upper)) + domain.delta / scale
        away = np.abs(np.linalg.inv(self.matrix)) @ reach  # largest |q - translation| of a point of the domain
        world = np.abs(self.translation) + away
        rounded = np.abs(self.translation - self.values[:n]) + (UNIT32 * world if double else 0.0)
        size = np.abs(self.matrix)
        moved = size @ (gamma(n + 3) * (away + rounded) + rounded)
        moved += (64 * UNIT64 * size.max(axis=1) + 2 * TINY) * (
            away + rounded
        ).sum()  # the inverse; an entry that is subnormal
        moved += (n + 2) * TINY * (1 + size.sum(axis=1))  # other results that are
        needed = (moved * scale * (1 + 4 * UNIT32) + rounding_of_map(domain.limit.astype(np.float64)) + TINY) * GROWTH
        if not (needed <= domain.delta).all() or not (world < LARGEST).all():
            axis = int(np.argmax(needed / domain.delta))
            raise QueryError(
                f"xform and scale move a point by a rounding error of up to {needed[axis]:.2g} along axis {axis}, the certificate "
                f"covers {domain.delta[axis]:.2g}: give queries in object space, or a shape nearer to its own origin"
            )


def _rigid(xform, spatial: int) -> tuple[np.ndarray, np.ndarray]:
    """Rotation matrix and translation, float64, of what ``xform=`` takes."""
    if xform is None:
        return np.eye(spatial), np.zeros(spatial)
    try:
        values = np.array(xform, dtype=np.float64).reshape(
            getattr(type(xform), "_shape_", np.shape(xform))
        )  # Warp matrices come flat
    except (TypeError, ValueError) as error:
        raise QueryError(f"xform must be a transform or a matrix of numbers, got {type(xform).__name__}") from error
    if not np.isfinite(values).all():
        raise QueryError("xform must be finite")
    if values.shape == (7,) and spatial == 3:
        position, (x, y, z, w) = values[:3], values[3:]
        norm = float(np.sqrt(x * x + y * y + z * z + w * w))
        if abs(norm - 1) > UNIT_TOLERANCE:
            raise QueryError(f"xform must hold a unit quaternion, got one of length {norm:.6g}")
        x, y, z, w = (c / norm for c in (x, y, z, w))
        rotation = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
        return np.array(rotation), position
    if values.shape == (spatial + 1, spatial + 1):
        rotation, position, last = values[:-1, :-1], values[:-1, -1], values[-1]
        if np.abs(rotation @ rotation.T - np.eye(spatial)).max() > 1e-3 or (last != np.eye(spatial + 1)[-1]).any():
            raise QueryError("xform must be a rigid transform (rotation and translation; the scale goes into scale=)")
        return rotation, position
    expected = f"a ({spatial + 1}, {spatial + 1}) matrix" + (" or 7 numbers" if spatial == 3 else "")
    raise QueryError(f"xform must be {expected} for {spatial} spatial dimensions, got shape {values.shape}")
