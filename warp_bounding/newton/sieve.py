"""Which pairs of balls and shapes may touch; on a CPU in their order (``kernels``), on a GPU as lists (``lists``).

Balls are particles, or hold a face of a soft body. Hulls of shapes decide most pairs, bounders what hulls leave.
"""

from functools import partial

import warp as wp

from warp_bounding.bounders import Bounder
from warp_bounding.newton import kernels, lists
from warp_bounding.newton.kernels import BLOCKS, CPU_BLOCK, query_distances_in_lanes, query_hulls, runs_of
from warp_bounding.newton.shapes import Shapes
from warp_bounding.runtime.arrays import Compaction
from warp_bounding.runtime.launch import BlockLaunch, ready

# On a GPU
WARPS = 16  # per multiprocessor: Newton's pass runs so many at a time, and the surviving pairs are shared among them
SORTED = 100_000  # a list of so many pairs or more is sorted by place
THREADS = 2048  # per multiprocessor


class Sieve:
    """The pairs of a list that may touch.

    Attributes:
        pairs: ``(N,)`` ``vec2i``, ball and shape.
        keep: ``(N,)`` bool, true for the pairs that the last pass left.
    """

    def __init__(self, pairs: wp.array, balls: int, shapes: Shapes):
        """Of ``balls`` balls; loads all kernels, so that a graph can be captured."""
        self.pairs, self._shapes, self._device = pairs, shapes, pairs.device
        self._balls, device, size = balls, pairs.device, len(pairs)
        self.keep = wp.full(size, True, dtype=wp.bool, device=device)
        self._kept = wp.empty(size, dtype=wp.vec2i, device=device)
        # The pairs that the hulls leave to the bounders.
        self._undecided = wp.empty(size, dtype=wp.int32, device=device)
        self.in_lists = in_lists(device)
        if self.in_lists:
            self._listed = wp.empty(size, dtype=wp.vec2i, device=device)
            self._counts = wp.zeros(4, dtype=wp.int32, device=device)  # see ``lists``
            self._count = self._counts[:1]
            if size >= SORTED:
                self._ordered = wp.empty(size, dtype=wp.vec2i, device=device)
                self._cells = wp.empty(size, dtype=wp.vec2i, device=device)
                self._sizes, self._ends = (wp.zeros(lists.CELLS, dtype=wp.int32, device=device) for _ in range(2))
            self._threads = max(1, min(size, THREADS * max(device.sm_count, 1)))  # that share a list
        else:
            # The balls, row by row (``split_balls``), and which pairs follow each other, so that they are looked at
            # together; how many undecided pairs each block has.
            self._rows = wp.empty(4 * balls, dtype=wp.float32, device=device)
            self._runs = wp.array(runs_of(pairs.numpy()), dtype=wp.bool, device=device)
            self._undecided_count = wp.empty(-(-size // CPU_BLOCK), dtype=wp.int32, device=device)
            self._survivors = Compaction(self.keep)
            self._count = self._survivors.count
            inputs = [pairs, self._survivors.indices, self._count]
            gather = partial(wp.launch, kernels.gather_or_repeat, size, inputs, [self._kept], device=device)
            self._gather = gather(record_cmd=True) if size else None
        self._count.fill_(size)
        # What is made when it is first needed is made now: a graph would hold the copy of a bounder's numbers to the
        # device, from memory that is not kept.
        for kernel in self._kernels():
            ready(kernel, device)
        self._data = [bounder.data for bounder in shapes.bounders]

    def __len__(self) -> int:
        """The number of all pairs."""
        return len(self.pairs)

    @property
    def left(self) -> int:
        """How many pairs ``kept`` has found; waits for the device."""
        return int(self._count.numpy()[0])

    def launches(self, points: wp.array, radii: wp.array) -> list[BlockLaunch]:
        """What fills ``keep``, in this order, behind ``place_shapes``; of balls with these centres and radii.

        In lists, counts must be zero before (``begin``).
        """
        shapes, device, size = self._shapes, self._device, len(self.pairs)
        if not size:
            return []
        launch = partial(BlockLaunch, device=device)
        asking = [self._query(number, bounder, points, radii) for number, bounder in enumerate(shapes.bounders)]
        if self.in_lists:
            inputs = [0, self.pairs, points, radii, shapes.hulls]
            outputs = [self.keep, self._undecided, self._listed, self._counts]
            return [launch(lists.sift, size, inputs, outputs, first_index=0, block=1), *asking]
        rows = [0, points, radii, self._balls]
        hulls = [self.pairs, size, CPU_BLOCK, 0, self._runs, self._rows, shapes.hulls]
        left = [self._undecided, self._undecided_count, self.keep]
        return [
            launch(kernels.split_balls, self._balls, rows, [self._rows], first_index=0, block=1),
            launch(query_hulls, size, hulls, left, first_index=3, block=CPU_BLOCK),
            *asking,
        ]

    def begin(self) -> None:
        """Forget what the last pass counted."""
        if self.in_lists:
            self._counts.zero_()

    def kept(self, points: wp.array, reads_back: bool) -> wp.array:
        """The pairs that ``keep`` leaves; where nothing is read back as many as there are, some denied one for others.

        See ``Cull.candidates``.
        """
        capturing = self._device.is_capturing
        if self.in_lists:
            return self._kept_in_lists(points, reads_back and not capturing)
        if capturing or not reads_back:
            return self._padded()
        left = int(self._survivors.launch()[1].numpy()[0])
        if left:
            self._gather.set_dim(left)
            self._gather.launch()
        return self._kept[:left]

    def _padded(self) -> wp.array:
        """As many pairs as there are: those that are left, and a denied one."""
        device = self._device
        indices, total = self._survivors.launch_recorded() if device.is_capturing else self._survivors.launch()
        inputs = [self.pairs, indices, total]
        wp.launch(kernels.gather_or_repeat, dim=len(self.pairs), inputs=inputs, outputs=[self._kept], device=device)
        return self._kept

    def _kept_in_lists(self, points: wp.array, reads_back: bool) -> wp.array:
        """``kept`` on a GPU; see ``lists``."""
        if reads_back:
            return self._listed[: self.left]
        device, size = self._device, len(self.pairs)
        listed = self._listed if size < SORTED else self._by_place(points)
        warps = max(1, min(size // lists.WARP, WARPS * max(device.sm_count, 1)))
        inputs = [self.pairs, listed, self._counts, warps]
        wp.launch(lists.arrange, dim=size, inputs=inputs, outputs=[self._kept], device=device)
        return self._kept

    def _by_place(self, points: wp.array) -> wp.array:
        """The listed pairs, sorted by their places."""
        threads, launch = self._threads, partial(wp.launch, dim=self._threads, device=self._device)
        self._sizes.zero_()
        inputs = [threads, self._listed, self._counts, points, self._shapes.hulls]
        launch(lists.count_cells, inputs=inputs, outputs=[self._cells, self._sizes])
        wp.utils.array_scan(self._sizes, self._ends, inclusive=True)
        inputs = [threads, self._listed, self._counts, self._cells, self._ends, self._sizes]
        launch(lists.sort_by_cells, inputs=inputs, outputs=[self._ordered])
        return self._ordered

    def _asking(self, bounder: Bounder) -> wp.Kernel:
        """The kernel that asks a bounder."""
        if self.in_lists:
            return lists.ask_listed(bounder.source)
        return (query_distances_in_lanes if bounder.of_distances else kernels.query_bounders)(bounder.source)

    def _kernels(self) -> list[wp.Kernel]:
        if self.in_lists:
            own = [lists.sift, lists.arrange, lists.count_cells, lists.sort_by_cells]
        else:
            own = [kernels.split_balls, kernels.gather_or_repeat, query_hulls]
        return [*own, *map(self._asking, self._shapes.bounders)]

    def _query(self, number: int, bounder: Bounder, points: wp.array, radii: wp.array) -> BlockLaunch:
        """Ask a bounder about the pairs of its shapes that the hulls have left."""
        shapes, device, data = self._shapes, self._device, bounder.data
        where, dilated = [shapes.placed, shapes.hulls], bounder.info.get("margin") or 0.0
        of, found, outputs = shapes.bounder_of, [self._undecided], [self.keep]
        items, first, share = len(self.pairs), 0, CPU_BLOCK
        if self.in_lists:
            items, share, outputs = self._threads, 1, [self.keep, self._listed, self._counts]
            inputs = [0, items, data, number, dilated, of, self.pairs, points, radii, *where]
        elif not bounder.of_distances:
            inputs = [0, CPU_BLOCK, data, number, of, self.pairs, points, shapes.placed]
            found += [self._undecided_count]
        else:
            items, first, share = len(self._undecided_count), 3, BLOCKS
            inputs = [data.parameters, items, CPU_BLOCK, 0, data.words, number, dilated, of, self.pairs, self._rows]
            inputs, found = [*inputs, *where], [*found, self._undecided_count]
        options = {"first_index": first, "block": share}
        return BlockLaunch(self._asking(bounder), items, [*inputs, *found], outputs, device, **options)


def in_lists(device: wp.Device) -> bool:
    """Whether the kernels of ``lists`` are used, and not those for a CPU."""
    return device.is_cuda
