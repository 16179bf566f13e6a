"""Joints that turn without end answer alike after whole turns, beyond limits the answer is maybe: no tolerance."""

from fractions import Fraction

import numpy as np
import pytest
import warp as wp
from asking import ask, run_text
from edges import COUNT, check_until
from shape_kinds import around

import warp_bounding as wb
from warp_bounding.arms import Arm, ArmConfigurations, Body, Joint
from warp_bounding.errors import BoundingError
from warp_bounding.rigid import TWO_PI
from warp_bounding.shapes.joints import NUMBERS, TEXT, TURNS, WIDER, Joints
from warp_bounding.shapes.shape import IN, OUT, UNDECIDED

LIMIT = 2.0
WEIGHTS = np.array([1.3, 0.7])  # a turn is then 8.17 and no float32, and the limits are none
ELBOW = np.eye(4)
ELBOW[0, 3] = 0.5
LINKS = [Body.capsule([0, 0, 0], [0.5, 0, 0], 0.05, link=i) for i in range(2)]
WALL = Body.box([-0.9, -0.1, -0.1], [-0.7, 0.1, 0.1])  # met at the seam, half a turn away
FEW = {"hidden": (16, 16), "steps": 300, "device": "cpu"}


@pytest.fixture(scope="module")
def shape() -> ArmConfigurations:
    joints = [Joint(continuous=True), Joint(ELBOW, lower=-LIMIT, upper=LIMIT)]
    return ArmConfigurations(Arm(joints, LINKS), [WALL], weights=WEIGHTS)


@pytest.fixture(scope="module")
def bounders(shape) -> dict[str, wb.Bounder]:
    made = {"aabb": wb.fit(shape, method="aabb", device="cpu"), "mlp": wb.fit(shape, method="mlp", **FEW)}
    return made | {"bvh": wb.fit(shape, method="bvh", resolution=24, device="cpu"), "both": wb.cascade(*made.values())}


def turned_back(x: float, weight: float) -> Fraction:
    """A coordinate in the turn around 0, exactly."""
    period = TWO_PI * Fraction(weight)
    return Fraction(x) - round(Fraction(x) / period) * period


TURN = f"""
typedef float V;
enum {{ AXES = 1 }};
const float* extra = numbers.data;
const float q[1] = {{x.data[block]}};
bool testable = true;
{TEXT}
out.data[2 * block] = turned[0];
out.data[2 * block + 1] = testable;
"""


def test_what_turning_back_rounds_is_in_the_proof(device, rng):
    for weight in (1.0, 0.3, 1.3, 2.0**-20, 7.7e5):
        period = TWO_PI * Fraction(weight)
        joints = Joints.of(np.zeros(1), np.ones(1), np.array([float(period)]))
        assert joints.fault() is None
        number = rng.integers(-TURNS, TURNS, 1500) + rng.choice([0.0, 0.25, 0.5], 1500)  # the halves are the seam
        x = (number * float(period)).astype(np.float32)
        x = np.concatenate([x, np.nextafter(x, np.float32(1e9)), rng.uniform(-1, 1, 500) * joints.upper[0]])
        ends = np.float32(
            [joints.upper[0], np.nextafter(np.float32(joints.upper[0]), np.float32(np.inf)), np.nan, np.inf, 3e38]
        )
        x = np.concatenate([x, ends, -ends]).astype(np.float32)
        assert len(joints.numbers) == NUMBERS
        turned, asked = run_text("wb_test_turned_back", TURN, len(x), x, joints.numbers, (len(x), 2), device).T
        inside = np.abs(x) <= np.float32(joints.upper[0])
        assert (asked.astype(bool) == inside).all()
        allowed = Fraction(5, 2**24) * period  # what ``Joints.reach`` has beside the rounding of a float64 query
        for q, found in zip(x[inside].tolist(), turned[inside].tolist(), strict=True):
            by = Fraction(q) - Fraction(found)
            assert abs(by - round(by / period) * period) <= allowed
            assert abs(Fraction(found)) <= period / 2 * Fraction(WIDER)


def test_the_truth_is_periodic(shape, rng):
    x = around(shape, rng, 400)
    for turns in (0, 1, -2, 37, 10**5, -(10**6)):
        there = x + turns * np.array([2 * np.pi * WEIGHTS[0], 0.0])
        exact = np.array([[float(turned_back(a, WEIGHTS[0])), b] for a, b in there])
        answers, expected = shape.decide(there), shape.decide(exact)
        sure = (expected != UNDECIDED) & (answers != UNDECIDED)
        assert (answers == expected)[sure].all()
    far = np.array([[1e12, 0.0], [1e300, 0.0], [np.inf, 0.0], [np.nan, 0.0]])
    assert shape.decide(far).tolist() == [UNDECIDED, UNDECIDED, OUT, OUT]


def test_boxes_in_other_turns(shape, rng):
    x = rng.uniform(shape.lower, shape.upper, (3000, 2))
    half = 10.0 ** rng.uniform(-4, 0, (3000, 1)) * rng.random((3000, 2))
    lower, upper = x - half, x + half
    for turns in (1, -3, 500):
        by = turns * np.array([2 * np.pi * WEIGHTS[0], 0.0])
        there = lower + by, upper + by
        empty, inside, known = shape.empty(*there), shape.inside(*there), shape.half_spaces(*there)
        assert empty.any()
        assert inside.any()
        assert (known.empty == empty).all()
        for _ in range(6):
            y = lower + rng.random(x.shape) * (upper - lower) + by
            answers = shape.decide(y)
            assert (answers[empty] == OUT).all()
            assert (answers[inside & (np.abs(y[:, 1]) <= shape.upper[1])] != OUT).all()
            above = known.level + (known.slope * (y - known.center)).sum(axis=1)
            assert (above >= 0)[(answers == IN) & ~empty].all()


def test_no_positive_is_missed_after_any_turns(shape, bounders, device, rng):
    x = np.concatenate([around(shape, rng, 400), rng.uniform(shape.lower, shape.upper, (5000, 2))])
    period = 2 * np.pi * WEIGHTS[0]
    for turns in (0, 1, -1, 9, -333, TURNS - 1, TURNS, 5000, 10**9):
        for dtype in (np.float32, np.float64):
            there = (x + turns * np.array([period, 0.0])).astype(dtype)
            held = shape.contains(there.astype(np.float64))
            for bounder in bounders.values():
                maybe = bounder.to(device).query(there).numpy().astype(bool)
                assert maybe[held].all()
                if turns > TURNS:
                    assert maybe.all()
                elif bounder.method == "mlp":
                    assert not maybe[~held].all()


BEYOND = ([0, 1], [0, -1])  # one float32 step beyond a limit
OTHERS = ([0, 1.4001], [0, 3.0], [0, -3e38], [np.nan, 0], [0, np.inf], [1e4, 0], [-3e38, 0])


def beyond(shape) -> np.ndarray:
    top = shape.upper.astype(np.float32)
    steps = np.nextafter(top, np.float32(9)) * np.float32(BEYOND)
    return np.concatenate([steps, np.float32(OTHERS)]).astype(np.float32)


def test_beyond_limits_the_answer_is_maybe(shape, bounders, device):
    x, at = beyond(shape), np.float32([0, shape.upper[1]]) * np.float32([[1, 1], [1, -1]])
    for bounder in bounders.values():
        bounder = bounder.to(device)
        assert bounder.query(x).numpy().all()
        assert bounder.query(x.astype(np.float64)).numpy().all()
        assert int(bounder.candidates(x)[1].numpy()[0]) == len(x)
        assert bounder.prepare(wp.array(x, dtype=wp.vec2, device=device)).launch().numpy().all()
    assert not bounders["mlp"].query(at).numpy().any()  # at a limit there is an answer
    assert shape.decide(x[:4]).tolist() == [OUT] * 4  # as beyond a motion's time


def test_in_a_kernel_as_in_a_batch(shape, bounders, device, rng):
    bounder = bounders["mlp"].to(device)
    x = np.concatenate([beyond(shape), rng.uniform([-60, -1.5], [60, 1.5], (4000, 2)), around(shape, rng, 400)]).astype(
        np.float32
    )
    maybe = ask(bounder, x).astype(bool)
    assert maybe[: len(BEYOND) + len(OTHERS)].all()
    assert maybe[shape.decide(x.astype(np.float64)) != OUT].all()
    assert not maybe.all()


def test_segments_across_turns_and_limits(shape, bounders, rng):
    clear, s = 0, np.linspace(0, 1, 400)[:, None]
    for name in ("mlp", "aabb"):
        for span in (6.0, 300.0, 8000.0):
            a = np.stack([rng.uniform(-span, span, 300), rng.uniform(-1.4, 1.4, 300)], axis=1)
            b = np.stack(
                [a[:, 0] + rng.normal(size=300) * rng.choice([0.1, 3, 30], 300), rng.uniform(-1.4, 1.4, 300)], axis=1
            )
            cleared, edge = wb.proof.clear_segments(bounders[name], a, b), wb.proof.Segments(bounders[name])
            alone = np.array([edge(a[i : i + 1], b[i : i + 1])[0][0] for i in range(len(a))])  # many within one turn
            assert (alone >= cleared).mean() > 0.98
            cleared |= alone
            for p, q in zip(a[cleared], b[cleared], strict=True):
                assert not shape.contains(p + s * (q - p)).any()
            clear += cleared.sum()
            if span == 6.0:
                check_until(bounders[name], shape.contains, a[:COUNT], b[:COUNT])
    assert clear
    top, folded = float(shape.upper[1]), 0.9  # a folded elbow passes the wall in a whole turn, and in many
    beyond, folded = np.nextafter(np.float32(top), np.float32(9)), folded * top
    away = np.array([[0.0, folded], [0, folded], [0, 0], [0, 0], [0, 0], [0, 0]])
    ends = np.array([[8.2, folded], [50, folded], [0, top], [0, beyond], [0, np.nan], [1e5, 0]])
    found = wb.proof.clear_segments(bounders["mlp"], away, ends)
    assert found[[2]].all()
    assert not found[3:].any()
    assert found[0] == found[1]
    edge = wb.proof.Segments(bounders["mlp"])
    assert (np.concatenate([edge(away[i : i + 1], ends[i : i + 1])[0] for i in range(len(away))]) == found)[2:].all()


def test_from_the_inside(shape, bounders):
    inner = wb.fit(shape, side="inside", method="mlp", **FEW)
    both = wb.two_sided(bounders["mlp"], inner)
    x = np.random.default_rng(0).uniform([-60, -1.4], [60, 1.4], (20000, 2)).astype(np.float32)
    answers, held = both.classify(x).numpy(), shape.contains(x.astype(np.float64))
    assert not ((held & (answers == 0)) | (~held & (answers == 2))).any()
    assert (both.classify(beyond(shape)).numpy() == 1).all()
    assert wb.certify(inner, shape).proven


def test_files_tell_of_joints(shape, bounders, tmp_path):
    file = tmp_path / "arm.safetensors"
    for bounder in bounders.values():
        bounder.save(file)
        again = wb.load(file, device="cpu")
        assert again.domain.joints == shape.joints
        assert again.query(beyond(shape)).numpy().all()
    assert wb.certify(again, shape).proven
    for limit, continuous in ((LIMIT + 0.1, True), (LIMIT, False)):  # of other limits, or that turns no more
        joints = [Joint(continuous=continuous), Joint(ELBOW, lower=-limit, upper=limit)]
        other = ArmConfigurations(Arm(joints, LINKS), [WALL], weights=WEIGHTS)
        found = wb.certify(again, other)
        assert (found.kind, "older file" in found.message) == ("inapplicable", False)


def test_a_file_that_lies_about_joints_is_no_proof(shape, bounders):
    """It is refused as it is read, or by ``certify``, as is one that was written before bounders knew of joints."""
    bounder, refused = bounders["mlp"], 0
    for edit in (
        {"period": [0.0, 0.0]},
        {"period": [np.nan, 0.0]},
        {"period": [1e-30, 0.0]},
        {"lower": [-1e9, -1.5]},
        {"lower": [-8364.17578125]},
        {"upper": [8364.17578125, -2.0]},
        {"upper": [8364.17578125, "2"]},
        None,
    ):
        reported = bounder.domain.to_dict()
        joints = reported.pop("joints")
        try:
            other = type(bounder.domain).from_dict(reported | ({"joints": joints | edit} if edit else {}))
        except (ValueError, TypeError):
            refused += 1
            continue
        invalid = type(bounder)(other, bounder.tensors, bounder.sizes, "cpu")
        invalid.freeze(float(bounder.threshold), None).info = dict(bounder.info)
        found = wb.certify(invalid, shape)
        assert (found.kind, "limits" in found.message) == ("inapplicable", True)
    assert refused >= 5


def test_what_is_not_asked_of_configurations(shape, bounders):
    for wrong, message in (
        (lambda: wb.fit(shape, "box", method="aabb"), "box queries of configurations are not bounded"),
        (lambda: wb.fit(shape, "distance", method="aabb"), "distances of configurations are not bounded"),
        (lambda: bounders["mlp"].query(np.zeros((1, 2), np.float32), scale=2.0), "no place in the world"),
        (lambda: Joint(continuous=True, upper=1.0), "has no limits"),
        (lambda: Joint(slides="no"), "expected slides to be True or False, got 'no'"),
    ):
        with pytest.raises(BoundingError, match=message):
            wrong()
