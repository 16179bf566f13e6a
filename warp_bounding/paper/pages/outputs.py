"""The files that show a run: ``README.md`` and the rank plot, made from the table alone, as often as wanted."""

from collections.abc import Sequence

from warp_bounding.errors import BoundingError
from warp_bounding.paper.columns import Supports
from warp_bounding.paper.folder import Folder
from warp_bounding.paper.pages.markdown import page
from warp_bounding.paper.pages.rank_plot import rank_plot
from warp_bounding.runtime.whole_file import write_whole

__all__ = ["PICTURE", "write_outputs", "write_page"]

PICTURE = "rank"


def write_page(folder: Folder, supports: Supports, failed: Sequence[str] = ()) -> None:
    """Write the Markdown page.

    Args:
        folder: Whose rows to show.
        supports: Which bounders exist at all.
        failed: Lines about cells that failed.

    Raises:
        FileFormatError: If it cannot be written.
    """
    picture = f"{PICTURE}.png"
    there = picture if (folder.path / picture).exists() else None
    write_whole(folder.page, page(folder, supports, failed, there).encode())


def write_outputs(folder: Folder, supports: Supports, failed: Sequence[str] = ()) -> list[str]:
    """Write the page and the rank plot.

    Args:
        folder: Whose rows to show.
        supports: Which bounders exist at all.
        failed: Lines about cells that failed.

    Returns:
        What could not be drawn and why, for people.

    Raises:
        FileFormatError: If a file cannot be written.
    """
    notes = []
    try:
        pictures = rank_plot(folder.rows.values())
    except BoundingError as error:
        pictures = {}
        notes.append(str(error))
    for kind, content in pictures.items():
        write_whole(folder.path / f"{PICTURE}.{kind}", content)
    write_page(folder, supports, failed)
    return notes
