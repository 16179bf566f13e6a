"""A shape's place in the world: a rotation or reflection R, a translation and a scale per axis, given at query time.

World point ``q`` becomes object point ``x = M (q - translation)``, ``M = diag(1 / scale) R^-1``: the inverse of what
``xform=`` (R and the translation) and ``scale=`` do to the shape. The difference comes first and its error is relative
to the difference, so a shape far from the world's origin loses nothing that float32 coordinates had not lost before.
Of a ray the origin is moved like a point and the direction d becomes ``M d``, made a unit vector in object space; of a
plane the normal n becomes ``M^-T n``. A box becomes the axis-aligned box around the moved one: the region itself where
R is a signed permutation of the axes, larger otherwise.

The error of the whole map is bounded in float64, from M and M^-1 as they are (``queries.directions``), and must fit
into the ``delta`` that the bounder's proof covers. So R need not be exactly orthogonal: what is computed, and proven,
is the map with the very matrix that was given.
"""

from dataclasses import dataclass

import numpy as np

from warp_bounding.errors import QueryError
from warp_bounding.queries import QUERIES
from warp_bounding.queries.base import FAR, WorldMap
from warp_bounding.queries.domain import GROWTH, Domain, rounding_of_map
from warp_bounding.queries.region_domain import RegionDomain
from warp_bounding.rounding import LARGEST, UNIT32

MOST_STRETCH = 1e6  # ratio of the scales of two axes beyond which a placement is refused
UNIT_TOLERANCE = 1e-5  # of a quaternion's norm; it is normalised here, which Warp's own transforms do not do
ORTHOGONAL_TOLERANCE = 1e-3  # of the entries of R R^T: products of float32 matrices pass, a forgotten scale does not


@dataclass(frozen=True)
class Placement:
    """World-to-object map of one shape instance.

    Attributes:
        values: float32, as the kernels read them: n numbers of the translation; the n x n matrix M by rows; of rays and
            planes n numbers ``drift``, local units, by how much M's rounding may displace a point per unit of
            ``|a|_1`` (``queries.directions``); of planes ``M^-T`` by rows.
        world: The map before rounding.
    """

    values: np.ndarray
    world: WorldMap

    @classmethod
    def of(cls, domain: Domain | RegionDomain, xform, scale) -> "Placement | None":
        """Build the map.

        Args:
            domain: The bounder's domain; time, where it has one, is not transformed.
            xform: Object to world: ``wp.transform`` or 7 numbers (position, quaternion x y z w) for three spatial
                dimensions, or a homogeneous ``(s + 1, s + 1)`` matrix for any number s of them, a rotation or a
                reflection and a translation; it is orthogonal within ``ORTHOGONAL_TOLERANCE``.
            scale: A positive number, or s of them; applied before ``xform``.

        Returns:
            The map, or ``None`` where nothing was given.

        Raises:
            QueryError: For a wrong shape, a non-finite number, a scale that is not positive, a singular matrix.
        """
        if xform is None and scale is None:
            return None
        if domain.joints is not None:
            raise QueryError("configurations of joints have no place in the world, got xform or scale")
        n, first_spatial = domain.space_ndim, int(domain.time)  # coordinate 0 may be time, which no placement moves
        spatial = n - first_spatial
        factors = np.ones(spatial) if scale is None else numbers_of(scale)
        if factors is not None and factors.size == 1:
            factors = np.repeat(factors, spatial)
        if factors is None or factors.shape != (spatial,) or not all(0 < size < np.inf for size in factors.tolist()):
            raise QueryError(f"scale must be a positive number or {spatial} of them, got {_shown(scale)}")
        sizes = factors.tolist()
        rotation, position = _orthogonal(xform, spatial)
        forward = np.eye(n)
        forward[first_spatial:, first_spatial:] = rotation * factors
        translation = np.zeros(n)
        translation[first_spatial:] = position
        sizes += [1.0] * first_spatial  # of time
        if max(sizes) > MOST_STRETCH * min(sizes):
            raise QueryError(
                f"scale must stretch the axes within {MOST_STRETCH:g} times of each other, got {_shown(scale)}"
            )
        matrix = np.eye(n)
        matrix[first_spatial:, first_spatial:] = np.linalg.inv(rotation) / factors[:, None]  # R^T would be less exact
        with np.errstate(over="ignore"):
            translation32 = translation.astype(np.float32)
        if not np.isfinite(translation32).all():
            raise QueryError("xform and scale must fit float32")
        world = WorldMap(matrix, forward, translation, np.abs(translation - translation32))
        with np.errstate(over="ignore"):
            extra = QUERIES[domain.query].placed_values(domain, world)
            values = np.concatenate([translation32, matrix.reshape(-1), *extra]).astype(np.float32)
        if not np.isfinite(values).all():
            raise QueryError("xform and scale must fit float32")
        return cls(values, world)

    def check(self, domain: Domain | RegionDomain, *, double: bool) -> None:
        """Refuse a map whose rounding error exceeds what the proof's ``delta`` leaves for a placement: ``QueryError``.

        ``double``: queries come in float64 and are rounded to float32 in world space first.
        """
        needed, covered = placement_error(domain, self.world, double=double), _covered(domain)
        if not (needed <= covered).all() or not (_farthest(domain, self.world) < LARGEST).all():
            axis = int(np.argmax(needed - covered))
            raise QueryError(
                f"xform and scale move a {domain.query} by a rounding error of up to {needed[axis]:.2g} along axis "
                f"{axis}, the certificate covers {covered[axis]:.2g}: give queries in object space, or a shape nearer "
                "to its own origin"
            )


def placement_error(domain: Domain | RegionDomain, world: WorldMap, *, double: bool) -> np.ndarray:
    """``(n,)``, local units: the error of a moved query, of points with that of the map to v; may be infinite."""
    return QUERIES[domain.query].placed_rounding(domain, world, UNIT32 if double else 0.0)


def _farthest(domain: Domain | RegionDomain, world: WorldMap) -> np.ndarray:
    """``(n,)``, world units: about the largest coordinates of a query that a bounder tests."""
    base = domain.base
    reach = base.reach
    if domain is not base:  # a region's point may lie up to FAR away; 1.1 generously covers the rounding of that test
        reach = reach + 1.1 * FAR / base.scale.astype(np.float64)
    return np.abs(world.translation) + np.abs(world.forward) @ reach


def _covered(domain: Domain | RegionDomain) -> np.ndarray:
    """``(n,)``, local units: how large ``placement_error`` may be.

    Of points it is all of ``delta``, as their error counts the map to v as well; of regions what the map's rounding
    leaves.
    """
    if domain is domain.base:
        return domain.delta
    return np.maximum(domain.base.delta - domain.kind.rounding(domain.base, domain.length), 0.0)


def placement_allowance(domain: Domain | RegionDomain) -> np.ndarray:
    """``(n,)``, object units, rounded down: the largest error that a placement may add and is not refused."""
    base = domain.base
    map_error = rounding_of_map(base.limit.astype(np.float64)) if domain is base else 0.0
    return np.maximum(_covered(domain) / GROWTH - map_error, 0.0) / base.scale / GROWTH


def numbers_of(given) -> np.ndarray | None:
    """Real numbers of any library's array, or of a sequence, as float64; ``None`` for anything else."""
    given = given.detach().cpu() if hasattr(given, "detach") else given  # torch, which may want gradients
    try:
        values = np.asarray(given)
        return values.astype(np.float64) if values.dtype.kind in "iuf" else None
    except (TypeError, ValueError):  # a ragged sequence
        return None


def _shown(value) -> str:
    return " ".join(repr(value).split())


def _orthogonal(xform, spatial: int) -> tuple[np.ndarray, np.ndarray]:
    """R and the translation, float64, of what ``xform=`` takes."""
    if xform is None:
        return np.eye(spatial), np.zeros(spatial)
    values = numbers_of(xform)
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
                f"xform must have {row} as its last row (the translation stands in the last column), got "
                f"{last.tolist()}"
            )
        if np.abs(rotation @ rotation.T - np.eye(spatial)).max() > ORTHOGONAL_TOLERANCE:
            raise QueryError("xform must be a rotation or reflection, and a translation (the scale goes into scale=)")
        return rotation, position
    expected = f"a ({spatial + 1}, {spatial + 1}) matrix" + (" or 7 numbers" if spatial == 3 else "")
    raise QueryError(f"xform must be {expected} for {spatial} spatial dimensions, got shape {values.shape}")
