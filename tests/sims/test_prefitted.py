"""Bounders of demos: fitted, or loaded where a file is of the very shape."""

import numpy as np
import pytest

import warp_bounding as wb
from sims import prefitted
from sims.prefitted import FitSpec, bounder_from, bounders_of, check_fit, fit, stored

MLP = FitSpec("mlp", options={"hidden": (8,), "steps": 10})


def disc(radius=0.3, resolution=16) -> wb.shapes.Grid:
    x = np.stack(np.meshgrid(*[np.linspace(0, 1, resolution)] * 2, indexing="ij"), axis=-1)
    return wb.shapes.Grid(np.linalg.norm(x - 0.5, axis=-1) < radius)


def test_closed_forms_are_fitted_and_networks_loaded(tmp_path, monkeypatch):
    monkeypatch.setattr(prefitted, "FOLDER", tmp_path)
    grid, specs = disc(), {"aabb": FitSpec("aabb"), "mlp": MLP, "aabb+mlp": FitSpec("aabb+mlp")}
    with pytest.raises(wb.BounderError, match="there is no bounder for this shape; --refit fits one"):
        bounders_of("disc", grid, specs)
    made = bounders_of("disc", grid, specs, refit=True, out=tmp_path)
    assert list(made) == list(specs)
    assert made["aabb+mlp"].certificate.proven
    path = stored("disc", "mlp", tmp_path)
    assert path.is_file()
    assert bounder_from(path, grid, MLP, device="cpu").threshold == made["mlp"].threshold


def test_what_does_not_fit_is_refused_with_both_numbers(tmp_path):
    grid = disc()
    bounder = fit(MLP, grid, device="cpu")
    check_fit(bounder, grid, MLP, "file")
    with pytest.raises(wb.BounderError, match="another shape, array; expected"):
        check_fit(bounder, disc(0.35), MLP, "file")
    with pytest.raises(wb.BounderError, match=r"too small a margin, expected 0\.05, got 0"):
        check_fit(bounder, grid.to_grid(margin=0.05), MLP, "file")
    cells = FitSpec("aabb", resolution=8)
    mesh = wb.shapes.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    for own, other, got in (
        (cells, FitSpec("aabb"), "itself, got one of its cells at resolution 8"),
        (FitSpec("aabb"), cells, "cells at resolution 8, got one of the shape itself"),
    ):
        made = fit(own, mesh, device="cpu")
        check_fit(made, mesh, own, "file")
        with pytest.raises(wb.BounderError, match=got):
            check_fit(made, mesh, other, "file")
    inner = FitSpec("mlp", options=MLP.options | {"side": "inside"})
    with pytest.raises(wb.BounderError, match="from the inside, got one from the other side"):
        check_fit(bounder, grid, inner, "file")
    with pytest.raises(wb.BounderError, match="of method mlp-early, got mlp"):
        check_fit(bounder, grid, FitSpec("mlp-early"), "file")
    rays = FitSpec("aabb", query="ray", options={"length": 2.0})
    with pytest.raises(wb.BounderError, match="rays of length 1, got 2"):
        check_fit(fit(rays, grid, device="cpu"), grid, FitSpec("aabb", query="ray"), "file")
    bounder.certificate = None
    with pytest.raises(wb.BounderError, match="expected a bounder with a certificate"):
        check_fit(bounder, grid, MLP, "file")
