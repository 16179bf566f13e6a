"""A small run of the fuzzer over every method and kind of query, and false claims that ``certify`` once called proven.

Each of these is refused where it is made, not proven, or true now; with the mend taken back, where that can be done
from outside, certify accepts it again, and the attack finds the denied positive. ``make fuzz`` is the long run.
"""

from dataclasses import replace

import fuzzing
import numpy as np
import pytest
from bounding_shapes import shape
from fuzzing import Tally, attack, fuzz, judge, undistracted
from mutations import File
from subjects import made, resolved, subjects

import warp_bounding as wb
from warp_bounding.bounders import learned_kdop
from warp_bounding.bounders.voxels import Voxels
from warp_bounding.errors import BounderError
from warp_bounding.queries.domain import Domain
from warp_bounding.queries.region_domain import domain_of

SUBJECTS = {subject.name: subject for subject in subjects()}
FILES, POSITIVES = 3, 256
OTHER = ("obb", "kdop", "learned-kdop")  # distances with six kernels each
LEFT = [name for name in SUBJECTS if " distance " in name and name.startswith(OTHER)]
FLAT = [n for n in SUBJECTS if ":" not in n and n not in LEFT and not n.endswith(("blob", "animated"))]  # in 2D
FEW = ("bvh point blob", "aabb box blob", "mlp point animated", "kdop point mesh: half-spaces, dilated")
DEEP = [n for n in SUBJECTS if n not in (*FLAT, *FEW)]  # kernels of their own; ``make fuzz`` has them, too


@pytest.mark.parametrize("name", [*FLAT, *FEW, *(pytest.param(n, marks=pytest.mark.slow) for n in DEEP)])
def test_no_false_claim_is_accepted(name):
    tally = fuzz(7, iterations=FILES, among=[SUBJECTS[name]], count=POSITIVES, quick=True)
    assert tally.counts["files"] == FILES
    assert not tally.found, tally.found


@pytest.mark.parametrize("name", [name for name in FLAT if name.endswith(" c")])
def test_the_honest_file_is_proven_and_holds(name, tmp_path, rng, monkeypatch):
    """Else the attack would ask what is no positive, or the fuzzer never get to attack."""
    monkeypatch.setattr(fuzzing, "SECONDS", 900.0)
    subject, tally = SUBJECTS[name], Tally()
    file = File.of(subject.bounder, tmp_path / "b.safetensors")
    file.agree(np.random.default_rng(0), len(subject.grid.occupied))
    file.write(tmp_path / "b.safetensors")
    with undistracted():
        assert judge(tmp_path / "b.safetensors", subject, rng, tally, POSITIVES, quick=True) is None
    assert tally.counts["proven"] == 1, tally
    assert tally.counts["queries"] > POSITIVES


# --- false claims that were accepted once ----------------------------------------------------------------------------


def proven(bounder, grid) -> bool:
    with undistracted():
        return wb.certify(bounder, grid).proven


def denied(bounder, grid, rng) -> bool:
    return attack(bounder, grid, rng, 2000, quick=True)[1] is not None


def backwards() -> tuple[Domain, dict[str, np.ndarray], dict]:
    """Voxels of twice as many cells along axis 0, in reverse order, of which every other one is empty.

    The middle of each of the object's cells falls into an occupied one, its ends do not.
    """
    grid, honest = shape("c"), made("voxels", "c", "point")
    rows = grid.shape[0]
    occupancy = np.zeros((2 * rows, grid.shape[1]), bool)
    occupancy[::2] = grid.occupancy[::-1]
    bits = np.packbits(occupancy.reshape(-1), bitorder="little")
    tensors = {k: t.copy() for k, t in honest.tensors.items()}
    tensors["bits"] = np.pad(bits, (0, -len(bits) % 4)).view("<u4").astype(np.uint32)
    tensors["summand"][0] = 2 * rows - 0.5 - 2 * tensors["summand"][0]
    tensors["factor"][0] *= 2
    return honest.domain, tensors, {"shape": list(occupancy.shape)}


def test_voxels_that_run_backwards_are_refused(rng):
    """The ends of a box changed places in the proof, so that every box lay in one cell."""
    domain, tensors, sizes = backwards()
    reverse = tensors | {"factor": tensors["factor"] * np.float32([-1, 1])}
    with pytest.raises(BounderError, match="positive factors"):
        Voxels(domain, reverse, sizes, "cpu")
    invalid = Voxels(domain, tensors, sizes, "cpu").freeze(0.5, None)
    invalid.tensors = reverse  # past the check
    assert proven(invalid, shape("c"))
    assert denied(invalid, shape("c"), rng)


def test_voxels_reach_less_than_half_a_cell():
    honest = made("voxels", "c", "point")
    for reach in (-1e-3, 0.75, 1e6):
        with pytest.raises(BounderError, match="reaches from 0 to 1/2"):
            Voxels(honest.domain, honest.tensors | {"reach": np.full(2, reach, np.float32)}, honest.sizes, "cpu")


def test_long_normals_cut_nothing_off(rng, monkeypatch):
    """Half-spaces have no second face; one that stands in for it at -2^20 lay inside the domain."""
    name = "c"
    honest, grid = made("learned-kdop", name, "plane"), shape(name)
    tensors = {k: t * np.float32(2.0**24) for k, t in honest.tensors.items()}
    long = resolved(type(honest)(honest.domain, tensors, {}, "cpu"), name)
    assert proven(long, grid)
    assert not denied(long, grid, rng)
    monkeypatch.setattr(learned_kdop, "second_faces", lambda normals, _: np.full(len(normals), -(2.0**20)))
    invalid = resolved(type(honest)(honest.domain, tensors, {}, "cpu"), name)
    assert proven(invalid, grid)
    assert denied(invalid, grid, rng)


def test_a_flat_field_is_looked_up_inside_its_grid():
    """Its rounding is 0 whatever the node coordinates are, infinite ones included, which have no index."""
    honest = made("relu-field", "c", "point")
    tensors = {k: t.copy() for k, t in honest.tensors.items()}
    tensors["values"][:] = 1
    tensors["factor"][:] = 3e38
    with pytest.raises(BounderError, match="so large"):
        type(honest)(honest.domain, tensors, honest.sizes, "cpu")


def test_no_bound_is_no_proof(monkeypatch):
    """A bound that is NaN must not get lost in a minimum."""
    bounder, grid = made("aabb", "c", "ray"), shape("c")
    spoilt = type(bounder).bound

    def lost(self, lower, upper):
        found = spoilt(self, lower, upper)
        return found._replace(lower=found.lower * np.nan)

    monkeypatch.setattr(type(bounder), "bound", lost)
    with pytest.raises(BounderError, match="do not hold"):
        bounder.least(grid)
    assert not proven(bounder, grid)


def test_a_domain_is_taken_to_about_one():
    domain = domain_of(shape("c"))
    for by in (2.0**-40, 2.0**-3, 2.0**3, 2.0**40):
        single = {k: (getattr(domain, k) * by).astype(np.float32) for k in ("scale", "limit")}
        assert "[-1, 1]" in replace(domain, **single, delta=domain.delta * by).fault()


@pytest.mark.parametrize(
    ("directions", "words"),
    [([[1, 2], [2, 4], [-1, -2]], "do not bound a polytope"), (np.ones((800, 3)), "choices")],
    ids=["parallel", "many"],
)
def test_half_spaces_that_bound_nothing_are_refused(directions, words):
    normals = np.array(directions, np.float32)
    domain = domain_of(shape({2: "c", 3: "blob"}[normals.shape[1]]), "plane")
    with pytest.raises(BounderError, match=words):
        wb.METHODS["learned-kdop"](
            domain, {"normals": normals, "offsets": np.ones(len(normals), np.float32)}, {}, "cpu"
        )
