"""Results on disk: rows come back, torn ends are dropped, settings are never mixed, nothing foreign is overwritten."""

from dataclasses import replace

import numpy as np
import pytest
from bounding_shapes import shape

from paper import regions, results
from paper.labels import SampledOracle
from paper.parametric import SAMPLES, fit, rates
from warp_bounding.errors import BounderError, BoundingError
from warp_bounding.queries import oracle, sample

COLUMNS = ("object", "samples", "fp_rate", "certificate", "fit_seconds")
DEFAULTS = {"samples": 100, "budget": 60.0, "seed": 0}
ROW = {"object": 'a,"b"', "samples": 100, "fp_rate": 12.5, "certificate": "", "fit_seconds": None}
HEADER = ",".join(COLUMNS) + "\n"
LINE = '"a,""b""",100,12.5,,\n'


def opened(path, **given):
    return results.opened(path, "t", COLUMNS, DEFAULTS, given)


@pytest.fixture
def place(tmp_path):
    opened(tmp_path / "out").append(ROW)
    return tmp_path / "out"


@pytest.mark.parametrize("kept", [0, 1, 10, len(LINE) - 1])
def test_rows_come_back_and_a_torn_line_is_dropped(place, kept):
    (place / "t.csv").write_text(HEADER + LINE + LINE[:kept])
    folder = opened(place)
    assert folder.rows == [ROW]
    assert (place / "t.csv").read_text() == HEADER + LINE
    folder.append(ROW | {"object": "c"})
    assert [row["object"] for row in opened(place).rows] == ['a,"b"', "c"]


def test_somebody_elses_folder(tmp_path):
    (tmp_path / "README.md").write_text("mine")
    for path in (tmp_path, tmp_path / "README.md"):
        with pytest.raises(BoundingError, match="choose another folder"):
            opened(path)


def test_failures_are_told_and_an_interruption_is_no_result(place, capsys):
    done = []

    def measure(cell):
        if cell == "bad":
            raise IndexError("out of bounds")
        if cell == "stop":
            raise KeyboardInterrupt
        done.append(cell)
        return "well"

    folder = opened(place)
    assert not results.work(folder, ["good", "bad", "stop", "late"], measure, str.upper)
    assert (done, len(folder.failed)) == (["good"], 1)
    err = capsys.readouterr().err
    assert "failed: BAD: IndexError: out of bounds" in err
    assert "interrupted: 2 of 4" in err


# --- volumes around the numbers of regions enclose their samples, and miss hardly any others --------------------------

METHODS = ("aabb", "obb", "kdop", "sphere", "ellipsoid", "oriented-ellipsoid", "learned-kdop")


@pytest.mark.parametrize("query", ["ray", "plane", "box"])
@pytest.mark.parametrize(("name", "methods"), [("c", METHODS), ("animated", ("obb", "oriented-ellipsoid"))])
def test_samples_are_enclosed_and_others_are_hardly_missed(name, methods, query):
    x = sample(query, shape(name), SAMPLES, np.random.default_rng(0))
    x = x[oracle(query, shape(name), "cpu", 1.0)(x)]
    for method in methods[: 6 + (query != "ray")]:  # rays are slow to learn
        volume = fit(shape(name), query, method, steps=30)
        assert volume.query(x).mean() > 1 - 1e-3, method  # the rounding of products
        found = rates(volume.query, query, shape(name), 20_000, "exact", seed=3, length=volume.domain.oracle_length)
        assert found.fn < 0.005 * found.samples
        assert 0 < found.fp_rate + found.positives <= 100 + 1e-9


@pytest.mark.parametrize("query", ["ray", "box"])
def test_networks_over_the_numbers_deny_none_of_the_samples_that_set_their_threshold(query, monkeypatch):
    drawn, true = [], regions.RegionSamples.labelled
    monkeypatch.setattr(regions, "DRAWN", 5000)
    monkeypatch.setattr(regions, "BATCH", 1000)
    monkeypatch.setattr(regions.RegionSamples, "labelled", lambda self, n: drawn.append(true(self, n)) or drawn[-1])
    network = regions.fit(shape("c"), query, (8,), steps=60, length=0.7)
    found = [(network.network(v), truth) for v, truth in drawn]
    last = [f[truth] for f, truth in found[-regions.LEAST_DRAWS :]]
    assert min(f.min() for f in last) == network.threshold
    assert np.mean([f[truth].mean() - f[~truth].mean() for f, truth in found]) > 0  # it has learnt something
    grid, own = shape("c"), {"seed": 3, "length": network.domain.oracle_length}
    counted = rates(network.query, query, grid, 20_000, "exact", **own)
    assert counted.fn < 0.01 * counted.samples
    x = sample(query, grid, 20_000, np.random.default_rng(3))
    truth, maybe = oracle(query, grid, "cpu", network.domain.oracle_length)(x), network.query(x)
    assert (counted.fp_rate, counted.fn) == (pytest.approx(100 * (maybe & ~truth).mean()), (truth & ~maybe).sum())
    nothing = replace(network, threshold=np.inf)
    assert rates(nothing.query, query, grid, 20_000, "exact", **own).fn == truth.sum() > 0
    assert network.nbytes > 4 * (8 * 4 + 8 + 8 + 1)


def test_points_have_no_other_numbers():
    with pytest.raises(BounderError, match="expected regions"):
        fit(shape("c"), "point", "aabb")


@pytest.mark.parametrize("query", ["ray", "plane", "box"])
def test_sampled_labels_are_some_of_the_exact_ones(query):
    """Random points of a region miss thin hits and invent none."""
    grid = shape("star")
    x = sample(query, grid, 20_000, np.random.default_rng(2))
    labels, truth = SampledOracle(query, grid, "cpu", length=0.6)(x), oracle(query, grid, "cpu", 0.6)(x)
    assert not (labels & ~truth).any()
    assert 0 < labels.sum() < truth.sum()
