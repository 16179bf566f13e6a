"""Files and bounders that somebody has edited, and what finds them out."""

import json

import numpy as np
import pytest
import safetensors.numpy

import warp_bounding as wb
from warp_bounding.bounders import file_format
from warp_bounding.certificates.claim import as_fitted
from warp_bounding.errors import FileFormatError
from warp_bounding.queries import QUERIES, oracle
from warp_bounding.shapes import Grid
from warp_bounding.shapes.shape import IN


def rewrite(path, change, tensors=None):
    """Edit the document as an author who knows the format would: with a digest that fits."""
    held = tensors or safetensors.numpy.load_file(path)
    with safetensors.safe_open(path, framework="numpy") as file:
        document = json.loads(file.metadata()[file_format.KEY])["bounder"]
    change(document)
    entry = json.dumps({"sha256": file_format.digest_of(held, document), "bounder": document})
    path.write_bytes(safetensors.numpy.save(held, metadata={file_format.KEY: entry}))


def check_refused(path, *words):
    with pytest.raises(FileFormatError) as error:
        wb.load(path, device="cpu")
    assert str(path) in str(error.value)
    assert all(word in str(error.value) for word in words)


def changed(bounder, tensors, certificate=None):
    """A copy of a bounder in which some tensors are replaced."""
    made = type(bounder)(bounder.domain, bounder.tensors | tensors, bounder.sizes, "cpu")
    made.info = dict(bounder.info)
    return made.freeze(float(bounder.threshold), certificate)


def check_refuted(bounder, shape, kinds=("refuted",), **told):
    """Not proven; and a counterexample, where one is given, is one, which the bounder denies."""
    proof, query = wb.certify(bounder, shape, **told), bounder.query_kind
    assert proof.kind in kinds, proof.message
    if proof.kind == "refuted":
        x, claimed = np.float32([proof.counterexample]), as_fitted(bounder, shape)
        if query in ("point", "distance"):
            assert claimed.contains(x)[0]
        elif isinstance(claimed, Grid):
            assert oracle(query, claimed, "cpu", bounder.domain.oracle_length)(x)[0]
        else:
            assert QUERIES[query].decide(claimed, x)[0] == IN
        assert bounder.query(x).numpy()[0] == 0
    return proof
