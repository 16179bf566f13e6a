"""What an array's values mean, and where its cells lie: told, or asked for."""

import numpy as np
import pytest
from PIL import Image

import warp_bounding as wb
from warp_bounding.errors import IndicatorError
from warp_bounding.indicators import load_indicator

MAP = np.array([[0, 254, 205], [127, 128, 255]], dtype=np.uint8)  # a map of a robot: dark is a wall, white is free
DISTANCE = np.linalg.norm(np.mgrid[-1:1:8j, -1:1:8j], axis=0) - 0.5


def refused(array, *words, **options):
    with pytest.raises(IndicatorError) as caught:
        load_indicator(array, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 400
    for word in words:
        assert word in message, message


@pytest.mark.parametrize(
    "array",
    [MAP < 128, (MAP < 128).astype(np.uint8), (MAP < 128).astype(np.int64), (MAP < 128).astype(np.float32)[:, :2]],
)
def test_truth_values_and_0_and_1_are_clear(array):
    assert np.array_equal(load_indicator(array).occupancy, array.astype(bool))


AMBIGUOUS = {
    "a map, white is free": (
        MAP,
        "uint8 from 0 to 255",
        "load_indicator(a < 128)",
        "load_indicator(a >= 128)",
        "'<128'",
    ),
    "0 and 255": (np.where(MAP < 128, 255, 0).astype(np.uint8), "load_indicator(a < 128)", "load_indicator(a >= 128)"),
    "labels": (MAP % 3, "uint8 from 0 to 2"),
    "signed distances": (DISTANCE, "load_indicator(a <= 0)", "signed distances", "load_indicator(a > 0)"),
    "unsigned distances": (np.abs(DISTANCE), "load_indicator(a < 0.5)", "load_indicator(a >= 0.5)"),
    "a picture": (np.stack([MAP] * 3, axis=2), "load_indicator(a < 128)", "rgb.mean(axis=2)"),
    "vertices": (np.random.default_rng(0).random((50, 3)), "load_indicator((vertices, faces))", "shape (50, 3)"),
    "the vertices of a cube": (
        np.array(list(np.ndindex(2, 2, 2)), dtype=np.float32),
        "(vertices, faces)",
        "shape (8, 3)",
    ),
    "infinite": (np.array([0, np.inf]), "from 0 to inf"),
}


@pytest.mark.parametrize("case", AMBIGUOUS)
def test_what_may_mean_two_things_is_refused_with_the_lines_that_do_not(tmp_path, case):
    array, *words = AMBIGUOUS[case]
    refused(array, *words)
    np.save(tmp_path / "a.npy", array)
    refused(tmp_path / "a.npy", "a.npy", *words)
    with pytest.raises(IndicatorError):
        wb.fit(array, method="aabb")


@pytest.mark.parametrize(
    ("threshold", "expected"),
    [
        ("<128", MAP < 128),
        (" <= 127 ", MAP < 128),
        (">=128", MAP >= 128),
        ("> 127", MAP >= 128),
        ("128", MAP >= 128),
        (128, MAP >= 128),
        (127.5, MAP >= 128),
        (np.float32(128), MAP >= 128),
    ],
)
def test_a_threshold_says_which_values_are_occupied(tmp_path, threshold, expected):
    np.save(tmp_path / "a.npy", MAP)
    Image.fromarray(MAP).save(tmp_path / "a.png")
    Image.fromarray(MAP.astype(np.uint16)).save(tmp_path / "deep.png")
    Image.fromarray(np.stack([MAP] * 3, axis=2)).save(tmp_path / "rgb.png")
    Image.fromarray(np.stack([MAP] * 3 + [np.full_like(MAP, 255)], axis=2)).save(tmp_path / "opaque.png")
    for source in (
        MAP,
        MAP.astype(np.float32),
        *(tmp_path / f"{n}" for n in ("a.npy", "a.png", "deep.png", "rgb.png", "opaque.png")),
    ):
        assert np.array_equal(load_indicator(source, threshold=threshold).occupancy, expected), source


def test_signed_distances():
    assert np.array_equal(load_indicator(DISTANCE, threshold="<=0").occupancy, DISTANCE <= 0)
    assert np.array_equal(load_indicator(-DISTANCE, threshold=">=0").occupancy, DISTANCE <= 0)


@pytest.mark.parametrize("threshold", ["", "dark", "<", "<x", "==3", "<<3", True, np.nan, "<nan", "<inf", [3], b"<3"])
def test_a_threshold_that_is_none(threshold):
    refused(MAP, "threshold must be a number or a text such as '<128'", threshold=threshold)


@pytest.mark.filterwarnings("error")
def test_a_threshold_beyond_the_type_of_the_array():
    half = np.array([[-2.0, 2.0], [np.inf, 1.0]], np.float16)
    assert load_indicator(half, threshold=1e6).occupancy.tolist() == [[False, False], [True, False]]


def test_a_threshold_of_what_has_no_numbers(tmp_path):
    refused(MAP < 128, "a threshold needs numbers, got truth values", threshold=128)
    half = np.dstack([np.stack([MAP] * 3, axis=2), MAP])
    Image.fromarray(half).save(tmp_path / "half.png")
    refused(tmp_path / "half.png", "half.png: expected opaque pixels", "got 5", threshold=128)


def test_by_default_the_first_and_the_last_centre_lie_on_0_and_1():
    grid = load_indicator(np.arange(160 * 100).reshape(100, 160) % 7 == 0)
    assert (grid.sample_lower.tolist(), grid.sample_upper.tolist()) == ([0, 0], [1, 1])


@pytest.mark.parametrize(
    ("spacing", "origin", "first", "last"),
    [
        (0.05, None, [0, 0], [99 * 0.05, 159 * 0.05]),
        (0.05, (-12.2, 3.0), [-12.2, 3.0], [-12.2 + 99 * 0.05, 3 + 159 * 0.05]),
        ((0.5, 0.25), (0.25, -0.125), [0.25, -0.125], [0.25 + 49.5, -0.125 + 159 * 0.25]),
        (0.3, None, [0, 0], [99 * 0.3, 159 * 0.3]),
        (np.float32(2), np.array([1, 1]), [1, 1], [199, 319]),
        (None, (1 / 99, -1.0), [1 / 99, -1], [100 / 99, 0]),
    ],
)
def test_spacing_and_origin_place_the_centres_of_cells(tmp_path, spacing, origin, first, last):
    array = np.zeros((100, 160), dtype=np.uint8)
    array[3, 7] = 200
    Image.fromarray(array).save(tmp_path / "map.png")
    options = {"spacing": spacing, "origin": origin}
    grid = load_indicator(tmp_path / "map.png", threshold=128, **options)
    assert grid.digest == load_indicator(array > 0, **options).digest
    np.testing.assert_allclose(grid.sample_lower, first, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(grid.sample_upper, last, rtol=1e-6)
    size = (np.array(last) - first) / (99, 159)
    centre = np.array(first) + size * (3, 7)
    inside = centre + size * np.array([[0, 0], [0.49, 0.49], [-0.49, 0.49], [0.49, -0.49]])
    assert grid.contains(inside).all()
    assert not grid.contains(centre + size * np.array([[0.51, 0], [0, -0.51]])).any()


def test_a_map_in_metres_is_fitted_in_metres():
    array = np.zeros((20, 32), dtype=bool)
    array[4:7, 8:12] = True
    bounder = wb.fit(load_indicator(array, spacing=0.05, origin=(-0.5, 1.0)), method="aabb")
    assert bounder.certificate.proven
    x = np.array([[-0.5 + 5 * 0.05, 1 + 9 * 0.05], [-0.5 + 10 * 0.05, 1 + 9 * 0.05]], dtype=np.float32)
    assert bounder.query(x).numpy().tolist() == [1, 0]


BAD_PLACEMENTS = [
    ({"spacing": 0}, "spacing must be positive"),
    ({"spacing": -1.0}, "spacing must be positive"),
    ({"spacing": (1, 2, 3)}, "spacing must be 2 numbers or one for all"),
    ({"spacing": np.nan}, "spacing must be 2 numbers"),
    ({"spacing": "wide"}, "spacing must be 2 numbers"),
    ({"spacing": 1e-60}, "cells_per_unit must be positive float32"),
    ({"origin": 1.0}, "origin must be 2 numbers, one for each axis"),
    ({"origin": (0, np.inf)}, "origin must be 2 numbers"),
]


@pytest.mark.parametrize(("options", "words"), BAD_PLACEMENTS)
def test_bad_placement(options, words):
    refused(MAP < 128, words, **options)


def test_the_spacing_of_an_animation_names_every_axis():
    array = np.arange(2 * 3 * 4 * 5).reshape(2, 3, 4, 5) % 3 == 0
    refused(array, "spacing must be 4 numbers", spacing=0.1)
    grid = load_indicator(array, spacing=(0.5, 0.1, 0.1, 0.1))
    np.testing.assert_allclose(grid.sample_upper, [0.5, 0.2, 0.3, 0.4], rtol=1e-6)


@pytest.mark.parametrize("options", [{"threshold": 1}, {"spacing": 0.1}, {"origin": (0, 0, 0)}])
def test_what_is_placed_already_takes_no_options(options):
    mesh = (np.eye(3), np.array([[0, 1, 2]]))
    refused(mesh, f"{next(iter(options))} is for arrays and images", "IndicatorMesh", **options)
    refused(load_indicator(MAP < 128), "is for arrays and images", "IndicatorGrid", **options)
