"""The generative model: its region as a shape, and what a bounder leaves of its work."""

import numpy as np
import pytest

import warp_bounding as wb

torch = pytest.importorskip("torch", reason="torch is not installed")

from sims.digits import Example, model  # noqa: E402
from sims.prefitted import stored  # noqa: E402

SMALL = {"images": 12, "resolution": 16}


@pytest.fixture(scope="module")
def network():
    return model.load(3)


def bounder():
    return wb.load(stored("digits-3", "mlp"), device="cpu")


@pytest.mark.parametrize("latent", [2, 3])
def test_the_region_holds_all_ink_that_float32_makes(latent):
    network = model.load(latent)
    shape, x = model.region(network, latent), model.rows(model.codes(200, latent, 7), model.pixels(12))
    ink = model.decode(network, x) >= 0
    assert 0.2 < ink.mean() < 0.4
    assert shape.contains(x)[ink].all()
    assert shape.contains(x).mean() < ink.mean() + 0.01


def test_no_bit_of_a_pixel_depends_on_the_others(network, rng):
    x = model.rows(model.codes(40, 3), model.pixels(16))
    whole = model.decode(network, x)
    chosen = np.flatnonzero(rng.random(len(x)) < 0.3)
    assert len(x) > model.CHUNK > len(chosen)
    assert (model.decode(network, x[chosen]) == whole[chosen]).all()
    assert np.abs(x[:, :3]).max() <= model.LARGEST


def test_images_are_the_same_with_a_proven_bounder_and_a_lost_pixel_is_told(network, tmp_path):
    proven, lying = bounder(), bounder()
    lying.freeze(float(lying.threshold) + 30.0, lying.certificate)
    reference, example, broken = (Example(network, 3, each, **SMALL) for each in (None, proven, proven))
    broken.bounder = lying
    for _ in range(2):
        for each in (reference, example, broken):
            each.step()
    example.test_final(reference)
    assert sum(example.calls) < 0.5 * sum(reference.calls)
    assert broken.missed(reference) > 0
    with pytest.raises(AssertionError, match="pixels of ink were lost"):
        broken.test_final(reference)
    (path,) = example.render(tmp_path)
    assert path.read_bytes()[:4] == b"\x89PNG"
