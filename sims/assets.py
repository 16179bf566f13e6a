"""Shapes for a first look: meshes that installed packages bring along, read from there or written where a user wants them.

Nothing is downloaded. ``warp-bounding demo --assets DIR`` writes them as ``.obj`` files, so that what documentation shows runs as printed.
"""

from pathlib import Path

import numpy as np

import warp_bounding as wb
from warp_bounding.runtime.whole_file import write_whole

__all__ = ["MESHES", "asset_mesh", "write_assets"]

MESHES = ("bunny", "bear", "rocks")  # by the names of warp-lang's files


def asset_mesh(name: str) -> wb.IndicatorMesh:
    """A mesh that ships in warp-lang, such as the Stanford bunny; y up.

    Raises:
        IndicatorError: If it is not there, or cannot be read.
    """
    import warp.examples

    path = Path(warp.examples.get_asset_directory()) / f"{name}.usd"
    if not path.is_file():
        raise wb.IndicatorError(f"{path}: expected this mesh in the installed warp-lang, there is no such file")
    return wb.load_indicator(path)


def write_assets(folder: Path) -> list[Path]:
    """Write every mesh as ``.obj``; float32 numbers are written so that they are read back to the bit.

    Args:
        folder: Where; made if there is none. Files of these names are replaced.

    Returns:
        The files.

    Raises:
        IndicatorError: If one of the meshes is missing; nothing is written then.
        FileFormatError: If a file cannot be written.
    """
    files = {Path(folder) / f"{name}.obj": _obj(asset_mesh(name)) for name in MESHES}
    for path, content in files.items():
        write_whole(path, content)
    return list(files)


def _obj(shape: wb.IndicatorMesh) -> bytes:
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in np.asarray(shape.vertices, np.float32)]
    lines += [f"f {a} {b} {c}" for a, b, c in shape.faces + 1]
    return ("\n".join(lines) + "\n").encode()
