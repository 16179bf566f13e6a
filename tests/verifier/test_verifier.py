"""``python -m verifier``: what holds is verified, and every planted fault is found."""

import ctypes
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from asking import ask
from bounding_shapes import DEEP, HIDDEN, random_mlp
from lockstep import lockstep
from rewriting import changed, rewrite

import warp_bounding as wb
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.bounders.mlp_distance import MlpDistance
from warp_bounding.networks import network as networks
from warp_bounding.networks import tensor_cores
from warp_bounding.proof import prove
from warp_bounding.proof.search import ShapePositives
from warp_bounding.queries.distance import DistanceDomain
from warp_bounding.queries.domain import Domain

pytest.importorskip("flint", reason="the verifier needs python-flint (the extra verify)")
from verifier import files, network, search
from verifier.__main__ import main
from verifier.bounders import Claim, parts
from verifier.mesh import Mesh

MARGIN = 0.05
RING = trimesh.creation.torus(0.7, 0.3, major_sections=12, minor_sections=8)
METHODS = ("aabb", "obb", "kdop", "learned-kdop", "bvh")
STORAGES = {"grid": "float16", "bytes": "uint8", "floats": "float32"}
SEARCHED = ("mlp", "sin", "distance", "grid", "cascade")


@cache
def ring(margin=MARGIN):
    return wb.shapes.Mesh(RING.vertices, RING.faces, name="ring").dilated(margin)


@cache
def bounder(kind):
    """Proven bounders of the ring: by method, fitted networks, or networks of random weights."""
    if kind in ("sin", "relu", "deep"):
        made = random_mlp(ring(), DEEP if kind == "deep" else HIDDEN, "relu" if kind == "relu" else "sin")
        prove(made, ring(), eps=1e-6)
        made.info["margin"] = MARGIN
        return made
    if kind == "distance":
        return wb.fit(ring(), "distance", "mlp", hidden=HIDDEN, steps=60, device="cpu")
    if kind in STORAGES:
        return wb.fit(ring(), "distance", "distance-grid", nodes=12, storage=STORAGES[kind], device="cpu")
    if kind == "cascade":  # in another
        return wb.cascade(bounder("aabb"), wb.cascade(bounder("learned-kdop"), bounder("mlp")))
    options = {"resolution": 24} if kind == "bvh" else {"steps": 20} if kind == "learned-kdop" else {}
    options = {"hidden": HIDDEN, "steps": 60} if kind == "mlp" else options
    return wb.fit(ring(), method=kind, device="cpu", **options)


@pytest.fixture
def files_of(tmp_path):
    """Writes a bounder and the ring; the command's arguments."""

    def write(kind, change=None, tensors=None):
        made = bounder(kind) if isinstance(kind, str) else kind
        made.save(tmp_path / "ring.safetensors")
        if change:
            rewrite(tmp_path / "ring.safetensors", change, tensors)
        RING.export(tmp_path / "ring.obj", digits=17)
        return [str(tmp_path / "ring.safetensors"), str(tmp_path / "ring.obj")]

    return write


def lowest(made, count=200_000):
    """The least exact f of many points of the object; of a distance the least that it exceeds F by, in local units."""
    if made.of_distances:
        x = np.random.default_rng(3).uniform(made.domain.lower, made.domain.upper, (5000, 3))
        solid = trimesh.Trimesh(np.float32(RING.vertices), RING.faces, process=False)  # as the verifier reads it
        away = np.where(solid.contains(x), 0, trimesh.proximity.closest_point(solid, x)[1] - MARGIN)
        return float((np.maximum(away, 0) / made.domain.unit - made.reference(made.domain.to_local(x))).min())
    return float(made.reference(made.domain.to_local(ring().points(count, np.random.default_rng(3)))).min())


@pytest.mark.parametrize("kind", [*METHODS, *SEARCHED, "relu", "deep", "bytes", "floats"])
def test_what_is_proven_is_verified(files_of, capsys, kind):
    assert main(files_of(kind)) == 0
    does = "overestimates no distance to the points" if bounder(kind).of_distances else "answers maybe for all points"
    assert capsys.readouterr().out.startswith(f"verified: ring.safetensors {does} within 0.05 of the solid in ring.obj")


@pytest.mark.parametrize("kind", [*METHODS, *SEARCHED])
@pytest.mark.parametrize("fault", ["threshold", "margin", "vertex", "margin in the file"])
def test_changes_are_found(files_of, tmp_path, capsys, kind, fault):
    def change(document):
        if fault == "threshold":
            document["threshold"] = float(np.float32(lowest(bounder(kind)) + 0.05)) if kind != "bvh" else 0.5
        if fault == "margin in the file":
            document["margin"] = 3 * MARGIN

    given = files_of(kind, change)
    if fault == "vertex":
        moved, k, by = RING.copy(), 5, 0.3
        if kind in ("distance", "grid"):  # to where its F is largest, in the domain
            domain, by = bounder(kind).domain, 0.2
            v = domain.to_local(moved.vertices + by * moved.vertex_normals)
            k = np.where((abs(v) <= domain.limit).all(axis=1), bounder(kind).reference(v), -1).argmax()
        moved.vertices[k] += by * moved.vertex_normals[k]
        moved.export(tmp_path / "ring.obj", digits=17)
    status = main([*given, *(["--margin", "0.2"] if fault == "margin" else [])])
    assert status == 1, capsys.readouterr()
    assert "not verified: " in capsys.readouterr().out


@pytest.mark.parametrize("kind", [*METHODS, "mlp", "sin", "distance"])
def test_a_changed_number_is_found(files_of, capsys, kind):
    made = bounder(kind)
    name, by = {"aabb": ("low", 0.3), "bvh": ("low", 0.3), "learned-kdop": ("offsets", -0.3)}.get(kind, ("high", -0.3))
    if kind in ("mlp", "sin", "distance"):
        name, by = f"layers.{len(made.hidden)}.bias", 0.3 if kind == "distance" else -0.3
    names = ("low", "high") if kind == "bvh" else (name,)
    assert main(files_of(changed(made, {name: made.tensors[name] + np.float32(by) for name in names}))) == 1
    assert "not verified: " in capsys.readouterr().out


@pytest.mark.parametrize("node", [(0, 0, 0), (5, 5, 0), (11, 3, 1)])
def test_a_node_of_a_grid_that_is_too_high_is_found(files_of, capsys, node):
    """By a ten-thousandth of a unit, at a place outside."""
    made = bounder("floats")
    values, limit = made.tensors["values"].copy(), made.domain.limit.astype(float)
    x = made.domain.to_object((2 * limit * node / (np.array(values.shape) - 1) - limit)[None])
    away = trimesh.proximity.closest_point(trimesh.Trimesh(np.float32(RING.vertices), RING.faces), x)[1][0] - MARGIN
    assert values[node] + float(made.threshold) < away / made.domain.unit
    values[node] = away / made.domain.unit - float(made.threshold) + 1e-4
    assert main(files_of(changed(made, {"values": values}))) == 1
    assert "not verified: box" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "by"),
    [("0.low", 0.3), ("1.0.offsets", -0.3), ("1.1.layers.1.bias", -0.3), ("thresholds", 0.3), ("1.thresholds", 0.3)],
)
def test_a_change_in_any_part_of_a_cascade_is_found(files_of, capsys, name, by):
    made = bounder("cascade")
    tensors = made.tensors | {name: made.tensors[name] + np.float32(by)}
    assert main(files_of("cascade", lambda document: None, tensors)) == 1
    assert "not verified: " in capsys.readouterr().out


@pytest.mark.parametrize("kind", ["mlp", "sin", "deep", "distance", "grid", "cascade"])
def test_an_error_that_is_a_hundredth_too_small_is_found(files_of, kind):
    least, held = lowest(bounder(kind)), files.read_bounder(Path(files_of(kind)[0]))
    error = Claim(*parts(*held[:2])[-1]).error
    threshold = float(np.float32(least - 0.99 * error))

    def change(document):
        document["threshold"] = threshold

    assert main(files_of(kind, change)) == 1


# --- a thin wall -----------------------------------------------------------------------------------------------------

WALL = trimesh.creation.box((1, 1, 0.02))


@cache
def wall():
    """Half the sum of what v exceeds the sides of a plate by: no farther than the plate, and 0 on all of it."""
    domain = DistanceDomain.of(wb.shapes.Mesh(WALL.vertices, WALL.faces), 0.2)
    scale = float(domain.scale[0])
    tensors = {"layers.0.weight": np.concatenate([np.eye(3), -np.eye(3)]), "layers.1.weight": np.full((1, 6), 0.5)}
    tensors |= {"layers.0.bias": -scale * np.tile([0.5, 0.5, 0.01], 2), "layers.1.bias": np.zeros(1)}
    tensors = {name: tensor.astype(np.float32) for name, tensor in tensors.items()}
    made = MlpDistance(domain, tensors, {"hidden": [6], "activation": "relu"}, "cpu").freeze(-0.01, None)
    made.info["margin"] = 0.0
    return made


@pytest.mark.parametrize(("threshold", "margin", "status"), [(-0.01, 0, 0), (1e-5, 0, 1), (-0.01, 0.03, 1)])
def test_a_wall_that_boxes_straddle(files_of, tmp_path, threshold, margin, status):
    """Nothing is claimed in it where the threshold is under 0; with a higher one, more than 0 within the wall."""
    file, shape = files_of(wall(), lambda document: document.update(threshold=float(np.float32(threshold))))
    WALL.export(shape, digits=17)
    assert main([file, shape, "--margin", str(margin)]) == status
    claim, mesh = Claim(*files.read_bounder(Path(file))[:2]), Mesh(*files.read_mesh(Path(shape)))
    boxes = search.Boxes(-claim.limit[None], claim.limit[None], np.array([12]), np.arange(12))
    for _ in range(12):  # what a box touches is listed, whatever slope its parents had
        boxes = search.Look(claim, mesh, float(margin))(boxes)
        listed = np.zeros((len(boxes.count), 12), bool)
        listed[np.repeat(np.arange(len(listed)), boxes.count), boxes.items] = True
        box, triangle = (each.reshape(-1) for each in np.indices(listed.shape))
        low, high = claim.origins(boxes.lower, boxes.upper)
        assert listed[box, triangle][mesh.gaps(low, high, box, triangle) == 0].all()


# --- going on --------------------------------------------------------------------------------------------------------


def test_a_search_that_was_stopped_goes_on(files_of, monkeypatch, capsys, tmp_path):
    """What a kill leaves is what Ctrl-C leaves: nothing is written when the search ends."""
    given, looks, whole = files_of("mlp"), [], search.Look.__call__

    def stopped(self, boxes):
        looks.append(len(boxes.count))
        if len(looks) == 12:
            raise KeyboardInterrupt
        return whole(self, boxes)

    assert main(given) == 0
    alone = capsys.readouterr().out
    monkeypatch.setattr(search, "SECONDS", 0.0)
    monkeypatch.setattr(search.Look, "__call__", stopped)
    assert main(given) == 2
    (saved,) = tmp_path.glob("ring.safetensors.verify-*.npz")
    monkeypatch.setattr(search.Look, "__call__", whole)
    assert main([*given, "--margin", "0.04"]) == 0  # of another search
    assert saved.is_file()
    assert main(given) == 0
    assert capsys.readouterr().out.splitlines()[-1] == alone.splitlines()[-1]
    assert not saved.exists()


# --- bad input -------------------------------------------------------------------------------------------------------


def edits():
    yield lambda d: d.update(query="ray")
    yield lambda d: d.update(method="sphere")
    yield lambda d: d["domain"].update(unbounded=True)
    yield lambda d: d["sizes"].update(activation="tanh")
    yield lambda d: d["sizes"].update(hidden=[9])
    yield lambda d: d["domain"].update(scale=[0.1, 0.1, 0.1])
    yield lambda d: d.pop("threshold")
    yield lambda d: d.update(method="distance-grid")
    yield lambda d: d.update(query="distance")  # by a scale that is no power of two


@pytest.mark.parametrize("change", list(edits()))
def test_other_kinds_and_damaged_files_are_bad_input(files_of, change, capsys):
    assert main(files_of("mlp", change)) == 2
    assert "bad input" in capsys.readouterr().err


@pytest.mark.parametrize("part", [{"method": "sphere"}, {"method": "mlp", "sizes": {"hidden": [9]}}])
def test_a_cascade_of_other_parts_is_bad_input(files_of, part):
    assert main(files_of("cascade", lambda document: document["sizes"]["parts"][0].update(part))) == 2


def test_what_a_part_says_besides_is_not_heeded(files_of):
    """Threshold and domain are those of the whole."""
    other = {"threshold": -9.0, "domain": {}, "query": "ray"}
    assert main(files_of("cascade", lambda document: document["sizes"]["parts"][0].update(other))) == 0


def test_layers_that_are_too_wide_are_bad_input(files_of, monkeypatch, capsys):
    monkeypatch.setattr(network, "WIDEST", HIDDEN[0] - 1)
    assert main(files_of("sin")) == 2
    assert "7 neurons at most" in capsys.readouterr().err


def test_scales_of_distances_are_one_power_of_two(files_of, capsys):
    for scale, limit in (([0.75] * 3, 1.0), ([0.5, 0.5, 1.0], 1.0), ([2.0**40] * 3, 1.0), ([0.5] * 3, 2.0**-21)):
        assert main(files_of("distance", lambda d: d["domain"].update(scale=scale, limit=[limit] * 3))) == 2  # noqa: B023
    assert "the scale of a distance is not one power of two" in capsys.readouterr().err


def test_damaged_bytes_and_open_meshes_are_bad_input(files_of, tmp_path, capsys):
    given = files_of("mlp")
    (tmp_path / "short").write_bytes((tmp_path / "ring.safetensors").read_bytes()[:-40])
    assert main([str(tmp_path / "short"), given[1]]) == 2
    assert main([given[0], str(tmp_path / "none.obj")]) == 2
    assert main([*given, "--margin", "nan"]) == 2
    RING.export(tmp_path / "ring.ply", encoding="ascii")
    assert main([given[0], str(tmp_path / "ring.ply")]) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith("bad input: ValueError('a PLY file of other")
    RING.submesh([np.arange(5, len(RING.faces))])[0].export(tmp_path / "ring.obj")
    assert main(given) == 2


# --- faults of the library -------------------------------------------------------------------------------------------


def relaxed(monkeypatch, made):
    bounds = networks.bound_boxes

    def too_high(*given):
        found = bounds(*given)
        return found._replace(lower=found.lower + 0.2)

    monkeypatch.setattr(networks, "bound_boxes", too_high)


def lowest_place(made):
    x = ring().points(10_000, np.random.default_rng(3))
    return x[made.reference(made.domain.to_local(x)).argmin()]


def uncovered(monkeypatch, made):
    """The eighth of the domain alone that is opposite to the lowest f."""
    end = -np.sign(made.domain.to_local(lowest_place(made))) * made.domain.limit
    cover = np.minimum(end, 0)[None], np.maximum(end, 0)[None]
    monkeypatch.setattr(ShapePositives, "boxes", lambda self: cover)


def emptied(monkeypatch, made):
    """As if there were nothing around the lowest f."""
    empty, place = wb.shapes.Mesh.empty, lowest_place(made)

    def wrong(self, low, high):
        return empty(self, low, high) | (np.abs((low + high) / 2 - place) < 0.3).all(axis=1)

    monkeypatch.setattr(wb.shapes.Mesh, "empty", wrong)


def unrounded(monkeypatch, made):
    monkeypatch.setattr(Mlp, "rounding_bound", lambda self: 0.0)


@pytest.mark.parametrize("kind", ["sin", "deep"])
@pytest.mark.parametrize("fault", [relaxed, uncovered, emptied, unrounded])
def test_what_a_faulty_library_proves_is_not_verified(files_of, monkeypatch, fault, kind):
    made, right = changed(bounder(kind), {}), float(bounder(kind).threshold)
    with monkeypatch.context() as patch:
        fault(patch, made)
        prove(made, ring(), eps=1e-6)
        assert made.certificate.proven
        assert float(made.threshold) > right + (0.5 * bounder(kind).certificate.rounding_bound)
    made.info["margin"] = MARGIN
    assert main(files_of(made)) == 1


# --- the order of sums -----------------------------------------------------------------------------------------------


def attack(big, activation):
    """Sums that cancel: f is a few terms, besides pairs of a size at which float32 keeps little of them.

    After "No Soundness in the Real World" (arXiv 2506.01054): what is true of real numbers is not of the deployed
    network, in one order of its sums or another.
    """
    rng, n = np.random.default_rng(0), 3
    weight, bias = rng.normal(size=(2 * n + 1, 3)) * 0.5, rng.uniform(0.5, 1, 2 * n + 1)
    weight[n : 2 * n], bias[n : 2 * n] = weight[:n], bias[:n]
    sizes, order = big * rng.uniform(0.5, 1, n), rng.permutation(2 * n + 1)
    last = np.concatenate([sizes, -sizes, [1.0]])[order]
    tensors = {"layers.0.weight": weight[order], "layers.0.bias": bias[order]}
    tensors |= {"layers.1.weight": last[None], "layers.1.bias": np.zeros(1)}
    tensors = {name: tensor.astype(np.float32) for name, tensor in tensors.items()}
    made = Mlp(Domain.of(ring()), tensors, {"hidden": [2 * n + 1], "activation": activation}, "cpu")
    made.info["margin"] = MARGIN
    return made


def denies(made, x):
    """Whether batches or a function in a kernel deny one of these points."""
    return not (made.query(x).numpy().all() and ask(made, x).all())


def denied_by_a_header(made, x):
    """Whether the exported header does, with products fused or not."""
    with tempfile.TemporaryDirectory() as folder:
        made.export(Path(folder) / "attack.h")
        line = "void ask(const float *q, int count, unsigned char *answers) { attack_maybe_many(q, count, answers); }"
        (Path(folder) / "attack.c").write_text(f'#include "attack.h"\n{line}\n')
        answers, options = np.zeros(len(x), np.uint8), ("-O2", "-O3 -march=native -ffp-contract=fast")
        for index, option in enumerate(options):
            library = f"{folder}/{index}.so"
            command = ["gcc", *option.split(), "-shared", "-fPIC", f"{folder}/attack.c", "-o", library, "-lm"]
            subprocess.run(command, check=True)
            given = np.ascontiguousarray(x)
            pointers = (array.ctypes.data_as(ctypes.c_void_p) for array in (given, answers))
            ctypes.CDLL(library).ask(next(pointers), len(x), next(pointers))
            if not answers.all():
                return True
    return False


def denied_by_tensor_cores(made, x):
    """Whether their text, emulated, denies one of the first points."""
    threshold = tensor_cores.lowered(made.threshold, made.rounding_bound(), tensor_cores.rounding(made.network))
    numbers, v = tensor_cores.numbers(made.source, made.layers, threshold), made.domain.to_local(x).astype(np.float32)
    for cuts in (0, 1):
        numbers[7] = cuts
        if min(lockstep(made.source, numbers, part).min() for part in v[:320].reshape(-1, 32, 3)) < threshold:
            return True
    return False


SLOW = pytest.param("sin", denied_by_tensor_cores, marks=pytest.mark.slow)  # a minute of compiling
COMPILED = pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc")
DENIED = [("sin", denies), ("relu", denies), pytest.param("sin", denied_by_a_header, marks=COMPILED), SLOW]


@pytest.mark.parametrize(("activation", "denied"), DENIED)
def test_no_order_of_sums_denies_what_is_verified(files_of, activation, denied, monkeypatch):
    """Where a search takes long nothing is verified."""
    whole, looks, told = search.Look.__call__, [], []

    def impatient(self, boxes):
        looks.append(len(boxes.count))
        if sum(looks) > 2_000:
            raise ArithmeticError("enough")
        return whole(self, boxes)

    monkeypatch.setattr(search.Look, "__call__", impatient)
    x = ring().points(20_000, np.random.default_rng(1)).astype(np.float32)
    for big in (1.0, 2.0**14):
        made = attack(big, activation)
        f = made.reference(made.domain.to_local(x))
        x, least, error = x[np.argsort(f)], float(f.min()), made.rounding_bound()
        more = tensor_cores.rounding(made.network) - error if denied is denied_by_tensor_cores else 0.0  # is taken off
        for threshold in (least + 0.1 * error + more, least, least - error - 0.1):
            made.freeze(float(np.float32(threshold)), None)
            looks.clear()
            told.append((main(files_of(made)) == 0, denied(made, x)))
    assert (True, True) not in told
    assert (True, False) in told
    assert (False, True) in told  # the attack is one
