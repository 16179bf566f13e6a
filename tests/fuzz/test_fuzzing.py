"""A small run of the fuzzer over every method, kind of query and dimension; ``make fuzz`` is the long one."""

import fuzzing
import numpy as np
import pytest
from fuzzing import Tally, fuzz, judge, undistracted
from mutations import MUTATIONS, File, mutate
from subjects import subjects

SUBJECTS = {subject.name: subject for subject in subjects()}
FILES, POSITIVES = 4, 256
OTHER = ("obb", "kdop", "learned-kdop", "sphere", "ellipsoid", "oriented-ellipsoid")  # distances with six kernels each
FLAT = [  # in 2D
    name
    for name in SUBJECTS
    if ":" not in name
    and not name.endswith(("blob", "animated"))
    and not (" distance " in name and name.startswith(OTHER))
]
DEEP = [name for name in SUBJECTS if name not in FLAT]  # kernels of their own; ``make fuzz`` has them, too
FEW = ("bvh point blob", "aabb box blob", "mlp point animated", "kdop point mesh: half-spaces, dilated")


@pytest.mark.parametrize(
    "name", [*FLAT, *FEW, *(pytest.param(n, marks=pytest.mark.slow) for n in DEEP if n not in FEW)]
)
def test_no_lie_is_accepted(name, monkeypatch):
    monkeypatch.setattr(fuzzing, "STUCK", 1000)  # what does not end shows itself; a slow machine is no fault
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


def test_iterations_depend_on_their_number_alone(tmp_path):
    honest = File.of(SUBJECTS["voxels+mlp point c"].bounder, tmp_path / "b.safetensors")
    first, second = (mutate(honest.copy(), np.random.default_rng([3, 5])) for _ in range(2))
    assert first == second
    assert first


def test_every_mutation_finds_something_to_change(tmp_path):
    rng, found = np.random.default_rng(0), set()
    honest = [File.of(s.bounder, tmp_path / "b.safetensors") for n, s in SUBJECTS.items() if n.endswith(" c")]
    for mutation in MUTATIONS:
        for file in honest:
            before = file.copy()
            if mutation(spoilt := file.copy(), rng):
                changed = spoilt.document != before.document or any(
                    k not in spoilt.tensors or spoilt.tensors[k].tobytes() != t.tobytes()
                    for k, t in before.tensors.items()
                )
                if changed or set(spoilt.tensors) != set(before.tensors):
                    found.add(mutation)
    assert found == set(MUTATIONS)
