"""Many bounders in one launch: each query names the bounder that it asks.

Bounders of equal sizes share one ``wp.Func`` and differ in their data, so they are a *group*: an array of ``Data``, and for each bounder its place in
it. A stack asks one kernel a group; in a kernel of your own, ``wp.static(group.func)(group.data[group.slots[s]], q)`` asks bounder s.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import warp as wp

from warp_bounding.bounders import Bounder, DistanceBounder
from warp_bounding.errors import QueryError
from warp_bounding.kernels.functions import Data, point_func
from warp_bounding.kernels.source import Source
from warp_bounding.runtime.arrays import flat_queries, new_output
from warp_bounding.runtime.launch import launch_blocks
from warp_bounding.runtime.native import named, unique_name, vector_type

__all__ = ["BounderGroup", "BounderStack"]


@dataclass(frozen=True)
class BounderGroup:
    """Bounders that share a function.

    Attributes:
        func: As of ``Bounder.func``; write ``wp.static(group.func)`` in a kernel.
        data: ``wp.array(dtype=wb.Data)``, one entry a bounder of the group.
        slots: ``wp.array(dtype=wp.int32)``, ``(S,)``: the place in ``data`` of each bounder of the stack, -1 for those of other groups.
        members: Numbers of the bounders in the stack, in the order of ``data``.
    """

    func: wp.Function
    data: wp.array
    slots: wp.array
    members: tuple[int, ...]
    source: Source
    held: tuple[Data, ...]  # whose memory ``data`` points to


class BounderStack:
    """Bounders that are asked together, each by its number.

    Args:
        bounders: Of the same kind of query, dimension and device. Thresholds are those of now.

    Raises:
        QueryError: If they are of several kinds, or there are none.

    Example:
        >>> stack = wb.BounderStack([bounder, wb.fit(ball, method="kdop", device="cpu")])
        >>> stack
        <stack of 2 bounders, 2 functions, 3D point queries>
    """

    def __init__(self, bounders: Sequence[Bounder]):
        if not bounders:
            raise QueryError("a stack needs at least one bounder, got none")
        for bounder in bounders:
            if isinstance(bounder, DistanceBounder):
                raise QueryError(f"a stack is asked points, rays, planes or boxes, got {bounder!r}, a distance")
            bounder.expect_local("a stack")
        first = bounders[0]
        self.query_kind, self.ndim, self.device = first.query_kind, first.ndim, first.device
        self._columns = first.domain.columns
        groups: dict[Source, list[int]] = {}
        for number, bounder in enumerate(bounders):
            if (bounder.query_kind, bounder.ndim, bounder.device) != (self.query_kind, self.ndim, self.device):
                raise QueryError(
                    f"bounders of a stack must be of one kind, dimension and device, got {first!r} and {bounder!r}"
                )
            groups.setdefault(bounder.source, []).append(number)
        self._bounders = [bounder.to() for bounder in bounders]  # at these thresholds, for pickling
        self.groups = tuple(self._group(source, members, bounders) for source, members in groups.items())

    def _group(self, source: Source, members: list[int], bounders: Sequence[Bounder]) -> BounderGroup:
        slots = np.full(len(bounders), -1, np.int32)
        slots[members] = np.arange(len(members))
        held = tuple(bounders[number].data for number in members)
        return BounderGroup(
            func=point_func(source),
            data=wp.array(list(held), dtype=Data, device=self.device),
            slots=wp.array(slots, dtype=wp.int32, device=self.device),
            members=tuple(members),
            source=source,
            held=held,
        )

    def __reduce__(self):
        return BounderStack, (self._bounders,)

    def __len__(self) -> int:
        return len(self._bounders)

    def __repr__(self) -> str:
        return f"<stack of {len(self)} bounders, {len(self.groups)} functions, {self.ndim}D {self.query_kind} queries>"

    def query(self, shape_indices, x, *, out: wp.array | None = None) -> wp.array:
        """Ask each query of one bounder.

        Args:
            shape_indices: ``(N,)`` NumPy array or ``wp.array`` of whole numbers: which bounder each query asks. Those on the device as int32
                are read in place, and not checked: a number of no bounder is answered with *maybe*.
            x: As for ``Bounder.query``, in the coordinates of each query's own shape.
            out: ``(N,)`` uint8 to write to, instead of a new array.

        Returns:
            ``(N,)`` uint8 ``wp.array``: 1 = maybe, 0 = certainly not.

        Raises:
            QueryError: For a wrong shape, dtype, device or number.

        Example:
            >>> stack = wb.BounderStack([bounder, wb.fit(ball, method="kdop", device="cpu")])
            >>> stack.query([0, 1, 1], points[:3]).shape
            (3,)
        """
        queries, count, _ = flat_queries(x, self._columns, self.device)
        numbers = self._numbers(shape_indices, count)
        out = new_output(out, count, wp.uint8, self.device)
        out.fill_(1)
        if not count:
            return out
        rows, vector = count * self._columns // self.ndim, vector_type(self.ndim)
        vectors = wp.array(ptr=queries.ptr, dtype=vector, shape=(rows,), device=self.device, copy=False)
        for group in self.groups:
            inputs = [0, group.data, group.slots, len(self), numbers, vectors]
            launch_blocks(_asking(group.source), count, inputs, [out], self.device, first_index=0, block=1)
        return out

    def _numbers(self, given, count: int) -> wp.array:
        if isinstance(given, wp.array) and given.dtype == wp.int32 and given.device == self.device:
            numbers = given
        else:
            values = given.numpy() if isinstance(given, wp.array) else np.asarray(given)
            if values.dtype.kind not in "iu" and values.size:
                raise QueryError(f"shape_indices must be whole numbers, got {values.dtype}")
            wrong = values[(values < 0) | (values >= len(self))] if values.size else values
            if len(wrong):
                raise QueryError(f"shape_indices must be from 0 to {len(self) - 1}, got {wrong[0]}")
            numbers = wp.array(values.astype(np.int32), dtype=wp.int32, device=self.device)
        if numbers.shape != (count,):
            raise QueryError(f"shape_indices must have shape ({count},), one for each query, got {numbers.shape}")
        return numbers


@cache
def _asking(source: Source) -> wp.Kernel:
    """The kernel that answers the queries of one group's bounders, and leaves the answers of others as they are."""
    test, vector = point_func(source), vector_type(source.ndim)
    name = named(unique_name(source, "stack"))
    if source.is_region:

        @name.kernel
        def ask_regions(
            # inputs
            first: int,
            data: wp.array(dtype=Data),
            slots: wp.array(dtype=wp.int32),
            size: int,
            numbers: wp.array(dtype=wp.int32),
            x: wp.array(dtype=vector),
            # outputs
            out: wp.array(dtype=wp.uint8),
        ):
            i = first + wp.tid()
            number = numbers[i]
            if number >= 0 and number < size:
                slot = slots[number]
                if slot >= 0 and not test(data[slot], x[2 * i], x[2 * i + 1]):
                    out[i] = wp.uint8(0)

        return ask_regions

    @name.kernel
    def ask_points(
        # inputs
        first: int,
        data: wp.array(dtype=Data),
        slots: wp.array(dtype=wp.int32),
        size: int,
        numbers: wp.array(dtype=wp.int32),
        x: wp.array(dtype=vector),
        # outputs
        out: wp.array(dtype=wp.uint8),
    ):
        i = first + wp.tid()
        number = numbers[i]
        if number >= 0 and number < size:
            slot = slots[number]
            if slot >= 0 and not test(data[slot], x[i]):
                out[i] = wp.uint8(0)

    return ask_points
