"""``python -m sims.arm``: the same as ``python -m sims arm``."""

from sims.base import command

if __name__ == "__main__":
    command("arm")
