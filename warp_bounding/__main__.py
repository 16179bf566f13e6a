"""``python -m warp_bounding``: the same as the command ``warp-bounding``."""

from warp_bounding.cli import main

if __name__ == "__main__":
    main()
