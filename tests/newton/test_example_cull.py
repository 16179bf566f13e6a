"""The example for Newton's users, run as they run it: with the cull, without, and with a viewer."""

import sys

import pytest

pytest.importorskip("newton", reason="Newton is not installed: pip install '.[newton]'")

from newton.viewer import ViewerNull

from sims.newton.example_cull import Example, main

SMALL = ["--meshes", "2", "--side", "16", "--quiet"]


def run(monkeypatch, capsys, *arguments: str) -> str:
    monkeypatch.setattr(sys, "argv", ["example_cull", *SMALL, *arguments])
    main()
    return capsys.readouterr().out


def test_it_ends_in_the_state_of_the_run_without(monkeypatch, capsys):
    reported = run(
        monkeypatch, capsys, "--viewer", "null", "--headless", "--num-frames", "12", "--test", "--device", "cpu"
    )
    assert "289 particles, 4 shapes, cpu" in reported
    assert "mesh with a bounder" in reported
    assert "the cull's own time included" in reported


def test_a_state_that_differs_is_found():
    """The comparison that ends the run can fail."""
    args = Example.create_parser().parse_args([*SMALL, "--viewer", "null"])
    example = Example(ViewerNull(num_frames=2), args)
    example.step()
    example.test_final()
    example.frames += 1
    with pytest.raises(ValueError, match="expected the same particle_q as without the cull"):
        example.test_final()
