"""A folder of bounders as a mapping, and many of them asked together."""

import numpy as np
import pytest
import warp as wp
from bounding_shapes import fitted, shape

import warp_bounding as wb
from warp_bounding.errors import FileFormatError, QueryError

NAMES = ("blob", "half", "single", "star")


@pytest.fixture
def library(tmp_path):
    for number, name in enumerate(NAMES):
        wb.fit(shape(name), method="kdop" if number else "aabb", device="cpu").save(tmp_path / f"{name}.safetensors")
    return wb.baking.BounderLibrary(tmp_path, device="cpu")


def test_nothing_is_loaded_before_it_is_asked(tmp_path):
    (tmp_path / "bad.safetensors").write_bytes(b"bad")
    library = wb.baking.BounderLibrary(tmp_path)
    assert "bad" in library
    with pytest.raises(FileFormatError, match=r"bad\.safetensors"):
        library["bad"]
    with pytest.raises(FileFormatError, match="no such folder"):
        wb.baking.BounderLibrary(tmp_path / "none")


def test_pairs_are_asked_as_one_by_one(library, rng):
    x = rng.random((3000, 3), dtype=np.float32) * 1.4 - 0.2
    x[0] = np.nan
    queried = rng.integers(0, len(library), len(x))
    expected = np.stack([bounder.query(x).numpy() for bounder in library.values()])[queried, np.arange(len(x))]
    assert 0 < expected.mean() < 1
    assert (library.stack().query(queried, x).numpy() == expected).all()
    stack = library.stack()
    assert len(stack.groups) == 2
    assert {len(group.members) for group in stack.groups} == {1, 3}
    numbers = wp.array(queried, dtype=wp.int32, device="cpu")
    assert (stack.query(numbers, wp.array(x, dtype=wp.vec3, device="cpu")).numpy() == expected).all()
    assert stack.query(np.empty(0, int), np.empty((0, 3), np.float32)).shape == (0,)


def test_regions_are_asked_together(rng):
    bounders = [wb.fit(shape(name), "box", "kdop", device="cpu") for name in ("blob", "star")]
    stack = wb.baking.BounderStack(bounders)
    lower = rng.random((500, 3), dtype=np.float32)
    x, queried = np.hstack([lower, lower + 0.05]), rng.integers(0, 2, 500)
    expected = np.stack([bounder.query(x).numpy() for bounder in bounders])[queried, np.arange(500)]
    assert (stack.query(queried, x).numpy() == expected).all()


def test_a_group_is_asked_in_a_kernel_of_ones_own(library, rng):
    group = max(library.stack().groups, key=lambda group: len(group.members))

    @wp.kernel(enable_backward=False)
    def ask(
        data: wp.array(dtype=wb.Data),
        slots: wp.array(dtype=wp.int32),
        numbers: wp.array(dtype=wp.int32),
        q: wp.array(dtype=wp.vec3),
        out: wp.array(dtype=wp.bool),
    ):
        i = wp.tid()
        if wp.static(group.func)(data[slots[numbers[i]]], q[i]):
            out[i] = True

    x = rng.random((1000, 3), dtype=np.float32)
    numbers = rng.choice(group.members, len(x)).astype(np.int32)
    out = wp.zeros(len(x), dtype=wp.bool, device="cpu")
    q = wp.array(x, dtype=wp.vec3, device="cpu")
    inputs = [group.data, group.slots, wp.array(numbers, dtype=wp.int32, device="cpu"), q]
    wp.launch(ask, len(x), inputs, [out], device="cpu")
    assert (out.numpy() == library.stack().query(numbers, x).numpy()).all()


def test_numbers_of_no_bounder_are_maybe_or_refused(library):
    far = np.full((3, 3), 1e3, np.float32)
    numbers = wp.array([0, -1, 99], dtype=wp.int32, device="cpu")
    assert library.stack().query(numbers, far).numpy().tolist() == [0, 1, 1]
    assert library.stack().query([0, -1, 99], far).numpy().tolist() == [0, 1, 1]
    with pytest.raises(QueryError, match="one for each query"):
        library.stack().query([0], far)
    with pytest.raises(QueryError, match="whole numbers"):
        library.stack().query([0.0, 0.0, 0.0], far)


def test_what_is_no_stack_is_refused():
    with pytest.raises(QueryError, match="at least one bounder"):
        wb.baking.BounderStack([])
    with pytest.raises(QueryError, match="of one kind, dimension and device"):
        wb.baking.BounderStack([fitted("aabb", "blob"), fitted("aabb", "c")])
    with pytest.raises(QueryError, match="a distance"):
        wb.baking.BounderStack([wb.fit(shape("star"), "distance", "aabb", device="cpu")])
