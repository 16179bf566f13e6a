"""Training of learned bounders; torch lives here only."""

from warp_bounding.errors import BounderError

try:
    import torch  # noqa: F401
except ImportError as error:
    raise BounderError("fitting needs torch: pip install 'warp-bounding[train]'") from error

from warp_bounding.training.fit import fit
from warp_bounding.training.hierarchy import hierarchy

__all__ = ["fit", "hierarchy"]
