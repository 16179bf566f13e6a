"""The cloth: proven bounders change no bit of it, broken ones are found out, files that do not fit are refused."""

import numpy as np
import pytest

import warp_bounding as wb

newton = pytest.importorskip("newton", reason="Newton is not installed: pip install '.[newton]'")


from broken import denying  # noqa: E402

from sims import cloth  # noqa: E402
from sims.cloth import demo, example, scene  # noqa: E402
from sims.prefitted import FitSpec, fitted  # noqa: E402

SIDE, STEPS, ORIGIN = 33, 120, [[0, 0, 0]]
CLOSED = {"aabb": FitSpec("aabb"), "kdop": FitSpec("kdop"), "voxels": FitSpec("voxels", resolution=64)}


def all_fitted(specs, **options):
    return fitted({name: scene.dilated(name) for name in scene.SHAPES}, specs, scenes="cloth-", **options)


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
    broken = {shape: denying(bounder, ORIGIN) for shape, bounder in bounders["kdop"].items()}
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
