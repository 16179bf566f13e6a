"""Headers for C and C++ answer as ``query`` does, under every compiler, language and option; nothing is missed."""

import ctypes
import shutil
import subprocess
from functools import cache

import numpy as np
import pytest
from bounding_shapes import (
    domain_points,
    object_points,
    random_bounder,
    random_mlp,
    reloaded,
    rounding_of_answers,
    shape,
)
from commands import ROOT, check_bad, fit, run
from distances import far, squared_distance_to_cells
from plain_shapes import LEANING, TETRAHEDRON
from region_cases import REGIONS, VOLUMES, fitted_region, hard_regions, ray_length
from scipy.spatial.transform import Rotation
from snippets import FENCED

import warp_bounding as wb
from warp_bounding.bounders import DISTANCES, METHODS
from warp_bounding.bounders.cascade import Cascade
from warp_bounding.bounders.file_format import digest_of, read
from warp_bounding.queries import oracle

COUNT = 100_000
STEP = np.float32([0.25, 0, 0])  # of the segments that are asked
STRICT = ("-Wall", "-Wextra", "-Werror", "-shared", "-fPIC")
OPTIONS = ("-O0", "-O2", "-O3 -march=native")
LANGUAGES = {"c": "-std=c99 -pedantic", "c++": "-std=gnu++11"}
ASK = """
void ask_{0}(const float *q, int count, unsigned char *answers) {{ {0}_maybe_many(q, count, answers); }}
"""
MEASURE = """
void ask_{0}(const float *q, int count, float *d, unsigned char *near, unsigned char *swept) {{
    for (int i = 0; i < count; ++i) {{
        d[i] = {0}_distance(q + 3 * i);
        near[i] = (unsigned char){0}_within(q + 3 * i, 0.1f);
        const float end[3] = {{q[3 * i] + 0.25f, q[3 * i + 1], q[3 * i + 2]}};
        swept[i] = (unsigned char){0}_segment(q + 3 * i, end, 0.1f);
    }}
}}
"""


@cache
def bounders() -> dict[str, wb.Bounder]:
    """One of every method and kind of query, by the name of its header."""
    grid = shape("blob")
    points = {method: random_bounder(method, "blob") for method in METHODS}
    found = points | {f"{m} {query}": fitted_region(m, query, grid) for m in VOLUMES for query in REGIONS}
    found["mlp wide"] = random_mlp(grid, (50, 50), "relu")
    found["mlp time"] = random_bounder("mlp", "animated")
    found["cascade"] = Cascade.of([points["aabb"], points["voxels"], points["mlp"]])
    found |= {f"{method} distance": far(method, "blob") for method in DISTANCES}
    return {name.replace("-", "_").replace(" ", "_"): bounder for name, bounder in found.items()}


@cache
def queries(query: str, ndim: int) -> np.ndarray:
    """Hard ones, most of which meet the object barely, and some that are no numbers."""
    rng, grid = np.random.default_rng(3), shape("blob" if ndim == 3 else "animated")
    if query in REGIONS:
        q = hard_regions(query, grid, rng, ray_length(grid), COUNT // 2)
    else:
        x = np.concatenate([object_points(grid, rng, COUNT), domain_points(grid, COUNT, rng)])
        q = rng.permutation(x)[:COUNT].astype(np.float32)
    if query == "distance":
        q[::5] = 3 * q[::5] - 1  # what is farther away
    q[::997, 0], q[1::997, -1] = np.nan, np.inf
    return np.ascontiguousarray(q)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The headers, and a source that asks all of them."""
    place, lines = tmp_path_factory.mktemp("headers"), []
    for name, bounder in bounders().items():
        bounder.export(place / f"{name}.h")
        lines.append(f'#include "{name}.h"')
    open_, close = ('#ifdef __cplusplus\nextern "C" {\n#endif', "#ifdef __cplusplus\n}\n#endif")
    asked = [(MEASURE if each.of_distances else ASK).format(name) for name, each in bounders().items()]
    declared = [text[: text.index("{")].strip() + ";" for text in asked]
    (place / "all.c").write_text("\n".join([*lines, open_, *declared, *asked, close, ""]))
    return place


def compiled(compiler: str, language: str, options: str, source, output):
    """Standard error of a compiler, empty where all is well."""
    name = {"gcc": {"c": "gcc", "c++": "g++"}, "clang": {"c": "clang", "c++": "clang++"}}[compiler][language]
    if shutil.which(name) is None:
        pytest.skip(f"there is no {name}")
    line = [name, "-x", language, *LANGUAGES[language].split(), *options.split(), *STRICT, source, "-o", output, "-lm"]
    return subprocess.run(line, capture_output=True, text=True, check=False).stderr


def pointer(array: np.ndarray):
    return array.ctypes.data_as(ctypes.c_void_p)


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_answers_are_those_of_query(compiler, language, options, folder, tmp_path):
    """Equal; but where products and sums are fused, what is rounded may decide, and no positive is missed."""
    assert compiled(compiler, language, options, folder / "all.c", tmp_path / "all.so") == ""
    library = ctypes.CDLL(str(tmp_path / "all.so"))
    for name, bounder in bounders().items():
        q, ask = queries(bounder.query_kind, bounder.ndim), library[f"ask_{name}"]
        if bounder.of_distances:
            check_distances(ask, bounder, q)
            continue
        answers, expected = np.empty(len(q), np.uint8), answers_of(name)
        ask(pointer(q), len(q), pointer(answers))
        assert (answers != expected).mean() < 1e-3, name
        if len(denied := q[expected & (answers == 0)]):
            if bounder.rounding_bound() > 0:
                near = np.abs(bounder.values(denied).numpy() - bounder.threshold)
                assert near.max() <= 2 * rounding_of_answers(bounder), name
            else:
                assert not oracle(bounder.query_kind, shape("blob"), "cpu", ray_length(shape("blob")))(denied).any(), (
                    name
                )


@cache
def answers_of(name: str) -> np.ndarray:
    bounder = bounders()[name]
    return bounder.query(queries(bounder.query_kind, bounder.ndim)).numpy()


@cache
def distances_of(bounder) -> tuple[np.ndarray, ...]:
    q = queries("distance", 3)
    return bounder.distance(q).numpy(), bounder.query(q, 0.1).numpy(), bounder.segments(q, q + STEP, 0.1)[0].numpy()


@cache
def exact(i: int, t: float = 0.0):
    """The squared distance at a time of a query's segment."""
    return squared_distance_to_cells(shape("blob"), queries("distance", 3)[i].astype(np.float64) + t * STEP)


def check_distances(ask, bounder, q):
    found = np.empty(len(q), np.float32), np.empty(len(q), np.uint8), np.empty(len(q), np.uint8)
    ask(pointer(q), len(q), *map(pointer, found))
    distance, near, swept = distances_of(bounder)
    assert np.abs(found[0] - distance).max() < 1e-6
    assert (found[1] != near).mean() < 1e-4
    assert (found[2] != swept).mean() < 1e-4
    for i in range(2, 40):
        if np.isfinite(q[i]).all():
            assert float(found[0][i]) ** 2 <= exact(i)
    inside = shape("blob").contains(q)
    assert not found[0][inside].any()
    assert found[1][inside].all()
    clear = np.flatnonzero(found[2] == 0)
    assert len(clear)
    for i in clear[:40].tolist():
        assert all(exact(i, t) > 0.01 for t in (0.0, 0.25, 0.5, 0.75, 1.0))


def test_pairs(tmp_path):
    """A pair of placed meshes answers as ``Pair.query`` does, in C and C++, and misses no vertex near another one."""
    rng, mesh = np.random.default_rng(5), wb.shapes.Mesh(LEANING * 3.0, TETRAHEDRON[1])
    pair = wb.pairs.Pair(wb.fit(mesh, "distance", "kdop", progress=False), wb.pairs.Balls.of(mesh, 24))
    pair.export(tmp_path / "pair.h")

    def corners(x):
        turned = [Rotation.from_quat(x[:, 3:]).apply(np.tile(v, (len(x), 1))) for v in mesh.vertices.astype(np.float64)]
        return np.stack(turned, axis=1) + x[:, None, :3]

    ask = "void ask(const float *a, const float *b, int count, unsigned char *near, float *d)"
    loop = "for (int i = 0; i < count; ++i) near[i] = (unsigned char)pair_maybe(a + 7 * i, b + 7 * i, 0.1f),"
    text = f'#include "pair.h"\n{ask};\n{ask} {{ {loop} d[i] = pair_distance(a + 7 * i, b + 7 * i); }}\n'
    (tmp_path / "ask.c").write_text(text.replace("void ask", '\n#ifdef __cplusplus\nextern "C"\n#endif\nvoid ask', 1))
    places = rng.normal(size=(2, COUNT // 10, 7)) * ([2.0] * 3 + [1.0] * 4)
    places[..., 3:] /= np.linalg.norm(places[..., 3:], axis=2, keepdims=True)
    away = rng.normal(size=(COUNT // 20, 3))  # of half of them: a vertex of B from one of A
    away *= rng.uniform(0, 0.11, (len(away), 1)) / np.linalg.norm(away, axis=1, keepdims=True)
    places[1, ::2, :3] += corners(places[0])[::2, 0] - corners(places[1])[::2, 3] + away
    a, b = np.ascontiguousarray(places, dtype=np.float32)
    at_a, at_b = (corners(x.astype(np.float64)) for x in (a, b))
    high = np.linalg.norm(at_a[:, :, None] - at_b[:, None], axis=3).min(axis=(1, 2))
    near, distance = np.empty(len(a), np.uint8), np.empty(len(a), np.float32)
    expected, distances = pair.query(a, b, 0.1).numpy(), pair.distance(a, b).numpy()
    assert 0.05 < expected.mean() < 0.95
    for language in LANGUAGES:
        assert compiled("gcc", language, "-O2", tmp_path / "ask.c", tmp_path / f"{language}.so") == ""
        ctypes.CDLL(str(tmp_path / f"{language}.so")).ask(
            *map(pointer, (a, b)), len(a), *map(pointer, (near, distance))
        )
        assert (near != expected).mean() < 1e-4
        assert np.abs(distance - distances).max() < 1e-4
        assert (distance <= high).all()
        assert near[high <= 0.1].all()
    assert (high <= 0.1).any()


def test_cuda(folder, tmp_path):
    if shutil.which("nvcc") is None:
        pytest.skip("there is no nvcc")
    text = "".join(f'#include "{folder}/{name}.h"\n' for name in bounders())
    asked = [name for name, bounder in bounders().items() if not bounder.of_distances]
    calls = "".join(f"    *found += {name}_maybe(q);\n" for name in asked)
    (tmp_path / "all.cu").write_text(f"{text}__global__ void ask(const float *q, int *found) {{\n{calls}}}\n")
    line = ["nvcc", "-arch=sm_90", "-cubin", tmp_path / "all.cu", "-o", tmp_path / "all.cubin"]
    assert subprocess.run(line, capture_output=True, text=True, check=False).returncode == 0


def test_the_guide_compiles(tmp_path):
    page = (ROOT / "docs/guide/in-cpp.md").read_text()
    code = next(text for language, text in FENCED.findall(page) if language == "c")
    bounders()["mlp_wide"].export(tmp_path / "bunny.h")
    bounders()["kdop_distance"].export(tmp_path / "far.h")
    (tmp_path / "guide.c").write_text(code)
    for language in LANGUAGES:
        assert compiled("gcc", language, "-O2", tmp_path / "guide.c", tmp_path / "guide.so") == ""


def test_fast_math_is_refused(folder, tmp_path):
    assert "leave it out" in compiled("gcc", "c", "-O2 -ffast-math", folder / "aabb.h", tmp_path / "none")


def test_the_comment_names_the_file_and_its_claim(tmp_path):
    bounder = reloaded(far("kdop", "blob"), tmp_path)
    bounder.save(tmp_path / "b.safetensors")
    bounder.export(tmp_path / "b.h")
    text = (tmp_path / "b.h").read_text()
    assert digest_of(*read(tmp_path / "b.safetensors")) in text
    assert "certificate: proven" in text


def test_mistakes_of_the_command(capsys, tmp_path):
    np.save(tmp_path / "c.npy", shape("c").occupancy)
    path, _ = fit(capsys, tmp_path)
    for _ in range(2):  # an export is replaced by another
        assert run(capsys, "export", path, "-o", tmp_path / "c.h")[0] == 0
    (tmp_path / "other.h").write_text("int main(void);\n")
    check_bad(*run(capsys, "export", path, "-o", tmp_path / "other.h"))
    assert (tmp_path / "other.h").read_text() == "int main(void);\n"
    for name in ("2d", "a b", "é", ""):
        check_bad(*run(capsys, "export", path, "-o", tmp_path / "c.h", "--name", name))
    check_bad(*run(capsys, "export", path, "-o", path))


def test_an_origin_is_refused(tmp_path):
    shifted = wb.load_shape(shape("blob").occupancy, spacing=0.1, origin=(5e5, 4e6, 12.0))
    bounder = wb.fit(shifted, method="aabb", device="cpu", progress=False)
    with pytest.raises(wb.QueryError, match="local"):
        bounder.export(tmp_path / "b.h")
    bounder.local.export(tmp_path / "b.h")
