"""Files spoilt at random, and at thresholds that make the most of their proof: what is left is for ``certify`` to find.

Each mutation changes a ``File`` in place and returns what it did in a few words, or ``None`` where there is nothing
that it could change; what another one has spoilt before may make it fail.
"""

import copy
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import safetensors
import safetensors.numpy

from warp_bounding.bounders import METHODS, Bounder, file_format
from warp_bounding.bounders.voxels import Voxels
from warp_bounding.certificates import Certificate
from warp_bounding.proof import least_value
from warp_bounding.proof.distances import largest_overestimate
from warp_bounding.queries.distance import DISTANCE
from warp_bounding.rounding import round_down
from warp_bounding.shapes import Grid

SEARCHED = 5000  # boxes, for the threshold of a spoilt network
SEARCH_SECONDS = 0.5  # for that of a spoilt distance
MOST = 5  # mutations of one file
POWERS = (-149, -100, -60, -24, -8, -2, -1, 1, 1, 2, 4, 8, 24, 60, 100)  # of two
HONEST = 0.97  # how often the description outside the domain is made to agree with it
NUMBERS = [1e-45, -1e-40, 1e-38, 1.0, -1.0, 0.0, 0.5, 2.0**20, 1e30, 3e38, -(2.0**127), np.nan, np.inf, -np.inf]
ODD = (True, None, 0, -0.0, -1, 1, 1.5, 1e308, 2**31, 2**63, "1", "", [], {}, [1], float("nan"), float("inf"))
SCALED_WITH_V = ("directions", "normals", "matrix", "factor", "layers.0.weight")


@dataclass
class File:
    """What a bounder's file holds."""

    document: dict
    tensors: dict[str, np.ndarray]

    @classmethod
    def of(cls, bounder: Bounder, path: Path) -> "File":
        """A bounder's own, by way of ``path``."""
        bounder.save(path)
        with safetensors.safe_open(str(path), framework="numpy") as held:
            document = json.loads(held.metadata()[file_format.KEY])["bounder"]
        return cls(document, {k: v.copy() for k, v in safetensors.numpy.load_file(path).items()})

    def write(self, path: Path) -> None:
        """With a digest that fits."""
        entry = json.dumps({"sha256": file_format.digest_of(self.tensors, self.document), "bounder": self.document})
        path.write_bytes(safetensors.numpy.save(self.tensors, metadata={file_format.KEY: entry}))

    def agree(self, rng: np.random.Generator, cells: int) -> None:
        """Make the description and a certificate say what the domain and the threshold say, as a liar would."""
        document, domain = self.document, self.document["domain"]
        if not isinstance(domain, dict) or not {"center", "lower", "upper"} <= set(domain):
            return
        axes = len(domain["center"]) if isinstance(domain["center"], list) else 0
        if rng.random() < HONEST:
            plain = DISTANCE.name if document["query"] == DISTANCE.name else "point"
            document |= {"query": domain.get("query", plain), "space": domain.get("space", "geometric")}
            moving = domain.get("moving", domain.get("time"))
            document |= {"length": domain.get("length"), "motion": "time" if moving else None, "dimension": axes}
        document["grid_shape"] = None  # the shares of a cell need not agree with anything then
        document["certificate"] = Certificate(
            **{name: document[name] for name in ("query", "threshold", "indicator", "margin", "length", "resolution")},
            kind="proven",
            domain=[domain["lower"], domain["upper"]],
            delta=[0.0] * axes,
            cells=cells,
            lower_bound=1e300,
            rounding_bound=1e300,
            boxes=1,
            seconds=0.0,
        ).to_dict()


def one(rng: np.random.Generator, values):
    return values[rng.integers(len(values))]


def power_of_two(rng: np.random.Generator) -> int:
    return int(rng.choice(POWERS)) if rng.random() < 0.6 else int(rng.integers(-30, 31))


def numbers(a: np.ndarray, rng: np.random.Generator) -> str:
    """Change some numbers of an array of floats in place: all, a row, or one."""
    flat, size, kind = a.reshape(-1), a.size, rng.integers(3)
    step = size if kind == 0 else size // len(a) if kind == 1 and a.ndim > 1 else 1
    index = int(rng.integers(size // step))
    place = slice(index * step, (index + 1) * step)
    part, power = flat[place].copy(), power_of_two(rng)
    changes = {
        "sign": lambda: -part,
        f"2^{power}": lambda: part * np.asarray(2.0**power, dtype=np.float64),
        f"entries by 2^{power}": lambda: part * np.exp2(power * rng.random(part.shape)),
        "set": lambda: np.full_like(part, rng.choice(NUMBERS)),
        "ulps": lambda: part + np.spacing(np.abs(part)) * rng.choice([-1024, -16, -2, -1, 1, 2, 16, 1024]),
        "noise": lambda: part + part * rng.normal(size=part.shape) * 10.0 ** rng.uniform(-7, 0),
        "moved": lambda: part + rng.normal() * 10.0 ** rng.uniform(-3, 1),
        "permuted": lambda: rng.permutation(part),
        "reversed": lambda: part[::-1],
        "swapped signs": lambda: part * rng.choice([-1.0, 1.0], part.shape),
    }
    name = one(rng, list(changes))
    flat[place] = np.asarray(changes[name]()).astype(a.dtype)
    return f"{name} ({index} of {size // step})"


# --- the description: domain, sizes, threshold, kind


def domain_numbers(file: File, rng: np.random.Generator) -> str | None:
    domain, name = file.document["domain"], one(rng, ("center", "scale", "limit", "delta", "lower", "upper"))
    value = np.array(domain.get(name), dtype=np.float64)
    if value.ndim != 1 or not value.size:
        return None
    value = value.astype(np.float32) if name in ("center", "scale", "limit") else value
    what = numbers(value, rng)
    domain[name] = [float(v) for v in value]
    return f"domain.{name}: {what}"


def domain_of_another_size(file: File, rng: np.random.Generator) -> str | None:
    """A larger (or smaller) domain whose numbers fit one another; half of the time the tensors are made to fit, too."""
    domain, power = file.document["domain"], int(rng.choice([-2, -1, 1, 2, 4, 8, 16, 24, 32, 48, 58]))
    center, scale, lower, upper = (np.array(domain[k], dtype=np.float64) for k in ("center", "scale", "lower", "upper"))
    s = np.where(rng.random(len(center)) < rng.choice([0.5, 1.0]), 2.0**power, 1.0)
    domain["scale"] = [float(v) for v in (scale / s).astype(np.float32)]
    domain["lower"] = (center - s * (center - lower)).tolist()
    domain["upper"] = (center + s * (upper - center)).tolist()
    for k, tensor in file.tensors.items() if rng.random() < 0.5 else ():
        if tensor.shape[-1:] == s.shape and k in SCALED_WITH_V:
            file.tensors[k] = (tensor * s).astype(np.float32)
        elif tensor.shape[-1:] == s.shape and k in ("low", "high") and "directions" not in file.tensors:
            file.tensors[k] = (tensor / s).astype(np.float32)
    return f"domain by {s.tolist()}"


def domain_moved(file: File, rng: np.random.Generator) -> str | None:
    domain = file.document["domain"]
    center = np.array(domain["center"], dtype=np.float32)
    moved = (center + np.float32(rng.normal() * 10.0 ** rng.uniform(-3, 6))).astype(np.float32)
    by, around = moved.astype(np.float64) - center, 1.01 * (rng.random() < 0.5)  # still around the object, or not
    domain["center"] = [float(v) for v in moved]
    lower, upper = np.array(domain["lower"]) + by, np.array(domain["upper"]) + by
    domain |= {"lower": (lower - np.abs(by) * around).tolist(), "upper": (upper + np.abs(by) * around).tolist()}
    if around:
        wide = (np.array(domain["upper"]) - np.array(domain["lower"])) / 2
        domain["scale"] = [float(v) for v in (1 / wide).astype(np.float32)]
    return f"domain moved by {by.tolist()}"


def domain_allowance(file: File, rng: np.random.Generator) -> str | None:
    """A larger delta with a limit that fits, or a limit that fits less tightly."""
    domain = file.document["domain"]
    limit = np.array(domain["limit"], dtype=np.float64)
    delta = np.array(domain.get("delta", 0 * limit), dtype=np.float64)  # a distance's domain has none
    by = 2.0 ** float(rng.choice([-20, -8, -4, -2, -1, -0.1, 0.1, 1, 2, 4, 8, 12, 20, 60]))
    more = delta * (by - 1) if rng.random() < 0.7 else limit * (2.0 ** rng.uniform(0, 3) - 1)
    domain |= {"delta": (delta * by).tolist()} if "delta" in domain else {}
    domain["limit"] = [float(v) for v in np.nextafter((limit + more).astype(np.float32), np.float32(np.inf))]
    return f"domain.delta by {by:g}, limit by {more.tolist()}"


def claim(file: File, rng: np.random.Generator) -> str | None:
    """Another kind of query, length, margin or resolution than was proven, or the other side of the object."""
    document, domain = file.document, file.document["domain"]
    key = one(rng, ("query", "space", "length", "time", "margin", "resolution", "unbounded"))
    if key == "query":
        domain["query"] = one(rng, ["ray", "plane", "box", "point"])
        domain["length"] = 0.75 if domain["query"] == "ray" else None
        domain.setdefault("space", "geometric")
        domain.setdefault("moving", False)
    elif key == "space":
        domain["space"] = "parametric" if domain.get("space") == "geometric" else "geometric"
    elif key == "length":
        domain["length"] = float(domain["length"] * 2.0 ** rng.choice([*POWERS, 0.01, -0.01]))
    elif key == "margin":
        margin = document["margin"] or 0.0
        document["margin"] = float(one(rng, [0.0, margin / 2, 2 * margin, np.nextafter(margin, 1.0), 0.01, 0.05]))
    elif key == "resolution":
        document["resolution"] = one(rng, [None, 4, 8, 9, 16])
    else:
        key = "moving" if key == "time" and "moving" in domain else key
        domain[key] = not domain.get(key, False)
    return f"claim: another {key}"


def threshold(file: File, rng: np.random.Generator) -> str | None:
    value = np.array([file.document["threshold"]], np.float32)
    what = numbers(value, rng)
    file.document["threshold"] = float(value[0])
    return f"threshold: {what}"


def odd_value(file: File, rng: np.random.Generator) -> str | None:
    """Any leaf of the description, or a whole branch, replaced by a value that is not its kind's, or is one off."""
    place, path = file.document, []
    while True:
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        key = one(rng, [k for k in keys if k not in ("certificate", "margin", "resolution", "training")])
        path.append(key)
        old = place[key]
        if not isinstance(old, (dict, list)) or not old or rng.random() < 0.1:
            break
        place = old
    place[key] = copy.deepcopy(one(rng, ODD))
    if type(old) in (int, float) and rng.random() < 0.5:
        place[key] = one(rng, [old + 1, old - 1, 2 * old, -old, float(old), str(old), bool(old), [old]])
    return f"{'.'.join(map(str, path))}: {old!r} -> {place[key]!r}"


def sizes_edited(file: File, rng: np.random.Generator) -> str | None:
    """Another activation, a part's other method, a permuted list of sizes, or a method that reads them otherwise."""
    sizes, document = file.document["sizes"], file.document
    lists = [k for k, v in sizes.items() if isinstance(v, list) and len(v) > 1]
    kind = rng.integers(4)
    if kind == 0 and "activation" in sizes:
        sizes["activation"] = one(rng, ["sin", "relu"])
    elif kind == 1 and sizes.get("parts"):
        one(rng, sizes["parts"])["method"] = one(rng, [*METHODS, "cascade"])
    elif kind == 2 and lists:
        name = one(rng, lists)
        sizes[name] = [sizes[name][i] for i in rng.permutation(len(sizes[name]))]
    else:
        document["method"] = one(rng, [*METHODS, "cascade"])
    return f"method {document['method']}, sizes {sizes!r:.60}"


# --- tensors


def tensor_numbers(file: File, rng: np.random.Generator) -> str | None:
    name = one(rng, [k for k, t in file.tensors.items() if t.dtype == np.float32 and t.size])
    file.tensors[name] = np.ascontiguousarray(file.tensors[name])
    return f"{name}: {numbers(file.tensors[name], rng)}"


def tensor_bits(file: File, rng: np.random.Generator) -> str | None:
    name = one(rng, [k for k, t in file.tensors.items() if t.dtype == np.uint32 and t.size])
    tensor, kind = file.tensors[name], int(rng.integers(4))
    if kind == 0:
        tensor[rng.integers(tensor.size)] ^= np.uint32(1 << int(rng.integers(32)))
    else:
        tensor[:] = (np.roll(tensor, int(rng.integers(1, 9))), np.uint32(0xFFFFFFFF), ~tensor)[kind - 1]
    return f"{name}: bits ({kind})"


def tensors_scaled_together(file: File, rng: np.random.Generator) -> str | None:
    """What leaves a volume's shape as it is: all numbers of some tensors, or of one half-space, by one power of two."""
    names = [k for k, t in file.tensors.items() if t.dtype == np.float32 and t.ndim and t.size]
    power, count = power_of_two(rng), len(file.tensors[names[0]])
    row = int(rng.integers(count)) if rng.random() < 0.5 else None
    chosen = names if rng.random() < 0.5 else [k for k in names if rng.random() < 0.6]
    for k in chosen:
        part = slice(None) if row is None or len(file.tensors[k]) != count else row
        file.tensors[k][part] = (file.tensors[k][part] * 2.0**power).astype(np.float32)
    return f"{', '.join(chosen)}: all by 2^{power} (row {row})"


def layers_balanced(file: File, rng: np.random.Generator) -> str | None:
    """What leaves a ReLU network's function as it is."""
    index = int(rng.integers(sum(k.startswith("layers.") and k.endswith(".weight") for k in file.tensors) - 1))
    factor = np.float32(2.0 ** float(rng.choice(POWERS)))
    for name, by in ((f"{index}.weight", factor), (f"{index}.bias", factor), (f"{index + 1}.weight", 1 / factor)):
        file.tensors[f"layers.{name}"] = (file.tensors[f"layers.{name}"] * by).astype(np.float32)
    return f"layers {index}, {index + 1}: balanced by {factor:g}"


def tensors_reflected(file: File, rng: np.random.Generator) -> str | None:
    """A map to cells that runs the other way along an axis."""
    sizes, factor, summand = file.document["sizes"], file.tensors["factor"], file.tensors["summand"]
    count = sizes.get("shape") or sizes["nodes"]
    k, by = int(rng.integers(len(count))), float(rng.choice([1, 1, 1.5, 2, 3, -0.5, -2]))
    factor[k], summand[k] = -by * factor[k], min(count[k], 2**31) / 2 * (1 + by) - by * summand[k]
    return f"axis {k} reflected, by {by:g}"


def tensors_exchanged(file: File, rng: np.random.Generator) -> str | None:
    """Two tensors of one shape change places, or one takes the other's numbers."""
    held = file.tensors
    a, b = one(rng, [(a, b) for a in held for b in held if a < b and held[a].shape == held[b].shape])
    held[a], held[b] = held[b].copy(), held[a].copy() if rng.random() < 0.7 else held[b].copy()
    return f"{a} and {b}"


def tensor_structure(file: File, rng: np.random.Generator) -> str | None:
    name, kind = one(rng, list(file.tensors)), int(rng.integers(6))
    tensor = file.tensors.pop(name)
    if kind:  # else it is gone
        others = (tensor.T, tensor.astype(one(rng, ["f8", "f2", "i4", "u4"])), tensor.reshape(-1), tensor[..., None])
        file.tensors[name] = tensor if kind == 5 else np.ascontiguousarray(others[kind - 1])
        file.tensors |= {f"{name}x": tensor.copy()} if kind == 5 else {}
    return f"{name}: structure ({kind})"


def rows_dropped_or_doubled(file: File, rng: np.random.Generator) -> str | None:
    """A half-space, a slab or a node less or more, in every tensor that has rows for it."""
    count = one(rng, sorted({len(t) for t in file.tensors.values() if t.ndim}))
    index, twice = int(rng.integers(count)), rng.random() < 0.5
    kept = np.sort(np.append(np.arange(count), index)) if twice else np.delete(np.arange(count), index)
    for k, tensor in file.tensors.items():
        if tensor.ndim and len(tensor) == count:
            file.tensors[k] = np.ascontiguousarray(tensor[kept])
    return f"row {index} of {count} {'twice' if twice else 'dropped'}"


# --- all of them, with their odds

MUTATIONS = {
    tensor_numbers: 8,
    tensors_scaled_together: 4,
    domain_numbers: 3,
    threshold: 3,
    odd_value: 3,
    domain_of_another_size: 3,
    claim: 2.5,
    domain_allowance: 2,
    tensors_reflected: 2,
    tensors_exchanged: 2,
    tensor_bits: 2,
    domain_moved: 1,
    layers_balanced: 1,
    sizes_edited: 0.8,
    rows_dropped_or_doubled: 0.7,
    tensor_structure: 0.5,
}


def mutate(file: File, rng: np.random.Generator) -> list[str]:
    """Spoil a file in place, by one mutation or several; what was done."""
    wanted, done = min(int(rng.geometric(0.55)), MOST), []
    odds = np.array(list(MUTATIONS.values()))
    for _ in range(8 * MOST):
        chosen = list(MUTATIONS)[rng.choice(len(odds), p=odds / odds.sum())]
        try:
            what = chosen(file, rng)
        except (LookupError, TypeError, ValueError, OverflowError, AttributeError):  # the file has nothing like that
            continue
        done += [what] if what else []
        if len(done) == wanted:
            break
    return done


def tighten(file: File, bounder: Bounder, grid: Grid, rng: np.random.Generator) -> None:
    """Make the most of the proof of a spoilt file, as a liar would: the highest thresholds that are proven, and
    voxels that keep what the proof counts on."""
    if bounder.of_distances:
        of_volume = bounder.volume is not None
        least = 0.0 if of_volume else -largest_overestimate(bounder, grid, SEARCH_SECONDS)[0]
        tightest = float(round_down(np.nextafter(least - bounder.rounding_bound(), -np.inf)))
        if np.isfinite(tightest):
            file.document["threshold"] = min(tightest, 0.0)
        return
    tests = [bounder, *getattr(bounder, "members", [])]
    for index, part in enumerate(tests):
        if isinstance(part, Voxels) and rng.random() < 0.7:
            file.tensors["bits" if index == 0 else f"{index - 1}.bits"] = _counted_on(part, grid)
    thresholds = []
    for part in bounder.parts:
        least = least_value(part, grid, eps=0.05, boxes=SEARCHED).lower_bound
        thresholds.append(round_down(np.nextafter(least - part.rounding_bound(), -np.inf)))
    if not np.isfinite(thresholds).all():
        return
    if any(isinstance(part, Voxels) for part in tests):  # whole numbers: the threshold that tells them apart
        kinds = zip(bounder.parts, thresholds, strict=True)
        thresholds = [np.float32(0.75) if isinstance(part, Voxels) else t for part, t in kinds]
    if "thresholds" in file.tensors:
        file.tensors["thresholds"] = np.array(thresholds[: file.tensors["thresholds"].size], np.float32)
    file.document["threshold"] = float(thresholds[-1])


def _counted_on(part: Voxels, grid: Grid) -> np.ndarray:
    """Bits of the cells in which the middles of the object's cells lie."""
    low, high = part.domain.widened(grid.position(grid.occupied - 0.5), grid.position(grid.occupied + 0.5))
    t = (low + high) / 2 * part.tensors["factor"].astype(np.float64) + part.tensors["summand"]
    cell = np.clip(np.floor(t), 0, np.array(part.shape) - 1).astype(np.int64)
    occupied = np.zeros(part.shape, bool)
    occupied[tuple(cell.T)] = True
    packed = np.packbits(occupied.reshape(-1), bitorder="little")
    return np.pad(packed, (0, -len(packed) % 4)).view("<u4").astype(np.uint32)
