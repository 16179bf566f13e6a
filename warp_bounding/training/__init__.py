"""``fit``: bounders from shapes. torch lives here only, and is imported where a bounder is learned (``engine``)."""

from warp_bounding.training.fit import fit

__all__ = ["fit"]
