"""Markdown tables."""

from collections.abc import Container, Iterable, Sequence

__all__ = ["table"]


def table(heads: Sequence[str | None], lines: Iterable[Sequence[str | None]], left: Container[int] = (0,)) -> list[str]:
    """Lines of a Markdown table; the columns ``left`` are aligned to the left, others to the right; ``None`` is no cell."""
    rule = "".join("---|" if i in left else "---:|" for i in range(len(heads)))
    first, *rest = (
        "|" + "".join(" |" if cell is None else f" {cell} |" for cell in cells) for cells in (heads, *lines)
    )
    return [first, f"|{rule}", *rest]
