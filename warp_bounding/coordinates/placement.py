"""A shape's place in the world: a rigid transform and a scale per axis, given at query time.

World point ``q`` becomes object point ``x = M (q - translation)``. The difference is rounded relatively to *itself*, so
a shape far from the world's origin loses nothing that float32 coordinates had not lost before. Of a ray the origin is
moved like a point and the direction d becomes ``M d``, made a unit vector in object space; of a plane the normal n
becomes ``M^-T n``. A box becomes the axis-aligned box around the moved one: the region itself where the rotation is a
signed permutation of the axes, larger otherwise.

The error of the whole map is bounded in float64 (``placement_rounding``) and must fit into the ``delta`` that the
bounder's proof covers.
"""

from dataclasses import dataclass

import numpy as np

from warp_bounding.arithmetic import LARGEST, UNIT32
from warp_bounding.coordinates.base import FAR, WorldMap
from warp_bounding.coordinates.domain import GROWTH, Domain, rounding_of_map
from warp_bounding.coordinates.region_domain import RegionDomain, region_rounding
from warp_bounding.coordinates.registry import coordinates_of
from warp_bounding.errors import QueryError

__all__ = ["Placement", "placement_room", "rounding"]

MOST_STRETCH = 1e6  # of one axis by another: the condition of the map
UNIT_TOLERANCE = 1e-5  # of a quaternion's norm; it is normalised here, which Warp's own transforms do not do


@dataclass(frozen=True)
class Placement:
    """World-to-object map of one shape instance.

    Attributes:
        values: float32, the ``n`` translations, then the n x n matrix M in row order, as the kernels read them; for
            rays and planes also n numbers ``drift``, and for planes ``M^-T`` in row order.
        world: The map before rounding.
    """

    values: np.ndarray
    world: WorldMap

    @classmethod
    def of(cls, domain: Domain | RegionDomain, xform, scale) -> "Placement | None":
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
        n, first = domain.space_ndim, int(domain.time)
        spatial = n - first
        factors = np.ones(spatial) if scale is None else _numbers(scale)
        if factors is not None and factors.size == 1:
            factors = np.repeat(factors, spatial)
        if factors is None or factors.shape != (spatial,) or not all(0 < size < np.inf for size in factors.tolist()):
            raise QueryError(f"scale must be a positive number or {spatial} of them, got {_shown(scale)}")
        sizes = factors.tolist()
        rotation, position = _rigid(xform, spatial)
        forward = np.eye(n)
        forward[first:, first:] = rotation * factors
        translation = np.zeros(n)
        translation[first:] = position
        sizes += [1.0] * first  # time's; a rotation adds nothing
        if max(sizes) > MOST_STRETCH * min(sizes):
            raise QueryError(
                f"scale must stretch the axes within {MOST_STRETCH:g} times of each other, got {_shown(scale)}"
            )
        matrix = np.eye(n)
        matrix[first:, first:] = np.linalg.inv(rotation) / factors[:, None]
        with np.errstate(over="ignore"):
            single = translation.astype(np.float32)
        if not np.isfinite(single).all():
            raise QueryError("xform and scale must fit float32")
        world = WorldMap(matrix, forward, translation, np.abs(translation - single))
        with np.errstate(over="ignore"):
            own = coordinates_of(domain.query, domain.space).placed_values(domain, world)
            values = np.concatenate([single, matrix.reshape(-1), *own]).astype(np.float32)
        if not np.isfinite(values).all():
            raise QueryError("xform and scale must fit float32")
        return cls(values, world)

    def check(self, domain: Domain | RegionDomain, *, double: bool) -> None:
        """Refuse a map whose rounding error the bounder's proof does not cover.

        Args:
            domain: The bounder's domain.
            double: Queries come in float64 and are rounded to float32 in world space first.

        Raises:
            QueryError: If the error bound exceeds ``delta`` on an axis, or what the map of regions leaves of it.
        """
        needed, covered = rounding(domain, self.world, double=double), _covered(domain)
        if not (needed <= covered).all() or not (_farthest(domain, self.world) < LARGEST).all():
            axis = int(np.argmax(needed - covered))
            raise QueryError(
                f"xform and scale move a {domain.query} by a rounding error of up to {needed[axis]:.2g} along axis {axis}, the "
                f"certificate covers {covered[axis]:.2g}: give queries in object space, or a shape nearer to its own origin"
            )


def rounding(domain: Domain | RegionDomain, world: WorldMap, *, double: bool) -> np.ndarray:
    """``(n,)``, units of local space: what a placement rounds (``placement_rounding``); infinite where a bound does not hold.

    Args:
        domain: The bounder's.
        world: The map.
        double: Queries come in float64 and are rounded to float32 in the world first.
    """
    return coordinates_of(domain.query, domain.space).placed_rounding(domain, world, UNIT32 if double else 0.0)


def _farthest(domain: Domain | RegionDomain, world: WorldMap) -> np.ndarray:
    """``(n,)``: about the largest coordinates in the world that a bounder computes with."""
    base = domain.base
    reach = base.reach
    if domain is not base:
        reach = reach + 1.1 * FAR / base.scale.astype(np.float64)
    return np.abs(world.translation) + np.abs(world.forward) @ reach


def _covered(domain: Domain | RegionDomain) -> np.ndarray:
    """``(n,)``, units of local space: what the proof's ``delta`` leaves for a moved query, the map of points behind it included."""
    if domain is domain.base:
        return domain.delta
    return np.maximum(domain.base.delta - region_rounding(domain.base, domain.query, domain.length), 0.0)


def placement_room(domain: Domain | RegionDomain) -> np.ndarray:
    """``(n,)``, object units: by how much a placement may round a query before it is refused, on each axis, rounded down."""
    base = domain.base
    behind = rounding_of_map(base.limit.astype(np.float64)) if domain is base else 0.0
    return np.maximum(_covered(domain) / GROWTH - behind, 0.0) / base.scale / GROWTH


def _numbers(given) -> np.ndarray | None:
    """Real numbers as float64, whoever's array they are in; ``None`` of anything else."""
    given = given.detach().cpu() if hasattr(given, "detach") else given  # torch, which may want gradients
    try:
        values = np.asarray(given)
        return values.astype(np.float64) if values.dtype.kind in "iuf" else None
    except (TypeError, ValueError):  # a ragged sequence
        return None


def _shown(value) -> str:
    """A value in one line."""
    return " ".join(repr(value).split())


def _rigid(xform, spatial: int) -> tuple[np.ndarray, np.ndarray]:
    """Rotation matrix and translation, float64, of what ``xform=`` takes."""
    if xform is None:
        return np.eye(spatial), np.zeros(spatial)
    values = _numbers(xform)
    if values is None:
        raise QueryError(f"xform must be a transform or a matrix of numbers, got {type(xform).__name__}")
    values = values.reshape(getattr(type(xform), "_shape_", values.shape))  # Warp matrices come flat
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
        if (last != np.eye(spatial + 1)[-1]).any():
            row = f"({', '.join(['0'] * spatial)}, 1)"
            raise QueryError(
                f"xform must have {row} as its last row (the translation stands in the last column), got {last.tolist()}"
            )
        if np.abs(rotation @ rotation.T - np.eye(spatial)).max() > 1e-3:
            raise QueryError("xform must be a rigid transform (rotation and translation; the scale goes into scale=)")
        return rotation, position
    expected = f"a ({spatial + 1}, {spatial + 1}) matrix" + (" or 7 numbers" if spatial == 3 else "")
    raise QueryError(f"xform must be {expected} for {spatial} spatial dimensions, got shape {values.shape}")
