"""For Newton: a pass over the pairs of particles and shapes that may touch only (``cull``).

Needs Newton, the extra ``newton``: from 1.7 on, tested with 1.8.
"""

try:
    import newton  # noqa: F401 (the modules below need it)
except ImportError as error:
    raise ImportError(
        "warp_bounding.newton needs Newton: pip install 'warp-bounding[newton]'", name="newton"
    ) from error

from warp_bounding.newton.cull import ParticleCull, Tally
from warp_bounding.newton.shapes import margin_for

__all__ = ["ParticleCull", "Tally", "margin_for"]
