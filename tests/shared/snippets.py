"""The fenced blocks of a page, and the commands in them."""

import re
import shlex

__all__ = ["FENCED", "commands"]
FENCED = re.compile(r"```(\w+)\n(.*?)```", re.DOTALL)


def commands(body: str) -> list[list[str]]:
    """The words of each line of a shell block, without comments."""
    return [words for line in body.splitlines() if (words := shlex.split(line, comments=True))]
