"""``mlp-early``: an ``mlp`` with exits (the paper's OurNNEarly, section *Neural Early-out*).

Behind each hidden layer but the last stands an *exit*, two linear outputs on that layer's activations with a
threshold each. Where the first is below its threshold the answer is *no*, which is proven: an exit that denies is a
shorter network whose layers are shared, and every part is proven by itself, as an ordinary ``Mlp`` (``parts``, ``of``).
Where else the second, the *grant*, is above its threshold the answer is *maybe*, and no more is queried. That needs no
proof, because *maybe* is never wrong; it may cost false positives, of which its threshold allows a few
(``training.recipes.early``). Without grants an exit would pay only where most queries are denied: where they mostly
meet the object, as planes do, it is the *maybe* that can be told early.

``f`` is the output where no exit decides, ``DENIED``, a very low number, where the first to decide denies, and
``GRANTED``, a very high one, where it grants. Whatever is certified of the parts together holds: f is lower than
without grants nowhere.

On a CPU the batch path asks an exit for a block of queries, then moves the undecided together and begins the next part
with their coordinates; it computes the shared layers again rather than carry their activations along. Other code
(CUDA, the function for other kernels) asks one query and goes on from the layer where it is.

Limits: one hidden layer has no exit. The gain is what exits decide, less what they cost, a fifth to a third of the
network (``python -m paper speed`` measures it).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warp_bounding.bounders.bounder import STEPS, Bounder
from warp_bounding.bounders.mlp import ACTIVATION, HIDDEN, Mlp
from warp_bounding.errors import BounderError
from warp_bounding.kernels.source import DENIED, GRANTED, Early, Lanes
from warp_bounding.networks.bounds import BoxBounds
from warp_bounding.networks.inference import MlpSource, head_numbers
from warp_bounding.queries.domain import GROWTH
from warp_bounding.runtime.native import literal


@dataclass(frozen=True)
class MlpEarlySource(MlpSource):
    """Native code of a network with exits, for its sizes.

    Numbers: those of ``MlpSource``, then per exit its threshold and its output, written like the network's own, then
    those of its grant.
    """

    @property
    def exits(self) -> list[int]:
        """Where in the numbers each exit's threshold stands; its output follows."""
        places, at = [], self.places[-1] + self.head_size(-1)
        for index in range(len(self.hidden) - 1):
            places.append(at)
            at += 2 * (1 + self.head_size(index))
        return places

    @property
    def grants(self) -> list[int]:
        """Where in the numbers each grant's threshold stands; its output follows."""
        return [place + 1 + self.head_size(index) for index, place in enumerate(self.exits)]

    def early(self) -> list[Early]:
        lanes, tests = Lanes(vector=True), []
        for index, (place, grant) in enumerate(zip(self.exits, self.grants, strict=True)):
            code = self.chain(lanes, index + 1, place + 1, grant + 1)
            tests.append(Early(code, f"w[{place}]", f"w[{grant}]"))
        return tests

    def body(self, lanes: Lanes) -> str:
        """The single query goes through the exits here; lanes have been through them by ``early``."""
        if lanes.vector:
            return super().body(lanes)
        lines = [self.begin(lanes)]
        for index, (place, grant) in enumerate(zip(self.exits, self.grants, strict=True)):
            lines.append(self.layer(index, place + 1, keep=True, sure_at=grant + 1))
            lines.append(f"if (f < w[{place}]) {{ f = {literal(DENIED)}; }}")
            lines.append(f"else if (sure > w[{grant}]) {{ f = {literal(GRANTED)}; }} else {{")
        lines.append(self.layer(len(self.hidden) - 1, self.places[-1], keep=False))
        return "\n".join([*lines, "}" * len(self.exits)])

    def function_body(self) -> str:
        lines = [f"float answer = {literal(DENIED)}; do {{", self.inputs_text("float")]
        for index, (place, grant) in enumerate(zip(self.exits, self.grants, strict=True)):
            lines.append(self.function_layer(index))
            lines += ["{", self.function_output(index, place + 1), f"if (f < w[{place}]) break; }}"]
            granted = f"if (f > w[{grant}]) {{ answer = {literal(GRANTED)}; break; }} }}"
            lines += ["{", self.function_output(index, grant + 1), granted]
        last = len(self.hidden) - 1
        lines += [self.function_layer(last), self.function_output(last, self.places[-1])]
        return "\n".join([*lines, "answer = f; } while (false); const float f = answer;"])


class MlpEarly(Mlp):
    """A network with exits: each in turn may deny or grant a query, and the network's output decides the rest.

    Tensors: those of ``Mlp``; ``exits.i.weight`` ``(1, H_i)`` and ``exits.i.bias`` ``(1,)``, 2 rows for planes, for
    every hidden layer i but the last; ``exits.thresholds`` ``(exits,)``: a query is denied where an exit's output is
    less; ``grants.i.weight``, ``grants.i.bias`` and ``grants.thresholds`` of the same shapes, which older files do not
    have: a query that no exit denies before is granted where a grant's output is more. Sizes: those of ``Mlp``.
    """

    method = "mlp-early"
    options = (HIDDEN, ACTIVATION, STEPS)
    source_kind = MlpEarlySource

    def __init__(self, domain, tensors: dict[str, np.ndarray], sizes: dict, device: str | None = None):
        """Arguments and errors of ``Mlp``.

        Exits without ``exits.thresholds`` deny nothing; without grants none is granted.
        """
        exits = [name for name in tensors if name.startswith("exits.") and not name.endswith("thresholds")]
        if "exits.thresholds" not in tensors:
            tensors = tensors | {"exits.thresholds": np.full(len(exits) // 2, DENIED, np.float32)}
        if not any(name.startswith("grants.") for name in tensors):
            tensors = tensors | {
                f"grants.{name.removeprefix('exits.')}": np.zeros_like(tensors[name]) for name in exits
            }
            tensors["grants.thresholds"] = np.full(len(exits) // 2, GRANTED, np.float32)
        super().__init__(domain, tensors, sizes, device)

    def check_tensors(self) -> None:
        super().check_tensors()
        made_of = [part_of(self.tensors, self.sizes, depth) for depth in range(1, len(self.hidden) + 1)]
        self._parts = [Mlp(self.domain, *own, self._device) for own in made_of]
        for part, threshold in zip(self._parts, self.tensors["exits.thresholds"], strict=False):
            part.freeze(threshold, None)
        self._grants = [
            Mlp(self.domain, *grant_of(self.tensors, self.sizes, i), self._device) for i in range(len(self._parts) - 1)
        ]

    @classmethod
    def of(cls, parts: list[Mlp]) -> "MlpEarly":
        """The conjunction, without a certificate, of networks that share domain, sizes and layers, at their thresholds.

        Part i has the hidden layers 0 .. i of the last part, and an output of its own.
        """
        last = parts[-1]
        tensors, thresholds = dict(last.tensors), [part.threshold for part in parts[:-1]]
        for index, part in enumerate(parts[:-1]):
            for name in ("weight", "bias"):
                tensors[f"exits.{index}.{name}"] = part.tensors.get(f"layers.{index + 1}.{name}")
        tensors["exits.thresholds"] = np.array(thresholds, dtype=np.float32)
        if len(parts) == len(last.hidden) and all(value is not None for value in tensors.values()):
            early = cls(last.domain, tensors, last.sizes, last._device)
            if all(_same(a, b) for a, b in zip(parts, early._parts, strict=True)):
                return early.freeze(last.threshold, None)
        expected = "parts that share domain, sizes and layers, one for each hidden layer"
        raise BounderError(f"{cls.method}: expected {expected}")

    @property
    def parts(self) -> list[Mlp]:
        """The exits as networks by themselves, in order, then the network without exits; each at its threshold."""
        parts = [part.to(self._device) for part in self._parts]
        parts[-1].freeze(self.threshold, None)
        return parts

    def granting(self, grants: Sequence[tuple[np.ndarray, np.ndarray]], thresholds: Sequence[float]) -> "MlpEarly":
        """This bounder with other grants (weight and bias, shaped as of the exits) and their thresholds.

        Its own thresholds and its certificate stay.
        """
        tensors = dict(self.tensors)
        for index, grant in enumerate(grants):
            for name, value in zip(("weight", "bias"), grant, strict=True):
                tensors[f"grants.{index}.{name}"] = np.asarray(value, np.float32)
        tensors["grants.thresholds"] = np.asarray(thresholds, np.float32)
        other = type(self)(self.domain, tensors, self.sizes, self._device)
        other.info = dict(self.info)
        return other.freeze(float(self.threshold), self.certificate)

    def more_shapes(self) -> dict[str, tuple[int, ...]]:
        shapes, outputs = {}, self.head.outputs
        for role in ("exits", "grants"):
            for index, width in enumerate(self.hidden[:-1]):
                shapes |= {f"{role}.{index}.weight": (outputs, width), f"{role}.{index}.bias": (outputs,)}
            shapes[f"{role}.thresholds"] = (len(self.hidden) - 1,)
        return shapes

    def weights(self) -> np.ndarray:
        numbers = [super().weights()]
        for index in range(len(self.hidden) - 1):
            for role in ("exits", "grants"):
                head = head_numbers(self.tensors[f"{role}.{index}.weight"], self.tensors[f"{role}.{index}.bias"])
                numbers += [[self.tensors[f"{role}.thresholds"][index]], head]
        return np.concatenate(numbers).astype(np.float32)

    def reference(self, v: np.ndarray) -> np.ndarray:
        f = super().reference(v)
        exits = zip(self._parts[:-1], self._grants, self.tensors["grants.thresholds"], strict=True)
        for part, grant, sure in reversed(list(exits)):  # the first to decide has the last word
            f = np.where(grant.reference(v) > float(sure), GRANTED, f)
            f = denied_early([part], v, f)
        return f

    def bound(self, lower: np.ndarray, upper: np.ndarray) -> BoxBounds:
        return bounds_of_all(self._parts[:-1], super().bound(lower, upper), lower, upper, self.reference)


def denied_early(firsts: Sequence[Bounder], v: np.ndarray, f: np.ndarray) -> np.ndarray:
    """``f``, the last part's of v, where all parts before it pass, and ``DENIED`` elsewhere."""
    for part in firsts:
        f = np.where(part.reference(v) < float(part.threshold), DENIED, f)
    return f


def bounds_of_all(firsts: Sequence[Bounder], bounds: BoxBounds, lower, upper, reference) -> BoxBounds:
    """The last part's bounds where every part before it passes on every device, and ``DENIED`` elsewhere."""
    least, axis, point = (np.array(x) for x in bounds[:3])
    next_axis = None if bounds.next_axis is None else np.array(bounds.next_axis)
    for part in firsts:
        own = part.bound(lower, upper)
        # Where a part may deny on some device, f may be DENIED: no better bound holds there, and halving goes by
        # that part's axis.
        fails = ~(own.lower >= float(part.threshold) + part.rounding_bound() * GROWTH)
        least[fails], axis[fails], point[fails] = DENIED, own.axis[fails], own.point[fails]
        if next_axis is not None:
            next_axis[fails] = own.next_axis[fails]
    return BoxBounds(least, axis, point, reference(point), next_axis)


def part_of(tensors: dict[str, np.ndarray], sizes: dict, depth: int) -> tuple[dict[str, np.ndarray], dict]:
    """Tensors and sizes of the ``Mlp`` of the first ``depth`` hidden layers and the output behind them."""
    held, hidden = {}, list(sizes["hidden"])
    for index in range(depth + 1):
        role = f"exits.{depth - 1}" if index == depth < len(hidden) else f"layers.{index}"
        for name in ("weight", "bias"):
            held[f"layers.{index}.{name}"] = tensors[f"{role}.{name}"]
    return held, sizes | {"hidden": hidden[:depth]}


def grant_of(tensors: dict[str, np.ndarray], sizes: dict, index: int) -> tuple[dict[str, np.ndarray], dict]:
    """Tensors and sizes of the ``Mlp`` of the hidden layers up to ``index`` and the grant behind them."""
    held, own = part_of(tensors, sizes, index + 1)
    grant = {f"layers.{index + 1}.{name}": tensors[f"grants.{index}.{name}"] for name in ("weight", "bias")}
    return held | grant, own


def _same(a: Mlp, b: Mlp) -> bool:
    """Whether two networks are the same function of the same queries."""
    if a.source != b.source or a.domain.to_dict() != b.domain.to_dict() or a.tensors.keys() != b.tensors.keys():
        return False
    return all(np.array_equal(a.tensors[name], b.tensors[name]) for name in a.tensors)
