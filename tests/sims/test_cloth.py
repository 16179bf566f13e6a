"""The cloth: proven bounders change no bit of it, broken ones are found out, files that do not fit are refused."""

import subprocess
import sys

import numpy as np
import pytest

import warp_bounding as wb

newton = pytest.importorskip("newton", reason="Newton is not installed: pip install '.[newton]'")

import warp as wp  # noqa: E402

from sims import cloth  # noqa: E402
from sims.cloth import demo, example, field, scene  # noqa: E402
from sims.cloth.star import HALF, NOTCH, POINTS, TIP, star  # noqa: E402
from sims.prefitted import FitSpec, fitted  # noqa: E402

SIDE, STEPS = 33, 120
CLOSED = {"aabb": FitSpec("aabb"), "kdop": FitSpec("kdop"), "voxels": FitSpec("voxels", resolution=64)}


def denying(bounder):
    """The bounder with its threshold raised, so that it denies a part of the object."""
    raised = bounder.to(str(bounder.device))
    inside = raised.values(np.zeros((1, 3), np.float32)).numpy()[0]
    return raised.freeze(float(np.nextafter(inside, np.float32(np.inf))), None)


def all_fitted(specs, **options):
    return fitted({name: scene.dilated(name) for name in scene.SHAPES}, specs, scenes="cloth-", **options)


def test_the_star_is_a_closed_concave_solid():
    mesh = star(cuts=2)
    assert mesh.watertight
    a, b, c = (mesh.vertices.astype(np.float64)[mesh.faces[:, i]] for i in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert np.isclose(volume, 2 / 3 * HALF * POINTS * TIP * NOTCH * np.sin(np.pi / POINTS), rtol=1e-5)
    between = [0.0, 0.0, (NOTCH + TIP * np.cos(np.pi / POINTS)) / 2]  # two points: in the hull, not in the star
    assert not mesh.contains(np.float32([between]))[0]


@pytest.mark.slow
def test_proven_bounders_change_nothing_but_the_number_of_pairs_and_broken_ones_are_found_out(tmp_path):
    small, bounders = cloth.Scene(side=SIDE), all_fitted(CLOSED)
    runs = demo.simulate(small, bounders, steps=STEPS)
    reference = runs["none"]
    assert reference.touched > 500
    assert set(example.contact_records(reference._contacts)[1].tolist()) == {0, 1}  # it falls on both shapes
    assert (reference.deepest, reference.missed()) == (0.0, 0)  # and not through them; a pass repeated is the same pass
    for name in CLOSED:
        runs[name].test_final(reference)
        assert runs[name].missed() == 0
        assert runs[name].identical(reference)
        assert sum(runs[name].calls) < 0.5 * sum(reference.calls)
    broken = {shape: denying(bounder) for shape, bounder in bounders["kdop"].items()}
    run = cloth.Example(small, broken, unproven=True)
    for _ in range(STEPS):
        run.step()
    assert run.missed() > 0
    with pytest.raises(AssertionError, match="contacts were missed"):
        run.test_final(reference)
    with pytest.raises(wb.BounderError, match="proven"):
        cloth.Example(small, broken)
    records = [array.copy() for array in example.contact_records(reference._contacts)]
    before = example._digest(records)
    records[-1][0, 0] = np.nextafter(records[-1][0, 0], np.float32(2.0))
    assert before != example._digest(records)  # identical means every bit of every record
    q = runs["kdop"].state.particle_q.numpy()
    q[7, 1] = np.nextafter(q[7, 1], np.float32(np.inf))
    runs["kdop"].state.particle_q.assign(q)
    with pytest.raises(AssertionError, match="final states differ"):
        runs["kdop"].test_final(reference)
    pytest.importorskip("pyvista")
    if paths := reference.render(tmp_path):  # where this machine can draw
        assert [path.name for path in paths] == ["cloth.png"]


def test_depths():
    points = np.float32([[0.9, 1.1, 0.0], [0.0, 3.0, 0.0], *cloth.Scene().world_vertices("star")[:10]])
    depths = cloth.Scene().depths(wp.array(points, dtype=wp.vec3, device="cpu"))
    assert 0.1 < depths[0] < 0.25  # the middle of the star
    assert depths[1] == 0.0
    assert (depths[2:] < 1e-5).all()  # its corners


def test_a_file_that_does_not_fit_is_refused(tmp_path):
    path, margin = tmp_path / "other.safetensors", scene.dilated("bunny").margin
    wb.fit(scene.shape("bunny"), method="aabb", device="cpu", margin=0.01).save(path)
    with pytest.raises(wb.BounderError, match="expected a bounder of method mlp, got aabb"):
        cloth.run(tmp_path, quick=True, bounder_file=path, specs={"mlp": FitSpec("mlp")})
    with pytest.raises(wb.BounderError, match=f"expected {margin:.6g}, got 0.01"):
        cloth.run(tmp_path, quick=True, bounder_file=path, specs={"mlp": FitSpec("aabb", kept=True)})
    with pytest.raises(wb.BounderError, match="no such file"):
        all_fitted({"mlp": FitSpec("mlp")}, file=tmp_path / "none.safetensors")
    for options in ({"device": "cuda:0"}, {"steps": 0}, {"side": 1}):
        with pytest.raises(wb.BoundingError, match="got"):
            cloth.run(tmp_path, quick=True, **options)


def test_without_newton_one_line_says_what_to_install():
    code = "import sys; sys.modules['newton'] = None; from sims.__main__ import run; run(['cloth'])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.strip().splitlines() == ["sims: the demo needs newton: pip install 'warp-bounding[sims]'"]


@pytest.mark.slow
def test_many_meshes_have_the_same_contacts(monkeypatch):
    meadow = cloth.Field(rows=2, particles=3000)
    closed = {gap: field.bounders_for(gap, {}, {}) for gap in (min(field.GAPS), max(field.GAPS))}
    own = all_fitted({"distance": scene.SPECS["distance"]})["distance"]  # of the cloth, one for all gaps
    left = []
    for gap in field.GAPS:
        some = {"distance": own} | {name: b for name, b in closed.get(gap, {}).items() if name in ("aabb", "voxels")}
        row = field.measure(meadow, gap, some, rounds=2)
        assert row["contacts"] > 50
        for entry in row["bounders"]:
            assert (entry["identical"], entry["missed"]) == (True, 0)
            assert 0 < entry["survivors"] < row["pairs"]
        left.append(row["bounders"][0]["survivors"])
    assert left[0] < left[1] < left[2] < 0.1 * row["pairs"]
    narrow = {"aabb": closed[min(field.GAPS)]["aabb"]}
    with pytest.raises(wb.BounderError, match=r"margin of 0\.\d+ at least, got 0\.\d+"):
        field.measure(meadow, max(field.GAPS), narrow, rounds=1)
    broken, plain = {"aabb": {name: denying(b) for name, b in narrow["aabb"].items()}}, field.ParticleCull
    with pytest.raises(wb.BounderError, match="proven"):
        field.measure(meadow, min(field.GAPS), broken, rounds=1)
    monkeypatch.setattr(field, "ParticleCull", lambda *inputs: plain(*inputs, unproven=True))
    (entry,) = field.measure(meadow, min(field.GAPS), broken, rounds=1)["bounders"]
    assert not entry["identical"]
    assert entry["missed"] > 0
