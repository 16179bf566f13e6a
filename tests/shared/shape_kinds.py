"""A shape of every kind, small: what each promises, and what every part of the library does with all of them."""

from functools import cache

import numpy as np
import torch
import trimesh
from arm_cases import random_arm, robot
from bounding_shapes import shape as grid

import warp_bounding as wb
from warp_bounding.arms import Arm, ArmConfigurations, Body, Joint
from warp_bounding.shapes.recentred import Frame, Recentred
from warp_bounding.shapes.shape import IN

MARGIN = 0.0625
TORUS, BALL = trimesh.creation.torus(1, 0.3), trimesh.creation.icosphere(subdivisions=2)
BOX = trimesh.creation.box((1, 2, 0.5))


def mesh(*parts, **options):
    joined = trimesh.util.concatenate(parts)
    return wb.shapes.Mesh(joined.vertices, joined.faces, **options)


def moving(solid, faces=slice(None)):
    """It turns, slides and stretches between times of uneven distances."""
    x, y, z = solid.vertices.T
    angles = 1.5 * np.sin(np.linspace(0, 3, 5))
    frames = [
        np.stack([np.cos(a) * x - np.sin(a) * y + a, np.sin(a) * x + np.cos(a) * y, z * (1 + a)], 1) for a in angles
    ]
    return wb.shapes.MovingMesh(np.array(frames), solid.faces[faces], times=[-1, 0.5, 1, 1.25, 4], time_cells=4)


def arm(**joint):
    step = np.eye(4)
    step[0, 3] = 0.5
    links = [Body.capsule([0, 0, 0], [0.5, 0, 0], 0.05, link=i) for i in range(2)]
    walls = [Body.box([0.3, 0.2, -0.5], [0.6, 0.5, 0.5]), Body.sphere([-0.6, -0.2, 0], 0.2)]
    return ArmConfigurations(Arm([Joint(**joint), Joint(step)], links), walls, weights=[1.3, 0.7])


def network(n=3, level=0.0):
    """Of sines and of steps, steep enough to have a border."""
    torch.manual_seed(0)
    layers = torch.nn.Linear(n, 12), Sine(), torch.nn.Linear(12, 12), torch.nn.ReLU(), torch.nn.Linear(12, 1)
    layers[0].weight.requires_grad_(False).mul_(3.0)
    return wb.shapes.Network(torch.nn.Sequential(*layers), [-1] * (n - 1) + [0], [1] * n, level=level)


class Sine(torch.nn.Module):
    def forward(self, z):
        return torch.sin(z)


def distance(x):
    return np.linalg.norm(x, axis=1) - 1.0


KINDS = {
    "grid": lambda: grid("blob"),
    "grid 2D": lambda: grid("c"),
    "animation": lambda: grid("animated"),
    "mesh": lambda: mesh(TORUS),
    "mesh of parts": lambda: mesh(BALL, BALL.copy().apply_translation([0.9, 0, 0])),
    "open mesh": lambda: wb.shapes.Mesh(BALL.vertices, BALL.faces[: len(BALL.faces) // 2]),
    "tank": lambda: mesh(BOX, trimesh.Trimesh(0.8 * BOX.vertices, BOX.faces[:, ::-1], process=False), hollow="empty"),
    "motion": lambda: moving(TORUS),
    "open motion": lambda: moving(BALL, slice(160)),
    "arm": arm,
    "arm in space": lambda: ArmConfigurations(*random_arm(np.random.default_rng(1), 3)),
    "arm in space that slides": lambda: ArmConfigurations(
        *random_arm(np.random.default_rng(5), 3, True), weights=[0.2, 3, 1]
    ),
    "arm that slides": lambda: arm(slides=True, lower=-0.5, upper=0.4, axis=(1, 0, 0)),
    "arm that is a tree": lambda: ArmConfigurations(
        robot(np.random.default_rng(0)),
        [Body.sphere([0.9, 0.2, 0.1], 0.2)],
        self_collision=True,
        weights=[1.0, 2.0, 0.5],
    ),
    "arm that turns": lambda: arm(continuous=True),
    "function": lambda: wb.shapes.Function(None, [-1] * 3, [1] * 3, distance=distance),
    "steep function": lambda: wb.shapes.Function(
        None, [-1] * 5, [1] * 5, distance=lambda x: 4 * distance(x), lipschitz=4.0
    ),
    "short function": lambda: wb.shapes.Function(None, [-1, -1], [1, 1], distance=lambda x: 0.25 * distance(x)),
    "network": network,
    "outside": lambda: wb.shapes.Complement(mesh(TORUS)),
    "far away": lambda: Recentred(grid("blob"), Frame((500000.13, 4649776.37, 12.7), (1e-4, 0.0, 0.0))),
}


@cache
def made(name: str, margin: float = 0.0):
    return KINDS[name]().dilated(margin)


def dilates(name: str) -> bool:
    return not name.startswith(("arm", "network"))


def around(shape, rng, count: int) -> np.ndarray:
    """Random points, and as many within a few roundings of the border where both sides of it were found."""
    x = rng.uniform(shape.sample_lower, shape.sample_upper, (count, shape.ndim))
    held = shape.decide(x) == IN
    if held.all() or not held.any():
        return x
    a, b = (x[rng.choice(np.flatnonzero(side), count)] for side in (held, ~held))
    if shape.time:  # at one time: what moves fast is passed within a rounding of it
        b[:, 0] = a[:, 0]
    for _ in range(50):
        middle = a / 2 + b / 2
        inside = (shape.decide(middle) == IN)[:, None]
        a, b = np.where(inside, middle, a), np.where(inside, b, middle)
    return np.concatenate([x, a, b])
