"""A shape far from its coordinates' zero, or between the places of a grid's lattice: held near 0, with its origin.

float32 tells points apart by half a metre at the coordinates of a survey. So the numbers of such a shape are taken
relative to an origin, in float64, before anything is rounded; what is left is the *local* shape, which everything
computes with. A world point w is the local point ``w - origin``, exactly. The difference is rounded once, by ``UNIT64``
of itself, and then to float32: both lie within what every bounder's delta holds for float64 queries (``Domain``). A
grid's cells may besides stand a little beside the ones that were requested, where the inverse of their size is no
float32 number: by ``blur`` at most, which delta must hold as well.
"""

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from warp_bounding.errors import ShapeError
from warp_bounding.rounding import UNIT64
from warp_bounding.shapes.shape import IN, OUT, UNDECIDED, Derived, Shape

ROUNDED = 2.0**-19  # of a mesh's extent: where float32 would move a vertex by more, the mesh is recentred
OUTWARD = 1 + 2.0**-50


@dataclass(frozen=True)
class Frame:
    """Where local coordinates begin.

    Attributes:
        origin: World coordinates of the local 0, float64.
        blur: World units: by how much, on each axis, what was asked for may stand beside the local shape.
    """

    origin: tuple[float, ...]
    blur: tuple[float, ...]

    def shift(self, directed: tuple[bool, ...]) -> np.ndarray:
        """What is subtracted from a query's numbers: the origin from points, nothing from directions."""
        return np.concatenate([np.zeros(len(self.origin)) if each else self.origin for each in directed])

    @property
    def summary(self) -> str:
        """For messages."""
        return f"coordinates count from the origin ({', '.join(f'{x:.12g}' for x in self.origin)})"

    def noted(self, certificate):
        """A certificate of local coordinates, with a sentence that says so."""
        sentence = f"{self.summary[0].upper()}{self.summary[1:]}, which is taken off in float64."
        return replace(certificate, message=f"{certificate.message} {sentence}")

    def fault(self, bounder) -> str | None:
        """Why a bounder's claim does not hold in this frame, in a few words; ``None`` if it does.

        A distance subtracts the blur from its answers.
        """
        if len(self.origin) != bounder.ndim:
            return f"an origin of {len(self.origin)} numbers for {bounder.ndim} coordinates"
        blur = np.array(self.blur)
        domains = [] if bounder.of_distances else [each.domain for each in (bounder, *bounder.parts)]
        if blur.any() and (fault := next(filter(None, (domain.fault(blur) for domain in domains)), None)):
            return (
                f"cells stand up to {blur.max():.3g} beside the ones asked for, as float32 holds the inverse of their "
                f"size: {fault}"
            )
        return None

    def to_dict(self) -> dict:
        """JSON-ready."""
        return {"origin": list(self.origin), "blur": list(self.blur)}

    @classmethod
    def from_dict(cls, values: dict, ndim: int) -> "Frame":
        """Inverse of ``to_dict``; raises ``ValueError`` for numbers that are no frame's."""
        if not isinstance(values, dict) or set(values) != {"origin", "blur"}:
            raise ValueError(f"the origin is described by {values!r}")
        for name, numbers in values.items():
            own = isinstance(numbers, list) and len(numbers) == ndim and all(type(x) in (int, float) for x in numbers)
            if not (own and np.isfinite(numbers).all() and (name == "origin" or min(numbers) >= 0)):
                raise ValueError(f"{name} must be {ndim} numbers, got {numbers!r}")
        return cls(*(tuple(map(float, values[name])) for name in ("origin", "blur")))


class Recentred(Derived):
    """A shape in world coordinates, of which the local shape is what is bounded.

    What is asked of it here is answered in world coordinates, in float64; a bounder of it takes world coordinates, too.

    Attributes:
        local: The shape in its own coordinates: world coordinates less the origin.
        coordinates: The origin, and the blur.

    Example:
        >>> far = wb.load_shape(ball, spacing=0.1, origin=(500000.13, 4649776.37, 12.0))
        >>> far.origin
        array([5.00000130e+05, 4.64977637e+06, 1.20000000e+01])
        >>> bool(far.contains(far.origin + 0.75))
        True
    """

    def __init__(self, local: Shape, frame: Frame):
        super().__init__(local)
        self.local, self.coordinates, self.resolution = local, frame, local.resolution

    def __repr__(self) -> str:
        return f"{repr(self.local)[:-1]}, {self.coordinates.summary}>"

    @property
    def origin(self) -> np.ndarray:
        """``(n,)`` float64, world coordinates of the local 0."""
        return np.array(self.coordinates.origin)

    @property
    def remark(self) -> str:
        """That of the local shape."""
        return self.local.remark

    @property
    def lower(self) -> np.ndarray:
        return np.nextafter(self.local.lower - self.coordinates.blur + self.origin, -np.inf)

    @property
    def upper(self) -> np.ndarray:
        return np.nextafter(self.local.upper + self.coordinates.blur + self.origin, np.inf)

    @cached_property
    def geometry(self) -> str:
        numbers = np.array([self.coordinates.origin, self.coordinates.blur], "<f8").tobytes()
        return hashlib.sha256(b"warp-bounding origin 1" + self.local.geometry.encode() + numbers).hexdigest()

    def _around(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Local boxes that hold the ones given."""
        low, high = (np.asarray(side, dtype=np.float64) - self.origin for side in (lower, upper))
        room = (2 * UNIT64 * np.maximum(np.abs(low), np.abs(high)) + self.coordinates.blur) * OUTWARD
        return np.nextafter(low - room, -np.inf), np.nextafter(high + room, np.inf)

    def decide(self, x: np.ndarray) -> np.ndarray:
        x = np.atleast_2d(x)
        box = self._around(x, x)
        found = np.where(self.local.empty(*box), OUT, UNDECIDED).astype(np.uint8)
        found[self.local.inside(*box)] = IN
        found[np.isnan(x).any(axis=1)] = OUT
        return found

    def empty(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        return (np.asarray(lower) <= upper).all(axis=1) & self.local.empty(*self._around(lower, upper))

    def inside(self, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
        return (np.asarray(lower) <= upper).all(axis=1) & self.local.inside(*self._around(lower, upper))

    def distance(self, x: np.ndarray) -> np.ndarray | None:
        found = self.distances(x)
        return None if found is None else found[:, 0]

    def distances(self, x: np.ndarray) -> np.ndarray | None:
        local = np.asarray(x, dtype=np.float64) - self.origin
        found = None if self.time else self.local.distances(local)
        if found is None:
            return None
        away = np.linalg.norm(2 * UNIT64 * np.abs(local) + self.coordinates.blur, axis=1) * OUTWARD
        low = np.maximum(found[:, 0] - away, 0.0) / OUTWARD
        return np.stack([low, np.where(self.decide(x) == IN, 0.0, (found[:, 1] + away) * OUTWARD)], axis=1)

    def landmarks(self) -> np.ndarray:
        return self.local.landmarks() + self.origin

    def points(self, count: int, rng: np.random.Generator) -> np.ndarray:
        return self.local.points(count, rng) + self.origin

    def check_contents(self) -> None:
        self.local.check_contents()

    def dilated(self, margin: float) -> "Recentred":
        return Recentred(self.local.dilated(margin), self.coordinates)

    def to_grid(self, *, resolution: int | None = None, margin: float = 0.0) -> "Recentred":
        """The local shape's cells, with the same origin."""
        return Recentred(self.local.to_grid(resolution=resolution, margin=margin), self.coordinates)


def parted(shape):
    """A shape in its own coordinates, and its ``Frame``; ``None`` where these are the world's."""
    return (shape.local, shape.coordinates) if isinstance(shape, Recentred) else (shape, None)


def own_coordinates(shape, what: str):
    """A shape whose coordinates are its own; raises ``ShapeError`` for one with an origin."""
    if isinstance(shape, Recentred):
        raise ShapeError(
            f"{shape.name}: {what} takes local coordinates, and of this shape {shape.coordinates.summary}: give "
            "shape.local"
        )
    return shape


def expect_near(vertices: np.ndarray, name: str) -> None:
    """Raise ``ShapeError`` for vertices that float32 would move by over ``ROUNDED`` of their extent."""
    if (frame := recentred(vertices)[1]) is not None:
        raise ShapeError(
            f"{name}: float32 is too coarse for vertices at {list(frame.origin)}; subtract an origin from them first, "
            "as load_shape does for a mesh at rest"
        )


def recentred(vertices: np.ndarray) -> tuple[np.ndarray, Frame | None]:
    """Vertices relative to an origin near them, where float32 would round them too coarsely where they are.

    Args:
        vertices: ``(V, n)`` numbers.

    Returns:
        ``(V, n)`` float64, and the origin: multiples of a power of two that is about the extent, 0 on axes that begin
        near 0. Or the vertices as they came, and ``None``: of what is no array of finite numbers, too.
    """
    if vertices.ndim != 2 or vertices.dtype.kind not in "iuf" or not vertices.size or not np.isfinite(vertices).all():
        return vertices, None
    numbers = vertices.astype(np.float64)
    low, high = numbers.min(axis=0), numbers.max(axis=0)
    extent = float((high - low).max())
    with np.errstate(over="ignore", invalid="ignore"):
        rounding = np.abs(numbers - numbers.astype(np.float32)).max()
    if not (0 < extent < np.inf and ROUNDED * extent < rounding < np.inf):
        return vertices, None
    unit = 2.0 ** np.ceil(np.log2(extent))
    origin = np.rint((low / 2 + high / 2) / unit) * unit
    if not origin.any():
        return vertices, None
    return numbers - origin, Frame(tuple(origin.tolist()), (0.0,) * len(origin))
