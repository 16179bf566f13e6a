"""A method, a kind of shape and an activation of one's own, defined here: fitted, proven, kept, certified and asked as
the library's are, and no file of the package is touched for it."""

import json
from dataclasses import dataclass

import numpy as np
import pytest
from bounding_shapes import object_points, reloaded, shape

import warp_bounding as wb
from warp_bounding import activations
from warp_bounding.activations import ACTIVATIONS, Activation
from warp_bounding.bounders import register, unregister
from warp_bounding.bounders.bounder import Bounder, Option
from warp_bounding.errors import BounderError, FileFormatError, ShapeError
from warp_bounding.kernels.source import Source
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.proof import stress_test
from warp_bounding.queries.domain import Domain
from warp_bounding.rounding import TINY, UNIT64, gamma, round_up
from warp_bounding.shapes import READERS


@dataclass(frozen=True)
class DiamondSource(Source):
    """Native text of the diamond. Numbers: its radius."""

    def body(self, lanes):
        terms = " ".join(f"f = f - (v[{k}] < none ? none - v[{k}] : v[{k}]);" for k in range(self.coordinates))
        return f"const V none = {'{}' if lanes.vector else '0.0f'}; f = none + w[0]; {terms}"


class Diamond(Bounder):
    """``f(v) = radius - sum |v_k|``, which is concave."""

    method = "diamond"
    options = (Option("slack", 0.0, "added to the radius, half-widths of the domain", float, float),)

    @classmethod
    def fit(cls, grid, domain, *, slack=0.0, device=None):
        lower, upper = domain.widened(grid.position(grid.occupied - 0.5), grid.position(grid.occupied + 0.5))
        radius = np.maximum(np.abs(lower), np.abs(upper)).sum(axis=1).max() + slack
        return cls(domain, {"radius": round_up([radius])}, {}, device)

    @property
    def source(self):
        return DiamondSource(self.ndim, self.domain.time)

    def weights(self):
        return self.tensors["radius"]

    def reference(self, v):
        return float(self.tensors["radius"][0]) - np.abs(v).sum(axis=1)

    def bound(self, lower, upper):
        point = np.where(np.abs(lower) > np.abs(upper), lower, upper)
        value = self.reference(point)
        return BoxBounds(value - self._rounding(UNIT64), np.argmax(upper - lower, axis=1), point, value)

    def rounding_bound(self):
        return self._rounding()

    def _rounding(self, *unit):
        return float(gamma(self.ndim + 1, *unit) * (self.tensors["radius"][0] + self.domain.limit.sum()) + 8 * TINY)


class Ball:
    """A shape that the library does not know: a disc, in a file of centre and radius."""

    def __init__(self, center, radius, name="ball"):
        self.center, self.radius, self.name = np.array(center, dtype=np.float64), float(radius), name

    @classmethod
    def read(cls, path):
        return cls(*json.loads(path.read_text()), name=path.name)

    @property
    def extent(self):
        return np.full(2, 2 * self.radius)

    def to_grid(self, *, resolution=None, margin=0.0):
        cells = resolution or 16
        scale = cells / 8  # cells of a half or less, on a square of width 8
        nearest = np.arange(cells) - 0.5, np.arange(cells) + 0.5
        away = [np.maximum(np.maximum(nearest[0] / scale - c, c - nearest[1] / scale), 0) for c in self.center]
        occupied = np.hypot(*np.meshgrid(*away, indexing="ij")) <= self.radius + margin
        scale, offset = np.full(2, scale), np.zeros(2)
        return wb.shapes.Grid(occupied, scale, offset, name=self.name, margin=margin, resolution=cells)


@pytest.fixture(autouse=True)
def registered():
    """The method and the reader, for the time of a test."""
    methods, readers = list(wb.METHODS), list(READERS)
    register(Diamond)
    READERS[".ball"] = lambda path, _: Ball.read(path)
    yield
    unregister(Diamond)
    del READERS[".ball"]
    assert (list(wb.METHODS), list(READERS)) == (methods, readers)


@pytest.fixture
def ball(tmp_path):
    path = tmp_path / "b.ball"
    path.write_text(json.dumps([[4.0, 3.5], 2.0]))
    return path


def test_from_a_file_to_an_answer(ball, tmp_path, rng):
    bounder = wb.fit(str(ball), method="diamond", resolution=24, margin=0.25, device="cpu")
    assert bounder.certificate.proven
    loaded = reloaded(bounder, tmp_path)
    certificate = wb.certify(loaded, str(ball))
    assert certificate.proven
    assert (certificate.object, certificate.margin, certificate.resolution) == ("b.ball", 0.25, 24)
    grid = wb.load_shape(ball).to_grid(resolution=24, margin=0.25)
    inside = object_points(grid, rng, 20_000)
    assert loaded.query(inside).numpy().all()
    x = rng.uniform(grid.lower, grid.upper, (20_000, 2)).astype(np.float32)
    queried = loaded.query(x).numpy()
    assert 0 < queried.sum() < len(x)
    values, exact = loaded.values(x).numpy(), loaded.reference(loaded.domain.to_local(x))
    seen = np.isfinite(values)
    assert np.abs(values[seen] - exact[seen]).max() <= loaded.rounding_bound() + loaded.domain.delta.sum()
    whole = wb.fit(str(ball), method="diamond+obb", device="cpu")
    assert whole.certificate.proven
    parts = [part.query(x).numpy() for part in whole.parts]
    assert (whole.query(x).numpy() == parts[0] & parts[1]).all()
    assert wb.evaluate(loaded, Ball([4.0, 3.5], 2.0), samples=10_000).fn == 0
    assert stress_test(loaded, str(ball), 20_000).missed is None


def test_what_is_not_registered_is_not_known(ball, tmp_path):
    bounder = Diamond.fit(grid := Ball([4.0, 3.5], 2.0).to_grid(), Domain.of(grid), device="cpu")
    bounder.save(tmp_path / "b.safetensors")
    unregister(Diamond)
    with pytest.raises(FileFormatError, match="diamond"):
        wb.load(tmp_path / "b.safetensors")
    register(Diamond)
    assert wb.load(tmp_path / "b.safetensors", device="cpu").method == "diamond"
    del READERS[".ball"]
    with pytest.raises(ShapeError, match=r"expected one of .* got '\.ball'"):
        wb.load_shape(ball)
    READERS[".ball"] = lambda path, _: Ball.read(path)


def test_what_cannot_be_registered():
    for kind, words in (
        (Ball, "expected a class of bounders"),
        (type("Two", (Diamond,), {"method": "a+b"}), "must be a name without"),
        (type("Other", (Diamond,), {}), "method diamond is Diamond already"),
        (type("Cascade", (Diamond,), {"method": "cascade"}), "none of cascade,"),
    ):
        with pytest.raises(BounderError, match=words):
            register(kind)


# --- an activation, in every role that a network gives it -------------------------------------------------------------


class Leaky(Activation):
    """``max(z, z / 8)``: slopes 1 and 1/8, exact in float32 but for what is subnormal."""

    name = "leaky"

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


@pytest.fixture
def leaky():
    """Registered for the time of a test."""
    activation = Leaky()
    activations.register(activation)
    yield activation
    del ACTIVATIONS[activation.name]


def network():
    return wb.fit(shape("c"), hidden=(8, 8), activation="leaky", steps=100, device="cpu")


def test_an_activation_of_ones_own(tmp_path, rng, leaky):
    """Fitted, proven, stored, loaded, certified, asked."""
    grid, bounder = shape("c"), network()
    assert bounder.activation == "leaky"
    assert bounder.certificate.proven
    loaded = reloaded(bounder, tmp_path)
    assert wb.certify(loaded, grid).proven
    rates = wb.evaluate(loaded, grid, samples=20_000)
    assert rates.fn == 0
    assert rates.fp_rate + rates.positives < 99.95  # it denies something
    assert loaded.query(object_points(grid, rng)).numpy().all()


def test_names_of_activations_that_are_refused(leaky):
    for name in ("leaky", "sin", "one-eighth", "", "été"):
        other = Leaky()
        other.name = name
        with pytest.raises(BounderError, match="name"):
            activations.register(other)


def test_files_of_activations_that_nobody_knows(tmp_path, leaky):
    network().save(tmp_path / "b.safetensors")
    held = ACTIVATIONS.pop("leaky")
    try:
        with pytest.raises(FileFormatError, match=r"activation must be one of sin, relu, got 'leaky'"):
            wb.load(tmp_path / "b.safetensors", device="cpu")
    finally:
        activations.register(held)
