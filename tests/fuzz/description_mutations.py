"""Mutations of the description: domain, sizes, threshold, kind; each returns what it did, or ``None`` where it could not change anything."""

import copy

import numpy as np
from spoilt import POWERS, File, numbers

from warp_bounding.bounders import METHODS

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
