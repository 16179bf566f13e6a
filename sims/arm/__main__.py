"""``python -m sims.arm``: the same as ``warp-bounding demo arm``."""

from sims.base import command

if __name__ == "__main__":
    command("arm")
