"""``python -m sims.path``: the same as ``warp-bounding demo path``."""

from sims.base import command

if __name__ == "__main__":
    command("path")
