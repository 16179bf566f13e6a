"""``python -m sims.path``: the same as ``warp-bounding demo path``."""

import sys

from warp_bounding.cli import main

if __name__ == "__main__":
    main(["demo", "path", *sys.argv[1:]])
