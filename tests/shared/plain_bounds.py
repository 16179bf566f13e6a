"""Bounds of a network over boxes of its inputs in NumPy: the reference implementation of the native ones."""

from itertools import combinations, combinations_with_replacement, permutations

import numpy as np

from warp_bounding.activations import Curve
from warp_bounding.networks.bounds import ROOM, SQUARES_ROUNDING
from warp_bounding.networks.network import Layer, Network


def bound_plain(network: Network, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The reference implementation of ``Network.bound``.

    Returns:
        ``(N,)`` certified lower bounds (float64 rounding subtracted), ``(N,)`` the axes whose halving should help
        most, and ``(N, n)`` the corners where the linear part is least.
    """
    center, half_width = (lower + upper) / 2, (upper - lower) / 2
    lines = [column * half_width[:, k, None] for k, column in enumerate(network.hidden[0].weight.T)]
    lines, mean, noise = np.stack(lines), center, np.zeros((len(center), len(network.hidden[0].bias)))
    form = middles = reach = None  # of the arguments: quadratic forms, the middles and halves of their ranges
    trace = []  # per hidden layer: lines, form, middle, width of the arguments; curve
    for index, layer in enumerate(network.hidden):
        # An argument is z + l + p + y: l = lines . zeta, |l| <= near; p is a quadratic form, within radius of its
        # middle; |y| <= noise.
        z, near, pad = mean @ layer.weight.T + layer.bias, np.abs(lines).sum(axis=0), network.padding[index]
        middle = radius = np.zeros_like(z)
        if form is not None:
            middle, radius = _range(form, middles, reach, ROOM if layer.activation.limit < np.inf else np.inf)
        curve = _curve(layer, z + middle, near, radius, noise + pad)
        curve = curve._replace(spread=curve.spread + pad)
        trace.append((lines, form, middle, near + radius + noise + pad, curve))
        if index + 1 == len(network.hidden):
            break
        # What the next layer reads: l^3 is within near^3 / 4 of 3/4 near^2 l, and l p within near radius of 0.
        weight, sizes = network.hidden[index + 1].weight.T, np.abs(network.hidden[index + 1].weight.T)
        mean, half = curve.mean - curve.slope * middle, near * near / 2
        noise = np.abs(curve.slope) * noise + curve.spread + np.abs(curve.cross) * near * radius
        noise = (noise + np.abs(curve.cube) * near**3 / 4) @ sizes
        if form is not None or layer.activation.bends:
            square = curve.bend * lines[:, None] * lines + (0.0 if form is None else curve.slope * form)
            form, middles = square @ weight, (curve.slope * middle + curve.bend * half) @ weight
            reach = (np.abs(curve.slope) * radius + np.abs(curve.bend) * half) @ sizes
        lines = (lines * (curve.slope + curve.lean + 1.5 * curve.cube * half)) @ weight
    least = curve.mean - curve.slope * middle
    least = least @ network.output.weight[0] + network.output.bias[0] - network.padding[-1]
    # Backwards: curves are weighed by the output's coefficients and added to one polynomial. What the neurons'
    # spreads cost is charged to the inputs whose width causes it (score).
    n = center.shape[1]
    coefficient = np.broadcast_to(network.output.weight[0], curve.mean.shape)
    score, tilt = np.zeros_like(center), np.zeros_like(center)
    square, cube, bulk = np.zeros((len(center), n, n)), np.zeros((len(center), n, n, n)), 0.0
    for (lines, form, middle, width, curve), layer in zip(reversed(trace), reversed(network.hidden), strict=True):
        c, near = coefficient, np.abs(lines).sum(axis=0)
        loss = np.abs(c) * curve.spread
        least -= loss.sum(axis=1)
        score += np.einsum("bj,kbj->bk", loss / width, np.abs(lines))
        tilt += np.einsum("bj,kbj->bk", c * (curve.lean - curve.cross * middle), lines)
        square += np.einsum("bj,kbj,mbj->bkm", c * curve.bend, lines, lines)
        cube += np.einsum("bj,kbj,mbj,obj->bkmo", c * curve.cube, lines, lines, lines, optimize=True)
        bulk = bulk + (np.abs(c) * near * near * (np.abs(curve.bend) + np.abs(curve.cube) * near)).sum(axis=1)
        if form is not None:
            cube += np.einsum("bj,kbj,mobj->bkmo", c * curve.cross, lines, form, optimize=True)
            bulk += (np.abs(c * curve.cross) * near * np.abs(form).sum(axis=(0, 1))).sum(axis=1)
        coefficient = (c * curve.slope) @ layer.weight
    least -= SQUARES_ROUNDING * bulk
    least += _straighten(cube, tilt, score)
    slope = coefficient * half_width + tilt
    corner = np.where(slope > 0, lower, upper)
    return least + _close(slope, square, score), np.argmax(score, axis=1), corner


def _curve(layer: Layer, z: np.ndarray, near: np.ndarray, radius: np.ndarray, noise: np.ndarray) -> Curve:
    """What encloses a layer's outputs."""
    if layer.activation.bends:
        return layer.activation.curve(z, near, radius, noise)
    slope, mean, _, spread = layer.activation.relax(z, near, radius + noise)
    return Curve(mean, slope, *[np.zeros_like(z) for _ in range(4)], spread)


def _straighten(cube: np.ndarray, tilt: np.ndarray, score: np.ndarray) -> np.ndarray:
    """``(N,)``: what is lost where cubes ``(N, n, n, n)`` become lines, which are added to ``tilt``, as losses to
    ``score``.

    Over ``|zeta| <= 1``, ``zeta^3`` is within 1/4 of ``3/4 zeta``, and ``zeta_k^2 zeta_m`` within 1/2 of ``1/2
    zeta_m``.
    """
    n, least = tilt.shape[1], np.zeros(len(tilt))
    for entry in combinations_with_replacement(range(n), 3):
        a, b, d = entry
        orders = set(permutations(entry))
        total = sum(cube[:, i, j, k] for i, j, k in orders)
        share = {1: 0.75, 3: 0.5, 6: 0.0}[len(orders)]
        if share:
            tilt[:, b if a == d else d if a == b else a] += share * total
        loss = (1 - share) * np.abs(total)
        least -= loss
        for k in entry:
            score[:, k] += loss / 3
    return least


def _close(slope: np.ndarray, square: np.ndarray, score: np.ndarray) -> np.ndarray:
    """``(N,)`` bounds of ``slope . zeta`` and a quadratic form over ``|zeta| <= 1``; what they lose is added to
    ``score``.

    Entries off the diagonal count in absolute value; where they are positive in the corner where the linear part is
    least, they lower both slopes (McCormick). The least of ``-tilt |zeta| + up zeta^2`` is at ``zeta = tilt / (2 up)``
    if that is less than 1, else at the end.
    """
    tilt, size, sign = np.abs(slope), np.abs(square), np.sign(slope)
    diagonal = np.einsum("bkk->bk", square)
    score += size.sum(axis=2)
    least = np.maximum(diagonal, 0).sum(axis=1) - size.sum(axis=(1, 2))
    for k, m in combinations(range(slope.shape[1]), 2):
        gained = np.minimum(np.minimum(tilt[:, k], tilt[:, m]), 2 * size[:, k, m])
        gained[sign[:, k] * sign[:, m] * square[:, k, m] <= 0] = 0.0
        tilt[:, k] -= gained
        tilt[:, m] -= gained
    up = np.maximum(diagonal, 0)
    inner = -(tilt**2) / (4 * np.where(up > 0, up, 1.0))
    return least + np.where(tilt < 2 * up, inner, up - tilt).sum(axis=1)


def _range(square: np.ndarray, sums: np.ndarray, reach: np.ndarray, room: float) -> tuple[np.ndarray, np.ndarray]:
    """Middle and half of the range of quadratic forms over ``|zeta| <= 1``.

    Args:
        square: ``(n, n, N, H)``, their entries.
        sums: ``(N, H)``, middles of the parabolas that they consist of, summed.
        reach: ``(N, H)``, their half-heights, summed.
        room: The largest middle; farther ones become 0, and the range as much wider.
    """
    diagonal = np.einsum("kkbj->bj", square) / 2
    other = np.abs(square).sum(axis=(0, 1)) - np.einsum("kkbj->bj", np.abs(square)) / 2
    low, high = np.maximum(diagonal - other, sums - reach), np.minimum(diagonal + other, sums + reach)
    middle, radius = (low + high) / 2, (high - low) / 2
    beyond = np.abs(middle) > room
    return np.where(beyond, 0.0, middle), np.where(beyond, radius + np.abs(middle), radius)
