"""``python -m sims.shadows``: the same as ``warp-bounding demo shadows``."""

import sys

from warp_bounding.cli import main

main(["demo", "shadows", *sys.argv[1:]])
