"""Bounders of demos: fitted, or loaded where a file is of the very shape."""

import numpy as np
import pytest
from plain_shapes import TETRAHEDRON

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


def test_what_does_not_fit_is_refused_with_both_numbers():
    mesh, grid = wb.shapes.Mesh(*TETRAHEDRON), disc()
    cells, inner = FitSpec("aabb", resolution=8), FitSpec("mlp", options=MLP.options | {"side": "inside"})
    rays, whole = FitSpec("aabb", query="ray", options={"length": 2.0}), FitSpec("aabb")
    for own, of, other, given, words in (
        (MLP, grid, MLP, disc(0.35), "another shape, array; expected"),
        (MLP, grid, MLP, grid.to_grid(margin=0.05), r"too small a margin, expected 0\.05, got 0"),
        (MLP, grid, inner, grid, "from the inside, got one from the other side"),
        (MLP, grid, FitSpec("kdop"), grid, "of method kdop, got mlp"),
        (cells, mesh, whole, mesh, "itself, got one of its cells at resolution 8"),
        (whole, mesh, cells, mesh, "cells at resolution 8, got one of the shape itself"),
        (rays, grid, FitSpec("aabb", query="ray"), grid, "rays of length 1, got 2"),
    ):
        bounder = fit(own, of, device="cpu")
        check_fit(bounder, of, own, "file")
        with pytest.raises(wb.BounderError, match=words):
            check_fit(bounder, given, other, "file")
