"""A broad phase of Newton's with a filter behind it: pairs of meshes that are certainly apart go.

Newton makes contacts of two meshes where a point on an edge of one has a distance from the other under ``gap + margin``
of both, added up. ``PairFilter`` asks ``wb.pairs`` whether all of one mesh is farther than that from all of the other,
and by what float32 does on the way: Newton's transforms, as in ``placing``, and its closest points, under ``ROUNDING =
256 u`` of the places, of what the meshes reach from their origins, and of the sum itself. Pairs that are left stand in
Newton's order, and their contacts are the same. Newton's reduction may list them in another order unless the pipeline
is made with ``deterministic=True``.

What stays as it is: pairs in which a shape has no bounder and balls here, or is scaled by different numbers along its
axes (Newton's distance is then too small), or whose mesh is another one by now; everything, where there are more pairs
than Newton's list holds. Refused are shapes with a texture SDF, whose distances are only about right, and meshes that
are open or have an edge without exactly two faces: by their normals Newton may find an inside far away
(``unproven=True`` takes both).
"""

from collections.abc import Mapping
from functools import cache

import newton
import numpy as np
import warp as wp

from warp_bounding.bounders import Bounder
from warp_bounding.errors import BounderError
from warp_bounding.kernels.distances import DistanceSource
from warp_bounding.newton.placing import coordinates_of
from warp_bounding.newton.shapes import CLOSED, check_index, check_proven, triangles
from warp_bounding.pairs import Balls, Pair, PairData
from warp_bounding.pairs.kernels import closest_func
from warp_bounding.rounding import UNIT32
from warp_bounding.runtime.arrays import Compaction
from warp_bounding.runtime.launch import launch_blocks, ready
from warp_bounding.runtime.native import named, unique_name
from warp_bounding.shapes import Mesh

ROUNDING = wp.constant(256.0 * UNIT32)
NONE = wp.constant(-1)


@wp.func
def _even(scale: wp.vec3) -> bool:
    return wp.abs(scale[0]) == wp.abs(scale[1]) and wp.abs(scale[1]) == wp.abs(scale[2])


@wp.struct
class Scene:
    """Of each shape: its number among bounders and among balls, its mesh, and what Newton's pass reads."""

    bounder_of: wp.array(dtype=wp.int32)
    balls_of: wp.array(dtype=wp.int32)
    meshes: wp.array(dtype=wp.uint64)
    now: wp.array(dtype=wp.uint64)
    places: wp.array(dtype=wp.transform)
    scales: wp.array(dtype=wp.vec3)
    margins: wp.array(dtype=float)
    gaps: wp.array(dtype=float)


@wp.kernel(enable_backward=False)
def _begin(pairs: wp.array(dtype=wp.vec2i), count: wp.array(dtype=wp.int32), keep: wp.array(dtype=wp.bool)):
    i = wp.tid()
    keep[i] = i < count[0]


@wp.kernel(enable_backward=False)
def _end(
    # inputs
    before: wp.array(dtype=wp.vec2i),
    indices: wp.array(dtype=wp.int32),
    total: wp.array(dtype=wp.int32),
    # outputs
    pairs: wp.array(dtype=wp.vec2i),
    count: wp.array(dtype=wp.int32),
    found: wp.array(dtype=wp.int32),
):
    i = wp.tid()
    if count[0] <= pairs.shape[0]:
        if i < total[0]:
            pairs[i] = before[indices[i]]
        if i == 0:
            found[0] = count[0]
            found[1] = total[0]


@wp.kernel(enable_backward=False)
def _counted(found: wp.array(dtype=wp.int32), count: wp.array(dtype=wp.int32)):
    if found[0] >= 0:
        count[0] = found[1]


@cache
def deny_kernel(source: DistanceSource) -> wp.Kernel:
    """``(first, data, rows, scene, pairs, keep)``: pairs of shapes with a bounder of this source and balls, either way.

    ``data`` has a row for each such bounder, with all balls; ``rows`` tells which, or ``NONE``.
    """
    closest = closest_func(source)

    @named(unique_name(source, "newton_apart")).func
    def apart(data: wp.array2d(dtype=PairData), rows: wp.array(dtype=int), scene: Scene, i: int, j: int, gap: float):
        if scene.bounder_of[i] == NONE or scene.balls_of[j] == NONE:
            return False
        row = rows[scene.bounder_of[i]]
        if row == NONE:
            return False
        own, scale_i, scale_j = data[row, scene.balls_of[j]], scene.scales[i], scene.scales[j]
        world = coordinates_of(wp.transform_get_translation(scene.places[i])) + gap
        world += coordinates_of(wp.transform_get_translation(scene.places[j]))
        largest = wp.max(wp.abs(scale_i[0]), wp.abs(scale_j[0]))
        gap += ROUNDING * (world + largest * (own.reach_a + own.reach_b))
        return closest(own, scene.places[i], scene.places[j], scale_i, scale_j, gap, False) > gap

    def deny(
        first: int,
        # inputs
        data: wp.array2d(dtype=PairData),
        rows: wp.array(dtype=int),
        scene: Scene,
        pairs: wp.array(dtype=wp.vec2i),
        # outputs
        keep: wp.array(dtype=wp.bool),
    ):
        p, _ = wp.tid()
        p += first
        i, j = pairs[p][0], pairs[p][1]
        if not keep[p] or scene.meshes[i] != scene.now[i] or scene.meshes[j] != scene.now[j]:
            return
        if not (_even(scene.scales[i]) and _even(scene.scales[j])):
            return
        gap = wp.abs(scene.gaps[i]) + wp.abs(scene.gaps[j]) + wp.abs(scene.margins[i]) + wp.abs(scene.margins[j])
        if apart(data, rows, scene, i, j, gap) or apart(data, rows, scene, j, i, gap):
            keep[p] = False

    return named(unique_name(source, "newton_pairs")).kernel(deny)


class PairFilter:
    """The pipeline's broad phase, less the pairs of meshes that are certainly apart.

    Newton asks ``isinstance`` which arguments a broad phase takes, so this has the class of the one that it holds.
    """

    def __init__(
        self,
        pipeline: newton.CollisionPipeline,
        bounders: Mapping[int, Bounder],
        balls: Mapping[int, Balls],
        unproven: bool,
    ):
        """See ``Cull``; shapes without balls take part if they can. Raises ``BounderError`` for those that cannot."""
        if getattr(pipeline, "_speculative_enabled", False):
            raise BounderError("speculative contacts look farther than gaps and margins; pairs must stay")
        self.pipeline, self._model = pipeline, pipeline.model
        model, device = self._model, pipeline.model.device
        count, self._pairs = model.shape_count, pipeline.broad_phase_shape_pairs
        meshes = model.shape_source_ptr.numpy().astype(np.uint64) if count else np.zeros(0, np.uint64)
        lists: tuple[list[Bounder], list[Balls]] = [], []
        known: dict[int, Mesh] = {}
        numbers = np.full((2, count), NONE, np.int32)
        for shape in {**bounders, **balls}:
            bounder = bounders.get(shape)
            own = bounder if getattr(bounder, "of_distances", False) else None, balls.get(shape)
            try:
                _check(model, shape, own, unproven, meshes, known)
            except BounderError:
                if shape in balls:
                    raise
                continue
            for row, (held, each) in enumerate(zip(lists, own, strict=True)):
                if each is not None:
                    if not any(each is other for other in held):
                        held.append(each)
                    numbers[row, shape] = next(n for n, other in enumerate(held) if other is each)
        self._tests, self._data = [], []
        for source in dict.fromkeys(bounder.source for bounder in lists[0]) if lists[1] else ():
            own = [n for n, bounder in enumerate(lists[0]) if bounder.source == source]
            data = [Pair(lists[0][n], each).data for n in own for each in lists[1]]
            rows = np.full(len(lists[0]), NONE, np.int32)
            rows[own] = np.arange(len(own))
            table = wp.array(data, dtype=PairData, device=device).reshape((len(own), len(lists[1])))
            self._tests.append((deny_kernel(source), table, wp.array(rows, dtype=int, device=device)))
            self._data += data  # the table has their arrays' addresses
        self._scene = Scene()
        self._scene.bounder_of, self._scene.balls_of = (wp.array(row, dtype=int, device=device) for row in numbers)
        self._scene.meshes = wp.array(meshes, dtype=wp.uint64, device=device)
        size = max(len(self._pairs), 1)
        self._keep = wp.zeros(size, dtype=wp.bool, device=device)
        self._before = wp.empty(size, dtype=wp.vec2i, device=device)
        self._found = wp.full(2, NONE, dtype=wp.int32, device=device)
        self._compaction = Compaction(self._keep)
        for kernel in (_begin, _end, _counted, *(test[0] for test in self._tests)):
            ready(kernel, device)

    @property
    def __class__(self) -> type:
        return type(self.pipeline.broad_phase)

    def launch(self, *arguments, **options) -> None:
        """Launch the broad phase, then take denied pairs from its list."""
        self.pipeline.broad_phase.launch(*arguments, **options)
        self._filter()

    def counts(self) -> tuple[int, int]:
        """How many pairs the broad phase found in the last pass, and how many are left; waits for the device."""
        found, left = self._found.numpy().tolist()
        return max(found, 0), max(left, 0)

    def _filter(self) -> None:
        model, pipeline, device = self._model, self.pipeline, self._model.device
        count, scene, capturing = pipeline.broad_phase_pair_count, self._scene, device.is_capturing
        self._found.fill_(NONE)
        if not self._tests or not len(self._pairs):
            return
        scene.now, scene.places, scene.scales = model.shape_source_ptr, pipeline.geom_transform, model.shape_scale
        scene.margins, scene.gaps = model.shape_margin, model.shape_gap
        size = len(self._pairs)
        asked = size if device.is_cuda else min(int(count.numpy()[0]), size)
        if not asked:
            return
        self._keep.zero_()
        wp.launch(_begin, asked, [self._pairs, count, self._keep], device=device)
        for kernel, data, rows in self._tests:
            inputs = [0, data, rows, scene, self._pairs]
            if capturing:
                wp.launch(kernel, (asked, 1), [*inputs, self._keep], device=device)
            else:
                launch_blocks(kernel, asked, inputs, [self._keep], device, first_index=0, block=1)
        indices, total = self._compaction.launch_recorded() if capturing else self._compaction.launch()
        wp.copy(self._before, self._pairs, count=size)
        inputs, outputs = [self._before, indices, total], [self._pairs, count, self._found]
        wp.launch(_end, asked, inputs, outputs, device=device)
        wp.launch(_counted, 1, [self._found], [count], device=device)


def _check(model, shape: int, own, unproven: bool, meshes: np.ndarray, known: dict[int, Mesh]) -> None:
    """Refuse, with ``BounderError``, what is no bounder or no balls of a shape's mesh, as it is on the device."""
    check_index(model, shape)
    if int(model.shape_type.numpy()[shape]) != int(newton.GeoType.MESH):
        raise BounderError(f"shape {shape}: expected a mesh")
    bounder, balls = own
    if bounder is not None:
        Pair(bounder, Balls(np.zeros((1, 3), np.float32), np.zeros(1, np.float32), ""))  # a distance in 3D, at rest
        check_proven(model, shape, bounder, unproven)
    if not (balls is None or isinstance(balls, Balls)):
        raise BounderError(f"shape {shape}: expected balls (wb.pairs.Balls), got {type(balls).__name__}")
    if unproven:
        return
    place = int(meshes[shape])
    if place not in known:
        known[place] = Mesh(*triangles(place, model.device))
    mesh = known[place]
    if bounder is not None and bounder.info.get("shape") != mesh.geometry:
        raise BounderError(f"shape {shape}: the bounder was made for another mesh, {bounder.info.get('name')}")
    if balls is not None and balls.mesh != mesh.digest:
        raise BounderError(f"shape {shape}: the balls hold another mesh, {balls.name}")
    if not mesh.watertight:
        raise BounderError(f"shape {shape}: its mesh is open, and what Newton takes for its inside is not known")
    properties = getattr(model, "_shape_mesh_properties", None)
    if properties is None or not int(properties.numpy()[shape]) & CLOSED:
        raise BounderError(f"shape {shape}: an edge has not two faces, so Newton tells the inside by normals")
    index = getattr(model, "_shape_sdf_index", None)
    if index is not None and len(index) and int(index.numpy()[shape]) >= 0:
        raise BounderError(f"shape {shape}: it has a texture SDF, whose distances are only about right")
