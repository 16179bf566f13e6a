"""Distances between an arm's bodies, and from obstacles, by Coal, which shares nothing with the library."""

import coal
import numpy as np
from scipy.spatial import ConvexHull

from warp_bounding.arms import WORLD, Arm, Body, Cylinder, Scan


def solid(body: Body | Cylinder | Scan):
    """The core of a body, a cylinder, or the triangles of a scan."""
    if isinstance(body, Cylinder):
        return coal.Cylinder(body.radius, body.length)
    if isinstance(body, Scan):
        model, corners, faces = coal.BVHModelOBBRSS(), coal.StdVec_Vec3s(), coal.StdVec_Triangle()
        corners.extend(list(body.corners.reshape(-1, 3)))
        faces.extend([coal.Triangle(3 * k, 3 * k + 1, 3 * k + 2) for k in range(len(body.corners))])
        model.beginModel(len(faces), len(corners))
        model.addSubModel(corners, faces)
        model.endModel()
        return model
    points = body.points
    if len(points) == 1:
        return coal.Sphere(0.0)
    if len(points) == 2:
        return coal.Capsule(0.0, float(np.linalg.norm(points[1] - points[0])))
    hull = ConvexHull(points)
    corners, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    numbers = np.unique(hull.simplices)
    corners.extend(list(points[numbers]))
    for simplex, normal in zip(hull.simplices, hull.equations[:, :3], strict=True):
        a, b, c = points[simplex]
        i, j, k = np.searchsorted(numbers, simplex).tolist()
        faces.append(coal.Triangle(*((i, j, k) if np.cross(b - a, c - a) @ normal > 0 else (i, k, j))))
    return coal.Convex(corners, faces)


def placed(body: Body | Cylinder | Scan, pose: np.ndarray):
    """Where the solid of a body is, whose link is at a pose."""
    if isinstance(body, Cylinder | Scan):
        pose = pose @ body.pose
    elif len(body.points) <= 2:
        local = np.eye(4)
        local[:3, 3] = body.points.mean(axis=0)
        if len(body.points) == 2:
            z = (body.points[1] - body.points[0]) / np.linalg.norm(body.points[1] - body.points[0])
            x = np.cross(np.eye(3)[np.abs(z).argmin()], z)
            x /= np.linalg.norm(x)
            local[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
        pose = pose @ local
    return coal.Transform3s(pose[:3, :3], pose[:3, 3])


def clearance(arm: Arm, obstacles: list, pairs: np.ndarray, q: np.ndarray, shifts: np.ndarray | None = None):
    """The least distance ``(N,)`` of what is checked, for configurations ``(N, n)``; negative where bodies overlap.

    ``shifts`` ``(N, obstacles, 3)``: where obstacles have moved.
    """
    bodies = [*arm.bodies, *obstacles]
    solids = [solid(body) for body in bodies]
    radii = [0.0 if isinstance(body, Cylinder) else body.radius for body in bodies]
    own = len(arm.bodies)
    todo = [(own + k, i) for i, body in enumerate(arm.bodies) if body.link != WORLD for k in range(len(obstacles))]
    todo += [tuple(pair) for pair in pairs.tolist()]
    frames, found = arm.frames(q), np.full(len(q), np.inf)
    for n in range(len(q)):
        poses = [np.eye(4) if getattr(b, "link", WORLD) == WORLD else frames[n, b.link] for b in bodies]
        if shifts is not None:
            for k, shift in enumerate(shifts[n]):
                poses[own + k] = np.eye(4)
                poses[own + k][:3, 3] = shift
        at = [placed(body, pose) for body, pose in zip(bodies, poses, strict=True)]
        for a, b in todo:
            away = coal.distance(solids[a], at[a], solids[b], at[b], coal.DistanceRequest(), coal.DistanceResult())
            found[n] = min(found[n], away - radii[a] - radii[b])
    return found
