"""``soak`` on the command line: exit status, the query that was missed, state files, Ctrl-C and bad input."""

import json
import re

import numpy as np
import pytest
from bounding_shapes import shape
from commands import check_bad, run

import warp_bounding as wb


@pytest.fixture
def files(tmp_path):
    np.save(tmp_path / "c.npy", shape("c").occupancy)
    np.save(tmp_path / "blob.npy", shape("blob").occupancy)
    bounder = wb.fit(shape("c"), query="ray", method="kdop", device="cpu")
    bounder.save(tmp_path / "good.safetensors")
    bounder.freeze(float(bounder.threshold) + 0.01, None).save(tmp_path / "raised.safetensors")
    return tmp_path


def test_none_missed(files, capsys):
    status, out, _ = run(capsys, "soak", files / "good.safetensors", files / "c.npy", "--count", "3e5", "--seed", 7)
    assert status == 0
    assert "none missed" in out
    assert "seed 7" in out
    status, out, _ = run(capsys, "soak", files / "good.safetensors", files / "c.npy", "--count", "1000", "--json")
    result = json.loads(out)
    assert status == 0
    assert len(out.strip().splitlines()) == 1
    assert (result["missed"], result["wanted"], result["same_indicator"]) == (None, 1000, True)
    assert result["done"] >= 1000
    assert result["rate"] > 0


def test_a_false_negative_is_printed(files, capsys):
    arguments = ("soak", files / "raised.safetensors", files / "c.npy", "--count", "1e6", "--seed", 7)
    status, out, _ = run(capsys, *arguments)
    assert status == 1
    first, second = out.splitlines()
    assert re.fullmatch(r"FALSE NEGATIVE: the ray \[.*\] \(float32\) meets the shape and is answered with no\.", first)
    assert "hard positive ray queries were answered with maybe before it" in second
    assert "--seed 7" in second
    status, out, _ = run(capsys, *arguments, "--json")
    result = json.loads(out)
    assert status == 1
    raised = wb.load(files / "raised.safetensors", device="cpu")
    assert raised.query(np.array([result["missed"]], np.float32)).numpy()[0] == 0


def test_it_is_resumed(files, capsys):
    arguments = ("soak", files / "good.safetensors", files / "c.npy", "--resume", files / "s.json", "--json")
    first = json.loads(run(capsys, *arguments, "--count", "1000")[1])
    second = json.loads(run(capsys, *arguments, "--count", first["done"] + 1)[1])
    assert second["seed"] == first["seed"]
    assert second["chunks"] == first["chunks"] + 1


def test_an_interruption_says_what_was_done(files, capsys, monkeypatch):
    import warp_bounding.bounders.bounder as base

    asked, real = [], base.Bounder.query

    def query(self, *args, **kwargs):
        asked.append(1)
        if len(asked) > 3:
            raise KeyboardInterrupt
        return real(self, *args, **kwargs)

    monkeypatch.setattr(base.Bounder, "query", query)
    status, out, err = run(capsys, "soak", files / "good.safetensors", files / "c.npy", "--resume", files / "s.json")
    assert status == 0
    assert out.startswith("interrupted: ")
    assert "none missed" in out
    assert "--resume" in out
    assert "Traceback" not in err
    assert json.loads((files / "s.json").read_text())["chunks"] == 3


BAD = {
    "count 0": ("{good}", "{c}", "--count", "0"),
    "count words": ("{good}", "{c}", "--count", "many"),
    "count half": ("{good}", "{c}", "--count", "1.5"),
    "count nan": ("{good}", "{c}", "--count", "nan"),
    "seed": ("{good}", "{c}", "--seed", "-1"),
    "dimension": ("{good}", "{blob}"),
    "no file": ("{none}", "{c}"),
    "no shape": ("{good}", "{none}"),
    "state is a folder": ("{good}", "{c}", "--resume", "{dir}"),
    "state is no state": ("{good}", "{c}", "--resume", "{c}"),
    "device": ("{good}", "{c}", "--device", "cuda:99"),
}


@pytest.mark.parametrize("bad", BAD)
def test_bad_usage(bad, files, capsys):
    names = {"good": files / "good.safetensors", "c": files / "c.npy", "blob": files / "blob.npy"}
    names |= {"none": files / "none.npy", "dir": files}
    check_bad(*run(capsys, "soak", *(word.format(**names) for word in BAD[bad])))


def test_another_shape_is_told_first(files, capsys):
    occupancy = shape("c").occupancy.copy()
    occupancy[2:4] = False
    np.save(files / "part.npy", occupancy)
    status, out, _ = run(capsys, "soak", files / "good.safetensors", files / "part.npy", "--count", "1000")
    assert status == 0
    first, second = out.splitlines()
    assert "part.npy is not the shape that the bounder was fitted to" in first
    assert "none missed" in second
