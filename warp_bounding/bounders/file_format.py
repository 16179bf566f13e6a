"""Bounders on disk: one ``.safetensors`` file, tensors by role, everything else as JSON in its metadata.

The metadata holds one entry, ``warp_bounding``: a JSON object ``{"sha256": ..., "bounder": {...}}`` whose digest covers the
tensors (names, types, shapes, bytes) and every other field. The digest detects damage; an author who computes it anew
can still lie, and only ``certify`` finds that out. Files are written whole or not at all (write, then rename).
"""

import hashlib
import json
import os
import tempfile
from pathlib import Path

import numpy as np
import safetensors
import safetensors.numpy

from warp_bounding.arithmetic import round_down
from warp_bounding.bounders.base import Bounder
from warp_bounding.certificates.certificate import Certificate
from warp_bounding.certificates.claims import check_claims
from warp_bounding.coordinates.domain import number
from warp_bounding.coordinates.region_domain import RegionDomain
from warp_bounding.errors import BounderError, BoundingError, FileFormatError
from warp_bounding.indicators.formats.load import ARRAY_SUFFIXES, SUFFIXES
from warp_bounding.version import __version__

__all__ = ["FORMAT", "bounder_of", "check_writable", "load", "save", "write_whole"]

FORMAT = 1
KEY = "warp_bounding"
SUFFIX = ".safetensors"
STARTS = {SUFFIX: (8, b"{"), ".npy": (0, b"\x93NUMPY")}  # where a file of this kind says what it is, and how
INFO_FIELDS = ("indicator", "name", "grid_shape", "margin", "resolution", "seed", "note", "training", "rates")


def save(bounder: Bounder, path: str | os.PathLike) -> None:
    """Write a bounder.

    Args:
        bounder: Any bounder.
        path: File to write; an existing one is replaced only when the new one is complete, and only one that was a bounder's,
            by its name or its content.

    Raises:
        FileFormatError: If the file cannot be written.
    """
    document = {
        "format": FORMAT,
        "library": __version__,
        "method": bounder.method,
        "query": bounder.query_kind,
        "dimension": bounder.ndim,
        "space": bounder.domain.space,
        "length": bounder.domain.length,
        "motion": "time" if bounder.domain.time else None,
        "sizes": bounder.sizes,
        "domain": bounder.domain.to_dict(),
        "threshold": float(bounder.threshold),
        "certificate": bounder.certificate.to_dict() if bounder.certificate else None,
        **{field: bounder.info.get(field) for field in INFO_FIELDS},
    }
    entry = json.dumps({"sha256": _digest(bounder.tensors, document), "bounder": document}, allow_nan=False)
    write_whole(path, safetensors.numpy.save(bounder.tensors, metadata={KEY: entry}), SUFFIX)


def load(path: str | os.PathLike, device: str | None = None) -> Bounder:
    """Read a bounder and check all of it.

    Args:
        path: A file that ``save`` wrote.
        device: Warp device, such as ``"cpu"`` or ``"cuda:0"``; the default device if ``None``.

    Returns:
        The bounder, with its certificate as stored (``certify`` proves it anew).

    Raises:
        FileFormatError: If the file is missing, damaged, truncated, foreign, edited or newer than this library.
    """
    from warp_bounding.bounders import KINDS

    path = _path(path)
    tensors, entry = _read(path)
    try:
        wrapper = json.loads(entry)
        document, digest = wrapper["bounder"], wrapper["sha256"]
        version = document["format"]
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise FileFormatError(f"{path}: the description inside is damaged") from error
    if type(version) is int and version < 1:
        raise FileFormatError(f"{path}: format {version} is none that ever was")
    if type(version) is not int or version > FORMAT:
        raise FileFormatError(
            f"{path}: format {version} is newer than this library knows ({FORMAT}); please update warp-bounding"
        )
    if (
        digest != _digest(tensors, document) or json.dumps(wrapper) != entry
    ):  # the text too: 1.0 and 1.00 are one number
        raise FileFormatError(f"{path}: the content does not match its SHA-256; the file is damaged or was edited")
    try:
        method = KINDS[document["method"]]
        bounder = method(RegionDomain.from_dict(document["domain"]), tensors, document["sizes"], device)
        threshold = document["threshold"]
        certificate = Certificate.from_dict(document["certificate"]) if document["certificate"] else None
        described = [document[k] for k in ("query", "dimension", "space", "length", "motion")]
        motion = "time" if bounder.domain.time else None
        if described != [bounder.query_kind, bounder.ndim, bounder.domain.space, bounder.domain.length, motion]:
            raise FileFormatError("query, dimension, space, length and motion are not those of the domain inside")
        if not np.isfinite(number(threshold, "the threshold")) or np.float32(threshold) != threshold:
            raise FileFormatError(f"the threshold {threshold} is not a finite float32 number")
        _check_info(document)
        if certificate:
            _check_certificate(bounder, certificate, threshold)
            check_claims(bounder, certificate, document)
        bounder.freeze(threshold, certificate)
        bounder.info = {field: document.get(field) for field in INFO_FIELDS} | {"library": document["library"]}
    except BoundingError as error:
        raise FileFormatError(f"{path}: {error}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(f"{path}: a field is missing or of the wrong type ({error})") from error
    return bounder


def bounder_of(source: Bounder | str | os.PathLike, device: str | None = None) -> Bounder:
    """A bounder, or the one that a file holds.

    Args:
        source: Either.
        device: Warp device of one that is read.

    Raises:
        BounderError: For anything else.
        FileFormatError: See ``load``.
    """
    if isinstance(source, Bounder):
        return source
    if isinstance(source, str | os.PathLike):
        return load(source, device)
    raise BounderError(
        f"expected a bounder or the path of its file first, then the shape, got {type(source).__name__} first"
    )


def _path(path: str | os.PathLike) -> Path:
    if not isinstance(path, str | os.PathLike):
        raise FileFormatError(f"path must be a file name, got {type(path).__name__}")
    return Path(os.fsdecode(path))


def _check_certificate(bounder: Bounder, certificate: Certificate, threshold: float) -> None:
    """The certificate must be about this bounder; where it claims a proof, its numbers must add up with this network's rounding."""
    if certificate.threshold != threshold:
        raise FileFormatError(f"the certificate is about threshold {certificate.threshold}, the file has {threshold}")
    if certificate.query != bounder.query_kind or certificate.domain != [
        bounder.domain.lower.tolist(),
        bounder.domain.upper.tolist(),
    ]:
        raise FileFormatError("the certificate is about other queries or another domain than the file")
    if not bounder.conservative:
        raise FileFormatError(f"{bounder.method} is not conservative and cannot hold a certificate")
    if not certificate.proven:
        return
    if not bounder.provable:
        raise FileFormatError(
            f"the certificate claims a proof, {bounder.method} has none for {bounder.query_kind} queries"
        )
    error = bounder.rounding_bound()
    if not threshold <= round_down(certificate.lower_bound - error):
        raise FileFormatError(
            f"the certificate does not add up: threshold {threshold:.6g} exceeds bound {certificate.lower_bound:.6g} less rounding {error:.2g}"
        )


def _check_info(document: dict) -> None:
    """Margin and resolution are used again, to make the same cells of a mesh; rates are shown."""
    margin, resolution = document.get("margin"), document.get("resolution")
    if margin is not None and not (isinstance(margin, int | float) and 0 <= margin < float("inf")):
        raise FileFormatError(f"the margin {margin!r} is not a length")
    if resolution is not None and not isinstance(resolution, int):
        raise FileFormatError(f"the resolution {resolution!r} is not a whole number")
    rates = document.get("rates")
    if rates is not None and not all(0 <= rates[key] <= 100 for key in ("fp_rate", "fp_rate_aabb")):
        raise FileFormatError(f"the rates {rates!r} are none")
    if rates is not None and not isinstance(rates["samples"], int):
        raise FileFormatError(f"the samples {rates['samples']!r} are not a whole number")


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
        if path.suffix.lower() in SUFFIXES:
            kind = "an array, image or voxel" if path.suffix.lower() in ARRAY_SUFFIXES else "a mesh"
            got = f"got {kind} file; where both are named, the bounder comes first, then the shape"
            raise FileFormatError(f"{path}: expected a bounder that fit wrote, {got}") from error
        raise FileFormatError(f"{path}: not a complete safetensors file ({error})") from error


def _digest(tensors: dict[str, np.ndarray], document: dict) -> str:
    sha = hashlib.sha256(json.dumps(document, sort_keys=True, separators=(",", ":")).encode())
    for name in sorted(tensors):
        tensor = np.ascontiguousarray(tensors[name])
        sha.update(f"|{name}|{tensor.dtype.str}|{tensor.shape}|".encode() + tensor.tobytes())
    return sha.hexdigest()


def write_whole(path: str | os.PathLike, content: bytes, suffix: str | None = None) -> None:
    """Write a file so that a reader, a crash or a full disk never sees half of it; a link stays, and what it points to is written.

    Args:
        path: File to write.
        content: All of it.
        suffix: See ``check_writable``.

    Raises:
        FileFormatError: If it cannot be written; an existing file is then untouched.
    """
    check_writable(path, suffix=suffix)
    given, path, temporary = _path(path), Path(os.path.realpath(path)), None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as file:
            temporary = Path(file.name)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.chmod(0o666 & ~_umask())
        os.replace(temporary, path)
    except OSError as error:
        raise FileFormatError(f"{given}: cannot be written ({error.strerror or error})") from error
    finally:  # whatever ended it, Ctrl-C too
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def check_writable(path: str | os.PathLike, *inputs: str | os.PathLike, suffix: str | None = None) -> None:
    """Find out before long work whether its result can be written at the end; changes nothing.

    Args:
        path: File to write.
        *inputs: Files that the work reads, if they exist.
        suffix: Of its kind, one of ``STARTS``. An existing file is then to be replaced only if it has that suffix or holds that kind:
            a shape, or whatever else a slip of the hand names, is kept.

    Raises:
        FileFormatError: If the path is a folder or a device, cannot be written to, is one of the inputs, or such a file.
    """
    given = _path(path)
    if not os.fspath(path) or "\0" in str(given):
        raise FileFormatError(f"path must be a file name, got {os.fsdecode(path)!r}")
    path = Path(os.path.realpath(given))
    try:
        if any(path.exists() and Path(own).exists() and path.samefile(own) for own in inputs):
            raise FileFormatError(f"{given}: is read here, expected another file to write")
        if path.is_dir():
            raise FileFormatError(f"{given}: is a folder, expected a file name")
        if path.exists():
            if not path.is_file():
                raise FileFormatError(f"{given}: is a device or a pipe, expected a file name")
            if not os.access(path, os.W_OK):
                raise FileFormatError(f"{given}: exists and may not be written to")
            if suffix is not None and given.suffix.lower() != suffix and not _holds(path, suffix):
                raise FileFormatError(
                    f"{given}: exists and is no {suffix} file, so it is kept; expected a new name, or a {suffix} file to replace"
                )
        folder = path.parent
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
    except OSError as error:
        raise FileFormatError(f"{given}: cannot be written ({error.strerror or error})") from error
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        raise FileFormatError(f"{given}: {folder} is not a folder that can be written to")


def _holds(path: Path, suffix: str) -> bool:
    """Whether a file is of this kind by its content, or empty."""
    at, start = STARTS[suffix]
    with path.open("rb") as file:
        content = file.read(at + len(start))
    return not content or content[at:] == start


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
