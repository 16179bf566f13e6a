"""Boxes that meet an object: ``z = (low, high)`` in cells, cut to where it can hold a positive.

Of all boxes in a box of z, the largest is (least low, greatest high). If it meets no occupied cell, none does; if it
does, low need not go above the occupied cells in it, nor high below them. Occupied cells are counted by a summed-area
table, and only those that the box overlaps in their interior. Positives that only touch a cell are limits of others,
which the neighbouring boxes hold.

The network's inputs are ``z`` times a cell's size; computed boxes are off by ``delta``: noise. ``low <= high`` is a
constraint.
"""

from dataclasses import dataclass

import numpy as np

from warp_bounding.networks.charts.base import Chart

__all__ = ["BoxChart"]


@dataclass(frozen=True)
class BoxChart(Chart):
    """The chart of boxes.

    ``numbers``, n of each: the cells' size, the origin (local position of cell 0's centre), and noise. ``table``: shape
    (n), strides (n), the summed-area table.
    """

    @property
    def ndim(self) -> int:
        """Dimension n of the object."""
        return self.inputs // 2

    def _count(self, first: list[str], last: list[str]) -> str:
        """Number of occupied cells from ``first`` to one before ``last`` (C expressions of int, one per axis)."""
        n = self.ndim
        terms = []
        for corner in range(2**n):
            sides = [(corner >> k) & 1 for k in range(n)]
            place = " + ".join(f"({last[k] if sides[k] else first[k]}) * stride[{k}]" for k in range(n))
            terms.append(f"{'+' if (n - sum(sides)) % 2 == 0 else '-'} cells[{place}]")
        return " ".join(terms)

    def expand(self) -> str:
        n = self.ndim
        lines = [
            f"const int* shape = table.data; const int* stride = shape + {n}; const int* cells = stride + {n};",
            "dead = zero;",
            "for (int l = 0; l < L; ++l) {",
            f"int a[{n}], b[{n}]; bool some = true;",  # cells that the largest box overlaps: a to b - 1
        ]
        for k in range(n):
            j = n + k
            lines.append(
                f"a[{k}] = (int)floor(LANE(low[{k}]) + 0.5); b[{k}] = (int)ceil(LANE(high[{j}]) + 0.5);"
                f" a[{k}] = a[{k}] < 0 ? 0 : a[{k}]; b[{k}] = b[{k}] > shape[{k}] ? shape[{k}] : b[{k}]; some = some && a[{k}] < b[{k}];"
            )
        a, b = [f"a[{k}]" for k in range(n)], [f"b[{k}]" for k in range(n)]
        lines.append(f"if (!some || ({self._count(a, b)}) == 0) {{ LANE(dead) = 1.0; continue; }}")
        for k in range(n):  # the first and the last layer that is not empty
            for sign in (0, 1):
                lines.append(f"{{ int from = a[{k}], to = b[{k}];")
                middle = (
                    [*a[:k], "middle" if sign else "from", *a[k + 1 :]],
                    [*b[:k], "to" if sign else "middle", *b[k + 1 :]],
                )
                count = self._count(*middle)
                if sign:  # last: the greatest `from` with cells in [from, to)
                    lines.append(
                        f"while (to - from > 1) {{ const int middle = (from + to) / 2; if ({count}) from = middle; else to = middle; }}"
                        f" const double end = from + 0.5; if (LANE(low[{k}]) < end) {{ LANE(high[{k}]) = LANE(high[{k}]) < end ? LANE(high[{k}]) : end; }}"
                    )
                else:
                    lines.append(
                        f"while (to - from > 1) {{ const int middle = (from + to) / 2; if ({count}) to = middle; else from = middle; }}"
                        f" const double end = from - 0.5; if (LANE(high[{n + k}]) > end) {{ LANE(low[{n + k}]) = LANE(low[{n + k}]) > end ? LANE(low[{n + k}]) : end; }}"
                    )
                lines.append("}")
        lines.append("}")
        for k in range(n):
            lines.append(f"dead = low[{k}] > high[{n + k}] ? zero + 1.0 : dead;")
        for k in range(2 * n):
            unit, origin = f"numbers.data[{k % n}]", f"numbers.data[{n + k % n}]"
            lines.append(f"center[{k}] = (low[{k}] + high[{k}]) * (0.5 * {unit}) + {origin};")
            lines.append(
                f"gen[{k}] = (high[{k}] - low[{k}]) * (0.5 * {unit}); rest[{k}] = noise[{k}] = zero + numbers.data[{2 * n + k % n}];"
            )
        return "\n".join(lines)

    def constraints(self) -> list[tuple[str, list[tuple[int, str]]]]:
        n = self.ndim
        return [(f"center[{k}] - center[{n + k}] - noise[{k}]", [(k, "1.0"), (n + k, "-1.0")]) for k in range(n)]

    def realize(self) -> str:
        """The corner, with low moved down to high where it is above, if that box still meets the object."""
        n = self.ndim
        lines = [f"z[{k}] = slope[{k}] > zero ? low[{k}] : high[{k}];" for k in range(2 * n)]
        lines += [f"z[{k}] = z[{k}] > z[{n + k}] ? z[{n + k}] : z[{k}];" for k in range(n)]
        lines.append(f"for (int l = 0; l < L; ++l) {{ int a[{n}], b[{n}]; bool some = true;")
        for k in range(n):
            lines.append(  # cells that it touches
                f"a[{k}] = (int)ceil(LANE(z[{k}]) - 0.5); b[{k}] = (int)floor(LANE(z[{n + k}]) + 0.5) + 1;"
                f" a[{k}] = a[{k}] < 0 ? 0 : a[{k}]; b[{k}] = b[{k}] > shape[{k}] ? shape[{k}] : b[{k}]; some = some && a[{k}] < b[{k}];"
            )
        a, b = [f"a[{k}]" for k in range(n)], [f"b[{k}]" for k in range(n)]
        lines.append(f"LANE(valid) = some && ({self._count(a, b)}) != 0 ? 1.0 : 0.0; }}")
        for k in range(2 * n):  # as far off as a computed box may be
            lines.append(f"h[{k}] = z[{k}] * numbers.data[{k % n}] + numbers.data[{n + k % n}];")
            delta = f"numbers.data[{2 * n + k % n}]"
            lines.append(f"h[{k}] -= gradient[{k}] < zero ? zero - {delta} : zero + {delta};")
        return "\n".join(lines)

    def split(self) -> str:
        """Halves lie between cells as long as the interval spans several."""
        return (
            "middle = (a + b) * 0.5; { const double edge = floor(middle) + 0.5; const double other = edge > middle ? edge - 1.0 : edge + 1.0;"
            " if (edge > a && edge < b) middle = edge; else if (other > a && other < b) middle = other; }"
        )

    def middle(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        middle = (a + b) * 0.5
        edge = np.floor(middle) + 0.5
        other = np.where(edge > middle, edge - 1.0, edge + 1.0)
        within = (edge > a) & (edge < b)
        return np.where(within, edge, np.where((other > a) & (other < b), other, middle))

    def coordinates(self, z: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        n = self.ndim
        return z * np.tile(numbers[:n], 2) + np.tile(numbers[n : 2 * n], 2)
