"""``python -m sims.shadows``: the same as ``warp-bounding demo shadows``."""

from sims.base import command

if __name__ == "__main__":
    command("shadows")
