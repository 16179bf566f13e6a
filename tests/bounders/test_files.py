"""Files of bounders come back as they were, or not at all."""

import os
from functools import cache
from unittest.mock import Mock

import numpy as np
import pytest
import safetensors.numpy
from bounding_shapes import domain_points, fitted, fitted_query, random_layers, random_mlp, shape
from commands import check_bad, run
from region_cases import REGIONS, hard_regions
from rewriting import check_refused, rewrite

import warp_bounding as wb
from warp_bounding.bounders import METHODS, file_format
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.errors import BounderError, FileFormatError
from warp_bounding.proof import prove
from warp_bounding.runtime.whole_file import check_writable


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "box.safetensors"
    fitted("aabb", "c").save(path)
    return path


def test_what_is_not_proven_is_kept_too(tmp_path):
    bounder, path = random_mlp(shape("c")), tmp_path / "b.safetensors"
    bounder.freeze(0.25, None).save(path)
    reference = wb.load(path, device="cpu")
    assert reference.certificate is None
    assert reference.threshold == np.float32(0.25)


def test_every_flipped_byte_and_every_shorter_or_longer_file_is_noticed(saved, rng):
    content = saved.read_bytes()
    for position, old in enumerate(content):
        other = bytes([(old + int(rng.integers(1, 256))) % 256])
        saved.write_bytes(content[:position] + other + content[position + 1 :])
        with pytest.raises(FileFormatError):
            wb.load(saved, device="cpu")
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
    path, tensors = tmp_path / "foreign.safetensors", {"w": np.zeros(3, np.float32)}
    check_refused(path, "no such file")
    check_refused(tmp_path, "a folder, expected the file of a bounder")
    for content in (b"", b"prose", b"\0" * 100, b"\xff" * 100, b"PK\3\4", (1 << 62).to_bytes(8, "little") + b"{}"):
        path.write_bytes(content)
        check_refused(path)
    safetensors.numpy.save_file(tensors, path)
    check_refused(path, "not one that holds a bounder")
    for entry in ("prose", "[]", "{}", '{"sha256": 1, "bounder": []}', '{"sha256": 1, "bounder": {}}', "[" * 100_000):
        safetensors.numpy.save_file(tensors, path, metadata={file_format.KEY: entry})
        check_refused(path)
    (tmp_path / "x.stl").write_text("solid")
    check_refused(tmp_path / "x.stl", "got a mesh file")
    for name in (5, None, "x" * 3000, "a\0b"):
        with pytest.raises(FileFormatError):
            wb.load(name)


def test_files_of_what_is_gone_say_what_replaces_it(saved):
    for edit, words in (
        ({"method": "kd-tree"}, "method 'kd-tree' is gone: fit a bvh"),
        ({"method": "composition"}, "put proven parts together by cascade"),
        ({"method": "monotone-mlp"}, "'monotone-mlp' is gone: fit a bvh"),
        ({"method": "aabb", "pieces": [0]}, "pieces of a shape are gone"),
        ({"method": "aabb", "pieces": None, "space": "parametric"}, "volumes in parametric space are gone"),
    ):
        rewrite(saved, lambda document, edit=edit: document.update(edit))
        check_refused(saved, words)


@pytest.mark.parametrize("query", REGIONS)
@pytest.mark.parametrize("method", ["mlp", "cascade", "relu-field"])
def test_older_networks_and_fields_over_regions_are_refused_in_one_line(method, query, tmp_path, capsys, rng):
    """By ``load``, by ``certify`` and on the command line; the line names what answers these queries now."""
    path, source, box = tmp_path / "old.safetensors", tmp_path / "c.npy", fitted_query("c", "aabb", query, LENGTH)
    np.save(source, shape("c").occupancy)
    box.save(path)
    layers = enumerate(random_layers((box.domain.ndim, 8, 1), rng))
    tensors = {
        f"layers.{i}.{name}": x for i, layer in layers for name, x in zip(("weight", "bias"), layer, strict=True)
    }
    sizes = {"hidden": [8], "activation": "sin"}
    if method == "cascade":
        both = enumerate((box.tensors, tensors))
        tensors = {f"{i}.{name}": x for i, part in both for name, x in part.items()}
        sizes = {"parts": [{"method": "aabb", "sizes": {}}, {"method": "mlp", "sizes": sizes}]}
    rewrite(path, lambda document: document.update(method=method, sizes=sizes), tensors)
    name, end = "mlp", " can; a network of distances answers rays and boxes, proven: fit(shape, 'distance')"
    if method == "relu-field":
        name, end = method, " can"
    line = f"{path}: {name} does not bound {query} queries of 2D objects; aabb, "
    for read in (lambda: wb.load(path, device="cpu"), lambda: wb.certify(path, shape("c"))):
        with pytest.raises(FileFormatError) as error:
            read()
        assert str(error.value).startswith(line)
        assert str(error.value).endswith(end)
    for command in (("info", path), ("certify", path, source)):
        status, out, err = run(capsys, *command)
        check_bad(status, out, err)
        assert err == f"warp-bounding: {error.value}\n"


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
    full = OSError(28, "No space left on device")
    for name, raised in (("replace", full), ("fsync", full), ("fsync", KeyboardInterrupt())):
        with monkeypatch.context() as patch:
            patch.setattr(os, name, Mock(side_effect=raised))
            with pytest.raises((FileFormatError, KeyboardInterrupt)):
                other.save(saved)
        assert saved.read_bytes() == before
        assert [p.name for p in saved.parent.iterdir()] == [saved.name]
    other.save(saved)
    assert wb.load(saved, device="cpu").method == "kdop"
    assert [p.name for p in saved.parent.iterdir()] == [saved.name]


def test_places_that_cannot_be_written(saved, tmp_path):
    folder = tmp_path / "folder"
    folder.mkdir()
    for path in (saved / "below.safetensors", folder, tmp_path / ("x" * 300), "", "a\0b.safetensors"):
        with pytest.raises(FileFormatError):
            fitted("aabb", "c").save(path)
    for path in (saved / "below.safetensors", folder):
        with pytest.raises(FileFormatError):
            check_writable(path)
    check_writable(tmp_path / "new" / "deep" / "b.safetensors")
    assert not (tmp_path / "new").exists()
    assert not list(folder.iterdir())


def test_only_what_was_a_bounder_is_replaced(saved, tmp_path):
    """A slip of the hand keeps its shape: by its name, an existing file must have been a bounder."""
    notes, empty, link = (tmp_path / name for name in ("mesh.obj", "empty", "link.safetensors"))
    fitted("aabb", "c").save(saved)
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


def claim(**fields):
    return lambda document: document["certificate"].update(fields)


def test_rates_are_kept_and_say_nothing_of_another_threshold(saved):
    bounder = wb.load(saved)
    assert bounder.info["rates"] == fitted("aabb", "c").info["rates"]
    reference = bounder.to("cpu")
    reference.freeze(float(reference.threshold) - 1, None)
    assert "false positives" not in repr(reference)
    assert "false positives" in repr(bounder)


LENGTH = 0.75


@cache
def network(name: str) -> Mlp:
    """Random weights and an honest certificate."""
    grid = shape(name)
    bounder = random_mlp(grid, seed=3)
    prove(bounder, grid, eps=0.1)
    bounder.info = {"indicator": grid.digest, "margin": 0.0, "seed": 0}
    return bounder


CASES = [*((method, "c", "point") for method in METHODS), *((m, "animated", "point") for m in ("bvh", "mlp"))]
CASES += [*(("aabb", "animated", query) for query in REGIONS)]


@pytest.mark.parametrize(("method", "name", "query"), CASES)
def test_round_trip(method, name, query, device, tmp_path, rng):
    path, again = tmp_path / "deep" / "b.safetensors", tmp_path / "again.safetensors"
    if query == "point":
        bounder, x = fitted(method, name), domain_points(shape(name), 5000, rng)
    else:
        bounder = fitted_query(name, method, query, LENGTH)
        x = hard_regions(query, shape(name), rng, LENGTH, 1000)
    bounder.save(path)
    reference = wb.load(path, device=device)
    assert (reference.query(x).numpy() == bounder.to(device).query(x).numpy()).all()
    assert reference.values(x).numpy().tobytes() == bounder.to(device).values(x).numpy().tobytes()
    for of in (lambda b: (type(b), b.certificate, b.threshold, b.nbytes), lambda b: b.domain.to_dict()):
        assert of(reference) == of(bounder)
    assert all(reference.info[k] == v for k, v in bounder.info.items())
    assert reference.info["library"] == wb.__version__
    bounder.save(again)
    assert again.read_bytes() == path.read_bytes()


TENSORS = [  # of a bounder, an edit, and words of the error
    ("box", lambda t: t["low"].__setitem__(0, np.nan), ""),
    ("box", lambda t: t["high"].__setitem__(1, np.inf), ""),
    ("box", lambda t: t["high"].__setitem__(1, 3e38), ""),
    ("box", lambda t: t.pop("low"), ""),
    ("box", lambda t: t.update(extra=np.zeros(2, np.float32)), ""),
    ("box", lambda t: t.update(low=np.zeros((2, 1), np.float32)), ""),
    ("box", lambda t: t.update(low=t["low"].astype(np.float64)), ""),
    ("box", lambda t: t.update(low=t["low"].astype(np.uint32)), ""),
    ("voxels", lambda t: t.update(bits=t["bits"].astype(np.float32)), "uint32"),
    ("mlp", lambda t: t["layers.0.weight"].__setitem__((0, 0), np.nan), "finite"),
    ("mlp", lambda t: t.update({"layers.0.weight": np.zeros((6, 5), np.float32)}), "tensors"),
]


@pytest.mark.parametrize(("of", "change", "words"), TENSORS)
def test_wrong_tensors_are_refused(saved, of, change, words):
    if of != "box":
        fitted(of, "c").save(saved)
    tensors = {name: value.copy() for name, value in safetensors.numpy.load_file(saved).items()}
    with np.errstate(invalid="ignore"):
        change(tensors)
    rewrite(saved, lambda d: None, tensors)
    check_refused(saved, words)


def test_files_that_speak_of_moments_and_octaves(tmp_path):
    """Older files say that there are none; those of networks that had them have more numbers, and are refused."""
    path, bounder = tmp_path / "b.safetensors", network("c")
    bounder.save(path)
    rewrite(path, lambda d: d["sizes"].update(moments=False, octaves=0))
    reference = wb.load(path, device="cpu")
    assert reference.data.parameters.numpy().tobytes() == bounder.data.parameters.numpy().tobytes()


NAN, INF = float("nan"), float("inf")
EDITS = [  # kind of bounder, where, field, values: numbers, functions of what was there, or ... for none at all
    ("points", "document", "threshold", (0.5, NAN, 0.1, "low", -INF, True)),
    ("points", "document certificate", "threshold", (0.5,)),
    ("points", "document", "certificate", ([1],)),
    ("points", "document", "method", ("mlp", "magic", ["aabb"])),
    ("points", "document", "query", ("ray",)),
    ("points", "document", "dimension", (3,)),
    ("points", "document", "domain", ("here", ...)),
    ("points", "document", "sizes", (7, [])),
    ("points", "document", "margin", ("wide", NAN, 0.05)),
    ("points", "document", "resolution", ("fine", 4)),
    ("points", "document", "name", ("cube.obj",)),
    ("points", "document", "library", (...,)),
    ("points", "document", "format", (file_format.FORMAT + 1, "2", 1.5, None, 0, True)),
    ("points", "document", "rates", (5, {}, {"fp_rate": 1, "fp_rate_aabb": 5})),
    ("points", "document", "rates", ({"fp_rate": -1, "fp_rate_aabb": 5, "samples": 10},)),
    ("points", "domain", "limit", ([0.5, 0.5], [NAN, NAN])),
    ("points", "domain", "scale", (lambda old: [-s for s in old], [1e300, 1e300])),
    ("points", "domain", "scale", (lambda old: [str(s) for s in old], lambda old: [s * (1 + 1e-12) for s in old])),
    ("points", "domain", "delta", ([0.0, 0.0], [1e-3], [True, True])),
    ("points", "domain", "center", ([0.5] * 3,)),
    ("points", "domain", "time", ("no",)),
    ("points", "certificate", "more", (1,)),
    ("points", "certificate", "kind", ("certain",)),
    ("points", "certificate", "lower_bound", (-1.0, NAN, INF, "high")),
    ("points", "certificate", "rounding_bound", (NAN, -1.0)),
    ("points", "certificate", "indicator", ("0" * 64,)),
    ("points", "certificate", "margin", (None,)),
    ("points", "certificate", "counterexample", ([0.5, 0.5],)),
    ("rays", "document", "length", (0.5,)),
    ("rays", "domain", "length", (0.5, ...)),
    ("rays", "certificate", "length", (0.5,)),
    ("rays", "document domain", "length", (None, 0.5, 0.0, -1.0, NAN, INF, "long", 1e6, True)),
    ("rays", "document", "query", ("box",)),
    ("rays", "domain", "query", ("box", "point", ...)),
    ("rays", "document domain", "query", ("cone", "box")),
    ("rays", "document", "space", ("parametric",)),
    ("rays", "domain", "space", ("parametric", ...)),
    ("rays", "document domain", "space", ("flat", ["geometric"])),
    ("rays", "document", "motion", ("time",)),
    ("rays", "domain", "moving", (True, 0)),
    ("rays", "domain", "time", (True,)),
    ("rays", "domain", "delta", ([1e-9, 1e-9],)),
    ("rays", "domain", "limit", ([0.9, 0.9],)),
    ("rays", "domain", "scale", (lambda old: [2 * s for s in old],)),
    ("rays", "document", "threshold", (0.5,)),
    ("rays", "document", "method", ("mlp",)),
    ("rays", "certificate", "query", ("point",)),
    ("rays", "certificate", "threshold", (-20.0,)),
    ("rays", "certificate", "domain", ([[0.0, 0.0], [1.0, 1.0]],)),
]


@pytest.mark.parametrize(("kind", "where", "field", "values"), EDITS)
def test_edits_that_do_not_add_up_are_refused(kind, where, field, values, tmp_path):
    """Edited by hand they fail their digest; with a digest computed anew the numbers do not add up."""
    path = tmp_path / "b.safetensors"
    for value in values:

        def edit(document, value=value):
            for place in where.split():
                held = document if place == "document" else document[place]
                held[field] = value(held[field]) if callable(value) else value
                if value is ...:
                    del held[field]

        (fitted("aabb", "c") if kind == "points" else fitted_query("c", "aabb", "ray", LENGTH)).save(path)
        rewrite(path, edit)
        check_refused(path)


def test_what_networks_cannot_claim(tmp_path):
    """To round less, or to be conservative."""
    path, bounder = tmp_path / "b.safetensors", network("c")
    for made, edit, words in (
        (fitted("mlp", "c"), claim(rounding_bound=0.0), "rounds by"),
        (bounder, lambda d: d.update(method="occupancy"), "not conservative"),
    ):
        made.save(path)
        rewrite(path, edit)
        check_refused(path, words)
    with pytest.raises(BounderError, match="not conservative"):
        prove(METHODS["occupancy"](bounder.domain, bounder.tensors, bounder.sizes, "cpu"), shape("c"))
