"""An activation of one's own, defined here, in every role that a network gives it: no file of the package is touched
for it."""

import numpy as np
import pytest
import warp as wp
from bounding_shapes import object_points, shape
from enclosures import enclosure
from region_cases import hard_regions

pytest.importorskip("torch", reason="torch is not installed")

import warp_bounding as wb
from warp_bounding import activations
from warp_bounding.activations import ACTIVATIONS, Activation, register
from warp_bounding.errors import BounderError, FileFormatError
from warp_bounding.queries import oracle
from warp_bounding.rounding import TINY


@wp.func
def leaky_plain(z: float):
    return wp.max(z, 0.125 * z)


class Leaky(Activation):
    """``max(z, z / 8)``: slopes 1 and 1/8, exact in float32 but for what is subnormal."""

    name = "leaky"
    plain = leaky_plain

    def statement(self, lanes, target, z):
        return f"{{ const V z_ = {z}; const V less_ = z_ * 0.125f; {target} = z_ > less_ ? z_ : less_; }}"

    def error(self, limit):
        return TINY

    def value(self, z):
        return np.maximum(z, z / 8)

    def relaxation(self):
        return """
auto act_leaky = [&](V z) { return z > z * 0.125 ? z : z * 0.125; };
auto relax_leaky = [&](V z, V near, V noise, V& slope, V& mean, V& bend, V& spread) {
    const V d = near + noise; const V low = z - d; const V high = z + d; V s = high / (d + d);
    s = s < zero ? zero : s; s = s > zero + 1.0 ? zero + 1.0 : s;
    V e = s * low * -0.4375; e = low < zero ? e : zero; e = high > zero ? e : zero;
    slope = s * 0.875 + 0.125; mean = slope * z + e; bend = zero; spread = e;
};
"""

    def torch_value(self, z, out=None):
        import torch

        return torch.maximum(z, z * 0.125, out=out)

    def torch_slope(self, z, h, out):
        import torch

        torch.gt(z, 0, out=out)
        out.mul_(0.875).add_(0.125)


@pytest.fixture(autouse=True)
def leaky():
    """Registered for the time of a test."""
    activation = Leaky()
    register(activation)
    yield activation
    del ACTIVATIONS[activation.name]


def network(query: str):
    return wb.fit(shape("c"), query, hidden=(8, 8), activation="leaky", steps=100, device="cpu")


@pytest.mark.parametrize("query", ["point", "plane"])
def test_an_activation_of_ones_own(query, tmp_path, rng):
    """Fitted, proven, stored, loaded, certified, asked."""
    grid, bounder = shape("c"), network(query)
    assert bounder.activation == "leaky"
    assert bounder.certificate.proven
    bounder.save(tmp_path / "b.safetensors")
    loaded = wb.load(tmp_path / "b.safetensors", device="cpu")
    assert wb.certify(loaded, grid).proven
    q = object_points(grid, rng) if query == "point" else hard_regions(query, grid, rng, 1.0)
    rates = wb.evaluate(loaded, grid, samples=20_000)
    assert rates.fn == 0
    assert rates.fp_rate + rates.positives < 99.95  # it denies something
    truth = oracle(query, grid, "cpu")(q.astype(np.float32))
    assert loaded.query(q.astype(np.float32)).numpy().astype(bool)[truth].all()


def test_its_relaxation_holds_and_its_kernel_does_the_same(leaky, rng):
    z = rng.normal(size=(500, 9)) * 3
    near, noise = (10 ** rng.uniform(-6, 1, z.shape) for _ in range(2))
    chord = enclosure("leaky", z, near, np.zeros_like(z), noise)
    for _ in range(200):
        x = rng.uniform(-1, 1, z.shape) * near + rng.uniform(-1, 1, z.shape) * noise
        away, rounding = np.abs(leaky.value(z + x) - chord.mean - chord.slope * x), 1 + np.abs(z) + near + noise
        assert (away <= chord.spread + 1e-12 * rounding).all()
    part = network("point").network
    center, radius = rng.uniform(-0.9, 0.9, (200, 2)), 10 ** rng.uniform(-4, -1, (200, 1))
    least = part.bound(center - radius, center + radius).lower
    for share in rng.choice([-1.0, 0.0, 1.0, 0.5], (100, 200, 2)):
        assert (part(center + share * radius) >= least).all()
    assert (part(center) - part.bound(center, center).lower < 1e-9).all()


def test_names_that_are_refused():
    for name in ("leaky", "sin", "one-eighth", "", "été"):
        other = Leaky()
        other.name = name
        with pytest.raises(BounderError, match="name"):
            register(other)


def test_files_of_activations_that_nobody_knows(tmp_path):
    network("point").save(tmp_path / "b.safetensors")
    held = ACTIVATIONS.pop("leaky")
    try:
        with pytest.raises(FileFormatError, match=r"activation must be one of sin, relu, got 'leaky'"):
            wb.load(tmp_path / "b.safetensors", device="cpu")
    finally:
        activations.register(held)
