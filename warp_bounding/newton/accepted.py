"""Which bounders the cull takes: proven, of the shape's own mesh, dilated as far as Newton's pass looks and float32 may err."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from warp_bounding.arithmetic import UNIT32
from warp_bounding.bounders import Bounder, DistanceBounder
from warp_bounding.errors import BounderError
from warp_bounding.indicators import IndicatorMesh
from warp_bounding.newton.library import newton
from warp_bounding.newton.placing import IN_MESH, IN_WORLD
from warp_bounding.queries import QUERIES

__all__ = ["MESHES", "check_bounder", "contact_gap", "margin_for"]

MESHES = (int(newton.GeoType.MESH), int(newton.GeoType.CONVEX_MESH))


def margin_for(mesh: newton.Mesh, reach: float, *, world: float, scale: float = 1.0) -> float:
    """The ``margin`` to fit a bounder with, so that ``ParticleCull`` takes it.

    Args:
        mesh: The shape's mesh.
        reach: Largest particle radius + shape margin + the pipeline's soft contact gap, world units, not divided by the
            scale.
        world: Largest coordinate of particles and shapes, world units; pairs farther out are not cut.
        scale: The smallest scale that the mesh is used with.

    Returns:
        The margin, in the mesh's own units.

    Raises:
        BounderError: For a negative reach or world, or a scale of 0.
    """
    return _margin_for(float(np.abs(np.asarray(mesh.vertices)).max()), reach, world, scale)


def _margin_for(coordinates: float, reach: float, world: float, scale: float) -> float:
    """``margin_for`` of a mesh with this largest coordinate."""
    scale = abs(float(scale))
    if not (reach >= 0 and world >= 0 and scale > 0):
        raise BounderError(
            f"reach and world must be at least 0 and scale not 0, got {reach:g}, {world:g} and {scale:g}"
        )
    # In the mesh's units: gap + (margin + radius) / scale is at most reach / scale, and for scales above 1 at most
    # reach.
    way = reach / min(scale, 1.0)
    # The most that ``ask_hulls`` compares with the margin (``placing.Hull``): how far the pass looks, and what float32
    # does in the mesh and in the world. There |x| + |y| + |z| counts, at most 3 world for the particle and, turned back
    # into the mesh's axes, as much for the shape's place. 1e-6 is more than ``_SUM_ROUNDING``, 8 units of 2^-24, and
    # the rounding of the margin to float32.
    in_mesh = IN_MESH * UNIT32 * (coordinates + way)
    in_world = IN_WORLD * UNIT32 * 6.0 * world / scale
    return (way + in_mesh + in_world) * (1 + 1e-6)


def check_bounder(
    pipeline: newton.CollisionPipeline,
    shape: int,
    bounder: Bounder | DistanceBounder,
    unproven: bool,
    mesh_of: Callable[[int], tuple[np.ndarray, np.ndarray]],
) -> None:
    """Refuse a bounder that is not one of a shape's mesh.

    Args:
        pipeline: Whose model has the shape.
        shape: Its index.
        bounder: Of points, with margin enough for the pipeline's contact gap, or of distances.
        unproven: Whether one without a proof, or with too small a margin, will do.
        mesh_of: Called with the index of a shape, it returns points and triangles of its mesh on the device.

    Raises:
        BounderError: That says what was expected and what came.
    """
    model = pipeline.model
    whole = isinstance(shape, (int, np.integer)) and not isinstance(shape, bool)
    if not whole or not 0 <= shape < model.shape_count:
        raise BounderError(f"shape must be a whole number from 0 to {model.shape_count - 1}, got {shape!r}")
    if not isinstance(bounder, (Bounder, DistanceBounder)):
        raise BounderError(f"shape {shape}: expected a bounder, got {type(bounder).__name__}")
    if int(model.shape_type.numpy()[shape]) not in MESHES:
        raise BounderError(f"shape {shape}: expected a mesh, bounders of other shapes save nothing")
    of_distances = isinstance(bounder, DistanceBounder)
    of_points = not of_distances and not QUERIES[bounder.query_kind].is_region
    if not (of_distances or of_points) or bounder.ndim != 3 or bounder.domain.time or bounder.domain.unbounded:
        got = f"{bounder.ndim}D {bounder.query_kind}s"
        raise BounderError(f"shape {shape}: expected a bounder of 3D points or distances, got one of {got}")
    bounder.expect_local("a cull")
    if str(bounder.device) != str(model.device):
        raise BounderError(f"shape {shape}: expected a bounder on {model.device}, got one on {bounder.device}")
    if unproven:
        return
    if bounder.certificate is None or not bounder.certificate.proven:
        raise BounderError(f"shape {shape}: expected a proven bounder, got {bounder!r}")
    made_for, resolution, margin = (bounder.info.get(key) for key in ("indicator", "resolution", "margin"))
    if made_for is None or margin is None or _digest(*mesh_of(shape), resolution, margin) != made_for:
        raise BounderError(f"shape {shape}: the bounder was made for another mesh, {bounder.info.get('name')}")
    if of_distances:
        return
    scale = float(np.abs(model.shape_scale.numpy()[shape]).min())
    radius = float(np.abs(model.particle_radius.numpy()).max(initial=0.0))
    reach = radius + abs(float(model.shape_margin.numpy()[shape])) + abs(contact_gap(pipeline))
    # World 0: what the coordinates in the world add is weighed pair by pair (``placing.Hull.per_coordinate``), and
    # where it is too much the pair stays.
    needed = _margin_for(float(np.abs(mesh_of(shape)[0]).max()), reach, world=0.0, scale=scale)
    given = bounder.info["margin"]
    if not given >= needed:
        raise BounderError(f"shape {shape}: expected a bounder with a margin of {needed:.6g} at least, got {given:.6g}")


def contact_gap(pipeline: newton.CollisionPipeline) -> float:
    """The soft contact gap; before Newton 1.8 it was called a margin."""
    return float(pipeline.soft_contact_gap if hasattr(pipeline, "soft_contact_gap") else pipeline.soft_contact_margin)


def _digest(vertices: np.ndarray, indices: np.ndarray, resolution: int | None, margin: float) -> str:
    """Digest of what a bounder of a mesh is made for: its cells, or without a resolution the dilated mesh itself."""
    vertices, indices = np.asarray(vertices, np.float32), np.asarray(indices, np.int32)
    return _digest_of(vertices.tobytes(), indices.tobytes(), resolution, margin)


@lru_cache(maxsize=64)
def _digest_of(vertices: bytes, indices: bytes, resolution: int | None, margin: float) -> str:
    vertices, faces = np.frombuffer(vertices, np.float32), np.frombuffer(indices, np.int32)
    mesh = IndicatorMesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), margin=margin)
    return mesh.digest if resolution is None else mesh.to_grid(resolution=resolution).digest
