"""Files spoilt at random, and at thresholds that make the most of their proof: what is left is for ``certify`` to find.

Each mutation changes a ``File`` in place and returns what it did in a few words, or ``None`` where there is nothing
that it could change.
"""

import copy
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import safetensors
import safetensors.numpy

from warp_bounding.bounders import METHODS, Bounder, file_format
from warp_bounding.bounders.file_format import digest_of
from warp_bounding.bounders.voxels import Voxels
from warp_bounding.certificates import Certificate
from warp_bounding.proof import least_value
from warp_bounding.proof.distances import KEY as CHECKPOINT
from warp_bounding.proof.distances import largest_overestimate
from warp_bounding.queries.distance import DISTANCE
from warp_bounding.rounding import round_down
from warp_bounding.shapes import Grid

SEARCHED = 5000  # boxes, for the threshold of a spoilt network
SEARCH_SECONDS = 0.5  # for that of a spoilt distance
MOST = 5  # mutations of one file
POWERS = (-149, -100, -60, -24, -8, -2, -1, 1, 1, 2, 4, 8, 24, 60, 100)  # of two
HONEST = 0.97  # how often the description outside the domain is made to agree with it


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

    def copy(self) -> "File":
        return copy.deepcopy(self)

    def write(self, path: Path) -> None:
        """With a digest that fits."""
        entry = json.dumps({"sha256": file_format.digest_of(self.tensors, self.document), "bounder": self.document})
        path.write_bytes(safetensors.numpy.save(self.tensors, metadata={file_format.KEY: entry}))

    def agree(self, rng: np.random.Generator, cells: int) -> None:
        """Make the description and a certificate say what the domain and the threshold say, as a liar would."""
        document, domain = self.document, self.document["domain"]
        if not isinstance(domain, dict) or not {"center", "lower", "upper"} <= set(domain):
            return
        if rng.random() < HONEST:
            plain = DISTANCE.name if document["query"] == DISTANCE.name else "point"
            kind = {
                k: domain.get(k, other) for k, other in (("query", plain), ("space", "geometric"), ("length", None))
            }
            moving = domain.get("moving", domain.get("time"))
            document |= kind | {"motion": "time" if moving else None}
            document["dimension"] = len(domain["center"]) if isinstance(domain["center"], list) else 0
        threshold = document["threshold"]
        document["grid_shape"] = None  # the shares of a cell need not agree with anything then
        axes = len(domain["center"]) if isinstance(domain["center"], list) else 0
        document["certificate"] = Certificate(
            kind="proven",
            query=document["query"],
            domain=[domain["lower"], domain["upper"]],
            threshold=threshold,
            lower_bound=1e300,
            rounding_bound=1e300,
            delta=[0.0] * axes,
            boxes=1,
            seconds=0.0,
            indicator=document["indicator"],
            cells=cells,
            margin=document["margin"],
            length=document["length"],
            resolution=document["resolution"],
        ).to_dict()


def power_of_two(rng: np.random.Generator) -> int:
    return int(rng.choice(POWERS)) if rng.random() < 0.6 else int(rng.integers(-30, 31))


def numbers(a: np.ndarray, rng: np.random.Generator) -> str:
    """Change some numbers of an array of floats in place."""
    flat, size = a.reshape(-1), a.size
    kind = rng.integers(3)
    if kind == 0 or size == 1:
        place, where = slice(None), "all"
    elif kind == 1 and a.ndim > 1:
        row = int(rng.integers(len(a)))
        step = size // len(a)
        place, where = slice(row * step, (row + 1) * step), f"row {row}"
    else:
        index = int(rng.integers(size))
        place, where = slice(index, index + 1), f"entry {index}"
    part, power = flat[place].copy(), power_of_two(rng)
    spacing = np.spacing(np.abs(part)) * rng.choice([-1, 1]) * int(rng.choice([1, 2, 16, 1024]))
    changes = {
        "sign": lambda: -part,
        f"2^{power}": lambda: part * np.asarray(2.0**power, dtype=np.float64),
        f"-2^{power}": lambda: part * np.asarray(-(2.0**power), dtype=np.float64),
        f"entries by 2^{power}": lambda: part * np.exp2(power * rng.random(part.shape)),
        "zero": lambda: part * 0,
        "set": lambda: np.full_like(part, rng.choice([1e-45, -1e-40, 1e-38, 1.0, -1.0, 0.5, 2.0**20, 1e30, 3e38])),
        "not finite": lambda: np.full_like(part, rng.choice([np.nan, np.inf, -np.inf])),
        "ulps": lambda: part + spacing,
        "noise": lambda: part + part * rng.normal(size=part.shape) * 10.0 ** rng.uniform(-7, 0),
        "moved": lambda: part + rng.normal() * 10.0 ** rng.uniform(-3, 1),
        "permuted": lambda: rng.permutation(part),
        "reversed": lambda: part[::-1],
        "swapped signs": lambda: part * rng.choice([-1.0, 1.0], part.shape),
    }
    rare = {"not finite": 0.2, "zero": 0.6}
    names = list(changes)
    odds = np.array([rare.get(name, 1.0) for name in names])
    name = str(rng.choice(names, p=odds / odds.sum()))
    with np.errstate(all="ignore"):
        flat[place] = np.asarray(changes[name]()).astype(a.dtype)
    return f"{name} ({where})"


# --- the description: domain, sizes, threshold, kind

SINGLE, DOUBLE = ("center", "scale", "limit"), ("delta", "lower", "upper")  # fields of a domain
ODD = (
    True,
    False,
    None,
    0,
    0.0,
    -0.0,
    -1,
    1,
    1.5,
    1e308,
    -1e308,
    2**31,
    2**63,
    "1",
    "",
    [],
    {},
    [1],
    float("nan"),
    float("inf"),
)
SCALED_WITH_V = ("directions", "normals", "matrix", "factor", "layers.0.weight", "encoding.weight")


def domain_numbers(file: File, rng: np.random.Generator) -> str | None:
    domain, name = file.document["domain"], str(rng.choice([*SINGLE, *DOUBLE]))
    try:
        value = np.array(domain[name], dtype=np.float64)
    except (KeyError, TypeError, ValueError):
        return None
    if value.ndim != 1 or not value.size:
        return None
    if name in SINGLE:
        with np.errstate(all="ignore"):
            value = value.astype(np.float32)
    what = numbers(value, rng)
    domain[name] = [float(v) for v in value]
    return f"domain.{name}: {what}"


def domain_of_another_size(file: File, rng: np.random.Generator) -> str | None:
    """A larger (or smaller) domain whose numbers fit one another; half of the time the tensors are made to fit, too."""
    domain, power = file.document["domain"], int(rng.choice([-2, -1, 1, 2, 4, 8, 16, 24, 32, 48, 58]))
    try:
        center, scale, lower, upper = (
            np.array(domain[k], dtype=np.float64) for k in ("center", "scale", "lower", "upper")
        )
        axes = np.ones(len(center), bool) if rng.random() < 0.7 else rng.random(len(center)) < 0.5
        s = np.where(axes, 2.0**power, 1.0)
        domain |= {
            "scale": [float(v) for v in (scale / s).astype(np.float32)],
            "lower": (center - s * (center - lower)).tolist(),
            "upper": (center + s * (upper - center)).tolist(),
        }
        fitting = rng.random() < 0.5
        for k in file.tensors if fitting else ():
            if k in SCALED_WITH_V and file.tensors[k].shape[-1] == len(s):
                file.tensors[k] = (file.tensors[k] * s).astype(np.float32)
            elif k in ("low", "high") and "directions" not in file.tensors and file.tensors[k].shape[-1] == len(s):
                file.tensors[k] = (file.tensors[k] / s).astype(np.float32)
    except (TypeError, ValueError, IndexError, OverflowError):
        return None
    return f"domain by 2^{power} on {axes.tolist()}{', tensors too' * fitting}"


def domain_moved(file: File, rng: np.random.Generator) -> str | None:
    domain = file.document["domain"]
    try:
        center = np.array(domain["center"], dtype=np.float32)
        moved = (center + np.float32(rng.normal() * 10.0 ** rng.uniform(-3, 6))).astype(np.float32)
        by = moved.astype(np.float64) - center
        domain |= {k: (np.array(domain[k]) + by).tolist() for k in ("lower", "upper")}
        if rng.random() < 0.5:  # still around the object
            size = np.abs(by) * 1.01
            domain |= {
                "lower": (np.array(domain["lower"]) - size).tolist(),
                "upper": (np.array(domain["upper"]) + size).tolist(),
            }
            wide = (np.array(domain["upper"]) - np.array(domain["lower"])) / 2
            domain["scale"] = [float(v) for v in (1 / wide).astype(np.float32)]
        domain["center"] = [float(v) for v in moved]
    except (TypeError, ValueError, IndexError, OverflowError):
        return None
    return f"domain moved by {by.tolist()}"


def domain_allowance(file: File, rng: np.random.Generator) -> str | None:
    """A larger delta with a limit that fits, or a limit that fits less tightly."""
    domain = file.document["domain"]
    try:
        limit = np.array(domain["limit"], dtype=np.float64)
        delta = np.array(domain.get("delta", 0 * limit), dtype=np.float64)  # a distance's domain has none
        by = 2.0 ** float(rng.choice([-20, -8, -4, -2, -1, -0.1, 0.1, 1, 2, 4, 8, 12, 20, 60]))
        more = delta * (by - 1) if rng.random() < 0.7 else limit * (2.0 ** rng.uniform(0, 3) - 1)
        domain |= {"delta": (delta * by).tolist()} if "delta" in domain else {}
        domain["limit"] = [float(v) for v in np.nextafter((limit + more).astype(np.float32), np.float32(np.inf))]
    except (TypeError, ValueError, IndexError, OverflowError):
        return None
    return f"domain.delta by {by:g}, limit by {more.tolist()}"


def kind_of_query(file: File, rng: np.random.Generator) -> str | None:
    """Another kind of region, another space, or another length, said everywhere."""
    domain = file.document["domain"]
    if not isinstance(domain, dict):
        return None
    choice = int(rng.integers(4))
    if choice == 0:
        domain["query"] = str(rng.choice(["ray", "plane", "box", "point"]))
        domain["length"] = 0.75 if domain["query"] == "ray" else None
        domain.setdefault("space", "geometric")
        domain.setdefault("moving", False)
    elif choice == 1:
        domain["space"] = "parametric" if domain.get("space") == "geometric" else "geometric"
    elif choice == 2:
        length = domain.get("length")
        if not isinstance(length, float):
            return None
        domain["length"] = float(length * 2.0 ** rng.choice([*POWERS, 0.01, -0.01, 4, 10, 16]))
    else:
        key = "moving" if "moving" in domain else "time"
        domain[key] = not domain.get(key)
    return f"kind: {[domain.get(k) for k in ('query', 'space', 'length', 'moving', 'time')]}"


def claim(file: File, rng: np.random.Generator) -> str | None:
    """Another margin or resolution than the one that was proven, or the other side of the object."""
    document, domain, choice = file.document, file.document["domain"], int(rng.integers(3))
    if choice == 0:
        margin = document["margin"] or 0.0
        others = [0.0, margin / 2, 2 * margin, float(np.nextafter(margin, 1.0)), 0.01, 0.05]
        document["margin"] = float(others[rng.integers(len(others))])
    elif choice == 1:
        document["resolution"] = [None, 4, 8, 9, 16][rng.integers(5)]
    elif isinstance(domain, dict):
        domain["unbounded"] = not domain.get("unbounded", False)
    return f"claim: margin {document['margin']}, resolution {document['resolution']}, domain {domain!r:.40}"


def threshold(file: File, rng: np.random.Generator) -> str | None:
    value = np.array(
        [file.document["threshold"]] if isinstance(file.document["threshold"], float) else [0.0], np.float32
    )
    if rng.random() < 0.5:
        what = numbers(value, rng)
    else:
        what = "set"
        value[:] = rng.choice(
            np.float32([0, -0.0, 1, -1, 1e-45, -1e-45, 0.5, 2**-60, np.inf, -np.inf, np.nan, 1e30, -1e30, -(2.0**127)])
        )
    file.document["threshold"] = float(value[0])
    return f"threshold: {what} {float(value[0])}"


def odd_value(file: File, rng: np.random.Generator) -> str | None:
    """Any leaf of the description, or a whole branch, replaced by a value that is not its kind's, or is one off."""
    place, path = file.document, []
    while True:
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        keys = [k for k in keys if k not in ("certificate", "margin", "resolution", "training")]
        if not keys:
            return None
        key = keys[rng.integers(len(keys))]
        path.append(key)
        if not isinstance(place[key], (dict, list)) or not place[key] or rng.random() < 0.1:
            break
        place = place[key]
    old = place[key]
    if type(old) is int and rng.random() < 0.6:
        place[key] = [old + 1, old - 1, 2 * old, -old, float(old), str(old), bool(old)][rng.integers(7)]
    elif type(old) is float and rng.random() < 0.4:
        place[key] = [str(old), int(old) if abs(old) < 1e9 else 0, -old, [old], bool(old)][rng.integers(5)]
    else:
        place[key] = copy.deepcopy(ODD[rng.integers(len(ODD))])
    return f"{'.'.join(map(str, path))}: {old!r} -> {place[key]!r}"


def sizes_edited(file: File, rng: np.random.Generator) -> str | None:
    sizes = file.document["sizes"]
    if not isinstance(sizes, dict):
        return None
    if "activation" in sizes and rng.random() < 0.3:
        sizes["activation"] = str(rng.choice(["sin", "relu", "tanh"]))
        return f"activation {sizes['activation']}"
    if isinstance(sizes.get("parts"), list) and sizes["parts"] and rng.random() < 0.7:
        part = sizes["parts"][rng.integers(len(sizes["parts"]))]
        if not isinstance(part, dict):
            return None
        part["method"] = str(rng.choice([*METHODS, "cascade"]))
        return f"a part is {part['method']}"
    lists = [k for k, v in sizes.items() if isinstance(v, list) and len(v) > 1]
    if not lists:
        return None
    name = lists[rng.integers(len(lists))]
    sizes[name] = [sizes[name][i] for i in rng.permutation(len(sizes[name]))]
    return f"sizes.{name} permuted"


def method(file: File, rng: np.random.Generator) -> str | None:
    """A method that may read the same tensors otherwise."""
    file.document["method"] = str(rng.choice([*METHODS, "cascade"]))
    return f"method {file.document['method']}"


# --- tensors


def _a_tensor(file: File, rng: np.random.Generator) -> str | None:
    names = [k for k, t in file.tensors.items() if t.size]
    return str(rng.choice(names)) if names else None


def tensor_numbers(file: File, rng: np.random.Generator) -> str | None:
    name = _a_tensor(file, rng)
    tensor = name and file.tensors[name]
    if name is None or tensor.dtype != np.float32:
        return None
    tensor = file.tensors[name] = np.ascontiguousarray(tensor)
    return f"{name}: {numbers(tensor, rng)}"


def tensor_bits(file: File, rng: np.random.Generator) -> str | None:
    names = [k for k, t in file.tensors.items() if t.dtype == np.uint32 and t.size]
    if not names:
        return None
    tensor, kind = file.tensors[names[0]], int(rng.integers(4))
    if kind == 0:
        tensor[rng.integers(tensor.size)] ^= np.uint32(1 << int(rng.integers(32)))
    else:
        tensor[:] = (np.roll(tensor, int(rng.integers(1, 9))), np.uint32(0xFFFFFFFF), ~tensor)[kind - 1]
    return f"{names[0]}: bits ({kind})"


def tensors_scaled_together(file: File, rng: np.random.Generator) -> str | None:
    """What leaves a volume's shape as it is: every number of some tensors, or of one half-space, by one power of
    two."""
    names = [k for k, t in file.tensors.items() if t.dtype == np.float32 and t.size]
    if not names:
        return None
    power, count = power_of_two(rng), len(file.tensors[names[0]]) if file.tensors[names[0]].ndim else 0
    chosen = names if rng.random() < 0.5 else [k for k in names if rng.random() < 0.6]
    row = int(rng.integers(count)) if count and rng.random() < 0.5 else None
    for k in chosen:
        tensor = file.tensors[k]
        part = slice(None) if row is None or tensor.ndim == 0 or len(tensor) != count else row
        with np.errstate(all="ignore"):
            tensor[part] = (tensor[part] * 2.0**power).astype(np.float32)
    return f"{', '.join(chosen)}: all by 2^{power} (row {row})"


def layers_balanced(file: File, rng: np.random.Generator) -> str | None:
    """What leaves a ReLU network's function as it is."""
    last = sum(k.endswith(".weight") and k.startswith("layers.") for k in file.tensors) - 1
    if last < 1 or f"layers.{last}.weight" not in file.tensors:
        return None
    index, factor = int(rng.integers(last)), np.float32(2.0 ** float(rng.choice(POWERS)))
    with np.errstate(all="ignore"):
        for name, by in (
            (f"layers.{index}.weight", factor),
            (f"layers.{index}.bias", factor),
            (f"layers.{index + 1}.weight", 1 / factor),
        ):
            if name in file.tensors:
                file.tensors[name] = (file.tensors[name] * by).astype(np.float32)
    return f"layers {index}, {index + 1}: balanced by {factor:g}"


def tensors_reflected(file: File, rng: np.random.Generator) -> str | None:
    """A map to cells that runs the other way along an axis."""
    sizes = file.document["sizes"]
    count = sizes.get("shape") or sizes.get("nodes") if isinstance(sizes, dict) else None
    maps = [file.tensors.get(k) for k in ("factor", "summand")]
    if not isinstance(count, list) or any(m is None or m.ndim != 1 or len(m) != len(count) for m in maps):
        return None
    k, by = int(rng.integers(len(count))), float(rng.choice([1, 1, 1.5, 2, 3, -0.5, -2]))
    if isinstance(count[k], bool) or not isinstance(count[k], int):
        return None
    middle = min(count[k], 2**31) / 2
    with np.errstate(all="ignore"):
        maps[0][k], maps[1][k] = -by * maps[0][k], middle * (1 + by) - by * maps[1][k]
    return f"axis {k} reflected, by {by:g}"


def tensors_exchanged(file: File, rng: np.random.Generator) -> str | None:
    """Two tensors of one shape change places, or one takes the other's numbers."""
    pairs = [
        (a, b) for a in file.tensors for b in file.tensors if a < b and file.tensors[a].shape == file.tensors[b].shape
    ]
    if not pairs:
        return None
    a, b = pairs[rng.integers(len(pairs))]
    one, two = file.tensors[a], file.tensors[b]
    both = rng.random() < 0.7
    file.tensors[a], file.tensors[b] = two.copy(), one.copy() if both else two.copy()
    return f"{a} {'and' if both else 'from'} {b}"


def tensor_structure(file: File, rng: np.random.Generator) -> str | None:
    name = _a_tensor(file, rng)
    if name is None:
        return None
    tensor, kind = file.tensors[name], int(rng.integers(6))
    with np.errstate(all="ignore"):
        if kind == 0:
            file.tensors[name] = np.ascontiguousarray(tensor.T)
        elif kind == 1:
            del file.tensors[name]
        elif kind == 2:
            file.tensors[f"{name}x"] = tensor.copy()
        elif kind == 3:
            file.tensors[name] = tensor.astype(rng.choice(["f8", "f2", "i4", "u4", "f4"]))
        elif kind == 4:
            file.tensors[name] = tensor.reshape(-1)
        else:
            file.tensors[name] = tensor.reshape(*tensor.shape, 1)
    return f"{name}: structure ({kind})"


def rows_dropped_or_doubled(file: File, rng: np.random.Generator) -> str | None:
    """A half-space, a slab or a node less or more, in every tensor that has rows for it."""
    rows = {len(t) for t in file.tensors.values() if t.ndim}
    if not rows:
        return None
    count = int(rng.choice(sorted(rows)))
    index, twice = int(rng.integers(count)) if count else 0, rng.random() < 0.5
    kept = (
        np.sort(np.append(np.arange(count), index)) if twice else np.delete(np.arange(count), slice(index, index + 1))
    )
    for k, tensor in file.tensors.items():
        if tensor.ndim and len(tensor) == count:
            file.tensors[k] = np.ascontiguousarray(tensor[kept])
    return f"row {index} of {count} {'twice' if twice else 'dropped'}"


# --- all of them

MUTATIONS = {
    tensor_numbers: 8,
    tensors_scaled_together: 4,
    domain_numbers: 3,
    threshold: 3,
    odd_value: 3,
    domain_of_another_size: 3,
    domain_allowance: 2,
    domain_moved: 1,
    tensors_reflected: 2,
    tensors_exchanged: 2,
    tensor_bits: 2,
    rows_dropped_or_doubled: 0.7,
    kind_of_query: 1,
    claim: 1.5,
    layers_balanced: 1,
    sizes_edited: 0.5,
    tensor_structure: 0.5,
    method: 0.3,
}


def tighten(file: File, bounder: Bounder, grid: Grid, rng: np.random.Generator) -> None:
    """Make the most of the proof of a spoilt file, as a liar would: of voxels keep those that the proof counts on, and
    no others; raise
    (or lower) every threshold to the highest one that the proof of its part allows.

    Args:
        file: Changed in place.
        bounder: As it was loaded from it.
        grid: The object.
        rng: Whether to choose the voxels.
    """
    if bounder.of_distances:
        least = (
            0.0 if bounder.volume is not None else -float(largest_overestimate(bounder, grid, SEARCH_SECONDS)[0].max())
        )
        tightest = float(round_down(np.nextafter(least - bounder.rounding_bound(), -np.inf)))
        if np.isfinite(tightest):
            file.document["threshold"] = min(tightest, 0.0)
        return
    tests = [bounder, *getattr(bounder, "members", [])]
    for index, part in enumerate(tests):
        if isinstance(part, Voxels) and rng.random() < 0.7:
            name = "bits" if index == 0 else f"{index - 1}.bits"
            file.tensors[name] = _counted_on(part, grid)
    thresholds = []
    for part in bounder.parts:
        least = least_value(part, grid, eps=0.05, boxes=SEARCHED).lower_bound
        thresholds.append(round_down(np.nextafter(least - part.rounding_bound(), -np.inf)))
    if not np.isfinite(thresholds).all():
        return
    if any(isinstance(part, Voxels) for part in tests):  # whole numbers: the threshold that tells them apart
        thresholds = [
            np.float32(0.75) if isinstance(p, Voxels) else t for p, t in zip(bounder.parts, thresholds, strict=True)
        ]
    exits = len(thresholds) - 1
    for name in ("thresholds", "exits.thresholds", f"{len(tests) - 2}.exits.thresholds"):
        if name in file.tensors:
            count = min(file.tensors[name].size, exits)
            start = 0 if name == "thresholds" else exits - count
            file.tensors[name] = np.array(thresholds[start : start + count], np.float32)
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


def mutate(file: File, rng: np.random.Generator) -> list[str]:
    """Spoil a file in place, by one mutation or several; what was done."""
    wanted, done = 1 + min(int(rng.geometric(0.55)) - 1, MOST - 1), []
    odds = np.array(list(MUTATIONS.values()), dtype=np.float64)
    for _ in range(8 * MOST):
        chosen = list(MUTATIONS)[rng.choice(len(odds), p=odds / odds.sum())]
        try:
            what = chosen(file, rng)
        except LookupError:  # of what it spoils an earlier mutation has left nothing
            if not done:
                raise
            continue
        if what:
            done.append(what)
        if len(done) == wanted:
            break
    return done


def spoil_checkpoint(path: Path, rng: np.random.Generator) -> tuple[str, bool]:
    """Change a proof's checkpoint; what was done, and whether its digest was made right again."""
    tensors = {k: v.copy() for k, v in safetensors.numpy.load_file(path).items()}
    with safetensors.safe_open(str(path), framework="numpy") as held:
        entry = json.loads(held.metadata()[CHECKPOINT])
    content, kind, signed = path.read_bytes(), int(rng.integers(6)), bool(rng.random() < 0.7)
    if kind == 0:
        length = int(rng.integers(len(content)))
        path.write_bytes(content[:length])
        return f"checkpoint: the first {length} bytes", False
    before, left = digest_of(tensors, entry["left"]), entry["left"]
    name = str(rng.choice(sorted(tensors)))
    if kind == 1:
        del tensors[name]
        what = f"without {name}"
    elif kind == 2:
        tensors[name] = tensors[name].astype(rng.choice(["f4", "f8", "i4", "i8"])).reshape(-1, 1)
        what = f"another structure of {name}"
    elif kind == 3 and tensors[name].dtype == np.float64:
        tensors[name] = np.ascontiguousarray(tensors[name])
        what = f"{name}: {numbers(tensors[name], rng)}"
    elif kind == 4 and tensors[name].size:
        tensors[name] = tensors[name] + int(rng.choice([-1, 1, 2**20, -(2**40)]))
        what = f"{name} moved"
    else:
        key = str(rng.choice(sorted(left)))
        left[key] = copy.deepcopy(ODD[rng.integers(len(ODD))])
        what = f"{key}: {left[key]!r}"
    if digest_of(tensors, left) == before:
        return f"checkpoint: unchanged ({what})", True
    if signed:
        entry["sha256"] = digest_of(tensors, left)
    path.write_bytes(safetensors.numpy.save(tensors, metadata={CHECKPOINT: json.dumps(entry)}))
    return f"checkpoint: {what}{', signed' * signed}", signed
