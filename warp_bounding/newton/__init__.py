"""A broad phase for Newton: its contact pass goes only through the particle-shape pairs that may touch; see ``cull``.

Needs Newton, the extra ``newton``: from 1.7 on, tested with 1.8.
"""

from warp_bounding.newton.accepted import margin_for
from warp_bounding.newton.cull import ParticleCull
from warp_bounding.newton.tally import Tally

__all__ = ["ParticleCull", "Tally", "margin_for"]
