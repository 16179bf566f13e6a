"""A network over boxes, in float64 with every rounding counted; the argument is in ``docs/verifier.md``.

On a box with middle m and half sides r, ``f(m + h) = f(m) + g h + 1/2 h' H h``: g is the gradient in m, H lies in an
enclosure of the Hessian on the box. All three go forwards through the layers, as z, J and H of each neuron; behind one
they are ``sin z``, ``cos z J`` and ``cos z* H - sin z* J* J*'``, where z* and J* are what z and J can be on the box.
"""

import math

import flint
import numpy as np

U, UP, TINY = 2.0**-53, 1 + 2.0**-40, 2.0**-1000
WIDEST = 2000  # neurons of a layer
FIRST, SECOND = np.triu_indices(3)  # of a Hessian the upper triangle is kept
FULL = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # where in it each entry is
TERMS, REACH = 10, 1.6  # of two Taylor series, up to r^19 and r^18; of |r|, just over pi / 2
REST = REACH**20 / math.factorial(20) + 2.0**-46  # the first term that is left out, and what Horner's rule rounds


class Ball:
    """Arrays of balls: each holds all numbers within ``rad`` of ``mid``.

    A middle is rounded: by at most U of itself, or less than TINY where it is subnormal, which the radius takes in. A
    radius is a sum of at most WIDEST products of numbers that are not negative; UP is above what it rounds itself.
    """

    def __init__(self, mid, rad=0.0):
        self.mid, self.rad = np.asarray(mid, float), np.broadcast_to(rad, np.shape(mid))

    def __getitem__(self, at):
        return Ball(self.mid[at], self.rad[at])

    def __add__(self, other):
        mid = self.mid + other.mid
        return Ball(mid, (self.rad + other.rad + U * np.abs(mid) + TINY) * UP)

    def __mul__(self, other):
        mid, a, b = self.mid * other.mid, np.abs(self.mid), np.abs(other.mid)
        return Ball(mid, (a * other.rad + self.rad * (b + other.rad) + U * np.abs(mid) + TINY) * UP)

    def __rmatmul__(self, weight: np.ndarray):  # times the first axis; gamma(K + 1) covers any order of the sums
        terms, shape = weight.shape[1], (len(weight), *self.mid.shape[1:])
        within = self.rad + (terms + 2) * U * np.abs(self.mid) + TINY
        mid, rad = weight @ self.mid.reshape(terms, -1), np.abs(weight) @ within.reshape(terms, -1)
        return Ball(mid.reshape(shape), ((rad + terms * TINY) * UP).reshape(shape))

    __array_ufunc__ = None  # so that ``array @ ball`` comes here

    def widened(self, by: np.ndarray):
        return Ball(self.mid, (self.rad + by) * UP)

    def size(self) -> np.ndarray:  # upper bounds of absolute values
        return (np.abs(self.mid) + self.rad) * UP

    def lower(self, sign: float = 1.0) -> np.ndarray:  # lower bounds; with -1 of what is negated
        return sign * self.mid - (self.rad + U * np.abs(self.mid)) * UP - TINY

    def sine_cosine(self):
        # Taylor's alternating series in r = z - n pi. Horner's rule for m terms errs by gamma(3 m + 2) times the sum of
        # absolute terms (Higham, 5.1; r^2 and coefficients are rounded, too), which is at most cosh 1.6 < 2.6.
        n = np.rint(self.mid / math.pi)
        r = self + Ball(-n) * Ball(math.pi, 2.0**-52)
        if not (np.abs(r.mid) <= REACH).all():
            raise OverflowError("a sine's argument is too large")
        square, found = r.mid * r.mid, []
        for odd in (1, 0):
            p = np.zeros_like(square)
            for k in reversed(range(TERMS)):
                p = p * square + (-1) ** k / math.factorial(2 * k + odd)
            found.append(Ball(np.where(n % 2 == 0, p, -p) * (r.mid if odd else 1.0), (r.rad + REST) * UP))
        return found


def lowest(layers, activation: str, lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, ...]:
    """Lower bounds ``(N,)`` of f over boxes; base ``(N,)`` and slope of affine ones, what an axis bends, ``(N, n)``."""
    middle = (lower + upper) / 2
    half = np.maximum(upper - middle, middle - lower).T * UP
    weight, bias = layers[0]
    z = weight @ Ball(middle.T) + Ball(bias[:, None])
    slope = Ball(np.broadcast_to(weight[:, :, None], (*weight.shape, len(lower))))
    bend = Ball(np.zeros((len(bias), 6, len(lower))))
    for weight, bias in layers[1:]:
        turned = (bend.size()[:, FULL] * half).sum(axis=2)  # a bound of |H| r
        reach = ((slope.size() + turned * 0.5) * half).sum(axis=1) * UP
        if activation == "sin":
            value, change = z.sine_cosine()
            s, c = value.size(), change.size()
            moved = [np.minimum((a + b * reach * 0.5) * reach * UP, 2.0) for a, b in ((c, s), (s, c))]
            wide, minus = slope.widened(turned * UP), Ball(-value.mid, value.rad).widened(moved[0])
            bend = change.widened(moved[1])[:, None] * bend + minus[:, None] * (wide[:, FIRST] * wide[:, SECOND])
        else:
            around, top = z.widened(reach), np.maximum(-z.lower(-1), 0) / 2
            on, off, sure = around.lower() >= 0, around.lower(-1) >= 0, z.lower() >= 0
            value = Ball(np.where(sure, z.mid, top), np.where(sure, z.rad, top))
            change = Ball(np.where(on, 1.0, np.where(off, 0.0, 0.5)), np.where(on | off, 0.0, 0.5))
        z, slope, bend = weight @ value + Ball(bias[:, None]), weight @ (change[:, None] * slope), weight @ bend
    curved = np.where((FIRST == SECOND)[:, None], np.maximum(-bend[0].lower(), 0), bend[0].size())
    bent = (slope[0].rad + (curved[FULL] * half).sum(axis=1) / 2) * half  # H > 0 on the diagonal takes nothing off
    room = bent.sum(axis=0) * 2.0**-4 + z[0].size() * 2.0**-40 + z[0].rad  # for Arb
    base = np.nextafter(z[0].lower() - (bent.sum(axis=0) + room) * UP, -np.inf)
    return np.nextafter(base - (np.abs(slope[0].mid) * half).sum(axis=0) * UP, -np.inf), base, slope[0].mid.T, bent.T


def confirms(layers, activation: str, lower, upper, at, base: float, slope, halvings: int = 40) -> bool:
    """Whether ``f(x) >= base + slope . (x - at)`` on one box, or on its parts, by Arb and the mean value form."""
    ball = np.vectorize(lambda low, high: flint.arb(low).union(flint.arb(high)), otypes=[object])
    middle = ball((lower + upper) / 2, (lower + upper) / 2)
    away, value, turn = ball(lower, upper) - middle, middle, np.eye(len(middle), dtype=int)
    for index, (weight, bias) in enumerate(layers):
        if index and activation == "sin":
            value, change = [z.sin() for z in value], [z.cos() for z in value + turn @ away]
            turn = np.array(change)[:, None] * turn
        elif index:
            change = [flint.arb(*((1,) if z > 0 else (0,) if z < 0 else (0.5, 0.5))) for z in value + turn @ away]
            value, turn = [z.max(flint.arb(0)) for z in value], np.array(change)[:, None] * turn
        value, turn = ball(weight, weight) @ value + ball(bias, bias), ball(weight, weight) @ turn
    slopes = ball(slope, slope)
    rise = (turn[0] - slopes) * away
    if value[0] - slopes @ (middle - ball(at, at)) + sum(rise) >= base:
        return True
    k = int(np.argmax([float(abs(x).upper()) for x in rise]))
    one, two = upper.copy(), lower.copy()
    one[k] = two[k] = (lower[k] + upper[k]) / 2
    halves = (lower, one), (two, upper)
    return halvings > 0 and all(confirms(layers, activation, *each, at, base, slope, halvings - 1) for each in halves)
