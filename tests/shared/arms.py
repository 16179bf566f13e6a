"""Random arms, and how far their bodies are apart, computed without the package's kernels."""

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

from warp_bounding.arms import WORLD, Arm, Body, Joint


def turned(rng) -> np.ndarray:
    """A random rotation."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    q[:, 0] *= np.linalg.det(q)
    return q


def posed(rng, size: float = 0.4) -> np.ndarray:
    """A random pose."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turned(rng), rng.normal(size=3) * size
    return pose


def random_body(rng, link: int, place=(0.0, 0.0, 0.0)) -> Body:
    """A ball, a capsule, a box or a hull."""
    kind, place = rng.integers(4), np.asarray(place)
    if kind == 0:
        return Body.sphere(place, rng.uniform(0.02, 0.15), link=link)
    if kind == 1:
        return Body.capsule(place, place + rng.normal(size=3) * 0.3, rng.uniform(0.01, 0.1), link=link)
    if kind == 2:
        half = rng.uniform(0.02, 0.2, 3)
        pose = posed(rng, 0.0)
        pose[:3, 3] = place
        return Body.box(-half, half, pose=pose, radius=rng.choice([0.0, 0.02]), link=link)
    return Body(place + rng.normal(size=(12, 3)) * 0.1, radius=0.0, link=link, name="hull")


def random_arm(rng, n: int, slides: bool = False) -> tuple[Arm, list[Body]]:
    """An arm with all kinds of bodies, and obstacles around it."""
    joints, bodies = [], []
    for i in range(n):
        low, high = np.sort(rng.uniform(-np.pi, np.pi, 2))
        joints.append(Joint(posed(rng), rng.normal(size=3), low - 0.1, high + 0.1, slides=slides and i % 2 == 1))
        bodies += [random_body(rng, i, rng.normal(size=3) * 0.2) for _ in range(1 + i % 2)]
    obstacles = [random_body(rng, WORLD, rng.normal(size=3) * 0.5) for _ in range(8)]
    return Arm(joints, bodies), obstacles


def segments_apart(a, b, c, d) -> float:
    """The distance of two segments, by all pairs of what may be nearest."""
    u, v, w = b - a, d - c, a - c
    found = [point_apart(p, c, d) for p in (a, b)] + [point_apart(p, a, b) for p in (c, d)]
    cross = (u @ u) * (v @ v) - (u @ v) ** 2
    if cross > 1e-12 * (u @ u) * (v @ v):
        s = ((u @ v) * (v @ w) - (v @ v) * (u @ w)) / cross
        t = ((u @ u) * (v @ w) - (u @ v) * (u @ w)) / cross
        if 0 <= s <= 1 and 0 <= t <= 1:
            found.append(np.linalg.norm(w + s * u - t * v))
    return min(found)


def point_apart(p, a, b) -> float:
    u = b - a
    t = np.clip((p - a) @ u / (u @ u), 0, 1) if u @ u > 0 else 0.0
    return np.linalg.norm(a + t * u - p)


def hulls_apart(one: np.ndarray, other: np.ndarray) -> float:
    """The distance of two hulls of points, below 0 by their depth where they meet; up to about 1e-9."""
    if len(one) <= 2 and len(other) <= 2:
        return segments_apart(one[0], one[-1], other[0], other[-1])
    if len(one) == 1 and len(other) == 1:
        return np.linalg.norm(one[0] - other[0])
    differences = (other[:, None] - one[None]).reshape(-1, 3)
    hull = ConvexHull(differences)
    outside = hull.equations[:, 3].max()
    if outside < 0:
        return outside
    mesh = trimesh.Trimesh(differences, hull.simplices, process=False)
    return float(trimesh.proximity.closest_point_naive(mesh, [[0.0, 0.0, 0.0]])[1][0])


def gap_at(arm: Arm, obstacles: list[Body], q: np.ndarray) -> float:
    """The least distance of a link from an obstacle at one configuration, metres."""
    frames = arm.frames(q[None])[0]
    least = np.inf
    for body in (body for body in arm.bodies if body.link != WORLD):
        points = body.points @ frames[body.link][:3, :3].T + frames[body.link][:3, 3]
        for other in obstacles:
            least = min(least, hulls_apart(points, other.points) - body.radius - other.radius)
    return least
