"""A bounder as one header for C99, C++11 and CUDA: its numbers, and the text of f that Warp compiles.

Nothing of a test is written here. ``Source.around`` and ``Source.body`` give the C text for a single query, and
``native/export.h`` what stands around it. The lines that only Warp's compiler reads are left out. Numbers are
hexadecimal floats. A compiler may fuse products and sums, which rounding bounds allow for; f then differs from that of
``query`` in what is rounded, and is as safe.
"""

import os
from typing import TYPE_CHECKING

from warp_bounding.bounders.file_format import digest_of, document_of
from warp_bounding.certificates.statement import statement
from warp_bounding.kernels.distances import SEGMENT_STEPS, line_texts
from warp_bounding.kernels.distances import text as distances
from warp_bounding.kernels.source import LABEL, Lanes
from warp_bounding.runtime.header import array, write
from warp_bounding.runtime.native import fill, literal, native_text

if TYPE_CHECKING:
    from warp_bounding.bounders.bounder import Bounder


def texts_of(bounder: "Bounder") -> dict[str, object]:
    """What the functions' texts are filled with; ``begin`` is what each begins with."""
    source = bounder.source
    texts = source.around(placed=False, values=bounder.of_distances) | {
        "name": "$name",
        "n": source.ndim,
        "columns": source.columns,
        "coordinates": source.coordinates,
        "kind": bounder.query_kind,
        "scalar_body": source.body(Lanes(vector=False, alone=True)),
    }
    return texts | {"begin": fill(native_text("export.h").BEGIN, **texts)}


def numbers_of(bounder: "Bounder") -> list[str]:
    """The C text of a bounder's numbers."""
    parameters, words = bounder.data.parameters.numpy().copy(), bounder.words().tolist()
    parameters[:LABEL] = 0.0  # which tells other functions apart
    floats = array("numbers", "float", map(literal, parameters.tolist()))
    return [floats, array("words", "unsigned int", map("{:#x}u".format, words))]


def about(bounder: "Bounder") -> list[str]:
    """What is proven of a bounder, the digest of its file, and how to prove it again."""
    digest = digest_of(bounder.tensors, document_of(bounder, bounder.info.get("library")))
    own = [f"{key}: {value}" for key, value in statement(bounder).items()]
    again = "`warp-bounding certify FILE SHAPE` proves it anew, from that file and the shape."
    return [*own, "", f"SHA-256 of the bounder's file: {digest}", again]


def export(bounder: "Bounder", path: str | os.PathLike, name: str | None = None) -> None:
    """Write a bounder as a header; see ``Bounder.export``."""
    bounder.expect_local("export")
    text, texts, function = native_text("export.h"), texts_of(bounder), "MAYBE"
    if bounder.of_distances:
        texts |= line_texts(bounder.source) | {"steps": SEGMENT_STEPS}
        step = fill(distances.STEP, **texts, value="const V g = $name_distance(q);")
        texts["march"] = fill(distances.MARCH_ALONE, **texts, scalar_step=step)
        function = "DISTANCE"
    write(path, name, about(bounder), [*numbers_of(bounder), fill(getattr(text, function), **texts)])
