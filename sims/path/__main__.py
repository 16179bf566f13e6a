"""``python -m sims.path``: the same as ``python -m sims path``."""

from sims.base import command

if __name__ == "__main__":
    command("path")
