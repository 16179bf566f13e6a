"""A closed triangle mesh: which boxes lie off its triangles, and which points outside, for certain.

Inequalities have room for what float64 rounds, so they hold for the exact numbers; what does not hold is not known.
"""

from fractions import Fraction

import numpy as np

AGAIN = 1000  # one statement in so many is proven a second time
ROOM = 2.0**-48  # 32 units: more than what sums of up to 12 products round, times their absolute terms
SMALLEST = 2.0**-900  # products that matter are larger, so none is subnormal


class Mesh:
    """Triangles ``(T, 3, 3)`` of float32 vertices, in float64; ``ValueError`` for those without a certain inside."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        self.triangles = vertices[faces]
        faces = np.unique(vertices, axis=0, return_inverse=True)[1].reshape(-1)[faces]  # vertices at one place are one
        edges = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
        there, back = np.sort(edges @ (len(vertices), 1)), np.sort(edges @ (1, len(vertices)))
        if not np.abs(vertices).max() < 2.0**100 or (there != back).any():
            raise ValueError("a mesh that is not closed, or whose faces are not turned alike, is not for this program")
        self.lower, self.upper = self.triangles.min(axis=1), self.triangles.max(axis=1)

    def gaps(self, lower, upper, box, triangle) -> np.ndarray:
        """Lower bounds of squared gaps between pairs of a box and the box around a triangle."""
        gap = np.maximum(self.lower[triangle] - upper[box], lower[box] - self.upper[triangle])
        return (np.maximum(gap, 0) ** 2).sum(axis=1) * (1 - ROOM)

    def apart(self, lower, upper, box, triangle, gap, slope) -> np.ndarray:
        """Which pairs are farther apart than ``gap + slope . h`` at each m + h of a box, by one of 8 directions."""
        known, given = np.zeros(len(box), bool), (lower[box], upper[box], gap[box], slope[box])
        for k in range(8):
            some = np.flatnonzero(~known)
            corners, low, high, *needed = self.triangles[triangle[some]], *(each[some] for each in given)
            direction = towards(corners, (low + high) / 2, k) if k < 7 else -needed[1]
            size = np.sqrt((direction**2).sum(axis=1)) * (1 + ROOM)
            direction /= np.maximum(size, 2.0**-400 if k < 7 else 1.0)[:, None]
            pairs = direction, corners, low, high, *needed
            known[some] = separates(*pairs)
            for i in np.flatnonzero(known[some])[::AGAIN]:
                if not exactly_separates(*(each[i] for each in pairs)):
                    raise ArithmeticError(f"fractions contradict float64 about a triangle and the box at {low[i]}")
        return known

    def outside(self, x: np.ndarray) -> np.ndarray:
        """Which points are outside: a half-line crosses as many triangles from the front as from the back."""
        low, high = self.lower.T[1:].copy(), self.upper.T.copy()
        met = [np.flatnonzero((low <= p[1:]).all(axis=0) & (high >= p).all(axis=0)) for p in x[:, :, None]]
        point, triangle = np.array([(i, k) for i, row in enumerate(met) for k in row], int).reshape(-1, 2).T
        sign, certain = crossing(self.triangles[triangle], x[point])
        return (np.bincount(point, sign, len(x)) == 0) & (np.bincount(point, ~certain, len(x)) == 0)


def separates(direction, corners, low, high, gap, slope) -> np.ndarray:
    """Whether ``d . (y - m - h) > gap + slope . h`` for all y of triangles and m + h of boxes: apart if |d| <= 1."""
    middle = (low + high) / 2
    half = np.maximum(high - middle, middle - low) * (1 + ROOM)
    products = (corners - middle[:, None]) * direction[:, None]  # from the middle, so that differences are small
    rise, terms = products.sum(axis=2).min(axis=1), np.abs(products).sum(axis=2).max(axis=1)
    reach = (np.abs(direction + slope) * half).sum(axis=1) + gap
    terms += ((np.abs(direction) + np.abs(slope)) * half).sum(axis=1) + np.abs(gap)
    return rise - reach > ROOM * terms + SMALLEST


def exactly_separates(*pair) -> bool:
    """The same of one pair, in fractions, and that ``|d| <= 1``."""
    d, y, low, high, gap, slope, m = (np.vectorize(Fraction, otypes=[object])(x) for x in (*pair, sum(pair[2:4]) / 2))
    most = sum(np.maximum((d + slope) * low, (d + slope) * high)) - slope @ m + gap
    return d @ d <= 1 and min(y @ d) > most


def towards(corners: np.ndarray, x: np.ndarray, k: int) -> np.ndarray:
    """About the way from x to a triangle's plane (k = 0), to a corner (1 to 3) or to an edge; nothing rests on it."""
    way, edge = corners[:, k % 3] - x, corners[:, (k + 1) % 3] - corners[:, k % 3]
    line = np.cross(edge, corners[:, (k + 2) % 3] - corners[:, k % 3]) if k == 0 else edge
    along = line * ((way * line).sum(axis=1) / np.maximum((line**2).sum(axis=1), 1e-300))[:, None]
    return along if k == 0 else way if k < 4 else way - along


def crossing(corners: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of half-lines from x along axis 0 and triangles: +1 or -1 where they cross, else 0; and if that is certain."""
    along, *across = (corners - x[:, None]).transpose(2, 1, 0)
    after, last = [1, 2, 0], [2, 0, 1]
    one, two = across[0][after] * across[1][last], across[1][after] * across[0][last]
    area, room = one - two, ROOM * (np.abs(one) + np.abs(two)) + SMALLEST  # opposite to each corner
    beside = (area > room).any(axis=0) & (area < -room).any(axis=0)  # the line passes by
    through, front = (np.abs(area) > room).all(axis=0) & ~beside, np.sign(area[0])
    height = front * (area * along).sum(axis=0)  # has the sign of the way to where the line meets the triangle
    slack = ((2 * room + ROOM * np.abs(area)) * np.abs(along)).sum(axis=0) + SMALLEST
    certain = beside | (through & (np.abs(height) > slack))
    return np.where(through & (height > slack), front, 0.0), certain
