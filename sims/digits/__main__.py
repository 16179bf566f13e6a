"""``python -m sims.digits``: the same as ``python -m sims digits``."""

from sims.base import command

if __name__ == "__main__":
    command("digits")
