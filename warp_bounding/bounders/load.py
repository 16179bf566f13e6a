"""``load``: from a file to a bounder; every number in the file is checked as far as it can be without the shape."""

import os
from dataclasses import replace

import numpy as np

from warp_bounding.bounders.bounder import DISTANCES, METHODS, Bounder, class_named
from warp_bounding.bounders.file_format import INFO_FIELDS, read
from warp_bounding.certificates import Certificate
from warp_bounding.certificates.claim import check_claims
from warp_bounding.errors import BounderError, BoundingError, FileFormatError
from warp_bounding.queries.distance import DISTANCE, DistanceDomain
from warp_bounding.queries.domain import json_number
from warp_bounding.queries.region_domain import SPACE, RegionDomain
from warp_bounding.runtime.launch import device_of
from warp_bounding.runtime.whole_file import file_path
from warp_bounding.shapes.recentred import Frame
from warp_bounding.shapes.shape import dilated_digest


def load(path: str | os.PathLike, device: str | None = None) -> Bounder:
    """Read a bounder and check all of it.

    Args:
        path: A file that ``save`` wrote.
        device: Warp device, such as ``"cpu"`` or ``"cuda:0"``; the default device if ``None``.

    Returns:
        The bounder, with its certificate as stored (``certify`` proves it anew).

    Raises:
        FileFormatError: If the file is missing, damaged, truncated, foreign, edited or newer than this library.
        DeviceError: If there is no such device.

    Example:
        >>> bounder.save("ball.safetensors")
        >>> wb.load("ball.safetensors", device="cpu").method
        'obb'
    """
    path = file_path(path)
    device_of(device)  # first: a missing device is no fault of the file
    tensors, document = read(path)
    if document.get("method") == BALLS:
        raise FileFormatError(f"{path}: holds the balls of a pair, no bounder; read it with wb.pairs.Balls.load")
    try:
        bounder = _made(document, tensors, device)
        threshold = document["threshold"]
        certificate = Certificate.from_dict(document["certificate"]) if document["certificate"] else None
        described = [document[k] for k in ("query", "dimension", "space", "length", "motion")]
        motion = "time" if bounder.domain.time else None
        if described != [bounder.query_kind, bounder.ndim, SPACE, bounder.domain.length, motion]:
            raise FileFormatError("query, dimension, space, length and motion are not those of the domain inside")
        if not np.isfinite(json_number(threshold, "the threshold")) or float(np.float32(threshold)) != threshold:
            raise FileFormatError(f"the threshold {threshold} is not a finite float32 number")
        _check_info(document)
        if certificate:
            check_claims(bounder, certificate, document)
        bounder.freeze(threshold, certificate)
        if "frame" in document:
            bounder.frame = Frame.from_dict(document["frame"], bounder.ndim)
            if fault := bounder.frame.fault(bounder):
                raise FileFormatError(fault)
        bounder.info = {field: document.get(field) for field in INFO_FIELDS} | {"library": document["library"]}
        _bring_up(bounder)
    except BoundingError as error:
        raise FileFormatError(f"{path}: {error}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(f"{path}: a field is missing or of the wrong type ({error})") from error
    return bounder


# Methods of older files that are gone, and what does their work now.
GONE = {
    "composition": "put together by & and |: fit it anew, or put proven parts together by cascade",
    "kd-tree": "fit a bvh, which holds the same cells",
    "local": "fit an mlp, which has one threshold",
    "mlp-early": "fit an mlp behind a learned-kdop, learned-kdop+mlp",
    "monotone-mlp": "fit a bvh",
    "union": "fit the shape as a whole",
}
BALLS = "balls"  # ``pairs.balls``: no bounder


def _bring_up(bounder: Bounder) -> None:
    """Add the margin to the object's digest: older files name a shape without cells by its geometry's alone."""
    info = bounder.info
    if info["indicator"] is None or any(info[name] is not None for name in ("shape", "grid_shape", "resolution")):
        return
    geometry, digest = info["indicator"], dilated_digest(info["indicator"], info["margin"] or 0.0)
    info |= {"shape": geometry, "indicator": digest}
    if bounder.certificate is not None and bounder.certificate.indicator == geometry:
        bounder.certificate = replace(bounder.certificate, indicator=digest)


def _made(document: dict, tensors: dict[str, np.ndarray], device: str | None) -> Bounder:
    """The bounder that a file describes, without threshold and certificate."""
    name, of_distances = document["method"], document["query"] == DISTANCE.name
    method = class_named(name, document["query"])
    if method is None and name in GONE:
        raise FileFormatError(f"method {name!r} is gone: {GONE[name]}")
    if method is None:
        known = ", ".join(DISTANCES if of_distances else METHODS)
        raise FileFormatError(f"method {name!r} is not among those that are known here: {known}")
    if document["space"] != SPACE:
        raise FileFormatError(f"volumes in {document['space']} space are gone: fit one around the object")
    domain = (DistanceDomain if of_distances else RegionDomain).from_dict(document["domain"])
    return method(domain, tensors, document["sizes"], device)


def bounder_of(source: Bounder | str | os.PathLike, device: str | None = None):
    """A bounder, or the one in the file at a path, on this device; raises ``BounderError`` for anything else."""
    if isinstance(source, Bounder):
        return source
    if isinstance(source, str | os.PathLike):
        return load(source, device)
    expected = "expected a bounder or the path of its file first, then the shape"
    raise BounderError(f"{expected}, got {type(source).__name__} first")


def _check_info(document: dict) -> None:
    """Check fields of ``info``: margin and resolution divide a mesh into the same cells again, the others are shown."""
    margin, resolution = document.get("margin"), document.get("resolution")
    if margin is not None and not (type(margin) in (int, float) and 0 <= margin < float("inf")):
        raise FileFormatError(f"the margin {margin!r} is not a length")
    if resolution is not None and type(resolution) is not int:
        raise FileFormatError(f"the resolution {resolution!r} is not a whole number")
    for name in ("indicator", "shape", "name", "note"):
        if not isinstance(document.get(name), str | None):
            raise FileFormatError(f"the {name} {document[name]!r} is no text")
    if document.get("pieces") is not None:
        raise FileFormatError("bounders of pieces of a shape are gone: fit the shape as a whole")
    rates = document.get("rates")
    if rates is not None and not all(0 <= rates[key] <= 100 for key in ("fp_rate", "fp_rate_aabb")):
        raise FileFormatError(f"the rates {rates!r} are none")
    if rates is not None and not isinstance(rates["samples"], int):
        raise FileFormatError(f"the samples {rates['samples']!r} are not a whole number")
