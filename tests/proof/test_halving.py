"""A proof by many processes is the same as by one, also when some of them die."""

import os
import signal
import threading

import pytest
import trimesh

import warp_bounding as wb
from warp_bounding.errors import BoundingError
from warp_bounding.proof import halving
from warp_bounding.runtime import workers
from warp_bounding.runtime.workers import connected

pytest.importorskip("distributed", reason="needs Dask: pip install 'warp-bounding[bake]'")
OPTIONS = {"device": "cpu", "progress": False}


@pytest.fixture(scope="module")
def client():
    """Of two workers, which begin anew when they are killed."""
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
    whole, victim = wb.certify(bounder, torus), min(client.run(os.getpid).values())
    killer = threading.Timer(0.5, os.kill, (victim, signal.SIGKILL))
    killer.start()
    spread = wb.certify(bounder, torus, scheduler=client.scheduler.address, checkpoint=tmp_path / "left")
    killer.join()
    assert whole.proven
    assert (spread.kind, spread.boxes, spread.lower_bound) == ("proven", whole.boxes, whole.lower_bound)
    assert not (tmp_path / "left").exists()


def test_no_scheduler(torus, tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "CONNECT_SECONDS", 1)
    bounder = wb.fit(torus, hidden=(8, 8), steps=20, **OPTIONS)
    with pytest.raises(BoundingError, match="no scheduler answers"):
        wb.certify(bounder, torus, scheduler="tcp://127.0.0.1:1", checkpoint=tmp_path / "left")
    assert (tmp_path / "left").exists()  # whatever ends a proof, what is left of it is kept
    assert wb.certify(bounder, torus, checkpoint=tmp_path / "left").proven
