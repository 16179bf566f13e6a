"""``python -m sims.shadows``: the same as ``python -m sims shadows``."""

from sims.base import command

if __name__ == "__main__":
    command("shadows")
