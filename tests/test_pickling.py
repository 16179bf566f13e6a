"""Bounders and shapes come back from pickles and ``copy.deepcopy`` as they were, and read-only where they were."""

import copy
import pickle
from functools import cache

import numpy as np
import pytest
from bounding_shapes import fitted
from distances import far, thing
from shape_kinds import KINDS

import warp_bounding as wb
from warp_bounding.bounders import METHODS
from warp_bounding.errors import ShapeError
from warp_bounding.shapes.shape import Shape

COPIES = {"pickle": lambda value: pickle.loads(pickle.dumps(value)), "deepcopy": copy.deepcopy}


@pytest.fixture(params=COPIES)
def copied(request):
    return COPIES[request.param]


def check_read_only(made, original) -> None:
    """What the original keeps read-only stays so in a copy: else a proof would say nothing of it."""
    for name, value in vars(original).items():
        if isinstance(value, np.ndarray) and not value.flags.writeable and name in vars(made):
            assert not vars(made)[name].flags.writeable


def check_bounder(copied, bounder, ask) -> None:
    """Copies of a bounder, as it is and after use, answer as it does, and a new threshold of one is not the other's."""
    for used in (False, True):
        if used:
            if not bounder.of_distances:
                bounder.prepare(np.zeros((4, bounder.domain.columns), np.float32)).launch()
            _ = bounder.data, bounder.distance_func if bounder.of_distances else bounder.func
        made = copied(bounder)
        check_read_only(made, bounder)
        assert all(not tensor.flags.writeable for tensor in made.tensors.values())
        assert type(made) is type(bounder)
        assert (made.threshold, made.certificate) == (bounder.threshold, bounder.certificate)
        assert (made.info, str(made.device)) == (bounder.info, str(bounder.device))
        assert made.domain.to_dict() == bounder.domain.to_dict()
        assert ask(made).tobytes() == ask(bounder).tobytes()
        assert made.data.parameters.ptr != bounder.data.parameters.ptr
        before = bounder.threshold, bounder.certificate
        made.freeze(0.0, None)
        made.info["note"] = "changed"
        assert (bounder.threshold, bounder.certificate) == before
        assert bounder.info.get("note") != "changed"


@pytest.mark.parametrize("method", METHODS)
def test_every_method(copied, method, rng):
    bounder = fitted(method, "c").to("cpu")
    x = rng.random((500, bounder.domain.columns), np.float32)
    check_bounder(copied, bounder, lambda b: b.values(x).numpy())


# the others are volumes without tensors of their own
@pytest.mark.parametrize("method", ["bvh", "mlp", "distance-grid"])
def test_distances(copied, method, rng):
    x = thing("blob").lower + rng.random((500, 3)) * 2
    check_bounder(copied, far(method, "blob").to("cpu"), lambda b: b.distance(x.astype(np.float32)).numpy())


def test_compositions(copied, rng, tmp_path):
    box, volume = fitted("aabb", "c"), fitted("kdop", "c")
    x = rng.random((500, 2), np.float32)
    check_bounder(copied, wb.cascade(box, volume), lambda b: b.query(x).numpy())
    box.save(tmp_path / "box.safetensors")
    library = wb.baking.BounderLibrary(tmp_path, device="cpu")
    for _ in range(2):  # before and after use
        assert copied(library)["box"].query(x).numpy().tobytes() == library["box"].query(x).numpy().tobytes()


def star(x: np.ndarray) -> np.ndarray:
    return np.hypot(x[:, 0], x[:, 1]) <= 0.7 + 0.2 * np.sin(5 * np.arctan2(x[:, 1], x[:, 0]))


LEFT_OUT = "steep function", "short function", "motion"  # lambdas; costs ten times what the open motion does
SHAPES = {name: make for name, make in KINDS.items() if name not in LEFT_OUT}
SHAPES |= {
    "dilated mesh": lambda: KINDS["mesh"]().dilated(0.1),
    "points alone": lambda: wb.shapes.Function(star, [-1, -1], [1, 1]),
}


@cache
def answers(name: str, made: Shape | None = None) -> bytes:
    made = SHAPES[name]() if made is None else made
    x = np.random.default_rng(0).uniform(made.sample_lower, made.sample_upper, (300, made.ndim))
    found = [made.contains(x), made.empty(x, x + 0.05), made.inside(x, x + 0.05), made.distance(x)]
    return b"".join(each.tobytes() for each in found if each is not None)


@pytest.mark.parametrize("name", SHAPES)
def test_every_shape(copied, name):
    original = SHAPES[name]()
    for _ in range(2):  # before and after use
        made = copied(original)
        check_read_only(made, original)
        assert (type(made), made.digest, repr(made)[:20]) == (type(original), original.digest, repr(original)[:20])
        assert answers(name, made) == answers(name) == answers(name, original)


def test_a_function_that_cannot_be_pickled_is_one_error():
    local = wb.shapes.Complement(wb.shapes.Function(lambda x: star(x), [-1, -1], [1, 1]))
    with pytest.raises(ShapeError, match=r"^function: contains cannot be pickled .*define it in a module"):
        pickle.dumps(local)
    assert copy.deepcopy(local).contains(np.zeros((1, 2))) == local.contains(np.zeros((1, 2)))
