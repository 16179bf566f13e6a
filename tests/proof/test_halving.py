"""A proof by many processes is the same as by one, also when some of them die."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import ExitStack

import numpy as np
import pytest
import trimesh

import warp_bounding as wb
from warp_bounding.errors import BounderError, BoundingError
from warp_bounding.networks import network
from warp_bounding.proof import distances, halving, lowering
from warp_bounding.runtime import workers
from warp_bounding.runtime.workers import connected

distributed = pytest.importorskip("distributed", reason="needs Dask: pip install 'warp-bounding[bake]'")
OPTIONS = {"device": "cpu", "progress": False}


@pytest.fixture(scope="module")
def client():
    """A Dask client with two workers. Dask restarts a worker that is killed."""
    with connected(2) as client:
        yield client


@pytest.fixture(scope="module")
def torus() -> wb.shapes.Mesh:
    made = trimesh.creation.torus(1.0, 0.4, major_sections=24, minor_sections=12)
    return wb.shapes.Mesh(made.vertices, made.faces)


@pytest.mark.parametrize(
    ("query", "own"),
    [("point", {"hidden": (8, 8), "steps": 200}), ("distance", {"method": "distance-grid", "nodes": 6, "budget": 2.0})],
)
def test_many_processes_find_the_same(client, torus, query, own, tmp_path, monkeypatch):
    monkeypatch.setattr(halving, "FIRST", 1)
    monkeypatch.setattr(halving, "TASK", 0.1)
    bounder = wb.fit(torus, query, **own, **OPTIONS)
    client.wait_for_workers(2)  # the one that another test has killed may still begin
    whole, victim = wb.certify(bounder, torus), min(client.run(os.getpid).values())
    killer = threading.Timer(0.5, os.kill, (victim, signal.SIGKILL))
    killer.start()
    spread = wb.certify(bounder, torus, scheduler=client.scheduler.address, checkpoint=tmp_path / "left")
    killer.join()
    assert whole.proven
    assert (spread.kind, spread.boxes, spread.lower_bound) == ("proven", whole.boxes, whole.lower_bound)
    assert not (tmp_path / "left").exists()


def test_workers_have_the_bounds_of_the_proof(client, monkeypatch):
    """Workers look at the boxes of a learned distance that one process does, and prove no fault of the search."""
    made = trimesh.creation.icosphere(0)
    solid = wb.shapes.Mesh(made.vertices, made.faces)
    bounder = wb.fit(solid, "distance", "mlp", hidden=(8,), steps=200, budget=5.0, **OPTIONS)
    whole = wb.certify(bounder, solid)
    spread = wb.certify(bounder, solid, scheduler=client.scheduler.address)
    assert (spread.kind, spread.boxes, spread.lower_bound) == ("proven", whole.boxes, whole.lower_bound)
    met = float(distances._sampled(bounder, solid)[0].max())
    claim = bounder.to().freeze(float(np.float32(min(-met - bounder.rounding_bound() - 1e-6, 0.0))), None)
    claim.info = bounder.info
    true = network.SearchBounds.corners
    monkeypatch.setattr(network.SearchBounds, "corners", lambda *given: true(*given) + 0.01)
    bar = -float(np.nextafter(float(claim.threshold) + claim.rounding_bound(), np.inf))
    assert distances.overestimate_within(claim, solid, bar, 60.0)[0] <= bar  # by the search's bounds it would be
    monkeypatch.setattr(halving, "FIRST", 1)
    threads = {"processes": False, "n_workers": 1, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    with distributed.LocalCluster(**threads) as there:
        for scheduler in (None, there.scheduler_address):  # workers are threads of this process, where the fault is
            assert wb.certify(claim, solid, budget=3.0, scheduler=scheduler).kind != "proven"


def test_a_task_whose_result_was_taken_is_forgotten(client):
    """Else Dask does it again when the worker that holds its result dies, as long as anything refers to its future."""
    with workers.Workers(client.scheduler.address) as some:
        key, held = some.submit(abs, -1), [*some._running.values()]
        while not (done := some.ended(0.1)):
            pass
        assert done == [(key, 1)]
        for _ in range(100):
            if key not in client.run_on_scheduler(lambda dask_scheduler: list(dask_scheduler.tasks)):
                break
            time.sleep(0.1)
        else:
            pytest.fail("the scheduler still knows the task")
        assert held


def test_no_scheduler(torus, tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "CONNECT_SECONDS", 1)
    bounder = wb.fit(torus, hidden=(8, 8), steps=20, **OPTIONS)
    with pytest.raises(BoundingError, match="no scheduler answers"):
        wb.certify(bounder, torus, scheduler="tcp://127.0.0.1:1", checkpoint=tmp_path / "left")
    assert (tmp_path / "left").exists()  # whatever ends a proof, what is left of it is kept
    assert wb.certify(bounder, torus, checkpoint=tmp_path / "left").proven


@pytest.mark.slow  # a scheduler and its worker take some seconds to begin
def test_a_scheduler_that_goes_away(torus, tmp_path, monkeypatch):
    """One line, and what is left of the proof is kept."""
    monkeypatch.setattr(halving, "FIRST", 1)
    monkeypatch.setattr(halving, "TASK", 0.02)
    bounder, file = wb.fit(torus, hidden=(8, 8), steps=200, **OPTIONS), tmp_path / "address"
    options = ["--scheduler-file", str(file), "--no-dashboard"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    running: list[subprocess.Popen] = []
    with ExitStack() as ends:
        for part in (["dask_scheduler", "--port", "0"], ["dask_worker", "--nthreads", "1"]):
            words = [sys.executable, "-m", f"distributed.cli.{part[0]}", *part[1:], *options]
            running.append(ends.enter_context(subprocess.Popen(words, **quiet)))
            ends.callback(running[-1].kill)
            while not file.exists():
                time.sleep(0.1)
        address = json.loads(file.read_text())["address"]

        def gone(done, total):
            running[0].kill()

        with pytest.raises(BoundingError) as error:
            wb.certify(bounder, torus, scheduler=address, checkpoint=tmp_path / "left", progress=gone)
    assert "\n" not in str(error.value)
    assert "scheduler" in str(error.value)
    assert (tmp_path / "left").exists()
    assert wb.certify(bounder, torus, checkpoint=tmp_path / "left").proven


def test_a_statistical_threshold_becomes_a_proven_one(client, tmp_path, monkeypatch):
    """As low as the time allows; one that is stopped goes on with the threshold that it had chosen."""
    arm = wb.arms.Arm([wb.arms.Joint(), wb.arms.Joint()], [wb.arms.Body.capsule([0, 0, 0], [1, 0, 0], 0.1, link=1)])
    shape = wb.arms.ArmConfigurations(arm, [wb.arms.Body.sphere([0.7, 0.3, 0.0], 0.2)])
    found = wb.fit(shape, hidden=(4, 16), steps=300, statistical=True, **OPTIONS)
    whole = wb.proof.make_proven(found, shape, budget=600.0)
    assert whole.certificate.proven
    assert whole.threshold <= found.threshold
    assert wb.certify(whole, shape).proven

    def stop(done, total):
        raise KeyboardInterrupt

    monkeypatch.setattr(lowering, "_planned", lambda *_: 8)
    with pytest.raises(KeyboardInterrupt):
        wb.proof.make_proven(found, shape, progress=stop, checkpoint=tmp_path / "left")
    monkeypatch.undo()
    lower = wb.proof.make_proven(found, shape, budget=600.0, checkpoint=tmp_path / "left")
    assert whole.threshold > lower.threshold
    assert not (tmp_path / "left").exists()
    with pytest.raises(BounderError, match=r"larger budget= or more workers \(scheduler=\)"):
        wb.proof.make_proven(found, shape, budget=1e-9)
    spread = wb.fit(shape, hidden=(4, 16), steps=50, budget=60.0, scheduler=client.scheduler.address, **OPTIONS)
    assert spread.certificate.proven
    assert spread.info["rates"]["fp_rate"] < 100
    for query, method in (("plane", "kdop"), ("point", "kdop")):
        with pytest.raises(BounderError, match="scheduler is for"):
            wb.fit(shape, query, method, scheduler=2)
    for wrong in (0, -1, True, 2.5):
        with pytest.raises(BoundingError, match="an address or a number of processes"):
            wb.proof.make_proven(found, shape, scheduler=wrong)
        with pytest.raises(BoundingError, match="an address or a number of processes"):
            wb.certify(found, shape, scheduler=wrong)
    with pytest.raises(BounderError, match="budget"):
        wb.proof.make_proven(found, shape, budget=-1.0)
    balls = [wb.arms.Body.sphere([x, y, 0.0], 0.3) for x, y in ((0.7, -0.3), (-0.7, 0.3), (-0.7, -0.3))]
    other = wb.arms.ArmConfigurations(arm, balls)  # where the network is lowest, too
    with pytest.raises(BounderError, match="is arm its shape"):
        wb.proof.make_proven(found, other)
    grid = np.eye(8, dtype=bool)
    with pytest.raises(BounderError, match="shape without cells"):
        wb.proof.make_proven(wb.fit(grid, method="kdop", **OPTIONS), grid)
