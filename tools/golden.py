"""Hashes of what must not change: answers, native text, verdicts of ``certify``, and the demos' final states.

    python tools/golden.py FOLDER -o before.json             # before a change
    python tools/golden.py FOLDER --compare before.json      # after it: prints what differs, and exits with 1 if
    anything does

FOLDER keeps a small bounder of every method, kind of query and dimension. What is missing there is fitted in few steps;
what is there is loaded, so that a later run asks the very same bounders, and shows that their files are still read.
Numbers depend on the processor's vector width: compare runs of one machine. ``--slow`` certifies everything, which
takes minutes of an arm of four joints; ``--only`` takes parts, and ``--kept`` asks what FOLDER keeps and fits nothing.
What was hashed before a run is ended is written.
"""

import argparse
import hashlib
import json
import math
import re
import signal
import sys
import tempfile
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import warp as wp

import sims.base
import warp_bounding as wb
from sims import DEMOS
from sims.prefitted import FOLDER as BUNDLED

PARTS = ("answers", "fits", "bundled", "edges", "pairs", "choose", "certify", "demos")
QUERIES = ("point", "ray", "plane", "box")
SLOW = ("arm-planar-4-", "digits-10-", "shadows-", "cloth-")  # files whose proofs take longest
FEW = {"hidden": (8,), "steps": 3}
LEARNED = {"mlp": FEW, "occupancy": FEW}
LEARNED |= {"learned-kdop": {"steps": 3}, "relu-field": {"steps": 3}}
MOST = {"voxels": ("point",), "relu-field": ("point",), "learned-kdop": ("point", "ray")}
DISTANCES = ("aabb", "obb", "kdop", "bvh", "learned-kdop", "distance-grid", "mlp")
CASCADES = (("point", "aabb+kdop+mlp"),)
CLOSED = ("aabb", "obb", "sphere", "kdop", "bvh")  # of which ``choose`` counts what no clock decides

kept_only = False
found: dict[str, str] = {}
native: dict[str, str] = {}


def sha(*parts) -> str:
    """Hash arrays (type, shape and bytes) and text. Bool counts as uint8, the type of older answers."""
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, wp.array):
            part = part.numpy()
        if isinstance(part, np.ndarray):
            part = part.view(np.uint8) if part.dtype == bool else part
            digest.update(f"{part.dtype.str}{part.shape}".encode())
            part = np.ascontiguousarray(part).tobytes()
        digest.update(part if isinstance(part, bytes) else str(part).encode())
    return digest.hexdigest()[:20]


def record_native() -> None:
    """Remember the text of every native function; tags, which tell sources apart, are left out."""
    original = wp.func_native

    def func_native(snippet, *arguments, **named):
        text = re.sub(r"!= \d+u", "!= TAG", snippet)

        def decorate(function):
            native[sha(text)] = re.sub(r"_[0-9a-f]{16}_", "_", function.__name__)
            return original(snippet, *arguments, **named)(function)

        return decorate

    wp.func_native = func_native


def objects() -> dict[str, object]:
    """Small shapes: grids of two, three and four dimensions, the last of which is animated."""
    rng = np.random.default_rng(5)
    two = np.zeros((12, 12), bool)
    two[2:10, 2:10], two[4:8, 4:] = True, False
    axes = np.abs(np.stack(np.meshgrid(*[np.linspace(-1, 1, 11)] * 3, indexing="ij")))
    star = np.sqrt(axes).sum(axis=0) < 1.3
    star |= rng.random(star.shape) < 0.03
    animated = np.zeros((5, 7, 6, 8), bool)
    for step in range(5):
        animated[step, 1 + step // 2 : 3 + step // 2, 1:4, step : step + 3] = True
    grid = wb.shapes.Grid
    return {"2d": grid(two), "3d": grid(star), "4d": grid(animated, time=True)}


def numbers(query: str, ndim: int, lower: np.ndarray, upper: np.ndarray, count: int = 4000) -> np.ndarray:
    """Queries in and around a box, float32, some of them impossible."""
    rng, size = np.random.default_rng(11), upper - lower
    a = lower - 0.1 * size + rng.random((count, ndim)) * 1.2 * size
    if query == "point":
        q = a
    elif query == "ray":
        q = np.concatenate([a, rng.normal(size=a.shape)], axis=1)
    elif query == "plane":
        q = np.concatenate([rng.normal(size=a.shape), a], axis=1)
    else:
        q = np.concatenate([a, a + size * rng.random(a.shape) ** 2 / 2], axis=1)
    q = q.astype(np.float32)
    q[::997, -1], q[1::997, 0] = np.nan, np.inf
    return q


def made(folder: Path, name: str, shape, **options):
    """The bounder of this name in the folder, fitted if it is not there."""
    path = folder / f"{name}.safetensors"
    if not path.is_file() and kept_only:
        return None
    if not path.is_file():
        wb.fit(shape, device="cpu", progress=False, budget=600.0, **options).save(path)
    try:
        return wb.load(path, device="cpu")
    except wb.FileFormatError:  # what it holds is gone
        return None


def ask(name: str, bounder, query: str, shape, placed: bool = False) -> None:
    """Hash what a bounder of points or regions answers, and the numbers that a kernel reads."""
    if bounder is None:
        return
    x = numbers(query, bounder.ndim, np.asarray(shape.lower), np.asarray(shape.upper))
    if bounder.domain.columns != x.shape[1]:
        raise SystemExit(f"{name}: {bounder.domain.columns} numbers expected")
    found[f"values {name}"] = sha(bounder.values(x))
    found[f"query {name}"] = sha(bounder.query(x))
    found[f"numbers {name}"] = sha(bounder.data.parameters.numpy()[4:], bounder.data.words, bounder.nbytes)
    bounder.func  # noqa: B018 (its text is recorded)
    if placed:
        turned = wp.transform(
            wp.vec3(0.3, -0.2, 0.1), wp.quat_from_axis_angle(wp.normalize(wp.vec3(1.0, 2.0, 3.0)), 0.7)
        )
        found[f"placed {name}"] = sha(bounder.values(x, xform=turned, scale=1.5))


def query_distance(name: str, bounder, shape) -> None:
    """Hash distances, radii, segments and boxes."""
    if bounder is None:
        return
    lower, upper = np.asarray(shape.lower), np.asarray(shape.upper)
    x = numbers("point", bounder.ndim, lower, upper)
    found[f"distance {name}"] = sha(bounder.distance(x))
    found[f"radius {name}"] = sha(bounder.query(x, radius=0.05))
    found[f"numbers {name}"] = sha(bounder.data.parameters.numpy()[4:], bounder.data.words, bounder.nbytes)
    bounder.distance_func  # noqa: B018
    if bounder.domain.time or not name.startswith(("mlp", "distance-grid", "kdop", "bundled")):
        return
    maybe, t = bounder.segments(x[:500], x[500:1000], radius=0.01)
    found[f"segments {name}"] = sha(maybe, t)
    box = numbers("box", bounder.ndim, lower, upper, 500)
    found[f"boxes {name}"] = sha(bounder.boxes(box[:, : bounder.ndim].copy(), box[:, bounder.ndim :].copy()))


def answers(folder: Path) -> None:
    """Every method, kind of query and dimension; distances; cascades, both sides; functions' text."""
    folder.mkdir(parents=True, exist_ok=True)
    shapes = objects()
    methods = ("aabb", "obb", "sphere", "ellipsoid", "oriented-ellipsoid", "kdop", "bvh", "voxels", *LEARNED)
    for where, shape in shapes.items():
        for method in methods:
            for query in QUERIES if where != "4d" else ("point",):
                if query not in MOST.get(method, QUERIES) or not wb.METHODS[method].supports(query, shape.ndim):
                    continue
                bounder = made(
                    folder, f"{method}-{query}-{where}", shape, query=query, method=method, **LEARNED.get(method, {})
                )
                ask(
                    f"{method} {query} {where}",
                    bounder,
                    query,
                    shape,
                    placed=where == "3d" and method in ("kdop", "mlp", "sphere"),
                )
        for method in DISTANCES:
            if where == "4d" and method not in ("distance-grid", "mlp"):
                continue
            options, still = FEW if method == "mlp" else LEARNED.get(method, {}), replace(shape, time=False)
            bounder = made(folder, f"{method}-distance-{where}", still, query="distance", method=method, **options)
            query_distance(f"{method} {where}", bounder, shape)
    three = shapes["3d"]
    for query, method in CASCADES:
        bounder = made(folder, f"{method}-{query}-3d", three, query=query, method=method, **FEW | {"hidden": (6, 5)})
        ask(f"{method} {query} 3d", bounder, query, three)
    inner = made(folder, "inside-3d", three, side="inside", **FEW)
    ask("inside point 3d", inner, "point", three)
    outer = made(folder, "mlp-point-3d", three, **FEW)
    x = numbers("point", 3, np.asarray(three.lower), np.asarray(three.upper))
    if outer is not None and inner is not None:
        found["classify 3d"] = sha(wb.two_sided(outer, inner).classify(x))


def fits() -> None:
    """What short fits of every learned method give, in steps, which repeat to the bit: their numbers and verdicts."""
    shapes = objects()
    axes = np.indices((2, 2, 2)).reshape(3, -1).T * 1.0
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = np.array([[q[0], q[i], q[i + 1]] for q in quads for i in (1, 2)])
    shapes["mesh"] = wb.shapes.Mesh(axes, faces, name="cube")
    shapes["ball"] = wb.shapes.Function(
        None, [-1, -1], [1, 1], distance=lambda x: np.linalg.norm(x, axis=1) - 0.8, name="ball"
    )
    joint = wb.arms.Joint(lower=-2.0, upper=2.0)
    links = [wb.arms.Body.capsule([0, 0, 0], [1, 0, 0], 0.1, link=k) for k in (0, 1)]
    step = np.eye(4)
    step[0, 3] = 1.0
    arm = wb.arms.Arm([joint, wb.arms.Joint(origin=step, lower=-2.0, upper=2.0)], links)
    post = wb.arms.Body.sphere([0, 1.5, 0], 0.2)
    shapes["arm"] = wb.arms.ArmConfigurations(arm, [post], self_collision=False)
    able = {name: options for name, options in LEARNED.items() if name in wb.METHODS}
    for where, shape in shapes.items():
        for query in (*QUERIES, "distance"):
            for method, options in able.items():
                if where in ("4d", "arm") and query != "point":
                    continue
                try:
                    bounder = wb.fit(shape, query, method, device="cpu", progress=False, budget=600.0, **options)
                except wb.BoundingError:
                    continue  # the method has no such query
                kind = bounder.certificate.kind if bounder.certificate else "none"
                numbers_ = sha(bounder.data.parameters.numpy()[4:], bounder.data.words)
                found[f"fit {method} {query} {where}"] = f"{numbers_} {float(bounder.threshold)!r} {kind}"


def edges() -> None:
    """Which edges of the arms that the demos have are proven clear, and how far."""
    for path in sorted([*BUNDLED.glob("arm-*.safetensors"), *BUNDLED.glob("robots/*.safetensors")]):
        bounder = wb.load(path, device="cpu")
        rng, size = np.random.default_rng(7), bounder.ndim
        lower, upper = bounder.domain.lower, bounder.domain.upper
        starts = rng.uniform(lower, upper, (300, size))
        ends = starts + rng.normal(size=starts.shape) * 0.1 * (upper - lower)
        for first in (False, True):
            try:
                edge = wb.proof.Segments(bounder, first=first)
            except wb.BoundingError:
                continue
            for count in (1, 5, 300):
                cleared, until = edge(starts[:count], ends[:count])
                # without ``first`` only what is clear is an answer of its own
                found[f"edges {path.stem} {count} {first}"] = sha(cleared, until if first else b"")


def pairs() -> None:
    """What pairs of placed meshes answer."""
    rng, folder = np.random.default_rng(3), BUNDLED / "pairs"
    names = {"bunny-distance": "bunny-256-balls", "../pile-bunny-pairs": "pile-bunny-128-balls"}
    for name, balls in names.items():
        far = wb.load(folder / f"{name}.safetensors", device="cpu")
        pair = wb.pairs.Pair(far, wb.pairs.Balls.load(folder / f"{balls}.safetensors"))
        placed = []
        for spread in (0.2, 1.0):
            place = np.concatenate([rng.normal(size=(500, 3)) * spread, rng.normal(size=(500, 4))], axis=1)
            place[:, 3:] /= np.linalg.norm(place[:, 3:], axis=1, keepdims=True)
            placed.append(wp.array(place.astype(np.float32), dtype=wp.transform, device="cpu"))
        found[f"pairs {balls} query"] = sha(pair.query(*placed, 0.01))
        found[f"pairs {balls} distance"] = sha(pair.distance(*placed))


def chosen() -> None:
    """What ``choose`` measures that is no time: the share that each closed form leaves, its bytes, and its verdict."""
    for where, shape in objects().items():
        for query in QUERIES if where != "4d" else ("point",):
            methods = [name for name in CLOSED if wb.METHODS[name].supports(query, shape.ndim)]
            choice = wb.choose(
                shape, query, narrow_ns=1000.0, methods=methods, budget=600.0, device="cpu", progress=False
            )
            for row in choice.rows:
                counted = f"{row.nbytes} {row.share!r} {row.certificate} {row.missed} {row.why_not}"
                found[f"choose {row.label} {query} {where}"] = counted


def bundled() -> None:
    """What the bounders of the demos answer on numbers in their domains."""
    for path in sorted(BUNDLED.glob("*.safetensors")):
        bounder = wb.load(path, device="cpu")
        size = np.size(bounder.domain.center)

        class Box:
            lower, upper = -np.ones(size), np.ones(size)

        if hasattr(bounder, "distance_func"):
            query_distance(f"bundled {path.stem}", bounder, Box)
        else:
            ask(f"bundled {path.stem}", bounder, bounder.query_kind, Box)


def certified(slow: bool) -> None:
    """Verdict and threshold of what the demos load, proven anew from file and shape."""
    from sims.prefitted import bounded, stored
    from sims.refit import plan

    for scene, name, spec, shape in plan([]):
        file = f"{scene}-{name}"
        if slow or not file.startswith(SLOW):
            bounder = wb.load(stored(scene, name), device="cpu")
            own = bounded(spec, shape)
            reported = wb.certify(bounder, own, budget=math.inf if slow else 20.0)
            found[f"certify {file}"] = f"{reported.kind} {float(bounder.threshold)!r}"


def demos(names: list[str]) -> None:
    """The final state of every run of the demos in their small form."""
    original = sims.base.compare

    def compare(examples, *arguments, **named):
        for name, example in examples.items():
            if name.startswith("chosen"):  # what is chosen depends on times
                continue
            section = next((str(a) for a in arguments if isinstance(a, str)), named.get("section", ""))
            try:
                state = sha(example.state())
            except NotImplementedError:
                state = "-"
            missed = example.missed(examples["none"])
            found[f"demo {current[0]} {section} {name}"] = f"{state} missed {missed} calls {sum(example.calls)}"
        return original(examples, *arguments, **named)

    sims.base.compare, current = compare, [""]
    for name in names:
        current[0] = name
        module = import_module(f"sims.{name}")
        if hasattr(import_module(f"sims.{name}.demo"), "compare"):
            import_module(f"sims.{name}.demo").compare = compare
        with tempfile.TemporaryDirectory() as out:
            module.run(Path(out), quick=True)


def main() -> int:
    """Hash, write and compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--compare", type=Path)
    parser.add_argument("--only", nargs="*", choices=PARTS, default=list(PARTS))
    parser.add_argument("--demos", nargs="*", choices=list(DEMOS), default=list(DEMOS))
    parser.add_argument("--slow", action="store_true")
    parser.add_argument("--kept", action="store_true")
    reported = parser.parse_args()
    globals()["kept_only"] = reported.kept
    wp.config.quiet = True
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    record_native()
    try:
        if "answers" in reported.only:
            answers(reported.folder)
        if "fits" in reported.only and not reported.kept:
            fits()
        if "bundled" in reported.only:
            bundled()
        if "edges" in reported.only:
            edges()
        if "pairs" in reported.only:
            pairs()
        if "choose" in reported.only:
            chosen()
        if "certify" in reported.only:
            certified(reported.slow)
        if "demos" in reported.only:
            demos(reported.demos)
    finally:
        found.update({f"native {key}": name for key, name in native.items()})
        if reported.out:
            lines = ",\n".join(f"{json.dumps(key)}: {json.dumps(found[key])}" for key in sorted(found))
            reported.out.write_text(f"{{\n{lines}\n}}\n")
    if not reported.compare:
        return 0
    before = json.loads(reported.compare.read_text())
    kinds = {key.split()[0] for key in found}
    before = {key: value for key, value in before.items() if key.split()[0] in kinds}
    differ = [key for key in sorted(before) if key in found and before[key] != found[key]]
    gone, new = sorted(before.keys() - found.keys()), sorted(found.keys() - before.keys())
    for word, keys in (("differs", differ), ("gone", gone), ("new", new)):
        for key in keys:
            print(f"{word}: {key}: {before.get(key, '')} -> {found.get(key, '')}")
    print(f"{len(found)} hashes, {len(differ)} differ, {len(gone)} gone, {len(new)} new")
    return 1 if differ or gone else 0


if __name__ == "__main__":
    sys.exit(main())
