"""The generative model: its training, its region as a shape, and what a bounder leaves of its work."""

import numpy as np
import pytest

import warp_bounding as wb

torch = pytest.importorskip("torch", reason="torch is not installed")

from sims.digits import Example, model  # noqa: E402
from sims.digits.demo import rate, shape_of, shapes  # noqa: E402
from sims.prefitted import bounder_from, stored  # noqa: E402

SMALL = {"images": 12, "resolution": 16}


@pytest.fixture(scope="module")
def network():
    return model.load(3)


@pytest.fixture(scope="module")
def bounder():
    return wb.load(stored("digits-3", "mlp"), device="cpu")


def test_a_model_is_trained_and_read_again(tmp_path):
    pytest.importorskip("sklearn", reason="scikit-learn is not installed")
    told = []
    encoder, network = model.train(2, (16,), steps=50, progress=lambda *each: told.append(each))
    assert [done for done, *_ in told] == [50]
    assert told[-1][2] < 43  # nats: 64 pixels at even odds have 44
    assert encoder(model.images()).shape == (1797, 4)
    model.save(network, 2, tmp_path)
    again = model.load(2, tmp_path)
    x = torch.rand(50, 4)
    assert torch.equal(network(x), again(x))
    assert [path.name for path in tmp_path.iterdir()] == ["digits-2.safetensors"]


def test_without_scikit_learn_training_tells_what_is_missing(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "sklearn.datasets", None)
    with pytest.raises(wb.BoundingError, match=r"come with scikit-learn: pip install 'warp-bounding\[digits\]'"):
        model.train(2, steps=1)


def test_files_that_are_no_decoder_are_refused(tmp_path):
    with pytest.raises(wb.BoundingError, match=r"expected a decoder, python -m sims\.digits\.model trains one"):
        model.load(3, tmp_path)
    model.path_of(3, tmp_path).write_bytes(b"no decoder")
    with pytest.raises(wb.BoundingError, match="expected a decoder"):
        model.load(3, tmp_path)
    model.save(model.decoder(2, (8,)), 2, tmp_path).rename(model.path_of(3, tmp_path))
    with pytest.raises(wb.BoundingError, match="expected a decoder of 3 latent numbers, got other tensors"):
        model.load(3, tmp_path)


@pytest.mark.parametrize("latent", model.LATENTS)
def test_the_region_holds_all_ink_that_float32_makes(latent):
    network = model.load(latent)
    shape, x = model.region(network, latent), model.rows(model.codes(200, latent, 7), model.pixels(12))
    ink = model.decode(network, x) >= 0
    assert 0.2 < ink.mean() < 0.4
    assert shape.contains(x)[ink].all()
    assert shape.contains(x).mean() < ink.mean() + 0.01


def test_a_decoder_that_cannot_be_bounded_is_refused_in_one_line():
    layers = torch.nn.Sequential(torch.nn.Linear(5, 8), torch.nn.GELU(), torch.nn.Linear(8, 1)).requires_grad_(False)
    with pytest.raises(wb.IndicatorError, match=r"digits-3: expected modules Linear, .*, got GELU") as caught:
        model.region(layers, 3)
    assert "\n" not in str(caught.value)
    steep = model.decoder(3, (16,)).requires_grad_(False)
    steep[-1].weight.mul_(1e5)
    with pytest.raises(wb.IndicatorError, match=r"expected float32 to round the decoder by less than 0\.0025, got"):
        model.region(steep, 3)


def test_codes_lie_in_the_box_and_rows_are_images(network):
    found = model.codes(20_000, 3, seed=1)
    assert np.abs(found).max() <= model.LARGEST
    assert found.dtype == np.float32
    assert np.allclose(found.std(0), 0.88, atol=0.02)  # of a normal distribution that is cut off at 2
    asked = model.rows(found[:2], model.pixels(4))
    assert asked.shape == (32, 5)
    assert (asked[:16, :3] == found[0]).all()
    assert asked[:5, 3:].tolist() == [[0.125, 0.125], [0.125, 0.375], [0.125, 0.625], [0.125, 0.875], [0.375, 0.125]]


def test_no_bit_of_a_pixel_depends_on_the_others(network, rng):
    x = model.rows(model.codes(40, 3), model.pixels(16))
    whole = model.decode(network, x)
    chosen = np.flatnonzero(rng.random(len(x)) < 0.3)
    assert len(x) > model.CHUNK > len(chosen)
    assert (model.decode(network, x[chosen]) == whole[chosen]).all()


def test_images_are_the_same_with_a_proven_bounder(network, bounder, tmp_path):
    assert bounder.certificate.proven
    reference, example = Example(network, 3, **SMALL), Example(network, 3, bounder, **SMALL)
    for _ in range(2):
        reference.step()
        example.step()
    example.test_final(reference)
    assert sum(example.calls) < 0.5 * sum(reference.calls)
    assert example.extra(reference)["asked"] == round(100 * sum(example.calls) / sum(reference.calls), 2)
    (path,) = example.render(tmp_path)
    assert path.read_bytes()[:4] == b"\x89PNG"


def test_a_pixel_that_is_lost_is_told(network, bounder):
    reference, example = Example(network, 3, **SMALL), Example(network, 3, bounder, **SMALL)
    lying = wb.load(stored("digits-3", "mlp"), device="cpu")
    lying.freeze(float(lying.threshold) + 30.0, lying.certificate)
    example.bounder = lying
    reference.step()
    example.step()
    assert example.missed(reference) > 0
    with pytest.raises(AssertionError, match="pixels of ink were lost"):
        example.test_final(reference)


def test_three_latent_numbers_are_bounded_as_tightly_as_is_told(bounder):
    shape = shapes()["digits-3"]
    assert bounder.certificate.proven
    assert list(bounder.sizes["hidden"]) == [25, 25]
    wrong, missed = rate(bounder, shape, 200_000)
    assert missed == 0
    assert wrong <= 10


def test_what_has_no_proof_is_a_function():
    found = shapes()
    assert [shape.certified for shape in found.values()] == [True, True, False]
    assert [shape.ndim for shape in found.values()] == [4, 5, 12]
    assert shape_of(model.load(10), 10).digest == found["digits-10"].digest


@pytest.mark.slow
def test_the_bounder_of_three_latent_numbers_is_proven_anew():
    shape = shapes()["digits-3"]
    bounder = bounder_from(
        stored("digits-3", "mlp"), shape, __import__("sims.digits").digits.SPECS["mlp"], device="cpu"
    )
    assert wb.certify(bounder, shape).kind == "proven"
