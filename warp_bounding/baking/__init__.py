"""Thousands of shapes: fits a bounder for each file of a folder on many processes; a library loads and queries them."""

from warp_bounding.baking.engine import Baked, bake
from warp_bounding.baking.library import BounderLibrary, BounderStack

__all__ = ["Baked", "BounderLibrary", "BounderStack", "bake"]
