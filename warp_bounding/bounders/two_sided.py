"""Two bounders of one object, one from the outside and one from the inside: certainly not, maybe, certainly."""

from functools import cached_property

import numpy as np
import warp as wp

from warp_bounding.bounders.bounder import Bounder
from warp_bounding.certificates.claim import differing
from warp_bounding.errors import BounderError
from warp_bounding.kernels.functions import Data
from warp_bounding.queries.point import POINT
from warp_bounding.runtime.arrays import Picklable, new_output
from warp_bounding.runtime.launch import launch_on_cores
from warp_bounding.runtime.native import named, vector_type
from warp_bounding.shapes.derived import SIDES

NO, MAYBE, YES = 0, 1, 2  # answers of ``classify``


@wp.kernel(enable_backward=False)
def _combine(
    first: int, outer: wp.array(dtype=wp.bool), inner: wp.array(dtype=wp.bool), found: wp.array(dtype=wp.uint8)
):
    i = first + wp.tid()
    found[i] = wp.uint8(outer[i]) * (wp.uint8(YES) - wp.uint8(inner[i]))


class TwoSided(Picklable):
    """Two bounders of one object; made by ``two_sided``.

    Attributes:
        outer: Of the object: its *no* is certainly outside.
        inner: Of the object's complement (``fit(..., side="inside")``): its *no* is certainly inside.

    Example:
        >>> inner = wb.fit(ball, side="inside", hidden=(8,), steps=30, device="cpu")
        >>> both = wb.two_sided(bounder, inner)
        >>> both.nbytes == bounder.nbytes + inner.nbytes
        True
    """

    def __init__(self, outer: Bounder, inner: Bounder):
        self.outer, self.inner = outer, inner

    def classify(self, x, *, xform=None, scale=None, out: wp.array | None = None) -> wp.array:
        """Where points are; arguments as in ``Bounder.query``, but ``out`` is uint8.

        Returns:
            ``(N,)`` uint8 ``wp.array``: 0 = certainly not in the object dilated by the outer margin, 2 = certainly in
            the object dilated by the inner one, 1 = maybe.

        Raises:
            QueryError: As ``Bounder.query`` does.

        Example:
            >>> both = wb.two_sided(bounder, wb.fit(ball, side="inside", hidden=(8,), steps=30, device="cpu"))
            >>> int(both.classify(np.array([[9.0, 9.0, 9.0]], np.float32)).numpy()[0])
            0
        """
        placed = {"xform": xform, "scale": scale}
        maybe, device = self.outer.query(x, **placed), self.outer.device
        found = new_output(out, maybe.shape[0], wp.uint8, device)
        if device.is_cpu:  # only what is not outside for certain is asked whether it is inside
            answers, points = found.numpy(), x.numpy() if isinstance(x, wp.array) else x
            points = points if hasattr(points, "shape") else np.asarray(points, np.float64)
            answers[:] = maybe.numpy()
            left = np.flatnonzero(answers)
            answers[left] = YES - self.inner.query(points[left], **placed).numpy()
            return found
        within = self.inner.query(x, **placed)  # there, knowing how many are left would take longer than asking all
        launch_on_cores(_combine, found.shape[0], inputs=[maybe, within], outputs=[found], device=device)
        return found

    @cached_property
    def func(self) -> wp.Function:
        """The answer for one point in your kernels: ``wp.static(both.func)(both.outer.data, both.inner.data, q)``."""
        outer, inner = self.outer.func, self.inner.func
        vector = vector_type(self.outer.ndim)

        @named(f"{outer.key}_{inner.key}_sides").func
        def sides(outside: Data, inside: Data, q: vector) -> int:
            if not outer(outside, q):
                return NO
            if inner(inside, q):
                return MAYBE
            return YES

        return sides

    @property
    def nbytes(self) -> int:
        """Bytes of both."""
        return self.outer.nbytes + self.inner.nbytes

    def __repr__(self) -> str:
        return f"<two-sided: {self.outer!r}, {self.inner!r}>"


def two_sided(outer: Bounder, inner: Bounder) -> TwoSided:
    """A bounder from the outside and one from the inside, asked together.

    Args:
        outer: Of points, as ``fit`` makes it.
        inner: Of points, made by ``fit(..., side="inside")``, with a margin of at most the outer one. One of the two
            may bound cells of the other's shape.

    Returns:
        What classifies points; each half is proven, saved and certified by itself.

    Raises:
        BounderError: If these are not one of each, or of different objects, dimensions or devices.

    Example:
        >>> inner = wb.fit(ball, side="inside", hidden=(8,), steps=30, device="cpu")
        >>> wb.two_sided(bounder, inner).classify(points).shape
        (100,)
    """
    for bounder, name, side in ((outer, "outer", SIDES[0]), (inner, "inner", SIDES[1])):
        if not isinstance(bounder, Bounder) or bounder.query_kind != POINT.name:
            raise BounderError(f"two_sided: {name} must be a bounder of points, got {bounder!r}")
        if SIDES[bounder.domain.unbounded] != side:
            raise BounderError(f"two_sided: {name} must be fitted with side={side!r}, got {bounder!r}")
    kinds = [(b.ndim, b.domain.time, str(b.device)) for b in (outer, inner)]
    if kinds[0] != kinds[1]:
        raise BounderError(f"two_sided: expected the same dimension and device, got {kinds[0]} and {kinds[1]}")
    if other := differing(outer, inner, ()):
        raise BounderError(f"two_sided: expected bounders of the same object, got {other}")
    margins = [bounder.info.get("margin") or 0.0 for bounder in (outer, inner)]
    if not margins[0] >= margins[1]:
        raise BounderError(
            f"two_sided: expected an outer margin of at least the inner one, got {margins[0]} and {margins[1]}"
        )
    return TwoSided(outer, inner)
