"""Arms and their cells: planar arms of a few joints, and robots of example-robot-data."""

from collections.abc import Sequence
from functools import cache
from importlib.metadata import distribution
from pathlib import Path
from typing import NamedTuple

import numpy as np

import warp_bounding as wb
from sims.prefitted import FOLDER
from warp_bounding.rigid import sine_cosine

__all__ = [
    "CELLS",
    "KEPT",
    "ROBOTS",
    "Cell",
    "Own",
    "Robot",
    "planar",
    "robots",
    "ur5",
]

LENGTHS = {2: (0.55, 0.45), 3: (0.4, 0.35, 0.25), 4: (0.32, 0.28, 0.22, 0.18)}  # metres, of the planar arms' links


class Cell(NamedTuple):
    """An arm at work; of a robot also its name in ``ROBOTS``, and at what joints it is held, radians."""

    name: str
    title: str
    arm: wb.arms.Arm
    obstacles: tuple[wb.arms.Body, ...]
    robot: str = ""
    held: dict[str, float] = {}  # noqa: RUF012  never changed

    def shape(self, **options) -> wb.arms.ArmConfigurations:
        """Its colliding configurations, in coordinates in which a unit moves the arm by a metre at most."""
        return wb.arms.ArmConfigurations(self.arm, self.obstacles, weights=self.arm.reaching, name=self.name, **options)


def _moved(x: float) -> np.ndarray:
    return np.array([[1, 0, 0, x], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def planar(lengths: Sequence[float], radius: float = 0.04, limit: float = np.pi) -> wb.arms.Arm:
    """An arm in the plane z = 0 whose links have some lengths, metres; each is a capsule."""
    starts = [0.0, *lengths[:-1]]
    joints = [wb.arms.Joint(_moved(x), lower=-limit, upper=limit, name=f"joint {i}") for i, x in enumerate(starts)]
    links = [
        wb.arms.Body.capsule([0, 0, 0], [x, 0, 0], radius, link=i, name=f"link {i}") for i, x in enumerate(lengths)
    ]
    return wb.arms.Arm(joints, links, name=f"planar arm of {len(lengths)} joints")


def _post(x: float, y: float, radius: float, height: float = 1.0) -> wb.arms.Body:
    return wb.arms.Body.capsule([x, y, -height], [x, y, height], radius, name="post")


def _block(x: float, y: float, width: float, depth: float, turned: float = 0.0) -> wb.arms.Body:
    """A block that stands on the plane, turned about its middle."""
    s, c = sine_cosine(turned)
    pose = np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])
    return wb.arms.Body.box([-width / 2, -depth / 2, -1], [width / 2, depth / 2, 1], pose=pose, name="block")


def _flat() -> tuple[wb.arms.Body, ...]:
    """What surrounds the planar arms, whose links are a metre long together: posts, a wall with a gap, and blocks."""
    posts = (_post(0.35, 0.55, 0.07), _post(-0.5, 0.45, 0.09), _post(-0.62, -0.2, 0.06), _post(0.1, -0.62, 0.08))
    walls = (_block(0.75, 0.32, 0.06, 0.4, 0.3), _block(0.72, -0.38, 0.06, 0.42, -0.4))
    return (*posts, *walls, _block(-0.35, -0.68, 0.3, 0.08, 0.5), _post(-0.1, 0.85, 0.06))


def _planar_cell(count: int, lengths: Sequence[float]) -> Cell:
    return Cell(f"planar-{count}", f"Planar arm, {count} joints", planar(lengths), _flat())


CELLS = {cell.name: cell for cell in (*(_planar_cell(count, lengths) for count, lengths in LENGTHS.items()),)}


# --- robots of the package example-robot-data ------------------------------------------------------------------------

KEPT = FOLDER / "robots"  # bounders of their collisions with themselves
HELD_WRIST = {"wrist_2_joint": -np.pi / 2, "wrist_3_joint": 0.0}  # radians: of the UR5 in its cell


class Own(NamedTuple):
    """A network of a robot's collisions with itself, of all pairs of parts or of some, and how it is fitted.

    Attributes:
        options: Of ``fit``.
        share: Of a robot's time.
        revolved: Round parts at the ends, and what a flange carries; see ``Arm.self_collision``.
        pairs: Which pairs of parts; see ``Arm.self_collision``.
    """

    options: dict
    share: float = 1.0
    revolved: tuple[str, ...] = ()
    pairs: dict = {}  # noqa: RUF012  never changed


class Robot(NamedTuple):
    """A robot of example-robot-data, and the networks of its collisions with itself, by the names of their files."""

    title: str
    urdf: str
    srdf: str
    networks: dict[str, Own]
    held: dict[str, float] = {}  # noqa: RUF012  never changed

    def arm(self) -> wb.arms.Arm:
        """The arm, its gripper held."""
        folder = robots()
        return wb.arms.load_urdf(folder / self.urdf, srdf=folder / self.srdf, held=self.held, name=self.title)

    def shapes(self) -> dict[str, wb.arms.ArmConfigurations]:
        """What the networks bound, together all collisions of the robot with itself."""
        arm = self.arm()
        return {name: arm.self_collision(revolved=own.revolved, **own.pairs) for name, own in self.networks.items()}


# Pairs that have a network of their own. Whether a finger touches link 5 depends on two joints, one of them the last.
# All other pairs can do without the last joint. If solids of revolution replaced the fingers in these pairs, 1.3 % more
# of the Panda's free configurations would count as touching.
FINGERS = (("panda_link5", "panda_leftfinger"), ("panda_link5", "panda_rightfinger"))
ROBOTS = {
    "ur5": Robot(
        "UR5",
        "ur_description/urdf/ur5_robot.urdf",
        "ur_description/srdf/ur5.srdf",
        {"ur5": Own({"hidden": (8, 48, 48)}, revolved=("base_link", "wrist_3_link", "ee_link"))},
    ),
    "panda": Robot(
        "Panda",
        "panda_description/urdf/panda.urdf",
        "panda_description/srdf/panda.srdf",
        {
            "panda": Own(
                {"hidden": (10, 44, 44)},
                0.9,
                ("panda_link0", "panda_link7", "panda_hand", "panda_leftfinger", "panda_rightfinger"),
                {"without": FINGERS},
            ),
            "panda-fingers": Own({"hidden": (12,), "activation": "relu"}, 0.1, pairs={"only": FINGERS}),
        },
        {"panda_finger_joint1": 0.02},
    ),
    "xarm7": Robot(
        "xArm7",
        "xarm_description/urdf/xarm7.urdf",
        "xarm_description/srdf/xarm7.srdf",
        {"xarm7": Own({"hidden": (10, 48, 48)}, revolved=("link_base", "link7"))},
    ),
}


def robots() -> Path:
    """The folder of the robots.

    Raises:
        BoundingError: If they, or what reads them, are not installed.
    """
    try:
        import yourdfpy  # noqa: F401

        data = distribution("example-robot-data")
    except ImportError as error:
        raise wb.BoundingError("robots need example-robot-data: pip install 'warp-bounding[robots]'") from error
    return Path(data.locate_file("cmeel.prefix/share/example-robot-data/robots"))


def _workplace() -> tuple[wb.arms.Body, ...]:
    """A table, a shelf with its back, and a post."""
    box = wb.arms.Body.box
    return (
        box([-1, -1, -0.12], [1, 1, -0.04], name="table"),
        box([0.35, -0.6, 0.45], [0.8, 0.6, 0.5], name="shelf"),
        box([0.75, -0.6, 0.0], [0.8, 0.6, 1.0], name="back"),
        box([-0.1, 0.45, 0.0], [0.0, 0.55, 1.0], name="post"),
    )


@cache
def ur5() -> Cell:
    """Four joints of a UR5, the last two held, at a workplace."""
    folder, name = robots() / "ur_description", "ur5_joint_limited_robot"
    files = folder / f"urdf/{name}.urdf", folder / f"srdf/{name}.srdf"
    arm = wb.arms.load_urdf(files[0], srdf=files[1], held=HELD_WRIST, name="UR5")
    return Cell("ur5", "UR5", arm, _workplace(), "ur5", HELD_WRIST)
