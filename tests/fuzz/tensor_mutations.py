"""Mutations of tensors; each returns what it did in a few words, or ``None`` where there is nothing that it could change."""

import numpy as np
from spoilt import POWERS, File, numbers, power_of_two


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
    """What leaves a volume's shape as it is: every number of some tensors, or of one half-space, by one power of two."""
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
