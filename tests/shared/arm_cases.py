"""Random arms with bodies of all kinds, among obstacles."""

import numpy as np

from warp_bounding.arms import WORLD, Arm, Body, Joint, Mimic

BRANCHES = (-1, 0, 0, 2)  # of ``robot``: two branches behind one joint, the second of two joints


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


def robot(rng) -> Arm:
    """Two branches; the last joint of the second follows the first branch's, twice as fast."""
    arm, _ = random_arm(rng, len(BRANCHES), slides=True)
    joints = [Joint(joint.origin, joint.axis, -1.0, 1.0, joint.slides) for joint in arm.joints]
    base = Body.box([-0.5, -0.2, -0.2], [0.1, 0.2, 0.2])
    return Arm(joints, [*arm.bodies, base], parents=BRANCHES, mimics={3: Mimic(1, -2.0, 0.1)})
