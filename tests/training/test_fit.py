"""``fit``: the loop runs, is repeatable, keeps its budget and survives Ctrl-C; cascades share their time."""

import time
import warnings
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
import torch
import trimesh
from bounding_shapes import few, object_points, shape

import warp_bounding as wb
from warp_bounding.bounders.bvh import Bvh, build
from warp_bounding.bounders.mlp import Mlp
from warp_bounding.errors import BounderError, BoundingError, QueryError, ShapeError
from warp_bounding.proof import prove
from warp_bounding.queries.domain import Domain
from warp_bounding.shapes import MovingMesh
from warp_bounding.training import fit_network as networks
from warp_bounding.training.engine import Evaluator, TrainableNetwork


@pytest.fixture(autouse=True)
def _short_proofs(monkeypatch):
    """Three layers of sines that are hardly trained can keep a proof busy for long; it holds wherever it ends."""
    monkeypatch.setattr(networks, "SCHEDULE", replace(networks.SCHEDULE, search_boxes=100_000))
    monkeypatch.setattr(networks, "LIMITS", replace(networks.LIMITS, boxes=100_000))


def same(a, b) -> bool:
    return all(a.tensors[k].tobytes() == b.tensors[k].tobytes() for k in a.tensors) and a.threshold == b.threshold


def test_steps_are_repeatable_and_seeds_differ():
    first = few(steps=8, seed=4)
    assert same(first, few(steps=8, seed=4))
    assert not same(first, few(steps=8, seed=5))


def test_the_budget_is_kept(ticking):
    clock = ticking(0.02)
    bounder = few("star", steps=None, budget=3.0)
    assert clock.seconds < 3.0 * 1.1 + 0.5  # a proof may be late by a tenth, and something comes before and after
    assert bounder.certificate.proven
    assert bounder.info["training"]["steps"] > 10


def test_an_interrupt_keeps_the_best_so_far():
    calls = []

    def interrupt(done, total, note):
        calls.append((done, total, note))
        if len(calls) == 2:
            raise KeyboardInterrupt

    bounder = few(steps=10_000, progress=interrupt)
    assert bounder.certificate.proven
    assert bounder.info["training"]["interrupted"]
    assert bounder.info["training"]["steps"] < 10_000
    assert wb.certify(bounder, shape("blob")).proven
    assert not same(bounder, few(steps=1))  # not the weights that it began with


STEPS = 20  # the fewest in which activations are tried


@pytest.fixture
def _short_trials(monkeypatch):
    monkeypatch.setattr(networks, "FEWEST_STEPS", STEPS * networks.TRIAL_SHARE)


@pytest.mark.usefixtures("_short_trials")
def test_an_activation_that_is_not_given_is_the_better_one_of_short_trainings():
    bounder = few(steps=STEPS)
    trials = bounder.info["training"]["trials"]
    assert set(trials) == set(networks.TRIED)
    assert bounder.activation == min(trials, key=trials.get)
    assert same(bounder, few(steps=STEPS))


@pytest.mark.usefixtures("_short_trials")
@pytest.mark.parametrize("options", [{"steps": STEPS - 1}, {"steps": STEPS, "activation": "sin"}])
def test_nothing_is_tried_where_an_activation_is_given_or_trials_would_be_too_short(options):
    bounder = few(**options)
    assert "trials" not in bounder.info["training"]
    assert bounder.activation == "sin"


@pytest.mark.usefixtures("_short_trials")
def test_an_interrupt_of_the_second_trial_keeps_the_better_one():
    seen = []

    def interrupt(done, total, note):
        seen.append(done)
        if done >= networks.TRIAL_SHARE and seen[-2] < networks.TRIAL_SHARE:
            raise KeyboardInterrupt

    bounder = few(steps=STEPS, progress=interrupt)
    trials = bounder.info["training"]["trials"]
    assert bounder.certificate.proven
    assert bounder.info["training"]["steps"] == 0
    assert set(trials) == set(networks.TRIED)
    assert bounder.activation == min(trials, key=trials.get)


def test_an_interrupt_before_the_first_step():
    def interrupt(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):  # the second one, while the proof runs, is heard
        few(progress=interrupt)


def test_a_hierarchy_whose_time_is_over_has_fewer_boxes_and_is_proven(rng):
    grid = shape("blob")
    whole = build(grid, 16)
    hurried = build(grid, 16, seconds=0.0)
    assert len(hurried.first) == 1 < len(whole.first)
    bounder = Bvh.fit(grid, Domain.of(grid), leaves=16, seconds=0.0, device="cpu")
    prove(bounder, grid)
    assert bounder.certificate.proven
    assert bounder.query(object_points(grid, rng, 1000)).numpy().all()


@pytest.mark.parametrize(
    ("method", "query"),
    [
        ("learned-kdop+mlp", "point"),
        *(("learned-kdop+bvh", query) for query in ("ray", "box")),
    ],
)
def test_a_cascade_is_fitted_and_says_what_its_parts_say(method, query, tmp_path):
    bounder, grid = few("blob", method, query), shape("blob")
    assert bounder.method == "cascade"
    assert [entry["method"] for entry in bounder.sizes["parts"]] == method.split("+")
    assert bounder.certificate.proven
    assert bounder.info["indicator"] == grid.digest
    assert len(bounder.info["training"]["parts"]) == 2
    assert bounder.info["training"]["seconds"] >= sum(p["seconds"] for p in bounder.info["training"]["parts"]) - 0.01
    assert wb.evaluate(bounder, grid, samples=50_000).fn == 0
    bounder.save(tmp_path / "a.safetensors")
    assert wb.load(tmp_path / "a.safetensors").certificate == bounder.certificate


@pytest.mark.parametrize("query", ["ray", "plane", "box"])
def test_networks_of_regions_are_refused_in_one_line_that_names_the_distance(query):
    for method in ("mlp", "aabb+mlp", "occupancy"):
        with pytest.raises(BounderError, match=rf"does not bound {query} queries.*fit\(shape, 'distance'\)$") as error:
            wb.fit(shape("c"), query, method)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("method", "message"),
    [
        ("aabb+occupancy", "occupancy is not conservative"),
        ("aabb+", "method must be one of"),
        ("aabb+magic", "method must be one of"),
        ("+".join(["aabb"] * 9), "2 to 8"),
    ],
)
def test_what_is_no_cascade_is_refused_before_anything_is_fitted(method, message, monkeypatch):
    monkeypatch.setattr(networks, "_Fit", None)
    with pytest.raises(BounderError, match=message):
        few("c", method)


# --- what trains: gradients, and weights that are copied --------------------------------------------------------------

# coordinates, hidden, activation
SIZES = [(3, (7,), "sin"), (3, (6, 5), "relu"), (3, (6, 5, 4), "sin"), (8, (6,), "relu")]


def network_of(ndim, hidden, activation):
    network = TrainableNetwork(ndim, hidden, activation)
    network.initialise(3.0, 1.5, generator(0))
    return network


def autograd(network, v, flat):
    """The same network, written plainly."""
    h, layers = v, network.split(flat)
    for layer in layers[:-1]:
        z = layer[:, :-1] @ h + layer[:, -1:]
        h = {"sin": torch.sin, "relu": torch.relu}[network.activation](z)
    return (layers[-1][:, :-1] @ h + layers[-1][:, -1:])[0]


@pytest.mark.parametrize("sizes", SIZES)
def test_gradients_are_autograds(sizes):
    network = network_of(*sizes)
    v = torch.rand(sizes[0], 50, generator=generator(1)) * 2 - 1
    weight = torch.rand(50, generator=generator(2))
    flat, variable = network.flat.clone().requires_grad_(), v.clone().requires_grad_()
    f = autograd(network, variable, flat)
    (f * weight).sum().backward()
    per_sample = torch.autograd.grad(autograd(network, variable, flat).sum(), variable)[0]
    with torch.no_grad():
        worker, x = Evaluator(network), network.encode(v)
        assert torch.allclose(worker.forward(x, keep=True), f, atol=1e-5)
        worker.backward(x, weight.clone())
        assert torch.allclose(worker.gradient, flat.grad, atol=1e-4, rtol=1e-4)
        assert torch.allclose(worker.input_gradient(x), per_sample, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("sizes", SIZES[:3])
def test_the_bounder_is_the_trained_network(sizes):
    network, domain = network_of(*sizes), Domain.of(shape("blob"))
    _, hidden, activation = sizes
    mlp = Mlp(domain, network.tensors(), {"hidden": list(hidden), "activation": activation}, "cpu")
    v = torch.rand(3, 200, generator=generator(1)) * 2 - 1
    f = autograd(network, v, network.flat).numpy()
    assert np.abs(mlp.reference(v.T.numpy()) - f).max() < 1e-4
    network.flat.zero_()  # weights are copied: an optimiser's step would void the proof
    assert np.abs(mlp.reference(v.T.numpy()) - f).max() < 1e-4


def generator(seed):
    return torch.Generator().manual_seed(seed)


@pytest.mark.parametrize("method", ["learned-kdop", "relu-field"])
def test_what_torch_imports_for_its_first_optimiser_is_not_counted(method, monkeypatch):
    adam = torch.optim.Adam

    def late(*tensors, **options):
        time.sleep(0.3)
        return adam(*tensors, **options)

    monkeypatch.setattr(torch.optim, "Adam", late)
    bounder = wb.fit(shape("c"), method=method, steps=3, device="cpu", progress=False)
    assert bounder.info["training"]["compile_seconds"] >= 0.3


# --- the default method ----------------------------------------------------------------------------------------------

FOUND = {"point": "mlp", "plane": "bvh", "distance": "mlp", "ray": "bvh", "box": "bvh"}


@pytest.mark.parametrize("query", FOUND)
def test_without_a_method_every_kind_of_query_gets_what_is_proven(query):
    """A network where one answers, and boxes where none does."""
    options = {"steps": 3, "hidden": (8,)} if FOUND[query] == "mlp" else {}
    bounder = wb.fit(shape("blob"), query, device="cpu", progress=False, **options)
    assert bounder.method == FOUND[query]
    assert bounder.certificate.proven
    assert wb.certify(bounder, shape("blob")).proven


# --- options: every wrong one is one clear line -----------------------------------------------------------------------

WRONG = {
    "query": "cone",
    "method": ["magic", "", 5],
    "hidden": [0, (0,), (), (8, -1), (2.5,), (True,), (1025,), "eight", (8,) * 9, (1024,) * 3, None],
    "activation": ["softplus", ""],
    "budget": [0, float("nan"), float("inf"), "long", None, True],
    "seed": [-1, 1.5, 2**63, None],
    "margin": [-1, float("nan"), float("inf"), "wide", None],
    "length": [0, -1, float("nan"), "long"],
    "steps": [0, -1, 1.5, "many", True],
    "device": ["cuda:99", "nowhere"],
    "resolution": [7, "fine"],
    "progress": [5, True],
}


@pytest.mark.parametrize(
    ("option", "value"), [(k, v) for k, vs in WRONG.items() for v in (vs if isinstance(vs, list) else [vs])]
)
def test_wrong_options(option, value):
    with pytest.raises(BoundingError) as error:
        few(**{option: value})
    assert isinstance(error.value, BounderError | QueryError | ShapeError)
    assert "\n" not in str(error.value)
    assert str(error.value).count("got") == 1


TOLD = {"hidden": (8,), "activation": "relu", "k": 12, "leaves": 7, "steps": 3, "length": 0.5}
TAKEN = {
    ("aabb", "point"): set(),
    ("kdop", "point"): {"k"},
    ("kdop", "ray"): {"k", "length"},
    ("bvh", "point"): {"leaves", "hidden"},
    ("mlp", "point"): {"hidden", "activation", "steps"},
    ("kdop+mlp", "point"): {"k", "hidden", "activation", "steps"},
}


@pytest.mark.parametrize(("method", "query"), TAKEN)
def test_options_that_a_method_does_not_take_are_refused(method, query, monkeypatch):
    """Every option, with a value that makes sense: refused before anything is fitted, or on its way to the fit."""

    class BegunError(Exception):
        """The options were taken."""

    def begin(*_, **__):
        raise BegunError

    monkeypatch.setattr(import_module("warp_bounding.training.fit"), "Problem", begin)
    for option, value in {**TOLD, "speed": 9}.items():
        reported = {option: value}
        expected = BegunError if option in TAKEN[method, query] else BounderError
        with pytest.raises(expected) as error:
            wb.fit(shape("blob"), query, method, device="cpu", **reported)
        if expected is BounderError:
            assert option in str(error.value)


def test_what_cannot_be_statistical():
    grid = shape("c")
    true = {"statistical": True}
    for options in ({"statistical": "yes"}, true | {"query": "plane"}, true | {"query": "box"}):
        with pytest.raises(BounderError):
            wb.fit(grid, **options, steps=2, device="cpu")


def test_a_name_that_is_typed_wrong_is_told_with_the_one_that_was_meant(tmp_path):
    with pytest.raises(BounderError, match="there is no option 'marign'; did you mean 'margin'"):
        wb.fit(shape("blob"), method="kdop", device="cpu", marign=2.0)
    with pytest.raises(BounderError, match="there is no option 'sample'"):
        wb.baking.bake(tmp_path, tmp_path / "out", method="kdop", sample=1000)


def test_wrong_numbers_of_half_spaces_shapes_and_places_of_arguments():
    for k in (0, 7, 2.5):
        with pytest.raises(BounderError, match="kdop offers"):
            few(method="kdop", k=k)
    for source in ("nowhere.npy", None, np.zeros((3, 3)), np.ones((3, 3)), np.array(["a"])):
        with pytest.raises(ShapeError):
            wb.fit(source, method="aabb")
    with pytest.raises(QueryError, match="'mlp' is a method, which comes after the query: method='mlp'"):
        wb.fit(shape("blob"), "mlp")
    with pytest.raises(BounderError, match="python -m paper table1"):
        wb.fit(shape("c"), "ray", "kdop", space="parametric")


BOX = trimesh.creation.box(extents=(1, 2, 0.5))
BALL = np.linalg.norm(np.mgrid[-1:1:9j, -1:1:9j], axis=0) < 0.5


def motion():
    return MovingMesh(np.stack([BOX.vertices, BOX.vertices + 0.1]), BOX.faces, time_cells=2)


@pytest.mark.parametrize(
    ("given", "extent"), [(BOX, 2), (motion(), 2.1), (BALL, 1.125)], ids=["mesh", "motion", "grid"]
)
def test_a_margin_beyond_the_extent_is_an_error_unless_forced(given, extent, monkeypatch):
    shape = wb.load_shape(given)
    too_large = extent * 1.01
    with monkeypatch.context() as patch:
        patch.setattr(type(shape), "to_grid", lambda *_, **__: pytest.fail("work was begun"))
        with pytest.raises(wb.BounderError) as caught:
            wb.fit(shape, method="aabb", margin=too_large)
        assert f"the object's extent, {extent:.4g}, got {too_large:g}; force=True" in str(caught.value)
    options = {} if isinstance(shape, wb.shapes.Grid) else {"resolution": 6}
    assert wb.fit(shape, method="aabb", margin=too_large, force=True, **options).certificate.proven
    assert wb.fit(shape, method="aabb", margin=extent * 0.99, **options).certificate.proven


def test_a_margin_under_a_cell_is_warned_of_once():
    with pytest.warns(wb.BoundingWarning, match="margin 0.1 is under the size of a cell.*resolution 6") as caught:
        wb.fit(BOX, method="aabb", margin=0.1, resolution=6)
    assert sum("under the size" in str(each.message) for each in caught) == 1
    assert caught[0].filename == __file__
    finer = int(str(caught[0].message).rpartition("resolution=")[2].split()[0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wb.fit(BOX, method="aabb", margin=0.1, resolution=finer + 2)
