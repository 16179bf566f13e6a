"""``python -m sims.cloth``: the same as ``warp-bounding demo cloth``."""

import sys

from warp_bounding.cli import main

if __name__ == "__main__":
    main(["demo", "cloth", *sys.argv[1:]])
