"""Maps: every cell of a picture at its place in metres, what is free as all versions of ROS have it, and what is refused."""

import numpy as np
import pytest
from PIL import Image

import warp_bounding as wb
from warp_bounding.indicators import load_indicator

YAML = "image: {image}\nresolution: {resolution}\norigin: {origin}\nnegate: {negate}\noccupied_thresh: 0.65\nfree_thresh: 0.196\n{more}"
GREY = np.array([[0, 50, 90], [128, 204, 205], [206, 254, 255], [0, 255, 254]], np.uint8)


def pgm(values: np.ndarray, kind: str = "P5", white: int = 255, comment: str = "") -> bytes:
    head = f"{kind}\n{comment}{values.shape[1]} {values.shape[0]}\n{white}\n".encode()
    data = values.astype(np.uint8 if white < 256 else ">u2").tobytes()
    return head + (data if kind == "P5" else (" ".join(map(str, values.ravel())) + "\n").encode())


def ros(
    folder,
    values=GREY,
    *,
    image="m.pgm",
    resolution=0.05,
    origin="[-2.03, -3.11, 0.0]",
    negate=0,
    more="",
    unknown=None,
):
    if isinstance(values, np.ndarray):
        (folder / image).write_bytes(pgm(values))
    elif values is not None:
        values.save(folder / image)
    (folder / "m.yaml").write_text(
        YAML.format(image=image, resolution=resolution, origin=origin, negate=negate, more=more)
    )
    return load_indicator(folder / "m.yaml", unknown=unknown)


def state(values: np.ndarray, negate: int = 0) -> np.ndarray:
    """1 occupied, 0 free, -1 unknown; as map_server has it for a picture without alpha."""
    occ = (values if negate else 255.0 - values) / 255.0
    return np.where(occ > 0.65, 1, np.where(occ < 0.196, 0, -1))


def corners(shape: tuple[int, int], resolution: float, origin: tuple[float, float]):
    """Rows, columns, and lower corners in the world, of a picture's cells."""
    row, column = np.indices(shape).reshape(2, -1)
    return row, column, np.stack([column, shape[0] - 1 - row], axis=1) * resolution + np.array(origin)


@pytest.mark.parametrize("negate", [0, 1])
@pytest.mark.parametrize(("unknown", "left"), [(None, True), ("occupied", True), ("free", False)])
def test_cells_of_a_ros_map_are_where_they_are_and_what_they_are(tmp_path, negate, unknown, left):
    shape = ros(tmp_path, negate=negate, unknown=unknown)
    row, column, corner = corners(GREY.shape, 0.05, (-2.03, -3.11))
    full = {1: True, 0: False, -1: left}
    wanted = np.array([full[int(s)] for s in state(GREY, negate)[row, column]])
    np.testing.assert_array_equal(shape.contains(corner + 0.025), wanted)
    assert "unknown cells count as" in shape.remark


@pytest.mark.parametrize(
    ("origin", "resolution"),
    [
        ((-2.03, -3.11), 0.05),
        ((-10.0, -10.0), 0.05),
        ((1e-9, -1e-9), 0.03),
        ((500000.13, 4649776.37), 0.1),
        ((-7e8, 3.3), 0.15),
    ],
)
def test_no_wall_of_a_map_is_denied_wherever_it_lies(tmp_path, origin, resolution):
    values = np.full((30, 50), 254, np.uint8)
    values[4:9, 10:31] = values[20:, 40:] = 0
    shape = ros(tmp_path, values, origin=f"[{origin[0]!r}, {origin[1]!r}, 0]", resolution=resolution)
    bounder = wb.fit(shape, method="aabb", device="cpu")
    assert bounder.certificate.proven
    row, column, corner = corners(values.shape, resolution, origin)
    walls = corner[values[row, column] == 0]
    steps = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0.5, 0.5]]) * resolution
    x = (walls[:, None] + steps).reshape(-1, 2)  # corners and centres, as float64 has them
    assert bounder.query(x).numpy().all()
    near = np.abs(x).max() * 2.0**-24 < resolution / 8  # of what float32 holds, the same, but for its own rounding
    middles = (walls + resolution / 2).astype(np.float32)
    assert not near or bounder.query(middles).numpy().all()
    assert not bounder.query(np.array(origin)[None] - resolution).numpy().any()
    assert wb.certify(bounder, shape).proven


@pytest.mark.parametrize("query", ["ray", "plane", "box"])
def test_regions_of_a_map_at_any_origin(tmp_path, query):
    values = np.full((12, 16), 254, np.uint8)
    values[3:6, 5:9] = 0
    shape = ros(tmp_path, values, origin="[500000.13, 4649776.37, 0]")
    bounder = wb.fit(shape, query, "kdop", device="cpu")
    middle = shape.origin + 0.05 * np.array([7.0, 12 - 4.5])
    x = {"ray": [middle - [0.3, 0], [1, 0]], "plane": [[1, 0], middle], "box": [middle, middle]}[query]
    assert bounder.query(np.concatenate(x)[None]).numpy()[0] == 1
    away = {"ray": [middle + 9, [1, 0]], "plane": [[1, 0], middle + 9], "box": [middle + 9, middle + 10]}[query]
    assert bounder.query(np.concatenate(away)[None]).numpy()[0] == 0
    assert wb.certify(bounder, shape).proven


def test_modes_and_alpha(tmp_path):
    scale = ros(tmp_path, more="mode: scale\n", unknown="free")
    _, _, corner = corners(GREY.shape, 0.05, (-2.03, -3.11))
    np.testing.assert_array_equal(scale.contains(corner + 0.025), state(GREY).ravel() != 0)  # a value is not free
    with pytest.raises(wb.BoundingError, match="threshold is for maps of mode raw"):
        ros(tmp_path, more="mode: raw\n")
    values = np.array([[0, 64], [65, 100], [101, 255]], np.uint8)
    (tmp_path / "m.pgm").write_bytes(pgm(values))
    raw = load_indicator(tmp_path / "m.yaml", threshold=">=65")
    row, column, corner = corners(values.shape, 0.05, (-2.03, -3.11))
    np.testing.assert_array_equal(raw.contains(corner + 0.025), values[row, column] >= 65)
    rgba = np.zeros((1, 4, 4), np.uint8)
    rgba[0] = [[0, 0, 0, 255], [255, 255, 255, 255], [255, 255, 255, 128], [230, 230, 230, 255]]
    shape = ros(
        tmp_path, Image.fromarray(rgba), image="m.png"
    )  # trinary: means with alpha 64, 255, 223 but not opaque, 236
    _, _, corner = corners((1, 4), 0.05, (-2.03, -3.11))
    assert shape.contains(corner + 0.025).tolist() == [True, False, True, False]


def test_yaml_as_people_write_it(tmp_path):
    (tmp_path / "m.pgm").write_bytes(pgm(GREY))
    text = (
        '---\n# saved\nimage: "m.pgm"   # here\nresolution: 5.0e-2\norigin:\n  - -2.03\n  - -3.11\n  - 0.\nnegate: false\n'
        "occupied_thresh: .65\nfree_thresh: 0.196\nmode: trinary\nauthor: me\n"
    )
    (tmp_path / "other.yaml").write_text(text)
    shape = load_indicator(tmp_path / "other.yaml")
    assert shape.digest == ros(tmp_path).digest
    assert "not read: author" in shape.remark


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"origin": "[0, 0, 0.3]"}, "turned"),
        ({"origin": "[0, 0]"}, "origin: "),
        ({"origin": "[0, nan, 0]"}, "a number for origin"),
        ({"resolution": 0}, "resolution > 0"),
        ({"negate": "perhaps"}, "negate: 0 or 1"),
        ({"more": "mode: fancy\n"}, "expected mode"),
        ({"more": "free_thresh: 0.1\n"}, "line 7"),
        ({"more": "mode: raw\nnested: {a: 1}\n"}, "line 8"),
        ({"image": "gone.pgm", "values": None}, "no such file"),
    ],
)
def test_maps_that_are_refused(tmp_path, options, words):
    with pytest.raises(wb.BoundingError, match=words) as caught:
        ros(tmp_path, **options)
    assert "\n" not in str(caught.value)


def test_a_map_has_its_own_place(tmp_path):
    ros(tmp_path)
    for options in ({"spacing": 1.0}, {"origin": (0, 0)}, {"threshold": "<128"}, {"unknown": "maybe"}):
        with pytest.raises(wb.BoundingError):
            load_indicator(tmp_path / "m.yaml", **options)


@pytest.mark.parametrize("white", [255, 100, 65535])
@pytest.mark.parametrize("kind", ["P2", "P5"])
def test_pgm(tmp_path, kind, white):
    values = np.arange(20).reshape(4, 5) * white // 19
    (tmp_path / "a.pgm").write_bytes(pgm(values, kind, white, "# made here\n# and there\n"))
    half = white // 2
    grid = load_indicator(tmp_path / "a.pgm", threshold=f"<{half}")
    np.testing.assert_array_equal(grid.occupancy, values < half)
    whole = (tmp_path / "a.pgm").read_bytes()
    for content in (whole[:-1], whole + b" 7 ", whole[:9], b"P6" + whole[2:]):
        (tmp_path / "a.pgm").write_bytes(content)
        with pytest.raises(wb.BoundingError) as caught:
            load_indicator(tmp_path / "a.pgm", threshold="<1")
        assert "\n" not in str(caught.value)


def test_a_pgm_needs_a_threshold(tmp_path):
    (tmp_path / "a.pgm").write_bytes(pgm(np.eye(4, dtype=np.uint8), white=1))  # 0 and 1, and white is free as a rule
    with pytest.raises(wb.BoundingError, match="threshold"):
        load_indicator(tmp_path / "a.pgm")
    (tmp_path / "a.pgm").write_bytes(pgm(np.full((2, 2), 9), white=8))
    with pytest.raises(wb.BoundingError, match="up to 8"):
        load_indicator(tmp_path / "a.pgm", threshold="<1")


def test_movingai(tmp_path):
    path = tmp_path / "a.map"
    path.write_text("type octile\nheight 2\nwidth 4\nmap\n.@WT\nSG.O\n")
    grid = load_indicator(path)
    x = np.array([[0, 1], [1, 1], [2, 1], [3, 1], [0, 0], [1, 0], [2, 0], [3, 0]], float)  # y up
    assert grid.contains(x).tolist() == [False, True, True, True, False, False, False, True]
    assert load_indicator(path, spacing=0.5, origin=(10.1, 3.3)).contains([[10.6, 3.8]]).tolist() == [True]
    for text in (
        "type octile\nheight 3\nwidth 4\nmap\n.@WT\nSG.O\n",
        "type octile\nheight 2\nwidth 4\nmap\n.@WT\nSG.\n",
        "type octile\nheight 2\nwidth 4\nmap\n.@WT\nSG.O\n....\n",
        "type octile\nheight 2\nwidth 4\nmap\n.@WT\nSGxO\n",
        "type hex\nheight 2\nwidth 4\nmap\n.@WT\nSG.O\n",
        "height 2\nwidth 4\nmap\n.@WT\nSG.O\n",
    ):
        path.write_text(text)
        with pytest.raises(wb.BoundingError) as caught:
            load_indicator(path)
        assert "\n" not in str(caught.value)


def test_an_occupancy_grid_is_never_taken_for_truth_values():
    cells = np.array([[-1, 0, 100], [64, 65, 0]], np.int8)
    for make in (load_indicator, wb.IndicatorGrid):
        with pytest.raises(wb.BoundingError, match="65"):
            make(cells)
    assert load_indicator(cells, threshold=">=65").occupancy.tolist() == [[True, False, True], [False, True, False]]
    free = load_indicator(cells, threshold=">=65", unknown="free")
    assert free.occupancy.tolist() == [[False, False, True], [False, True, False]]
    assert "1 unknown" in free.remark
    with pytest.raises(wb.BoundingError, match="unknown is for maps"):
        load_indicator(np.eye(4), unknown="free")


def test_pictures_as_objects():
    picture = Image.fromarray(GREY)
    np.testing.assert_array_equal(load_indicator(picture, threshold="<128").occupancy, GREY < 128)
    with pytest.raises(wb.BoundingError, match="threshold"):
        load_indicator(picture)
    alpha = Image.fromarray(np.stack([GREY] * 3 + [GREY], axis=2))
    np.testing.assert_array_equal(load_indicator(alpha).occupancy, GREY >= 128)


@pytest.mark.parametrize(
    ("kind", "value"), [(np.float32, 0.1), (np.int64, 2**53), (np.uint64, 2**62), (np.float16, 0.1)]
)
def test_thresholds_compare_exactly(kind, value):
    array = np.array([value, 0], kind)
    exact = int(array[0]) if array.dtype.kind in "iu" else float(array[0])
    bound = float(value)
    for sign, holds in (("<", exact < bound), ("<=", exact <= bound), (">", exact > bound), (">=", exact >= bound)):
        occupied = load_indicator(
            np.array([array[0]] * 2 + [0 if holds == (sign[0] == ">") else 2 * array[0] + 1], kind),
            threshold=f"{sign}{value!r}",
        ).occupancy
        assert bool(occupied[0]) == holds
