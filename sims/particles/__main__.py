"""``python -m sims.particles``: the same as ``python -m sims particles``."""

from sims.base import command

if __name__ == "__main__":
    command("particles")
