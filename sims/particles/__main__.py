"""``python -m sims.particles``: the same as ``warp-bounding demo particles``."""

from sims.base import command

if __name__ == "__main__":
    command("particles")
