"""Bounders of shapes that have an origin (``indicators.recentred``): world coordinates from Python, local ones in kernels.

One rule: ``query`` and its like take world coordinates, float32 or float64, as exactly the numbers that they are, and take the origin
off in float64. Whatever reads float32 where it lies takes local coordinates: kernels' functions, ``prepare``, placements. They are asked
of ``bounder.local``, which has no origin, so that nobody gives them world coordinates unawares.
"""

import numpy as np
import warp as wp

from warp_bounding.coordinates.distance_domain import DistanceDomain
from warp_bounding.errors import BounderError, QueryError
from warp_bounding.indicators.recentred import Frame
from warp_bounding.runtime.arrays import flat_queries

__all__ = ["Framed", "frame_fault", "in_frame"]


class Framed:
    """What a bounder has of an origin.

    Attributes:
        frame: Where its local coordinates begin; ``None`` where they are the world's.
    """

    frame: Frame | None = None

    @property
    def origin(self) -> np.ndarray:
        """``(n,)`` float64, world coordinates of the local 0; zeros where local coordinates are the world's.

        Example:
            >>> bounder.origin
            array([0., 0., 0.])
        """
        return np.zeros(self.ndim) if self.frame is None else np.array(self.frame.origin)

    @property
    def local(self):
        """This bounder in local coordinates, world coordinates less ``origin``: for kernels of your own, ``prepare`` and ``xform=``."""
        if self.frame is None:
            return self
        made = self.to()
        made.frame = None
        return made

    def _flat(self, x, columns: int, directed: tuple[bool, ...]) -> tuple[wp.array, int, bool]:
        """``flat_queries``, in local coordinates."""
        return flat_queries(x, columns, self.device, None if self.frame is None else self.frame.shift(directed))

    def expect_local(self, what: str) -> None:
        """Refuse, with ``QueryError``, a bounder with an origin where ``what`` takes local coordinates."""
        if self.frame is not None:
            raise QueryError(
                f"{what} takes local coordinates, and of this bounder {self.frame.told}: subtract bounder.origin in float64, then ask "
                "bounder.local"
            )


def in_frame(bounder, frame: Frame | None):
    """A bounder of a local shape as one of the shape in its frame, in place; raises ``BounderError`` where delta does not hold the blur."""
    if frame is not None:
        if fault := frame_fault(bounder, frame):
            raise BounderError(f"{bounder.method}: {fault}")
        bounder.frame = frame
        if bounder.certificate is not None:
            bounder.certificate = frame.noted(bounder.certificate)
    return bounder


def frame_fault(bounder, frame: Frame) -> str | None:
    """Why a bounder's claim does not hold in a frame, in a few words; ``None`` if it does. A distance takes the blur off its answers."""
    if len(frame.origin) != bounder.ndim:
        return f"an origin of {len(frame.origin)} numbers for {bounder.ndim} coordinates"
    blur = np.array(frame.blur)
    domains = (
        [] if isinstance(bounder.domain, DistanceDomain) else [bounder.domain, *(part.domain for part in bounder.parts)]
    )
    if blur.any() and (fault := next(filter(None, (domain.fault(blur) for domain in domains)), None)):
        return f"cells stand up to {blur.max():.3g} beside the ones asked for, as float32 holds the inverse of their size: {fault}"
    return None
