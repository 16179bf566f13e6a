"""Files that somebody has edited."""

import json

import pytest
import safetensors.numpy

import warp_bounding as wb
from warp_bounding.bounders import file_format
from warp_bounding.errors import FileFormatError


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
