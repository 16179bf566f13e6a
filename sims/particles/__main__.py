"""``python -m sims.particles``: the same as ``warp-bounding demo particles``."""

import sys

from warp_bounding.cli import main

main(["demo", "particles", *sys.argv[1:]])
