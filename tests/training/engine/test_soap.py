"""The optimiser of every fit: bounded whatever its rotations are made of, and as good as a well-kept implementation."""

import math

import numpy as np
import pytest
import torch

from warp_bounding.training import engine as module
from warp_bounding.training.engine import (
    EIGEN_EVERY,
    Soap,
    single_threaded_torch,
)

SHAPES = [(6, 9), (1, 7), (7, 1), (1, 1), (2, 30), (25, 26)]
STEPS, CHANGE = 135, 95  # of a sequence of gradients; where it becomes another, in the middle between two refinements
ROUNDING = 1e-5  # relative, of the products of a few dozen float32 numbers that these tests compute anew


@pytest.fixture(autouse=True)
def as_in_training():
    with single_threaded_torch():
        yield


def generator(seed):
    return torch.Generator().manual_seed(seed)


def as_computed(rng, values, vectors):
    """This machine's own."""


def other_signs(rng, values, vectors):
    """An eigenvector's sign is the library's choice."""
    vectors *= torch.randint(2, values.shape, generator=rng) * 2 - 1


def other_vectors_of_equal_values(rng, values, vectors):
    """Within a space of equal eigenvalues (the whole null space, above all) any orthonormal vectors will do."""
    same = values <= 1e-6 * values.max()
    turn = torch.linalg.qr(torch.randn(int(same.sum()), int(same.sum()), generator=rng))[0]
    vectors[:, same] = vectors[:, same] @ turn.to(vectors)


def rounding_noise(rng, values, vectors):
    """Another library's rounding, a hundred times over; the vectors are orthogonal up to it."""
    vectors += 1e-5 * torch.randn(vectors.shape, generator=rng)


LIBRARIES = [as_computed, other_signs, other_vectors_of_equal_values, rounding_noise]


@pytest.fixture(params=LIBRARIES, ids=lambda library: library.__name__)
def library(request, monkeypatch):
    """Linear algebra as other machines may compute it."""

    rng = generator(1)

    class Linalg:
        @staticmethod
        def eigh(matrix):
            values, vectors = torch.linalg.eigh(matrix)
            request.param(rng, values, vectors)
            return values, vectors

        @staticmethod
        def qr(matrix):
            vectors, triangle = torch.linalg.qr(matrix)
            request.param(rng, triangle.diagonal().abs(), vectors)
            return vectors, triangle

    class Torch:
        linalg = Linalg

        def __getattr__(self, name):
            return getattr(torch, name)

    monkeypatch.setattr(module, "torch", Torch())
    return request.param


def quadratic(seed):
    """Matrices, their gradients and the loss: a steep one, and one whose gradient has rank 1 for ever."""
    target = torch.randn(6, 9, generator=generator(seed))
    steep = torch.diag(torch.logspace(-1, 1, 9))
    weights = [torch.zeros(6, 9), torch.zeros(1, 7)]

    def gradients():
        return [2 * (weights[0] - target) @ steep @ steep, 2 * (weights[1] - 3)]

    def losses():
        return [float(((weights[0] - target) @ steep).square().sum()), float((weights[1] - 3).square().sum())]

    return weights, gradients, losses


@pytest.mark.parametrize(("rate", "steps", "seeds"), [(0.02, 1200, 2), (0.05, 400, 30), (0.2, 400, 4)])
def test_a_quadratic_is_solved(rate, steps, seeds, library):
    for seed in range(seeds):
        weights, gradients, losses = quadratic(seed)
        soap, seen = Soap(weights, 0.9, 0.95), [losses()]
        for step in range(steps):
            soap.step(gradients(), rate * (1 - step / steps))
            seen.append(losses())
        worst = np.max(seen, axis=0)
        assert (worst < 3 * np.array(seen[0])).all(), (seed, worst)  # no step is a jump
        assert sum(seen[-1]) < 1e-3 * sum(seen[0]), (seed, seen[-1])


def sequences(rows, columns):
    """Gradients that are hard on second moments, by name: functions of the step."""
    rng = generator(5)
    left, right = torch.randn(rows, 1, generator=rng), torch.randn(1, columns, generator=rng)
    full = [torch.randn(rows, columns, generator=rng) for _ in range(STEPS)]
    return {
        "full rank": lambda k: full[k],
        "rank 1": lambda k: left @ right * math.cos(0.1 * k),
        "rank 1, then another": lambda k: left @ right if k < CHANGE else full[0][:, :1] @ full[1][:1],
        "rank 1, then full": lambda k: left @ right if k < CHANGE else full[k],
        "vanishing": lambda k: full[k] * 10.0 ** (-0.5 * k),
        "nothing, then something": lambda k: torch.zeros(rows, columns) if k < CHANGE else full[k],
        "something, then nothing": lambda k: full[k] if k < 50 else torch.zeros(rows, columns),
        "denormal": lambda k: full[k] * 1e-41,
        "one row alive": lambda k: torch.cat([full[k][:1], torch.zeros(rows - 1, columns)]),
        "one entry in a thousand": lambda k: full[k] * (torch.rand(rows, columns, generator=generator(k)) < 1e-3),
        "a spike": lambda k: full[k] * (1e6 if k == CHANGE else 1e-3),
    }


@pytest.mark.parametrize("betas", [(0.95, 0.95), (0.8, 0.95)])
@pytest.mark.parametrize("shape", SHAPES)
def test_no_coordinate_moves_by_more_than_the_bound(shape, betas, library):
    for name, gradient in sequences(*shape).items():
        weight = torch.zeros(shape)
        soap = Soap([weight], *betas)
        state = soap._states[0]
        for k in range(STEPS):
            before = weight.clone()
            bases = state.left_basis, state.right_basis
            soap.step([gradient(k)], 0.5)
            if k == 0:
                bases = state.left_basis, state.right_basis  # found in the first step, used at once
            change = weight - before
            rotated = (bases[0].T @ change if shape[0] > 1 else change) @ bases[1]
            norm = max(1.0, float(weight.abs().max())) * math.sqrt(weight.numel())
            assert torch.isfinite(weight).all(), (name, k)
            assert float(rotated.abs().max()) <= 0.5 * soap.bound * (1 + 1e-3) + ROUNDING * norm, (name, k)
            for basis in (state.left_basis, state.right_basis) if k % EIGEN_EVERY == EIGEN_EVERY - 1 else ():
                assert float((basis.T @ basis - torch.eye(len(basis))).abs().max()) < 3e-4, (name, k)
            assert (state.square >= 0).all(), (name, k)


def test_nothing_moves_without_gradient():
    weight = torch.ones(6, 9)
    soap = Soap([weight], 0.95, 0.95)
    for _ in range(3 * EIGEN_EVERY):
        soap.step([torch.zeros(6, 9)], 0.1)
    assert (weight == 1).all()


def test_directions_without_gradient_hardly_move():
    """The gradient has rank 1: whatever the basis of the rest, weights move along it, as if there were nothing else."""
    left, right = torch.randn(12, 1, generator=generator(1)), torch.randn(1, 20, generator=generator(2))
    weight = torch.zeros(12, 20)
    soap = Soap([weight], 0.95, 0.95)
    for k in range(200):
        soap.step([left @ right * (1 + 0.5 * math.sin(0.3 * k))], 0.01)
    along = float((left.T @ weight @ right.T) / (left.norm() * right.norm()))
    across = weight - along * left @ right / (left.norm() * right.norm())
    assert abs(along) > 1.5
    assert float(across.norm()) < 0.1 * abs(along)


def test_the_scale_of_gradients_does_not_matter():
    """Adam's steps do not depend on it, from the smallest floats whose squares float32 holds to the largest."""
    ends = []
    for scale in (2.0**-40, 1.0, 2.0**40):
        weight = torch.zeros(5, 8)
        soap = Soap([weight], 0.9, 0.95)
        for k in range(35):
            soap.step([torch.randn(5, 8, generator=generator(k)) * scale], 0.1)
        ends.append(weight)
    assert torch.allclose(ends[0], ends[1], atol=1e-3)
    assert torch.allclose(ends[2], ends[1], atol=1e-3)


def test_decays_without_a_bound_are_refused():
    for betas in ((0.98, 0.95), (0.9, 1.0), (0.9, 0.81)):
        with pytest.raises(ValueError, match="beta2 must be under 1 and above the square of beta1"):
            Soap([torch.zeros(2, 2)], *betas)
    assert Soap([], 0.95, 0.95).bound == pytest.approx(1.0)


@pytest.mark.parametrize("shape", [(6, 9), (25, 26), (50, 51)])
@pytest.mark.parametrize("seed", range(4))
def test_it_goes_as_far_as_a_well_kept_implementation(shape, seed):
    """A noisy quadratic whose factors have full rank, where the published method is stable too: loss beside loss, step beside step."""
    reference = pytest.importorskip("pytorch_optimizer", reason="pytorch-optimizer is not installed").SOAP
    rng, (rows, columns) = generator(seed), shape
    a = torch.randn(rows, rows, generator=rng) / math.sqrt(rows)
    b = torch.randn(columns, columns, generator=rng) / math.sqrt(columns)
    target = torch.randn(rows, columns, generator=rng)
    weight, other = torch.zeros(shape), torch.nn.Parameter(torch.zeros(shape))
    ours = Soap([weight], 0.95, 0.95)
    theirs = reference([other], lr=1.0, betas=(0.95, 0.95), weight_decay=0.0, eps=1e-12)
    steps = 320
    for k in range(steps):
        rate = 0.05 * (1 - k / steps)
        noise = torch.randn(shape, generator=rng) * 0.3
        ours.step([a.T @ (a @ (weight - target) @ b + noise) @ b.T], rate)
        theirs.param_groups[0]["lr"] = rate
        with torch.no_grad():
            other.grad = a.T @ (a @ (other - target) @ b + noise) @ b.T
        theirs.step()
        if k % 80 == 79:
            mine, its = (float((a @ (w - target) @ b).square().mean()) for w in (weight, other.detach()))
            assert 0.75 < mine / its < 1.25, (k, mine, its)
    assert mine < 0.01 * float((a @ target @ b).square().mean())
