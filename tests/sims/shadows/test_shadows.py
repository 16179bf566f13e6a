from dataclasses import replace

import numpy as np
import pytest
import warp as wp

import warp_bounding as wb
from sims import shadows
from sims.base import compare
from sims.prefitted import FitSpec, owner, stored
from sims.report import kept, verdict
from sims.shadows import Example, Scene
from sims.shadows.demo import simulate
from sims.shadows.example import check_rays
from sims.shadows.kernels import stop
from sims.shadows.scene import FARTHEST, LENGTH, LIFT, LOWEST, REACH, TOLERANCE, margin_of

RESOLUTION, STEPS, SIZE = 32, 2, (120, 90)
CLOSED = ("aabb", "kdop", "bvh")
DEVICES = ["cpu", *(["cuda:0"] if wp.is_cuda_available() else [])]


@pytest.fixture(scope="module", params=DEVICES)
def scene(request):
    return Scene.still_life(*SIZE, request.param)


@pytest.fixture(scope="module")
def cells(scene):
    return {name: shape.to_grid(resolution=RESOLUTION, margin=margin_of(shape)) for name, shape in scene.shapes.items()}


@pytest.fixture(scope="module")
def bounders(scene, cells):
    def fit(method, grid):
        options = {"margin": grid.margin, "resolution": RESOLUTION, "length": LENGTH, "device": str(scene.device)}
        return wb.fit(grid, query="ray", method=method, **options)

    return {method: {name: fit(method, grid) for name, grid in cells.items()} for method in CLOSED}


@pytest.fixture(scope="module")
def examples(scene, bounders):
    return simulate(scene, bounders, steps=STEPS)


def denying(scene, bounders):
    """The bounders, that of the chair with its threshold raised above what a good part of its shadow has."""
    example = Example(scene, steps=STEPS)
    example.step()
    rays = shadow_rays(scene, example)[example.shadows[0][scene.seen.things >= 0][facing(scene, example)] & 2 != 0]
    values = bounders["chair"].values(rays).numpy()
    raised = bounders["chair"].to(str(scene.device))
    return bounders | {"chair": raised.freeze(float(np.nextafter(np.median(values), np.float32(np.inf))), None)}


def facing(scene, example, step=0):
    return (scene.seen.normals.numpy().astype(np.float64) @ example.suns[step].astype(np.float64)) > 0


def shadow_rays(scene, example, step=0):
    """The shadow rays of a picture, in NumPy, in the order of the pixels."""
    points, normals = scene.seen.points.numpy(), scene.seen.normals.numpy()
    chosen = facing(scene, example, step)
    origins = (points + normals * np.float32(LIFT)).astype(np.float32)[chosen]
    return np.concatenate([origins, np.broadcast_to(example.suns[step], origins.shape)], axis=1).astype(np.float32)


def test_there_are_shadows_of_both_objects_on_the_floor_and_on_each_other(scene, examples):
    shadow, things = examples["none"].shadows, scene.seen.things
    for bit in (1, 2):
        assert all(((s & bit != 0) & (things == 0)).sum() > 50 for s in shadow)
    assert any(((s & 2 != 0) & (things == 1)).any() for s in shadow)  # the chair's on the bunny
    assert all((s[things < 0] == 0).all() for s in shadow)
    assert shadow[0].tobytes() != shadow[1].tobytes()


@pytest.mark.parametrize("method", CLOSED)
def test_a_proven_bounder_changes_nothing_but_the_number_of_calls(examples, method):
    reference, example = examples["none"], examples[method]
    example.test_final(reference)
    assert example.missed(reference) == 0
    assert example.state() == reference.state()
    assert example.rays == reference.rays
    assert example.hits == reference.hits
    assert all(few < all_ / 2 for few, all_ in zip(example.calls, reference.calls, strict=True))


def test_a_tighter_bounder_calls_less(examples):
    assert sum(examples["bvh"].calls) < sum(examples["kdop"].calls) < sum(examples["aabb"].calls)


def test_distances_march_along_rays(scene, examples):
    """Bounders of the meshes themselves, which are of no kind of ray: no pixel is lost, and fewer rays are left."""
    reference = examples["none"]
    own = {
        name: wb.fit(shape, "distance", "bvh", leaves=64, margin=margin_of(shape), device=str(scene.device))
        for name, shape in scene.shapes.items()
    }
    example = Example(scene, own, steps=STEPS)
    for _ in range(STEPS):
        example.step()
    example.test_final(reference)
    assert example.hits == reference.hits
    assert sum(example.calls) < 0.5 * sum(reference.calls)


def test_no_stopped_ray_lies_outside_the_cells(scene, cells, examples):
    """The exact truth of the very rays that the narrow phase stops: each meets the dilated object."""
    from warp_bounding.queries import oracle

    reference = examples["none"]
    for step in range(STEPS):
        rays = shadow_rays(scene, reference, step)
        shadow = reference.shadows[step][scene.seen.things >= 0][facing(scene, reference, step)]
        for bit, grid in enumerate(cells.values()):
            stopped = rays[shadow & (1 << bit) != 0]
            assert len(stopped) > 100
            assert oracle("ray", grid, str(scene.device), LENGTH)(stopped).all()


@pytest.mark.parametrize("method", CLOSED)
def test_a_bounder_that_denies_a_part_of_the_object_is_found_out(scene, bounders, method):
    broken = {"broken": denying(scene, bounders[method])}
    runs = simulate(scene, broken, steps=STEPS)
    row = compare(runs, broken)[1]
    assert not kept([row])
    assert row.missed > 0
    assert not row.identical
    with pytest.raises(AssertionError, match="shadow pixels were lost"):
        runs["broken"].test_final(runs["none"])


def test_one_bit_of_a_picture_makes_it_another(scene, bounders, examples):
    """A pixel in both shadows that loses one of them stays dark: nothing is missed, and the pictures still differ."""
    reference, example = examples["none"], Example(scene, bounders["aabb"], steps=STEPS)
    for _ in range(STEPS):
        example.step()
    example.test_final(reference)
    row, column = np.argwhere(example.shadows[0] != 0)[0]
    example.shadows[0][row, column] ^= 4
    assert example.missed(reference) == 0
    assert not compare({"none": reference, "aabb": example}, {"aabb": bounders["aabb"]})[1].identical
    with pytest.raises(AssertionError, match="pictures differ"):
        example.test_final(reference)


def test_a_series_is_called_what_its_weakest_certificate_is(examples, bounders):
    def certified(kind):
        bounder = bounders["aabb"]["chair"].to("cpu")
        certificate = replace(bounder.certificate, kind=kind) if kind else None
        return {"aabb": bounders["aabb"] | {"chair": bounder.freeze(bounder.threshold, certificate)}}

    two = {name: examples[name] for name in ("none", "aabb")}
    assert [compare(two, certified(kind))[1].certificate for kind in ("proven", "statistical", "")] == [
        "proven",
        "statistical",
        "",
    ]
    told = verdict(compare(two, certified("statistical")), "shadow pixels")
    assert "proven" not in told
    assert "whose certificate is statistical, missed none of the shadow pixels" in told


def test_threads_do_not_change_the_pictures(scene, examples, monkeypatch):
    monkeypatch.setenv("WARP_BOUNDING_THREADS", "1")
    single = Example(scene, steps=STEPS)
    for _ in range(STEPS):
        single.step()
    assert single.state() == examples["none"].state()


def test_a_hit_counts_only_where_the_ray_passes_the_named_point(scene):
    """With no tolerance at all hardly a hit is confirmed; with that of the demo every one is."""
    example = Example(scene, steps=STEPS)
    rays = shadow_rays(scene, example)
    device = scene.device
    inputs = [wp.array(rays, dtype=float, device=device), REACH]
    everyone = wp.array(np.arange(len(rays)), dtype=wp.int32, device=device)
    count = wp.array([len(rays)], dtype=wp.int32, device=device)
    stopped = {}
    for tolerance in (0.0, 1e-5, TOLERANCE, 1e6):
        answers = wp.zeros(len(rays), dtype=wp.uint8, device=device)
        given = [0, scene.meshes["bunny"].id, *inputs, tolerance, everyone, count]
        wp.launch(stop, dim=len(rays), inputs=given, outputs=[answers], device=device)
        stopped[tolerance] = int(answers.numpy().sum())
    assert stopped[0.0] < stopped[1e-5] == stopped[TOLERANCE] == stopped[1e6]


def test_the_margin_covers_the_tolerance_and_its_rounding(scene):
    for name in scene.shapes:
        assert TOLERANCE < scene.margin(name) < TOLERANCE * 1.2


def test_rays_are_long_enough_to_leave_the_objects(scene):
    suns = scene.suns(np.linspace(0.0, 1.0, 101)).astype(np.float64)
    assert np.allclose(np.linalg.norm(suns, axis=1), 1.0, atol=1e-6)
    assert (suns[:, 1] > np.sin(LOWEST)).all()
    top = max(float(shape.bounds[1, 1]) for shape in scene.shapes.values())
    assert scene.floor + REACH * suns[:, 1].min() > top + TOLERANCE
    with pytest.raises(wb.BoundingError, match="expected objects that need no more"):
        Scene(scene.shapes, scene.floor - FARTHEST, scene.camera, scene.device)


def test_bounders_of_other_rays_are_refused(scene, bounders, cells):
    grid = cells["chair"]
    options = {"margin": grid.margin, "resolution": RESOLUTION, "method": "aabb"}
    short, point = wb.fit(grid, query="ray", length=1.0, **options), wb.fit(grid, **options)
    with pytest.raises(wb.BounderError, match="expected a bounder of rays of length 3, got length 1"):
        check_rays(short, "chair")
    with pytest.raises(wb.BounderError, match="expected a bounder of rays or distances, got one of points"):
        Example(scene, bounders["aabb"] | {"chair": point})
    with pytest.raises(wb.BounderError, match="expected a bounder for each of bunny, chair, got some for chair"):
        Example(scene, {"chair": short})


def test_the_camera_sees_the_meshes_where_they_are(scene):
    seen = scene.seen
    assert {int(t) for t in np.unique(seen.things)} == {-1, 0, 1, 2}
    points, things = seen.points.numpy(), seen.things.reshape(-1)[seen.pixels]
    assert (points[things == 0][:, 1] == np.float32(scene.floor)).all()
    for thing, shape in enumerate(scene.shapes.values(), 1):
        inside = (points[things == thing] >= shape.bounds[0] - 1e-5) & (
            points[things == thing] <= shape.bounds[1] + 1e-5
        )
        assert inside.all()
    eye = np.array(scene.camera.eye)
    assert np.allclose(np.linalg.norm(points - eye, axis=1), seen.depths.reshape(-1)[seen.pixels], atol=1e-4)
    assert (np.einsum("ij,ij->i", seen.normals.numpy(), points - eye) <= 0).all()


def test_a_picture(scene, bounders, examples, tmp_path):
    pytest.importorskip("matplotlib")
    from matplotlib.image import imread

    from sims.shadows.pictures import LOST, draw, shaded

    runs = simulate(scene, {"broken": denying(scene, bounders["kdop"])}, steps=1)
    reference, broken = runs["none"], runs["broken"]
    path = draw(tmp_path, reference, {"none": reference, "broken": broken})
    picture = imread(path)[..., :3]
    red = (picture[..., 0] > 0.8) & (picture[..., 1] < 0.3) & (picture[..., 2] < 0.35)
    half = picture.shape[1] // 2
    assert not red[50:, :half].any()
    assert red[50:, half:].sum() > 10
    assert [p.name for p in tmp_path.iterdir()] == ["shadows.png"]
    lit, dark = shaded(broken), shaded(reference)
    same = ~broken.lost(reference)
    assert (lit[same] == dark[same]).all()
    assert (lit[~same].sum(axis=-1) >= dark[~same].sum(axis=-1)).all()
    assert LOST[0] > 0.5


def test_the_whole_demo(tmp_path, monkeypatch, capsys):
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(shadows.demo, "SIZES", (SIZE, SIZE))
    network = {"length": LENGTH, "hidden": (8,), "steps": 60}
    specs = {name: replace(shadows.SPECS[name], resolution=RESOLUTION) for name in ("aabb", "kdop")}
    for name, options in (("learned-kdop", {"length": LENGTH, "k": 16, "steps": 20}), ("aabb+learned-kdop", {})):
        specs[name] = FitSpec(name, "ray", options=options, resolution=RESOLUTION)
    specs["occupancy"] = FitSpec("occupancy", "ray", options=network, resolution=RESOLUTION)
    result = shadows.run(tmp_path, quick=True, refit=True, specs=specs)
    assert result["identical"]
    assert result["demo"] == "shadows"
    assert result["steps"] == 2
    runs = {row["bounder"]: row for row in result["runs"]}
    assert list(runs) == ["none", *(name for name in specs if name != "occupancy"), "chosen", "occupancy"]
    assert set(result["chosen"][""]) == set(result["bounders"])
    assert all(runs[name]["certificate"] == "proven" for name in specs if name != "occupancy")
    assert runs["occupancy"]["certificate"] == ""
    assert runs["none"]["narrow_calls"] == 2 * result["rays"]
    for row in (row for rows in result["bounders"].values() for row in rows if row["bounder"] != "occupancy"):
        assert row["fn"] == 0
        assert row["fp_rate_cells"] < row["fp_rate"]  # cells are larger than the mesh
    told = " ".join(capsys.readouterr().out.split())
    assert "The 4 runs with proven bounders missed none of the shadow pixels" in told
    assert "occupancy, which has no proof" in told
    assert [p.name for p in tmp_path.glob("*.png")] == ["shadows.png"]
    files = {p.name for p in tmp_path.glob("*.safetensors")}
    assert stored("shadows-chair", "occupancy").name in files
    again = shadows.run(
        tmp_path,
        quick=True,
        specs={"aabb": specs["aabb"]},
        steps=1,
    )
    assert again["identical"]
    dilated = {name: shape.dilated(margin_of(shape)) for name, shape in Scene.still_life(8, 8, "cpu").shapes.items()}
    for name in dilated:
        assert owner(stored(f"shadows-{name}", "occupancy", tmp_path), dilated, specs["occupancy"]) == name
    with pytest.raises(wb.BounderError, match="no such file"):
        shadows.run(tmp_path, quick=True, bounder_file=tmp_path / "none.safetensors", specs=specs)
    with pytest.raises(wb.BoundingError, match="steps must be at least 1"):
        shadows.run(tmp_path, steps=0)
