"""``python -m sims.digits``: the same as ``warp-bounding demo digits``."""

from sims.base import command

if __name__ == "__main__":
    command("digits")
