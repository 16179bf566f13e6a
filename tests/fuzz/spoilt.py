"""A bounder's file as its document and its tensors, to be changed, and made right again where loading would notice."""

import copy
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import safetensors
import safetensors.numpy

from warp_bounding.bounders import Bounder, file_format
from warp_bounding.certificates.certificate import Certificate
from warp_bounding.queries.distance import DISTANCE

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
