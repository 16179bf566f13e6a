"""How the rows of a page were made: its first sentence, and what is folded away below it."""

from collections.abc import Sequence

from paper.folder import Folder

__all__ = ["made_with"]


def made_with(folder: Folder, first: str, facts: Sequence[str]) -> list[str]:
    """Lines of Markdown.

    Args:
        folder: Its commands, and the threads and versions of its rows, are told.
        first: What is there, without a full stop; the first command follows.
        facts: Settings, one a line of a list.
    """
    commands, rows = folder.commands or ["(no command yet)"], folder.rows.values()
    threads = " and ".join(sorted({str(row.threads) for row in rows})) or "?"
    return [
        f"{first}; made with `{commands[0]}`.",
        "",
        "<details>",
        "<summary>Commands, settings and versions</summary>",
        "",
        "```",
        *commands,
        "```",
        "",
        *(f"- {fact}" for fact in facts),
        f"- CPU threads {threads}",
        *(f"- {version}" for version in sorted({row.versions for row in rows})),
        "",
        "</details>",
    ]
