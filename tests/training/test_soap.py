"""The optimiser of every fit: bounded whatever its rotations are made of, and as good as a well-kept implementation."""

import math

import pytest
import torch

from warp_bounding.training import engine as module
from warp_bounding.training.engine import EIGEN_EVERY, Soap, single_threaded_torch

SHAPES = [(6, 9), (1, 7), (7, 1), (2, 30)]
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


def other_vectors_of_equal_values(rng, values, vectors):
    """Within a space of equal eigenvalues (the whole null space, above all) any orthonormal vectors will do."""
    same = values <= 1e-6 * values.max()
    turn = torch.linalg.qr(torch.randn(int(same.sum()), int(same.sum()), generator=rng))[0]
    vectors[:, same] = vectors[:, same] @ turn.to(vectors)


def rounding_noise(rng, values, vectors):
    """Another library's rounding, a hundred times over; the vectors are orthogonal up to it."""
    vectors += 1e-5 * torch.randn(vectors.shape, generator=rng)


LIBRARIES = [as_computed, other_vectors_of_equal_values, rounding_noise]


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
        "denormal": lambda k: full[k] * 1e-41,
        "one entry in a thousand": lambda k: full[k] * (torch.rand(rows, columns, generator=generator(k)) < 1e-3),
        "a spike": lambda k: full[k] * (1e6 if k == CHANGE else 1e-3),
    }


@pytest.mark.parametrize("shape", SHAPES)
def test_no_coordinate_moves_by_more_than_the_bound(shape, library):
    for name, gradient in sequences(*shape).items():
        weight = torch.zeros(shape)
        soap = Soap([weight], 0.95, 0.95)
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


def test_decays_without_a_bound_are_refused():
    for betas in ((0.98, 0.95), (0.9, 1.0), (0.9, 0.81)):
        with pytest.raises(ValueError, match="beta2 must be under 1 and above the square of beta1"):
            Soap([torch.zeros(2, 2)], *betas)
    assert Soap([], 0.95, 0.95).bound == pytest.approx(1.0)


@pytest.mark.parametrize("shape", [(6, 9)])
def test_it_goes_as_far_as_a_well_kept_implementation(shape):
    """A noisy quadratic whose factors have full rank, where the published method is stable too: loss beside loss, step beside step."""
    reference = pytest.importorskip("pytorch_optimizer", reason="pytorch-optimizer is not installed").SOAP
    rng, (rows, columns) = generator(0), shape
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
