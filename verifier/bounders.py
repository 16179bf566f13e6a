"""What a bounder's file claims: the map to v, what f must reach there, and f of each kind.

``v = (x - center) * scale`` in float32. Of points it is within delta of the exact one, and the answer is *no* where
``|v| > limit`` or ``f < threshold``. Of distances f is -F, and F + threshold + E must be at most the distance where
``|v| <= limit``; ``docs/verifier.md`` says why no distance is then overestimated anywhere.
"""

from itertools import pairwise

import numpy as np

from verifier import float32, grid, network

METHODS = {"point": ("mlp", "aabb", "obb", "kdop", "learned-kdop", "bvh"), "distance": ("mlp", "distance-grid")}
ROOM = 1 + 2.0**-45  # outweighs what float64 rounds in a handful of operations on positive numbers


def parts(tensors: dict[str, np.ndarray], about: dict) -> list[tuple[dict, dict]]:
    """Bounders that a file holds: its own, or the parts of a cascade, which answers maybe where all of them do."""
    if about["method"] != "cascade" or about["query"] != "point":
        return [(tensors, about)]
    found, thresholds = [], [*tensors["thresholds"].tolist(), about["threshold"]]
    for i, (part, threshold) in enumerate(zip(about["sizes"]["parts"], thresholds, strict=True)):
        own = {name.partition(".")[2]: tensor for name, tensor in tensors.items() if name.startswith(f"{i}.")}
        found += parts(own, about | {"method": part["method"], "sizes": part["sizes"], "threshold": threshold})
    return found


class Claim:
    """A file's claim, or a part's; ``ValueError`` for one that is not checked by this program.

    It has a module ``f`` with its ``numbers`` and ``roots``, boxes to search, or ``faces`` (f is the least ``offset -
    d . v``). Boxes are of v, or of places in a grid: of ``(x - origin) * per``, where ``room`` is for what float64
    rounds. ``error`` is E; ``unit`` is 1 / scale where distances are claimed, else 0.
    """

    def __init__(self, tensors: dict[str, np.ndarray], about: dict):
        self.method, sizes, domain, far = about["method"], about["sizes"], about["domain"], about["query"] == "distance"
        activation = sizes.get("activation", "sin")
        odd = [self.method not in METHODS.get(about["query"], ()), activation not in ("sin", "relu")]
        odd += [about["dimension"] != 3, about["motion"], "frame" in about, "speed" in domain, sizes.get("shape")]
        odd += [x.get(name) for x in (domain, sizes) for name in ("joints", "time", "unbounded", "octaves", "moments")]
        if any(odd):
            raise ValueError(f"{self.method} for {about['query']} queries of this kind is not checked by this program")
        self.center, self.scale, self.limit = (np.array(domain[name], float) for name in ("center", "scale", "limit"))
        self.threshold, self.delta = float(about["threshold"]), np.array(0.0 if far else domain["delta"], float)
        numbers = np.concatenate([[self.threshold], self.center, self.scale, self.limit])
        if numbers.shape != (10,) or (np.float32(numbers) != numbers).any() or not (self.scale > 0).all():
            raise ValueError("the threshold or the domain has other numbers than float32")
        half, power = np.frexp(self.scale)
        odd = (half != 0.5) | (power != power[0]) | (np.abs(power) > 30) | (np.abs(np.log2(self.limit)) > 20)
        if far and odd.any():
            raise ValueError("the scale of a distance is not one power of two, or its domain is too flat or too large")
        self.origin, self.per, self.roots = self.center, self.scale, [(-self.limit, self.limit)]
        self.room = 2.0**-49 * ((2 * self.limit + self.delta) / self.scale + np.abs(self.center))
        self.f, self.faces, self.error, self.unit = network, None, float32.AROUND * far, far / self.scale[0]
        if self.method == "mlp":
            widths = [3, *sizes["hidden"], 1]
            layers = [(tensors[f"layers.{i}.weight"], tensors[f"layers.{i}.bias"]) for i in range(len(widths) - 1)]
            found = [weight.shape + bias.shape for weight, bias in layers]
            if found != [(h, k, h) for k, h in pairwise(widths)] or max(widths) > network.WIDEST:
                raise ValueError(f"expected layers of the sizes that the file says, {network.WIDEST} neurons at most")
            self.error += float32.network(layers, activation, self.limit)
            layers[-1] = tuple(-numbers if far else numbers for numbers in layers[-1])
            self.numbers = layers, activation
        elif self.method == "distance-grid":
            low, step = tensors.get("range", (0.0, 1.0))  # of values of 8 bits
            values = low + step * tensors["values"]
            size, cells = np.abs(values), np.array(values.shape) - 1
            small = sizes["storage"] == "float16" and ((size > 0) & (size < 2.0**-14)).any()  # is subnormal
            if values.ndim != 3 or not 1 <= cells.min() <= cells.max() < 1024 or size.max() > 2.0**20 or small:
                raise ValueError("nodes or values of the grid are not checked by this program")
            self.f, self.numbers, self.roots = grid, (values,), [(0 * cells, cells)]
            self.origin, self.per = self.center - self.limit / self.scale, self.scale * cells / (2 * self.limit)
            self.error += float32.grid(values, low)
        elif self.method == "bvh":
            self.numbers = [(np.zeros((1, 3)), -np.ones(1))], activation
            leaves = leaves_of(*(tensors[name] for name in ("low", "high", "past")))
            self.roots = uncovered(*self.roots[0], *leaves) if self.threshold <= 0 else self.roots  # f is 0 in a leaf
        elif self.method == "learned-kdop":
            self.faces = tensors["normals"], tensors["offsets"]
            self.error = float32.faces(*self.faces, self.limit, axes=False)
        else:
            d = tensors.get("directions", np.eye(3))
            self.faces = np.concatenate([d, -d]), np.concatenate([tensors["high"], -tensors["low"]])
            self.error = float32.faces(*self.faces, self.limit, axes=self.method == "aabb")
        self.target = np.nextafter(self.threshold + self.error, np.inf)

    def origins(self, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Boxes that hold all points of object space that may come to lie in these."""
        low, high = (lower - self.delta) / self.per, (upper + self.delta) / self.per
        return low + self.origin - self.room, high + self.origin + self.room

    def check_domain(self, lower: np.ndarray, upper: np.ndarray) -> None:
        """Raise ``ArithmeticError`` if the map itself may deny a point of an object in this box."""
        v = np.maximum(upper - self.center, self.center - lower) * self.scale * ROOM
        query = float32.U * np.maximum(np.abs(lower), np.abs(upper)) * self.scale * ROOM  # of float64, made float32
        needed = (query + 2.0001 * float32.U * (v + query)) * ROOM + 4 * float32.TINY * (1 + self.scale)
        if not (self.unit or (needed <= self.delta).all()):
            raise ArithmeticError(f"float32 rounds v by up to {needed.tolist()}, delta is only {self.delta.tolist()}")
        if not ((v + self.delta) * ROOM <= self.limit).all():
            raise ArithmeticError(f"the object reaches to |v| = {v.tolist()}, the domain to {self.limit.tolist()}")

    def check_faces(self, vertices: np.ndarray, margin: float) -> None:
        """Raise ``ArithmeticError`` unless f reaches the target on the hull of the object, and so on the object."""
        (d, offset), away = self.faces, vertices - self.center
        reach = margin * np.sqrt(((d * self.scale) ** 2).sum(axis=1)) + np.abs(d) @ self.delta  # beyond a vertex
        room = (np.abs(away) @ np.abs(d * self.scale).T + reach + np.abs(offset) + abs(self.target)) * 2.0**-45
        f = offset - away @ (d * self.scale).T - reach - room
        if not f.min() >= self.target:
            place, why = vertices[f.argmin() // len(d)].tolist(), f"f may be {f.min():.9g}, {self.target:.9g} is needed"
            raise ArithmeticError(f"vertex {place}, face {f.argmin() % len(d)}: {why}")


def leaves_of(low: np.ndarray, high: np.ndarray, past: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What of each leaf is reached by a walk, which goes from a node i that is met to i + 1, else to ``past[i]``."""
    at = np.arange(len(past))
    if low.shape != (len(past), 3) or high.shape != low.shape or (past <= at).any() or (past % 1 != 0).any():
        raise ValueError("the hierarchy is none")
    above = [(at <= leaf) & (past > leaf) for leaf in np.flatnonzero(past == at + 1)]
    return np.array([low[nodes].max(axis=0) for nodes in above]), np.array([high[nodes].min(axis=0) for nodes in above])


def uncovered(lower: np.ndarray, upper: np.ndarray, low: np.ndarray, high: np.ndarray) -> list:
    """Boxes that cover ``lower`` to ``upper`` together with the boxes ``low`` to ``high``, cut along their faces."""
    meets = ((low < upper) & (high > lower)).all(axis=1)
    low, high = low[meets], high[meets]
    if not len(low):
        return [(lower, upper)]
    if ((low <= lower) & (high >= upper)).all(axis=1).any():
        return []
    largest = (np.minimum(high, upper) - np.maximum(low, lower)).prod(axis=1).argmax()
    cuts = [(k, face[largest, k]) for face in (low, high) for k in range(3) if lower[k] < face[largest, k] < upper[k]]
    (k, at), one, two = cuts[0], upper.copy(), lower.copy()
    one[k] = two[k] = at
    return uncovered(lower, one, low, high) + uncovered(two, upper, low, high)
