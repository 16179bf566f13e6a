"""For Newton: passes over what may touch only: particles, whole soft surfaces (``surface``), meshes (``rigid``).

Needs Newton, the extra ``newton``: from 1.7 on, tested with 1.8.
"""

try:
    import newton  # noqa: F401 (the modules below need it)
except ImportError as error:
    raise ImportError(
        "warp_bounding.newton needs Newton: pip install 'warp-bounding[newton]'", name="newton"
    ) from error

from warp_bounding.newton.cull import Cull, Tally
from warp_bounding.newton.shapes import margin_for

__all__ = ["Cull", "Tally", "margin_for"]
