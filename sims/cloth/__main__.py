"""``python -m sims.cloth``: the same as ``warp-bounding demo cloth``."""

from sims.base import command

if __name__ == "__main__":
    command("cloth")
