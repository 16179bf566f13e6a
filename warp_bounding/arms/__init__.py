"""Arms: joints and bodies whose colliding configurations are a shape, which ``fit`` and everything else takes.

Example:
    >>> step = np.eye(4)
    >>> step[0, 3] = 0.5
    >>> links = [wb.arms.Body.capsule([0, 0, 0], [0.5, 0, 0], 0.05, link=i) for i in range(2)]
    >>> arm = wb.arms.Arm([wb.arms.Joint(), wb.arms.Joint(origin=step)], links)
    >>> cell = [wb.arms.Body.box([0.6, -0.2, -0.5], [0.8, 0.2, 0.5])]
    >>> shape = wb.arms.ArmConfigurations(arm, cell)
    >>> shape.contains(np.array([[0.0, 0.0], [0.0, 2.0]]))
    array([ True, False])
"""

from warp_bounding.arms.arm import WORLD, Arm, Body, Cylinder, Joint, Mimic
from warp_bounding.arms.configurations import ArmConfigurations
from warp_bounding.arms.motions import Motions, Plan
from warp_bounding.arms.scan import DistanceField, Scan
from warp_bounding.arms.scene import load_scene
from warp_bounding.arms.urdf import load_urdf

__all__ = [
    "WORLD",
    "Arm",
    "ArmConfigurations",
    "Body",
    "Cylinder",
    "DistanceField",
    "Joint",
    "Mimic",
    "Motions",
    "Plan",
    "Scan",
    "load_scene",
    "load_urdf",
]
