"""Budgets by column and method, and what a plan says about its time."""

import pytest
from fake_library import data_folder

from paper.columns import COLUMNS, VARIANTS, Column, Variant, select_columns
from paper.plan import Selection, TimeLeft, duration, plan, shares
from paper.settings import PRESETS, Settings, parse_budget
from paper.shapes import find_shapes
from warp_bounding import bounders
from warp_bounding.errors import BoundingError

RAY, BOX = Column(3, "ray"), Column(2, "box")


def test_the_last_word_counts():
    general, budgets = parse_budget("20, 3D=40,ray=50 ,3d-ray=90.5,occupancy=5")
    assert (general, budgets) == (20.0, "3d=40,ray=50,3d-ray=90.5,occupancy=5")
    settings = Settings(general, budgets)
    seconds = {v: settings.budget_of(RAY, Variant(v)) for v in ("mlp", "occupancy")}
    assert seconds == {"mlp": 90.5, "occupancy": 5.0}
    assert settings.budget_of(BOX, Variant("mlp")) == 20.0
    assert settings.budget_of(Column(3, "box"), Variant("mlp")) == 40.0
    assert settings.budget_of(Column(4, "ray"), Variant("mlp")) == 50.0
    assert parse_budget("3d=1") == (None, "3d=1")
    assert parse_budget("60") == (60.0, "")


@pytest.mark.parametrize(
    "text", ["", "a", "0", "nan", "-1", "3,4", "5d=3", "aabb=3", "3d=", "=4", "3d=0", "3d=x", "3,,"]
)
def test_budgets_that_make_no_sense(text):
    with pytest.raises(BoundingError, match="budget must"):
        parse_budget(text)


def test_presets_are_budgets():
    for preset in PRESETS.values():
        general, budgets = parse_budget(preset.budget)
        settings = Settings.of({"budget": general, "budgets": budgets, "samples": preset.samples})
        assert parse_budget(settings.budget_text) == (general, budgets)
        assert all(settings.budget_of(c, v) > 0 for c in COLUMNS for v in VARIANTS)


def test_settings_of_before_there_were_budgets():
    old = Settings.of({"budget": 20.0}).to_dict()
    del old["budgets"]
    assert Settings.from_dict(old) == Settings.of({"budget": 20.0})


def test_what_a_plan_takes(tmp_path, fake_supports):
    shapes = find_shapes(data_folder(tmp_path / "data"), (2, 3))
    settings = Settings.of({"budget": 10.0, "budgets": "3d=30,occupancy=2"})
    variants = [Variant("aabb"), Variant("mlp"), Variant("learned-kdop"), Variant("occupancy")]
    jobs, _ = plan(Selection(select_columns(["2d-point", "3d-ray"]), variants, shapes, ("exact",)))
    point, ray = shares(jobs, settings)
    assert (point.column.name, ray.column.name) == ("2d-point", "3d-ray")
    assert point.fits == {10.0: 6, 2.0: 3}
    assert ray.fits == {30.0: 2, 11.0: 2, 2.0: 2}  # a learned k-DOP ends by itself
    assert (ray.classic, ray.cells) == (2, 8)
    assert "2 x 30 s + 2 x 11 s + 2 x 2 s; 2 closed forms, 8 measurements: about" in ray.text
    assert ray.seconds > 86
    left = TimeLeft(jobs, settings)
    assert left.seconds() == pytest.approx(point.seconds + ray.seconds)
    networks = [j for j in jobs if (j.variant.method, j.column) == ("mlp", RAY)]
    left.finish(networks[0], 50.0, 1.0)
    assert (left.fit(networks[1]), left.measure(networks[1])) == (50.0, 1.0)
    fitted = {j.name for j in jobs}
    assert shares(jobs, settings, fitted)[1].fits == {}
    assert TimeLeft(jobs, settings, fitted).seconds() < 15


@pytest.mark.parametrize(
    ("seconds", "text"), [(5, "under a minute"), (130, "about 2 min"), (10_000, "about 2 h 47 min")]
)
def test_durations(seconds, text):
    assert duration(seconds) == text


def test_a_network_of_local_thresholds_takes_the_time_of_one_that_has_one():
    local, ray = Variant("mlp-local"), Column(3, "ray")
    settings = Settings(10.0, "3d-ray:mlp=240,3d:distance=90")
    assert settings.budget_of(ray, local) == settings.budget_of(ray, Variant("mlp")) == 240
    assert settings.budget_of(ray, Variant("distance")) == 90  # which is fitted by method="mlp", too
    assert Settings(10.0, "mlp-local=3").budget_of(ray, Variant("mlp")) == 10
    assert (local.fitted.method, local.fitted.options) == ("mlp", {"thresholds": 256})
    assert not local.of_distances
    assert local.space_in(ray) == Variant("mlp").space_in(ray)
    assert local.space_in(Column(3, "plane")) is None


def test_a_cascade_takes_the_time_of_its_last_part_unless_it_is_named():
    box, words = Column(3, "box"), "3d=20,learned-kdop=5,3d-box:mlp=90"
    settings = Settings(10.0, words)
    cascade = Variant("learned-kdop+mlp")
    assert settings.budget_of(box, cascade) == 90
    assert settings.budget_of(Column(3, "ray"), cascade) == 20
    assert Settings(10.0, words + ",3d:learned-kdop+mlp=7").budget_of(box, cascade) == 7
    assert settings.budget_of(box, Variant("learned-kdop")) == 5
    assert cascade.space_in(box) == "geometric"
    assert bounders.supports("kdop+mlp", "ray", 3)
    assert not bounders.supports("voxels+mlp", "ray", 3)
    assert not bounders.supports("kdop+magic", "ray", 3)


def test_a_cascade_takes_its_last_part_from_that_ones_own_row(tmp_path, fake_supports):
    shapes = find_shapes(data_folder(tmp_path / "data"), (2, 3))
    settings = Settings.of({"budget": 40.0, "budgets": "learned-kdop=5"})

    def seconds(methods, fitted=()):
        jobs, _ = plan(Selection([RAY], [Variant(m) for m in methods], shapes, ("exact",)))
        left = TimeLeft(jobs, settings, fitted)
        return left.fit(next(j for j in jobs if j.variant.method == "learned-kdop+mlp")), jobs

    alone, _ = seconds(["learned-kdop+mlp"])
    shared, jobs = seconds(["mlp", "learned-kdop+mlp"])
    assert (alone, shared) == (40.0, 5.0)
    assert seconds(["learned-kdop+mlp"], {j.file for j in jobs if j.variant.method == "mlp"})[0] == 5.0
