"""The folder of the figures: what each computed, part by part, as one JSON file that is written whole after every part."""

import contextlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from paper.drawing.settings import FigureSettings
from paper.settled import SETTINGS, settled_folder, write_settings
from warp_bounding.errors import FileFormatError
from warp_bounding.runtime.whole_file import write_whole

__all__ = ["ENDINGS", "PAGE", "FigureFolder", "open_figures"]

COMMAND, PAGE, ENDINGS = "figures", "README.md", ("png", "svg")
FORMAT = 1  # of a figure's JSON


class FigureFolder:
    """A locked folder of figures. Made by ``open_figures``.

    Attributes:
        path: Where.
        settings: Of all figures.
        commands: Command lines that contributed to it.
    """

    def __init__(self, path: Path, settings: FigureSettings, commands: list[str]):
        self.path, self.settings, self.commands = path, settings, commands

    def file(self, name: str) -> Path:
        """Where a figure's JSON lies."""
        return self.path / f"{name}.json"

    def read(self, name: str) -> dict[str, Any]:
        """What a figure has computed so far: ``parts`` by name, ``objects`` (digests by label), ``versions``.

        Raises:
            FileFormatError: If it is damaged, or of other settings or another version.
        """
        file = self.file(name)
        if not file.exists():
            return {"parts": {}, "objects": {}, "versions": []}
        try:
            document = json.loads(file.read_text())
            version, settings = document["format"], document["settings"]
            found = {key: document[key] for key in ("parts", "objects", "versions")}
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise FileFormatError(f"{file}: damaged or not of a figure; delete it and it is computed again") from error
        if version != FORMAT:
            raise FileFormatError(f"{file}: format {version}, this version of warp-bounding knows {FORMAT}")
        if settings != self.settings.to_dict():
            raise FileFormatError(
                f"{file}: made with other settings than the folder's; delete it and it is computed again"
            )
        parts, objects, versions = found.values()
        typed = isinstance(parts, dict) and isinstance(objects, dict) and isinstance(versions, list)
        if not typed or not all(isinstance(part, dict) for part in parts.values()):
            raise FileFormatError(f"{file}: damaged or not of a figure; delete it and it is computed again")
        return found

    def write(self, name: str, found: Mapping[str, Any]) -> None:
        """Keep what a figure has computed; once this returns, it is on the disk."""
        document = {"format": FORMAT, "figure": name, "settings": self.settings.to_dict(), **found}
        write_whole(self.file(name), (json.dumps(document, indent=1, allow_nan=False) + "\n").encode())

    def pictures(self, name: str) -> dict[str, Path]:
        """The pictures of a figure that are there, by file ending."""
        paths = {ending: self.path / f"{name}.{ending}" for ending in ENDINGS}
        return {ending: path for ending, path in paths.items() if path.is_file()}

    def remember(self, command: str) -> None:
        """Note a command line that is about to contribute."""
        if command not in self.commands:
            self.commands.append(command)
            write_settings(self.path / SETTINGS, self.settings, self.commands)


@contextlib.contextmanager
def open_figures(path: Path, given: Mapping[str, Any], figures: tuple[str, ...]) -> Iterator[FigureFolder]:
    """Lock a folder of figures, made if there is none.

    Args:
        path: The folder.
        given: Settings that were asked for; the others (``None``) are those of the folder.
        figures: Names of all figures.

    Raises:
        BoundingError: If it is not such a folder, damaged, in use, of other settings, or cannot be written to; nothing is overwritten then.
    """
    documents = tuple(f"{name}.json" for name in figures)
    names = (PAGE, *documents, *(f"{name}.{ending}" for name in figures for ending in ENDINGS))

    def is_blank() -> bool:
        return not any((path / name).exists() for name in documents)

    with settled_folder(path, given, COMMAND, FigureSettings, names, is_blank) as settled:
        yield FigureFolder(path, *settled)
