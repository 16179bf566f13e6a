"""Seven joints of a Panda, from a can on a table to one on a shelf: a plan of which every motion is proven.

Then a post is put in the way of the plan, the plan is certified anew as far as it goes, and another one is found.
Nothing is fitted. The planner is ``sims.planning.proven``.
"""

from typing import NamedTuple

import numpy as np

import warp_bounding as wb
from sims.arm.robots import ROBOTS, Cell, robots
from sims.planning.proven import Found, plan

__all__ = ["Seven", "cell", "planned", "tool"]

OPEN = {"panda_finger_joint1": 0.04}  # metres: each finger from the middle
PIECES = 4  # of a mesh: a finger is far from convex
START = (-0.913, 0.577, 0.135, -1.878, -0.116, 2.447, 0.075)  # radians: the gripper around a can on the table
GOAL = (0.416, -0.192, 0.014, -2.15, -0.028, 3.0, 0.819)  # before one on the shelf
RADIUS, HEIGHT = 0.033, 0.12  # metres, of cans
CANS = ((0.45, -0.45, 0.0), (0.62, -0.35, 0.0), (0.35, -0.6, 0.0), (0.61, 0.28, 0.44), (0.72, 0.12, 0.44))
POST, ABOVE = 0.04, 0.2  # metres: half its width, and how far it ends above the tool's way
FINE = 60  # configurations of a motion, to place the post


class Seven(NamedTuple):
    """What was planned.

    Attributes:
        motions: With the post.
        first: The plan without it.
        found: How it was found.
        spoiled: What is proven of it with the post.
        second: Another plan, around the post; ``None`` if there was none.
    """

    motions: wb.arms.Motions
    first: wb.arms.Plan
    found: Found
    spoiled: wb.arms.Plan
    second: wb.arms.Plan | None

    def sentence(self) -> str:
        """For people."""
        proven = "all proven free" if self.first.proven else "not all proven"
        at, share = self.spoiled.end
        more = f"a new one of {len(self.second.shares)} motions is proven." if self.second else "no new one was found."
        return (
            f"Panda, seven joints: a plan of {len(self.first.shares)} motions, {proven}, for {self.found.asked} that "
            f"were asked about. With a post in its way it is proven up to {share:.2f} of motion {at}; {more}"
        )


def cell() -> Cell:
    """The robot, a table, a shelf and cans.

    Raises:
        BoundingError: If robots are not installed.
    """
    own, box = ROBOTS["panda"], wb.arms.Body.box
    files = robots() / own.urdf, robots() / own.srdf
    arm = wb.arms.load_urdf(files[0], srdf=files[1], held=OPEN, pieces=PIECES, name="Panda")
    things = [
        box([-0.3, -0.75, -0.05], [0.95, 0.75, -0.005], name="table"),
        box([0.52, -0.1, 0.42], [0.85, 0.7, 0.44], name="shelf"),
        box([0.52, -0.1, 0.86], [0.85, 0.7, 0.88], name="upper shelf"),
        box([0.85, -0.1, -0.005], [0.87, 0.7, 0.88], name="back"),
    ]
    for place in CANS:
        pose = np.eye(4)
        pose[:3, 3] = np.add(place, (0, 0, HEIGHT / 2))
        things.append(wb.arms.Cylinder(RADIUS, HEIGHT, pose, name="can"))
    return Cell("panda-7", "Panda, seven joints", arm, tuple(things), "panda", OPEN)


def tool(arm: wb.arms.Arm, q: np.ndarray) -> np.ndarray:
    """Where the last body is, ``(N, 3)``, metres, in configurations ``(N, n)``."""
    body = arm.bodies[-1]
    frames = arm.frames(q)[:, body.link]
    return frames[:, :3, :3] @ body.points.mean(axis=0) + frames[:, :3, 3]


def planned(around: Cell, seed: int = 0) -> Seven:
    """Plan, put a post in the way, and plan again.

    Raises:
        BoundingError: If no first plan is found.
    """
    motions = wb.arms.Motions(around.arm, around.obstacles)
    found = plan(motions, START, GOAL, seed=seed)
    if found.path is None:
        raise wb.BoundingError(f"{around.title}: no plan was found")
    first = motions.path(found.path)
    steps = np.linspace(0, len(found.path) - 1, FINE * (len(found.path) - 1) + 1)
    way = tool(around.arm, np.stack([np.interp(steps, range(len(found.path)), q) for q in found.path.T], axis=1))
    x, y, z = way[np.abs(np.linalg.norm(way - way[0], axis=1) - np.linalg.norm(way - way[-1], axis=1)).argmin()]
    motions.add(wb.arms.Body.box([x - POST, y - POST, -0.005], [x + POST, y + POST, z + ABOVE], name="post"))
    other = plan(motions, START, GOAL, seed=seed).path
    return Seven(motions, first, found, motions.path(found.path), None if other is None else motions.path(other))
