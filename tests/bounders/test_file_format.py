"""Files come back as they were, or not at all."""

import os
import shutil

import numpy as np
import pytest
import safetensors.numpy
from bounding_shapes import domain_points, fitted, random_mlp, shape
from rewriting import check_refused, rewrite

import warp_bounding as wb
from warp_bounding.bounders import METHODS, file_format
from warp_bounding.errors import FileFormatError
from warp_bounding.runtime.whole_file import check_writable


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "box.safetensors"
    fitted("aabb", "c").save(path)
    return path


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["c", "mesh", "animated"])
def test_round_trip(method, name, device, tmp_path, rng):
    bounder, path = fitted(method, name), tmp_path / "deep" / "b.safetensors"
    bounder.save(path)
    twin = wb.load(path, device=device)
    x = domain_points(shape(name), 20_000, rng)
    assert (twin.query(x).numpy() == bounder.to(device).query(x).numpy()).all()
    assert twin.values(x).numpy().tobytes() == bounder.to(device).values(x).numpy().tobytes()
    assert twin.certificate == bounder.certificate
    assert twin.threshold == bounder.threshold
    assert type(twin) is type(bounder)
    assert twin.nbytes == bounder.nbytes
    assert all(twin.info[k] == v for k, v in bounder.info.items())
    assert twin.info["library"] == wb.__version__
    assert twin.domain.to_dict() == bounder.domain.to_dict()
    again = tmp_path / "again.safetensors"
    bounder.save(again)
    assert again.read_bytes() == path.read_bytes()


def test_what_is_not_proven_is_kept_too(tmp_path):
    bounder, path = random_mlp(shape("c"), octaves=1), tmp_path / "b.safetensors"
    bounder.freeze(0.25, None).save(path)
    twin = wb.load(path, device="cpu")
    assert twin.certificate is None
    assert twin.threshold == np.float32(0.25)
    assert twin.features == 4


@pytest.mark.parametrize("flip", [0x01, 0x20, 0x80])
def test_every_flipped_byte_is_noticed(saved, flip):
    content = bytearray(saved.read_bytes())
    for position in range(len(content)):
        content[position] ^= flip
        saved.write_bytes(content)
        with pytest.raises(FileFormatError):
            wb.load(saved, device="cpu")
        content[position] ^= flip
    saved.write_bytes(content)
    assert wb.load(saved, device="cpu").certificate.proven


def test_flipped_bytes_of_a_network_are_noticed(tmp_path, rng):
    path = tmp_path / "b.safetensors"
    fitted("mlp", "blob").save(path)
    content = bytearray(path.read_bytes())
    for position in rng.permutation(len(content))[:300]:
        old = content[position]
        content[position] = (old + int(rng.integers(1, 256))) % 256
        path.write_bytes(content)
        check_refused(path)
        content[position] = old


def test_every_shorter_or_longer_file_is_noticed(saved):
    content = saved.read_bytes()
    for length in [*range(64), *range(64, len(content), 17), len(content) - 1]:
        saved.write_bytes(content[:length])
        check_refused(saved)
    saved.write_bytes(content + b"\0")
    check_refused(saved)


def test_numbers_written_differently_are_an_edit(saved):
    """1.0 and 1.00 are the same number, so the digest of what was read could not tell."""
    held = safetensors.numpy.load_file(saved)
    with safetensors.safe_open(saved, framework="numpy") as file:
        entry = file.metadata()[file_format.KEY]
    saved.write_bytes(
        safetensors.numpy.save(held, metadata={file_format.KEY: entry.replace('"margin": 0.0', '"margin": 0.00')})
    )
    check_refused(saved, "SHA-256")


def test_foreign_files_are_refused(tmp_path, saved):
    path = tmp_path / "foreign.safetensors"
    check_refused(path, "no such file")
    check_refused(tmp_path, "a folder, expected the file of a bounder")
    for content in (b"", b"prose", b"\0" * 100, b"\xff" * 100, b"PK\3\4", (1 << 62).to_bytes(8, "little") + b"{}"):
        path.write_bytes(content)
        check_refused(path)
    safetensors.numpy.save_file({"w": np.zeros(3, np.float32)}, path)
    check_refused(path, "not one that holds a bounder")
    for entry in (
        "prose",
        "[]",
        "{}",
        "null",
        '{"sha256": 1, "bounder": []}',
        '{"sha256": 1, "bounder": {}}',
        "[" * 100_000,
    ):
        safetensors.numpy.save_file({"w": np.zeros(3, np.float32)}, path, metadata={file_format.KEY: entry})
        check_refused(path)


@pytest.mark.parametrize(
    ("method", "words"), [("kd-tree", "fit a bvh"), ("composition", "cascade, union or hierarchy")]
)
def test_files_of_methods_that_are_gone_say_what_replaces_them(saved, method, words):
    rewrite(saved, lambda document: document.update(method=method))
    check_refused(saved, f"method '{method}' is gone", words)


def test_newer_files_are_refused(saved):
    for version in (file_format.FORMAT + 1, "2", None, 1.5):
        rewrite(saved, lambda d, v=version: d.update(format=v))
        check_refused(saved, "newer")


EDITS = {
    "threshold": lambda d: d.update(threshold=d["threshold"] + 0.5),
    "threshold nan": lambda d: d.update(threshold=float("nan")),
    "threshold double": lambda d: d.update(threshold=0.1),
    "threshold text": lambda d: d.update(threshold="low"),
    "both thresholds": lambda d: (d.update(threshold=0.5), d["certificate"].update(threshold=0.5)),
    "lower bound": lambda d: d["certificate"].update(lower_bound=-1.0),
    "lower bound nan": lambda d: d["certificate"].update(lower_bound=float("nan")),
    "lower bound text": lambda d: d["certificate"].update(lower_bound="high"),
    "certificate field": lambda d: d["certificate"].update(more=1),
    "certificate list": lambda d: d.update(certificate=[1]),
    "method": lambda d: d.update(method="mlp"),
    "method unknown": lambda d: d.update(method="magic"),
    "method list": lambda d: d.update(method=["aabb"]),
    "query": lambda d: d.update(query="ray"),
    "dimension": lambda d: d.update(dimension=3),
    "no domain": lambda d: d.pop("domain"),
    "domain text": lambda d: d.update(domain="here"),
    "limit": lambda d: d["domain"].update(limit=[0.5, 0.5]),
    "limit nan": lambda d: d["domain"].update(limit=[float("nan")] * 2),
    "scale": lambda d: d["domain"].update(scale=[-s for s in d["domain"]["scale"]]),
    "scale huge": lambda d: d["domain"].update(scale=[1e300, 1e300]),
    "delta": lambda d: d["domain"].update(delta=[0.0, 0.0]),
    "delta short": lambda d: d["domain"].update(delta=[1e-3]),
    "three dimensions": lambda d: d["domain"].update(center=[0.5] * 3),
    "sizes": lambda d: d.update(sizes=7),
    "margin": lambda d: d.update(margin="wide"),
    "margin nan": lambda d: d.update(margin=float("nan")),
    "resolution": lambda d: d.update(resolution="fine"),
    "no library": lambda d: d.pop("library"),
}


@pytest.mark.parametrize("edit", EDITS)
def test_edits_that_do_not_add_up_are_refused(saved, edit):
    rewrite(saved, EDITS[edit])
    check_refused(saved)


TENSORS = {
    "nan": lambda t: t["low"].__setitem__(0, np.nan),
    "inf": lambda t: t["high"].__setitem__(1, np.inf),
    "huge": lambda t: t["high"].__setitem__(1, 3e38),
    "missing": lambda t: t.pop("low"),
    "more": lambda t: t.update(extra=np.zeros(2, np.float32)),
    "shape": lambda t: t.update(low=np.zeros((2, 1), np.float32)),
    "double": lambda t: t.update(low=t["low"].astype(np.float64)),
    "integers": lambda t: t.update(low=t["low"].astype(np.uint32)),
}


@pytest.mark.parametrize("edit", TENSORS)
def test_wrong_tensors_are_refused(saved, edit):
    tensors = {name: value.copy() for name, value in safetensors.numpy.load_file(saved).items()}
    with np.errstate(invalid="ignore"):
        TENSORS[edit](tensors)
    rewrite(saved, lambda d: None, tensors)
    check_refused(saved)


def test_bits_that_are_no_integers_are_refused(tmp_path):
    path = tmp_path / "b.safetensors"
    fitted("voxels", "c").save(path)
    tensors = safetensors.numpy.load_file(path)
    rewrite(path, lambda d: None, tensors | {"bits": tensors["bits"].astype(np.float32)})
    check_refused(path, "uint32")


def test_nan_weights_are_refused(tmp_path):
    path = tmp_path / "b.safetensors"
    fitted("mlp", "c").save(path)
    tensors = {name: value.copy() for name, value in safetensors.numpy.load_file(path).items()}
    tensors["layers.0.weight"][0, 0] = np.nan
    rewrite(path, lambda d: None, tensors)
    check_refused(path, "finite")


def test_a_lie_with_a_fitting_digest_loads_but_is_not_certified(saved):
    """The digest detects damage; only ``certify`` detects a lie."""

    def lie(document):
        document["threshold"] = document["certificate"]["threshold"] = 0.25
        document["certificate"]["lower_bound"] = 0.5

    rewrite(saved, lie)
    liar = wb.load(saved, device="cpu")
    assert liar.certificate.proven
    assert wb.certify(liar, shape("c")).kind == "refuted"


def test_a_file_is_replaced_whole_or_not_at_all(saved, monkeypatch):
    before, other = saved.read_bytes(), fitted("kdop", "c")
    for name in ("replace", "fsync"):
        with monkeypatch.context() as patch:

            def fail(*_):
                raise OSError(28, "No space left on device")

            patch.setattr(os, name, fail)
            with pytest.raises(FileFormatError, match="No space left"):
                other.save(saved)
        assert saved.read_bytes() == before
        assert [p.name for p in saved.parent.iterdir()] == [saved.name]
    other.save(saved)
    assert wb.load(saved, device="cpu").method == "kdop"
    assert [p.name for p in saved.parent.iterdir()] == [saved.name]


def test_places_that_cannot_be_written(saved, tmp_path):
    folder = tmp_path / "folder"
    folder.mkdir()
    for path in (saved / "below.safetensors", folder, tmp_path / ("x" * 300)):
        with pytest.raises(FileFormatError):
            fitted("aabb", "c").save(path)
    for path in (saved / "below.safetensors", folder):
        with pytest.raises(FileFormatError):
            check_writable(path)
    check_writable(tmp_path / "new" / "deep" / "b.safetensors")
    assert not (tmp_path / "new").exists()
    assert not list(folder.iterdir())


def test_ctrl_c_leaves_nothing_half_written(saved, monkeypatch):
    before = saved.read_bytes()

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        fitted("kdop", "c").save(saved)
    assert saved.read_bytes() == before
    assert [p.name for p in saved.parent.iterdir()] == [saved.name]


def test_only_what_was_a_bounder_is_replaced(saved, tmp_path):
    """A slip of the hand keeps its shape: by name or content, an existing file must have been a bounder."""
    unnamed, notes, empty, link = (tmp_path / name for name in ("unnamed", "mesh.obj", "empty", "link.safetensors"))
    for path in (unnamed, saved, unnamed, saved):
        fitted("aabb", "c").save(path)
    notes.write_text("v 0 0 0")
    with pytest.raises(FileFormatError, match=r"mesh\.obj: exists and is no \.safetensors file, so it is kept"):
        fitted("aabb", "c").save(notes)
    assert notes.read_text() == "v 0 0 0"
    empty.touch()
    fitted("aabb", "c").save(empty)
    assert wb.load(empty, device="cpu").method == "aabb"
    link.symlink_to(saved)
    fitted("kdop", "c").save(link)
    assert link.is_symlink()
    assert wb.load(saved, device="cpu").method == "kdop"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_device_is_no_file(tmp_path):
    """To rename over ``/dev/null``, which root may do, would take it away from the whole machine."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    link = tmp_path / "link.safetensors"
    link.symlink_to(pipe)
    for path in (pipe, link):
        with pytest.raises(FileFormatError, match="a device or a pipe"):
            fitted("aabb", "c").save(path)
    assert pipe.is_fifo()


@pytest.mark.parametrize("name", ["", "a\0b.safetensors"])
def test_names_that_are_none(name):
    with pytest.raises(FileFormatError, match="path must be a file name, got '"):
        fitted("aabb", "c").save(name)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission(tmp_path):
    folder = tmp_path / "closed"
    folder.mkdir()
    folder.chmod(0o500)
    with pytest.raises(FileFormatError):
        fitted("aabb", "c").save(folder / "b.safetensors")
    with pytest.raises(FileFormatError):
        check_writable(folder / "b.safetensors")
    folder.chmod(0o700)
    shutil.rmtree(folder)


def test_an_unknown_device(saved):
    """No fault of the file, which is not named."""
    with pytest.raises(
        wb.DeviceError, match=r"no such device on this machine: expected .*cpu.*, got 'cuda:99'"
    ) as error:
        wb.load(saved, device="cuda:99")
    assert saved.name not in str(error.value)
    assert not isinstance(error.value, FileFormatError)


def claim(**fields):
    return lambda document: document["certificate"].update(fields)


CLAIMS = {
    "kind": claim(kind="certain"),
    "boxes": claim(boxes=-1),
    "cells": claim(cells=0),
    "more cells than there are": claim(cells=10**6),
    "seconds": claim(seconds=float("nan")),
    "bound": claim(lower_bound=float("nan")),
    "bound infinite": claim(lower_bound=float("inf")),
    "rounding nan": claim(rounding_bound=float("nan")),
    "rounding negative": claim(rounding_bound=-1.0),
    "delta": claim(delta=[0.0, 0.0]),
    "delta large": claim(delta=[1.0, 1.0]),
    "delta short": claim(delta=[1e-4]),
    "shape": claim(indicator="0" * 64),
    "counterexample": claim(counterexample=[0.5, 0.5]),
    "samples of a proof": claim(samples=5),
    "rate of a proof": claim(fn_rate_bound=0.0),
    "message": claim(message=None),
    "statistical without samples": claim(kind="statistical"),
    "statistical, too good": claim(
        kind="statistical", samples=100, fn_rate_bound=1e-6, confidence=0.95, worst_margin=0.1
    ),
    "statistical, certain": claim(kind="statistical", samples=100, fn_rate_bound=0.5, confidence=1.0, worst_margin=0.1),
    "statistical, missed": claim(
        kind="statistical", samples=100, fn_rate_bound=0.5, confidence=0.95, worst_margin=-0.1
    ),
}


@pytest.mark.parametrize("edit", CLAIMS)
def test_a_certificate_that_contradicts_the_bounder_is_refused(saved, edit):
    """Edited by hand it fails its digest; with a digest computed anew its numbers do not add up."""
    rewrite(saved, CLAIMS[edit])
    check_refused(saved)


def test_a_certificate_edited_by_hand_fails_its_digest(saved):
    content = saved.read_bytes()
    assert content.count(b'\\"kind\\": \\"proven\\"') == 1
    saved.write_bytes(content.replace(b'\\"cells\\": 40', b'\\"cells\\": 41'))
    check_refused(saved, "SHA-256")


def test_a_network_that_claims_to_round_less_is_refused(tmp_path):
    path = tmp_path / "b.safetensors"
    fitted("mlp", "c").save(path)
    rewrite(path, claim(rounding_bound=0.0))
    check_refused(path, "rounds by")


def test_rates_are_kept_and_say_nothing_of_another_threshold(saved):
    bounder = wb.load(saved)
    assert bounder.info["rates"] == fitted("aabb", "c").info["rates"]
    assert f"{bounder.info['rates']['fp_rate']:.2f} % false positives of its cells (16,384 samples)" in repr(bounder)
    twin = bounder.to("cpu")
    twin.freeze(float(twin.threshold) - 1, None)
    assert "false positives" not in repr(twin)
    assert "false positives" in repr(bounder)


@pytest.mark.parametrize(
    "rates", [5, {}, {"fp_rate": -1, "fp_rate_aabb": 5, "samples": 10}, {"fp_rate": 1, "fp_rate_aabb": 5}]
)
def test_rates_that_are_none_are_refused(saved, rates):
    with pytest.raises(FileFormatError):
        wb.load(rewrite(saved, lambda document: document.update(rates=rates)) or saved)


@pytest.mark.parametrize("path", [5, None, "x" * 3000, "a\0b"])
def test_what_is_no_file_name(path):
    with pytest.raises(FileFormatError):
        wb.load(path)


def test_a_folder_and_a_shape_are_named(tmp_path):
    with pytest.raises(FileFormatError, match="a folder"):
        wb.load(tmp_path)
    (tmp_path / "x.stl").write_text("solid")
    with pytest.raises(FileFormatError, match="got a mesh file"):
        wb.load(tmp_path / "x.stl")
