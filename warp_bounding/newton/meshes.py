"""The triangles of a model's meshes as Newton's pass reads them: on the device, by ``shape_source_ptr``.

``shape_source`` holds objects of the host, whose points may have been changed, or which may have been replaced, since the model was finalised. What the
cull says of a mesh must be true of the one that is asked.
"""

import numpy as np
import warp as wp

from warp_bounding.newton.library import newton

__all__ = ["mesh_ids", "triangles"]


@wp.kernel(enable_backward=False)
def _measure(
    # inputs
    mesh: wp.uint64,
    # outputs
    sizes: wp.array(dtype=int),
):
    m = wp.mesh_get(mesh)
    sizes[0] = m.points.shape[0]
    sizes[1] = m.indices.shape[0]


@wp.kernel(enable_backward=False)
def _copy(
    # inputs
    mesh: wp.uint64,
    # outputs
    points: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
):
    i = wp.tid()
    m = wp.mesh_get(mesh)
    if i < points.shape[0]:
        points[i] = m.points[i]
    if i < indices.shape[0]:
        indices[i] = m.indices[i]


def mesh_ids(model: newton.Model) -> wp.array:
    """``(S,)`` uint64, the ``wp.Mesh`` of each shape as it is now; 0 where there is none."""
    return model.shape_source_ptr


def triangles(mesh: int, device: wp.Device) -> tuple[np.ndarray, np.ndarray]:
    """Points ``(P, 3)`` float32 and corners ``(T, 3)`` int32 of a ``wp.Mesh``, given by its id; waits for the device."""
    sizes = wp.zeros(2, dtype=int, device=device)
    wp.launch(_measure, dim=1, inputs=[wp.uint64(mesh)], outputs=[sizes], device=device)
    count, corners = (int(n) for n in sizes.numpy())
    points, indices = wp.empty(count, dtype=wp.vec3, device=device), wp.empty(corners, dtype=int, device=device)
    wp.launch(_copy, dim=max(count, corners), inputs=[wp.uint64(mesh)], outputs=[points, indices], device=device)
    return points.numpy(), indices.numpy().reshape(-1, 3)
