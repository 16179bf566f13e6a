"""Bounders on disk: one ``.safetensors`` file, tensors by role, everything else as JSON in its metadata.

The metadata holds one entry, ``warp_bounding``: a JSON object ``{"sha256": ..., "bounder": {...}}`` whose digest covers
the tensors (names, types, shapes, bytes) and every other field. The digest detects damage; an author who computes it
anew can still make an invalid claim, and only ``certify`` finds that out. Files are written whole or not at all.
"""

import hashlib
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import safetensors
import safetensors.numpy

from warp_bounding.errors import FileFormatError
from warp_bounding.queries.region_domain import SPACE
from warp_bounding.runtime.whole_file import BOUNDER, write_whole
from warp_bounding.version import __version__

if TYPE_CHECKING:
    from warp_bounding.bounders.bounder import Bounder

FORMAT, FRAMED = 2, 2  # the newest format, and the first with an origin; a file without an origin has format 1
KEY = "warp_bounding"
INFO_FIELDS = ("indicator", "name", "grid_shape", "margin", "resolution", "shape", "seed", "note", "training", "rates")


def save(bounder: "Bounder", path: str | os.PathLike) -> None:
    """Write a bounder; see ``Bounder.save``."""
    write(path, bounder.tensors, document_of(bounder))


def document_of(bounder: "Bounder", library: str | None = None) -> dict[str, Any]:
    """What a bounder's file says of it besides its tensors, written by a version of this library; by this one's."""
    return {
        "format": 1 if bounder.frame is None else FRAMED,
        "library": library or __version__,
        "method": bounder.method,
        "query": bounder.query_kind,
        "dimension": bounder.ndim,
        "space": SPACE,
        "length": bounder.domain.length,
        "motion": "time" if bounder.domain.time else None,
        "sizes": bounder.sizes,
        "domain": bounder.domain.to_dict(),
        "threshold": float(bounder.threshold),
        "certificate": bounder.certificate.to_dict() if bounder.certificate else None,
        **{field: bounder.info.get(field) for field in INFO_FIELDS},
        **({} if bounder.frame is None else {"frame": bounder.frame.to_dict()}),
    }


def write(path: str | os.PathLike, tensors: dict[str, np.ndarray], document: dict[str, Any]) -> None:
    """Write tensors and a document with their digest."""
    text = json.dumps({"sha256": digest_of(tensors, document), "bounder": document}, allow_nan=False)
    write_whole(path, safetensors.numpy.save(tensors, metadata={KEY: text}), BOUNDER)


def read(path: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The tensors and the document (``"bounder"``) of a file, as ``save`` wrote them.

    Raises:
        FileFormatError: If the file is missing, damaged, foreign or newer than this library.
    """
    tensors, text = _read(path)
    try:
        signed = json.loads(text)
        document, digest = signed["bounder"], signed["sha256"]
        version = document["format"]
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise FileFormatError(f"{path}: the description inside is damaged") from error
    if type(version) is int and version < 1:
        raise FileFormatError(f"{path}: format {version} never existed")
    if type(version) is not int or version > FORMAT:
        known = f"newer than this library knows ({FORMAT}); please update warp-bounding"
        raise FileFormatError(f"{path}: format {version} is {known}")
    if ("frame" in document) != (version >= FRAMED):
        raise FileFormatError(f"{path}: files of format {FRAMED} have an origin, others have none")
    # The digest covers values, not their spelling: a file edited from 1.0 to 1.00 would pass it.
    same_text = json.dumps(signed) == text
    if digest != digest_of(tensors, document) or not same_text:
        raise FileFormatError(f"{path}: the content does not match its SHA-256; the file is damaged or was edited")
    return tensors, document


def _read(path: Path) -> tuple[dict[str, np.ndarray], str]:
    try:
        if path.is_dir():
            raise FileFormatError(f"{path}: a folder, expected the file of a bounder")
        if not path.is_file():
            raise FileFormatError(f"{path}: no such file")
        with safetensors.safe_open(str(path), framework="numpy") as file:
            metadata = file.metadata() or {}
            if KEY not in metadata:
                raise FileFormatError(f"{path}: a safetensors file, but not one that holds a bounder")
            return {name: file.get_tensor(name) for name in file.keys()}, metadata[KEY]  # noqa: SIM118 (not a dict)
    except (safetensors.SafetensorError, OSError, ValueError, TypeError) as error:
        if isinstance(error, FileFormatError):
            raise
        from warp_bounding.shapes.formats.load import MESH_READERS, READERS
        from warp_bounding.shapes.formats.usd import USD_SUFFIXES

        if (suffix := path.suffix.lower()) in READERS:
            shape = "a mesh" if suffix in (*MESH_READERS, *USD_SUFFIXES) else "an array, image or voxel"
            got = f"got {shape} file; where both are named, the bounder comes first, then the shape"
            raise FileFormatError(f"{path}: expected a bounder that fit wrote, {got}") from error
        raise FileFormatError(f"{path}: not a complete safetensors file ({error})") from error


def digest_of(tensors: dict[str, np.ndarray], document: dict) -> str:
    """SHA-256 of the document as JSON with sorted keys, then of each tensor's name, type, shape and bytes, by name."""
    sha = hashlib.sha256(json.dumps(document, sort_keys=True, separators=(",", ":")).encode())
    for name in sorted(tensors):
        tensor = np.ascontiguousarray(tensors[name])
        sha.update(f"|{name}|{tensor.dtype.str}|{tensor.shape}|".encode() + tensor.tobytes())
    return sha.hexdigest()
