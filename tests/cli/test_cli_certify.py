"""``certify``: what is claimed is told, and another claim than the one that is stated is not proven."""

import json

import numpy as np
import pytest
from commands import run

import warp_bounding as wb

CELLS = np.pad(np.ones((2, 3, 2), bool), 2)


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("certify")
    np.save(folder / "block.npy", CELLS)
    shape = wb.load_indicator(folder / "block.npy")
    paths = {"shape": str(folder / "block.npy")}
    for query, length in (("point", None), ("ray", 0.5)):
        paths[query] = str(folder / f"{query}.safetensors")
        wb.fit(shape, query=query, method="aabb", margin=0.05, length=length, device="cpu").save(paths[query])
    return paths


def test_the_claim_is_told(files, capsys):
    code, out, _ = run(capsys, "certify", files["ray"], files["shape"])
    assert code == 0
    for words in ("proven: Proven from scratch", "block.npy, dilated by 0.05", "length 0.5", "xform= or scale="):
        assert words in out
    code, out, _ = run(capsys, "info", files["ray"])
    assert code == 0
    for words in ("block.npy", "dilated by 0.05", "0 <= t <= 0.5", "placement", "may round a query by up to"):
        assert words in " ".join(out.split())


@pytest.mark.parametrize(
    ("query", "options"),
    [
        ("point", ["--margin", "0.05"]),
        ("ray", ["--margin", "0.05", "--length", "0.5", "--query", "ray"]),
    ],
)
def test_the_expected_claim_is_proven(files, capsys, query, options):
    assert run(capsys, "certify", files[query], files["shape"], *options)[0] == 0


@pytest.mark.parametrize(
    ("query", "options", "words"),
    [
        ("point", ["--margin", "0.1"], "expected margin 0.1, the bounder is for margin 0.05"),
        ("ray", ["--length", "1"], "expected length 1.0, the bounder is for length 0.5"),
        ("point", ["--resolution", "64"], "expected resolution 64, the bounder is for resolution none"),
        ("point", ["--query", "ray"], "expected query ray, the bounder is for query point"),
    ],
)
def test_another_claim_is_not_proven(files, capsys, query, options, words):
    code, out, err = run(capsys, "certify", files[query], files["shape"], *options)
    assert code == 1
    assert not err
    line, *others = out.splitlines()
    assert line == f"inapplicable: another claim than the expected one: {words}"
    assert len(others) == 1  # boxes and seconds: this *is* the shape
    code, out, _ = run(capsys, "certify", files[query], files["shape"], *options, "--json")
    answer = json.loads(out)
    assert (code, answer["proven"], answer["same_indicator"]) == (1, False, True)
    assert words in answer["certificate"]["message"]
