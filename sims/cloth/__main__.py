"""``python -m sims.cloth``: the same as ``python -m sims cloth``."""

from sims.base import command

if __name__ == "__main__":
    command("cloth")
