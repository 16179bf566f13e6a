"""The cloth: proven bounders change no bit of it, broken ones are found out, files that do not fit are refused."""

import io
import json
import subprocess
import sys
from functools import cache

import numpy as np
import pytest
from rich.console import Console

import warp_bounding as wb

newton = pytest.importorskip("newton", reason="Newton is not installed: pip install '.[newton]'")

import warp as wp  # noqa: E402

from sims import cloth  # noqa: E402
from sims.cloth import demo, example, field, scene  # noqa: E402
from sims.cloth.example import cloth_data  # noqa: E402
from sims.cloth.star import HALF, NOTCH, POINTS, TIP, star  # noqa: E402
from sims.drawing import Drawn  # noqa: E402
from sims.prefitted import FitSpec, fitted  # noqa: E402

SIDE, STEPS = 33, 120
CLOSED = {"aabb": FitSpec("aabb"), "kdop": FitSpec("kdop"), "voxels": FitSpec("voxels", resolution=64)}
TINY = {"hidden": (12, 12), "steps": 20}


def denying(bounder):
    """The bounder with its threshold raised, so that it denies a part of the object."""
    raised = bounder.to(str(bounder.device))
    inside = raised.values(np.zeros((1, 3), np.float32)).numpy()[0]
    return raised.freeze(float(np.nextafter(inside, np.float32(np.inf))), None)


@pytest.fixture(scope="module")
def small() -> cloth.Scene:
    return cloth.Scene(side=SIDE)


def all_fitted(specs, **options):
    return fitted({name: scene.dilated(name) for name in scene.SHAPES}, specs, scenes="cloth-", **options)


@pytest.fixture(scope="module")
def bounders():
    return all_fitted(CLOSED)


@pytest.fixture(scope="module")
def examples(small, bounders):
    return demo.simulate(small, bounders, steps=STEPS)


def test_the_star_is_a_closed_concave_solid():
    mesh = star(cuts=2)
    assert mesh.watertight
    assert len(mesh.faces) == 4 * POINTS * 4**2
    a, b, c = (mesh.vertices.astype(np.float64)[mesh.faces[:, i]] for i in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert np.isclose(volume, 2 / 3 * HALF * POINTS * TIP * NOTCH * np.sin(np.pi / POINTS), rtol=1e-5)
    between = np.float32(
        [[0.0, 0.0, (NOTCH + TIP * np.cos(np.pi / POINTS)) / 2]]
    )  # two points: in the hull, not in the star
    assert not mesh.to_grid(resolution=48).contains(between)[0]


@pytest.mark.slow
def test_the_cloth_falls_on_both_shapes_and_not_through_them(examples):
    reference = examples["none"]
    assert reference.touched > 500
    assert set(example.contact_records(reference._contacts)[1].tolist()) == {0, 1}
    assert np.isfinite(reference.state.particle_q.numpy()).all()
    assert reference.deepest == 0.0
    assert reference.missed() == 0  # a pass repeated is the same pass


@pytest.mark.slow
@pytest.mark.parametrize("name", [*CLOSED])
def test_a_proven_bounder_changes_nothing_but_the_number_of_pairs(examples, name):
    reference, run = examples["none"], examples[name]
    run.test_final(reference)
    assert run.missed() == 0
    assert run.identical(reference)
    assert run.touched == reference.touched
    assert sum(run.calls) < 0.5 * sum(reference.calls)


@pytest.mark.slow
def test_a_tighter_bounder_leaves_fewer_pairs(examples):
    assert sum(examples["voxels"].calls) < sum(examples["kdop"].calls) < sum(examples["aabb"].calls)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*CLOSED])
def test_a_bounder_that_denies_a_part_of_the_object_is_found_out(small, bounders, examples, name):
    broken = {shape: denying(bounder) for shape, bounder in bounders[name].items()}
    run = cloth.Example(small, broken, unproven=True)
    for _ in range(STEPS):
        run.step()
    assert run.missed() > 0
    assert not run.identical(examples["none"])
    with pytest.raises(AssertionError, match="contacts were missed"):
        run.test_final(examples["none"])
    with pytest.raises(wb.BounderError, match="proven"):
        cloth.Example(small, broken)


@pytest.mark.slow
def test_identical_means_every_bit_and_every_record(small):
    first, second = (cloth.Example(small) for _ in range(2))
    for run in (first, second):
        run.step()
    second.test_final(first)
    q = second.state.particle_q.numpy()
    q[7, 1] = np.nextafter(q[7, 1], np.float32(np.inf))
    second.state.particle_q.assign(q)
    assert second.missed() == 0
    assert not second.identical(first)
    with pytest.raises(AssertionError, match="final states differ"):
        second.test_final(first)


@pytest.mark.slow
def test_a_digest_tells_one_bit_of_one_record(examples):
    records = [array.copy() for array in example.contact_records(examples["none"]._contacts)]
    before = example._digest(records)
    assert before == example._digest([array.copy() for array in records])
    normal = records[-1]
    normal[0, 0] = np.nextafter(normal[0, 0], np.float32(2.0))
    assert before != example._digest(records)
    assert before != example._digest([array[:-1] for array in records])


def test_depths():
    points = np.float32([[0.9, 1.1, 0.0], [0.0, 3.0, 0.0], *cloth.Scene().world_vertices("star")[:10]])
    depths = cloth.Scene().depths(wp.array(points, dtype=wp.vec3, device="cpu"))
    assert 0.1 < depths[0] < 0.25  # the middle of the star
    assert depths[1] == 0.0
    assert (depths[2:] < 1e-5).all()  # its corners


@pytest.mark.parametrize("change", [{"margin": 0.01}, {"resolution": 32}])
def test_a_file_of_another_margin_or_of_cells_is_refused_with_what_it_is(tmp_path, change):
    margin = scene.dilated("bunny").margin
    path = tmp_path / "other.safetensors"
    wb.fit(scene.shape("bunny"), method="mlp", device="cpu", **TINY, **{"margin": margin} | change).save(path)
    expected = (
        f"expected {margin:.6g}, got 0.01" if "margin" in change else "itself, got one of its cells at resolution 32"
    )
    with pytest.raises(wb.BounderError, match=expected):
        cloth.run(tmp_path, quick=True, bounder_file=path, specs={"mlp": FitSpec("mlp")})


def test_a_file_of_another_shape_is_refused(tmp_path):
    path = tmp_path / "other.safetensors"
    other = wb.IndicatorMesh(scene.shape("bunny").vertices * 1.01, scene.shape("bunny").faces)
    wb.fit(other, method="mlp", margin=scene.dilated("bunny").margin, device="cpu", **TINY).save(path)
    with pytest.raises(wb.BounderError, match="another shape"):
        all_fitted({"mlp": FitSpec("mlp")}, file=path)
    with pytest.raises(wb.BounderError, match="no such file"):
        all_fitted({"mlp": FitSpec("mlp")}, file=tmp_path / "none.safetensors")


@pytest.mark.parametrize("options", [{"device": "cuda:0"}, {"steps": 0}, {"side": 1}])
def test_impossible_options_are_refused(tmp_path, options):
    with pytest.raises(wb.BoundingError, match="got"):
        cloth.run(tmp_path, quick=True, **options)


def test_without_newton_one_line_says_what_to_install():
    code = "import sys; sys.modules['newton'] = None; from sims.__main__ import run; run(['cloth'])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.strip().splitlines() == ["sims: the demo needs newton: pip install 'warp-bounding[sims]'"]


@pytest.fixture(scope="module")
def meadow():
    return cloth.Field(rows=2, particles=3000)


@cache
def closed_of_field(gap):
    return {name: b for name, b in field.bounders_for(gap, {}, {}).items() if name in ("aabb", "voxels")}


@pytest.mark.slow
@pytest.mark.parametrize("gap", [min(field.GAPS), max(field.GAPS)])
def test_many_meshes_have_the_same_contacts(meadow, gap):
    row = field.measure(meadow, gap, closed_of_field(gap), rounds=2)
    assert row["contacts"] > 50
    assert [entry["bounder"] for entry in row["bounders"]] == ["aabb", "voxels", "voxels, all cores"]
    for entry in row["bounders"]:
        assert entry["identical"]
        assert entry["missed"] == 0
        assert 0 < entry["survivors"] < row["pairs"]
        assert entry["ms"] > 0
        assert entry["ratio"] > 0
    json.dumps(row)


@pytest.mark.slow
def test_one_bounder_of_distances_serves_all_gaps(meadow):
    """That of the cloth, whose margin is for the narrowest gap."""
    specs = {"distance": scene.SPECS["distance"]}
    own = {"distance": fitted({name: scene.dilated(name) for name in scene.SHAPES}, specs, scenes="cloth-")["distance"]}
    rows = [field.measure(meadow, gap, own, rounds=2) for gap in field.GAPS]
    for row in rows:
        (entry,) = row["bounders"]
        assert entry["identical"]
        assert entry["missed"] == 0
    left = [row["bounders"][0]["survivors"] for row in rows]
    assert left[0] < left[1] < left[2] < 0.1 * rows[0]["pairs"]


@pytest.mark.slow
def test_many_meshes_find_a_broken_bounder_out(meadow, monkeypatch):
    broken = {"aabb": {name: denying(b) for name, b in closed_of_field(0.05)["aabb"].items()}}
    with pytest.raises(wb.BounderError, match="proven"):
        field.measure(meadow, 0.05, broken, rounds=1)
    plain = field.ParticleCull
    monkeypatch.setattr(field, "ParticleCull", lambda *inputs: plain(*inputs, unproven=True))
    (entry,) = field.measure(meadow, 0.05, broken, rounds=1)["bounders"]
    assert not entry["identical"]
    assert entry["missed"] > 0


@pytest.mark.slow
def test_a_bounder_of_a_narrower_gap_is_refused(meadow):
    with pytest.raises(wb.BounderError, match=r"margin of 0\.\d+ at least, got 0\.\d+"):
        field.measure(meadow, 0.2, closed_of_field(0.05), rounds=1)


def test_sentences_say_who_wins():
    def row(gap, **ratios):
        return {"gap": gap, "bounders": [{"bounder": name, "ratio": ratio} for name, ratio in ratios.items()]}

    text = field.sentences(
        [row(0.2, **{"voxels": 2.0, "aabb": 0.9, "voxels, all cores": 2.5}), row(0.01, voxels=0.8, aabb=0.7)]
    )
    assert text.splitlines() == [
        "Gap 0.2: voxels is 2.00 times as fast as Newton's own pass; its early reject beats aabb; voxels, all cores: 2.50.",
        "Gap 0.01: Newton's own early reject wins; voxels comes closest, 0.80 times as fast.",
    ]


@pytest.mark.slow
def test_the_whole_demo(tmp_path, monkeypatch):
    """With networks that are fitted in a moment; contacts are kept all the same."""
    networks = {"mlp": FitSpec("mlp", options=TINY), "occupancy": FitSpec("occupancy", options=TINY)}
    monkeypatch.setattr(field, "FIELD_SPECS", {"mlp": FitSpec("aabb")})  # which needs no file
    monkeypatch.setattr(demo, "QUICK_FIELD", {"rows": 2, "particles": 500})
    drawn = []
    monkeypatch.setattr(demo, "draw_with", lambda *inputs: drawn.append(inputs) or Drawn([], "none"))
    console = Console(file=io.StringIO(), record=True, width=200)
    specs = {"aabb": FitSpec("aabb"), **networks, "aabb+mlp": FitSpec("aabb+mlp")}
    made = cloth.run(tmp_path, quick=True, refit=True, steps=100, specs=specs, console=console)
    assert [run["bounder"] for run in made["runs"]] == [
        "none",
        "aabb",
        "mlp",
        "occupancy",
        "aabb+mlp",
        "chosen",
        "mlp, all cores",
    ]
    assert made["identical"]
    assert made["runs"][3]["missed"] > 0
    assert not made["runs"][3]["identical"]
    assert {row["gap"] for row in made["field"]} == set(field.GAPS)
    assert all(run["identical"] and run["missed"] == 0 for run in made["runs"] if run["bounder"] != "occupancy")
    assert sorted(path.name for path in tmp_path.glob("*.safetensors")) == [
        f"cloth-{name}-{method}.safetensors" for name in ("bunny", "star") for method in networks
    ]
    text = console.export_text()
    assert text.count("broad phase") == 2
    assert "which has no proof, missed" in text
    assert drawn[0][0] == "sims.cloth.pictures"
    json.dumps(made)


@pytest.mark.slow
def test_picture(examples, tmp_path):
    pytest.importorskip("pyvista")
    paths = examples["none"].render(tmp_path)
    if not paths:
        pytest.skip("this machine cannot draw off-screen")
    assert [path.name for path in paths] == ["cloth.png"]
    assert paths[0].stat().st_size > 20_000


@pytest.mark.slow
def test_the_picture_says_what_a_run_missed(examples):
    data = cloth_data({"kdop": examples["kdop"]}, examples["none"])
    missed, under = str(data["caption0"]).splitlines()[1:]
    assert missed == "0 contacts missed; identical to the run without a bounder, to the bit"
    assert under.startswith(f"{int((examples['none'].look() > 0).sum())} particles under the surface")
