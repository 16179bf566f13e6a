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
    """The pairs of a list that may touch; ``OrderedSieve`` and ``ListSieve`` say how the pairs are listed.

    Attributes:
        pairs: ``(N,)`` ``vec2i``, ball and shape.
        keep: ``(N,)`` bool, true for the pairs that the last pass left.
        one_thread: Whether its launches must not be shared among threads.
    """

    one_thread = False
    _count: wp.array  # of the pairs that are left
    # Pairs that the hulls leave to bounders are in lists of ``_room`` places each, ``_undecided_counts`` long, which
    # ``_threads`` threads share.
    _undecided_counts: wp.array
    _room: int
    _threads = 1
    _listed = _counts = None  # on a GPU: the pairs that stay, and what ``lists`` counts

    def __init__(self, pairs: wp.array, balls: int, shapes: Shapes):
        """Of ``balls`` balls; loads all kernels, so that a graph can be captured."""
        self.pairs, self._balls, self._shapes, self._device = pairs, balls, shapes, pairs.device
        self.keep = wp.full(len(pairs), True, dtype=wp.bool, device=pairs.device)
        self._kept, self._undecided = self._empty(wp.vec2i), self._empty(wp.int32)  # undecided by the hulls
        self._allocate()
        self._count.fill_(len(pairs))
        # What is made when it is first needed is made now: a graph would hold the copy of a bounder's numbers to the
        # device, from memory that is not kept.
        for kernel in (*self._kernels, *(self._query_kernel(bounder) for bounder in shapes.bounders)):
            ready(kernel, self._device)
        self._data = [bounder.data for bounder in shapes.bounders]

    def __len__(self) -> int:
        """The number of all pairs."""
        return len(self.pairs)

    @property
    def left(self) -> int:
        """How many pairs ``kept`` has found; waits for the device."""
        return int(self._count.numpy()[0])

    def begin(self) -> None:
        """Forget what the last pass counted."""

    def launches(self, points: wp.array, radii: wp.array) -> list[BlockLaunch]:
        """What fills ``keep``, in this order, behind ``begin`` and ``place_shapes``.

        Of balls with these centres and radii.
        """
        if not len(self):
            return []
        queries = (self._query(number, each, points, radii) for number, each in enumerate(self._shapes.bounders))
        return [*self._query_hulls(points, radii), *queries]

    def kept(self, points: wp.array, reads_back: bool) -> wp.array:
        """The pairs that ``keep`` leaves; where nothing is read back as many as there are, some denied one for others.

        See ``Cull.candidates``.
        """
        return self._padded(points) if self._device.is_capturing or not reads_back else self._listed_alone()

    def _empty(self, dtype: type, size: int | None = None) -> wp.array:
        return wp.empty(len(self) if size is None else size, dtype=dtype, device=self._device)

    def _query_kernel(self, bounder: Bounder) -> wp.Kernel:
        return lists.query_listed(bounder.source)

    def _query(self, number: int, bounder: Bounder, points: wp.array, radii: wp.array) -> BlockLaunch:
        """Ask a bounder about the pairs of its shapes that the hulls have left: one after another, in lists."""
        shapes, threads = self._shapes, self._threads
        about = [bounder.data, number, bounder.info.get("margin") or 0.0, shapes.bounder_of, self.pairs, points, radii]
        found = [shapes.placed, shapes.hulls, self._undecided, self._undecided_counts]
        inputs, outputs = [0, threads, self._room, *about, *found], [self.keep, self._listed, self._counts]
        count = threads * len(self._undecided_counts)
        return BlockLaunch(self._query_kernel(bounder), count, inputs, outputs, self._device, first_index=0, block=1)


class OrderedSieve(Sieve):
    """Keeps the order of the pairs: blocks of them are decided together, and the kept ones gathered, on a CPU."""

    _kernels = kernels.split_balls, kernels.gather_or_repeat, query_hulls

    def _allocate(self) -> None:
        size = len(self)
        # The balls, row by row (``split_balls``), and which pairs follow each other, so that they are looked at
        # together.
        self._rows = self._empty(wp.float32, 4 * self._balls)
        self._runs = wp.array(runs_of(self.pairs.numpy()), dtype=wp.bool, device=self._device)
        self._room, self._undecided_counts = CPU_BLOCK, self._empty(wp.int32, -(-size // CPU_BLOCK))
        self._survivors = Compaction(self.keep)
        self._count = self._survivors.count
        inputs = [self.pairs, self._survivors.indices, self._count]
        gather = partial(wp.launch, kernels.gather_or_repeat, size, inputs, [self._kept], device=self._device)
        self._gather = gather(record_cmd=True) if size else None

    def _query_hulls(self, points: wp.array, radii: wp.array) -> list[BlockLaunch]:
        size, launch = len(self), partial(BlockLaunch, device=self._device)
        rows = [0, points, radii, self._balls]
        hulls = [self.pairs, size, CPU_BLOCK, 0, self._runs, self._rows, self._shapes.hulls]
        left = [self._undecided, self._undecided_counts, self.keep]
        return [
            launch(kernels.split_balls, self._balls, rows, [self._rows], first_index=0, block=1),
            launch(query_hulls, size, hulls, left, first_index=3, block=CPU_BLOCK),
        ]

    def _query_kernel(self, bounder: Bounder) -> wp.Kernel:
        return query_distances_in_lanes(bounder.source) if bounder.of_distances else super()._query_kernel(bounder)

    def _query(self, number: int, bounder: Bounder, points: wp.array, radii: wp.array) -> BlockLaunch:
        if not bounder.of_distances:
            return super()._query(number, bounder, points, radii)
        shapes, data, blocks = self._shapes, bounder.data, len(self._undecided_counts)
        about = [data.words, number, bounder.info.get("margin") or 0.0, shapes.bounder_of, self.pairs, self._rows]
        found = [shapes.placed, shapes.hulls, self._undecided, self._undecided_counts]
        inputs = [data.parameters, blocks, CPU_BLOCK, 0, *about, *found]
        options = {"device": self._device, "first_index": 3, "block": BLOCKS}
        return BlockLaunch(self._query_kernel(bounder), blocks, inputs, [self.keep], **options)

    def _listed_alone(self) -> wp.array:
        left = int(self._survivors.launch()[1].numpy()[0])
        if left:
            self._gather.set_dim(left)
            self._gather.launch()
        return self._kept[:left]

    def _padded(self, points: wp.array) -> wp.array:
        device = self._device
        indices, total = self._survivors.launch_recorded() if device.is_capturing else self._survivors.launch()
        inputs = [self.pairs, indices, total]
        wp.launch(kernels.gather_or_repeat, dim=len(self), inputs=inputs, outputs=[self._kept], device=device)
        return self._kept


class ListSieve(Sieve):
    """Lists the pairs in an order by chance, on a GPU; see ``lists``."""

    _kernels = lists.sift, lists.arrange, lists.count_cells, lists.sort_by_cells

    def _allocate(self) -> None:
        size, device = len(self), self._device
        self.one_thread = device.is_cpu  # threads of a CPU would count over each other
        self._listed = self._empty(wp.vec2i)
        self._counts = wp.zeros(4, dtype=wp.int32, device=device)  # see ``lists``
        self._count = self._counts[:1]
        self._room, self._undecided_counts = size, self._counts[1:2]  # a single list
        if size >= SORTED:
            self._ordered, self._cells = self._empty(wp.vec2i), self._empty(wp.vec2i)
            self._sizes, self._ends = (wp.zeros(lists.CELLS, dtype=wp.int32, device=device) for _ in range(2))
        self._threads = max(1, min(size, THREADS * max(device.sm_count, 1)))  # that share a list

    def begin(self) -> None:
        self._counts.zero_()

    def _query_hulls(self, points: wp.array, radii: wp.array) -> list[BlockLaunch]:
        inputs = [0, self.pairs, points, radii, self._shapes.hulls]
        outputs = [self.keep, self._undecided, self._listed, self._counts]
        return [BlockLaunch(lists.sift, len(self), inputs, outputs, self._device, first_index=0, block=1)]

    def _listed_alone(self) -> wp.array:
        return self._listed[: self.left]

    def _padded(self, points: wp.array) -> wp.array:
        device, size = self._device, len(self)
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


def in_lists(device: wp.Device) -> bool:
    """Whether pairs are listed by ``ListSieve``."""
    return device.is_cuda


def sieve_of(pairs: wp.array, balls: int, shapes: Shapes) -> Sieve:
    """The sieve of these pairs for their device."""
    return (ListSieve if in_lists(pairs.device) else OrderedSieve)(pairs, balls, shapes)
