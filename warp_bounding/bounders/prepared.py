"""Queries that are asked again and again, in every step of a simulation: all that does not change is set up once.

A call of ``Bounder.query`` checks and views its input, makes memory for the answers, checks a placement and packs a kernel's
arguments, which takes longer than the answers to a thousand queries. ``Bounder.prepare`` does so once; ``Prepared.launch`` only runs.
"""

from typing import Protocol

import numpy as np
import warp as wp

from warp_bounding.coordinates.domain import Domain
from warp_bounding.coordinates.placement import Placement
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.errors import QueryError
from warp_bounding.kernels.functions import Data, batch_kernel
from warp_bounding.kernels.plain import plain_kernel
from warp_bounding.kernels.source import Source
from warp_bounding.runtime.arrays import flat_queries, memory_of, new_output
from warp_bounding.runtime.compaction import Compaction
from warp_bounding.runtime.launch import BLOCK, BlockLaunch

__all__ = ["Prepared", "batch_launch"]


class Asked(Protocol):
    """A bounder as launches see it; every ``Bounder`` is one."""

    domain: Domain | RegionDomain
    query_kind: str
    device: wp.Device
    source: Source
    native: bool
    data: Data


def batch_launch(
    bounder: Asked, queries: wp.array, count: int, place: wp.array | None, out: wp.array, *, values: bool = False
) -> BlockLaunch:
    """A batch of queries about to be asked, with the bounder's threshold as it is now.

    Args:
        bounder: What is asked.
        queries: Flat, as ``flat_queries`` makes them.
        count: How many.
        place: ``Placement.values`` on the device; ``None`` for queries in object space.
        out: ``(count,)``, uint8, or float32 for values.
        values: See ``batch_kernel``.
    """
    data = bounder.data
    place_or_any = data.parameters if place is None else place  # kernels may not be given null pointers
    inputs = [queries, count, 0, data.parameters, data.words, place_or_any]
    kernel_of, block = (batch_kernel, BLOCK) if bounder.native else (plain_kernel, 1)
    kernel = kernel_of(bounder.source, place is not None, values)
    return BlockLaunch(kernel, count, inputs, [out], bounder.device, first_index=2, block=block)


class Prepared:
    """Some queries of one bounder, ready to be asked; made by ``Bounder.prepare``.

    It keeps the memory of the queries and of the answers. The queries are read anew in every launch: write the next ones to the same
    memory. Answers are written to the same memory in every launch; nothing is allocated, and nothing read back. A new threshold
    (``Bounder.freeze``) is seen by the next launch. One thread at a time may use it; several of them may run in several threads.

    Attributes:
        out: ``(N,)`` uint8, 1 = maybe, 0 = certainly not.
        indices: ``(N,)`` int32, ascending indices of the candidates; ``None`` unless they are asked for.
        count: How many there are, a 1-element int32 array, or ``None``.

    Example:
        >>> asked = bounder.prepare(points, candidates=True)
        >>> indices, count = asked.launch()
        >>> asked.out.shape, indices.shape, count.shape
        ((100,), (100,), (1,))
    """

    def __init__(self, bounder: Asked, x, *, out: wp.array | None, xform, scale, candidates: bool):
        self._bounder, self._x = bounder, x
        self._queries, self._number, _ = flat_queries(x, bounder.domain.columns, bounder.device)
        self._memory = memory_of(x)
        if self._memory is None or (self._number and self._memory[0] != self._queries.ptr):
            dtype = getattr(x, "dtype", "numbers")
            got = f"{type(x).__name__} of {getattr(dtype, '__name__', dtype)} that would have to be copied"
            raise QueryError(
                f"x must be float32, in one piece and on {bounder.device}: every launch reads it there; got {got}"
            )
        self.out = new_output(out, self._number, wp.uint8, bounder.device)
        self._place: wp.array | None = None
        if xform is not None or scale is not None:
            self._place = wp.array(self._placement(xform, scale), dtype=wp.float32, device=bounder.device)
        self._compaction = Compaction(self.out) if candidates else None
        self.indices = self._compaction.indices if candidates else None
        self.count = self._compaction.count if candidates else None
        self._record()

    def launch(self) -> wp.array | tuple[wp.array, wp.array]:
        """Ask.

        Returns:
            ``out``; where candidates are asked for, ``(indices, count)`` as of ``Bounder.candidates``, and ``out`` is filled, too.

        Raises:
            QueryError: If ``x`` lies elsewhere by now, or has another shape, as after ``resize_`` or a new ``data`` of a torch tensor.

        Example:
            >>> bounder.prepare(points).launch().dtype.__name__
            'uint8'
        """
        if memory_of(self._x) != self._memory:
            raise QueryError("x lies elsewhere than when it was prepared, or has another shape; prepare it again")
        if self._bounder.data is not self._data:
            self._record()
        self._asking.launch()
        return self.out if self._compaction is None else self._compaction.launch()

    def move(self, *, xform=None, scale=None) -> None:
        """Place the shape elsewhere in the world, for the launches to come.

        Args:
            xform: As for ``Bounder.query``; what is not given is not as before, but none.
            scale: As for ``Bounder.query``.

        Raises:
            QueryError: If neither is given, or ``prepare`` was given neither, or for a placement that the certificate does not cover;
                the old one is kept.

        Example:
            >>> asked = bounder.prepare(points, scale=1.0)
            >>> asked.move(xform=wp.transform(wp.vec3(9.0), wp.quat_identity()))
            >>> int(asked.launch().numpy().sum())
            0
        """
        if self._place is None:
            raise QueryError("move: expected queries that were prepared with xform or scale, got ones in object space")
        values = self._placement(xform, scale)
        if self._place.device.is_cpu:
            self._place.numpy()[:] = values
        else:
            self._place.assign(values)

    def __repr__(self) -> str:
        where = "object space" if self._place is None else "the world"
        asked = ", with candidates" if self._compaction else ""
        return (
            f"<{self._number:,} {self._bounder.query_kind} queries in {where}{asked}, prepared for {self._bounder!r}>"
        )

    def _placement(self, xform, scale) -> np.ndarray:
        domain = self._bounder.domain
        placement = Placement.of(domain, xform, scale)
        if placement is None:
            raise QueryError("move: expected xform or scale, got neither")
        placement.check(domain, double=False)
        return placement.values

    def _record(self) -> None:
        self._data = self._bounder.data
        self._asking = batch_launch(self._bounder, self._queries, self._number, self._place, self.out)
