"""Rays that meet an object: the point where one first enters it, its parameter t there, and its direction.

``z = (p, t, m)``: p in local space, on a face that is exposed (one entry has no width), or anywhere in the object with
t = 0; the ray's parameter 0 <= t <= 1 at p; m on a face of a cube (one entry is 1 or -1, without width), ``u = m /
|m|`` the unit direction in object space. The network's inputs are ``w = stretch u`` and ``a = p - t w``: of the 2n + 1
numbers of z 2n - 1 have a width in a box, and all 2n inputs depend on them.

* ``u(m0 + h) = u0 + J h + r`` with ``J = (I - u0 u0^T) / |m0|`` and ``|r| <= 1/2 |h|^2 sqrt(4/3) / min |m|^2``: with
  ``h = alpha u + h'``, ``D^2 u [h, h] = -(2 alpha h' + |h'|^2 u) / |m|^2``, whose length is largest, ``sqrt(4/3) |h|^2
  / |m|^2``, where ``|h'|^2 = 2/3 |h|^2``. The quadratic part of r is ``(-alpha h + (3/2 alpha^2 - |h|^2 / 2) u0) /
  |m0|^2``; behind it is at most ``sqrt(18) / 6 (|h| / min |m|)^3``: in the plane of u0 and h, ``theta = Im log(1 + s
  h)``, so its derivatives are at most ``1, 1, 2`` (over powers of ``|m| / |h|``), and the square of the third one of
  ``u = e^(i theta)`` is at most ``(2 + 1)^2 + (3 * 1 * 1)^2``.
* ``t w = t0 w + (t - t0) (w - w0) + (t - t0) w0``: the product of two changes is bilinear, but for the rest of w.
* Only queries with ``|a| <= limit`` reach the network: the box is cut in t, and what still lies outside is excluded by
  a constraint.
* A computed query differs from the exact one by ``delta_a`` in a and by ``delta_w`` in w: both are noise, and f is
  tried at a query that far off.
"""

from dataclasses import dataclass

import numpy as np

from warp_bounding.networks.charts.base import Chart

__all__ = ["RayChart"]

SECOND = 0.57736  # above sqrt(4/3) / 2, the factor in the bound of u without its linear part
THIRD = 0.70714  # above sqrt(18) / 6, the factor in the bound of u without its linear and quadratic parts


@dataclass(frozen=True)
class RayChart(Chart):
    """The chart of rays.

    ``numbers``, n of each: stretch (w is stretch times a unit vector), limit of |a|, lower and upper (the corners of
    the object's grid, local), delta_a, delta_w, and slop, a bound of what float64 rounds here.
    """

    @property
    def ndim(self) -> int:
        """Dimension n of the object."""
        return self.inputs // 2

    @property
    def size(self) -> int:
        return 2 * self.ndim + 1

    @property
    def columns(self) -> int:
        """There are n - 1 columns for p, one for t (or for the last entry of p where t is 0), and n - 1 for m."""
        return 2 * self.ndim - 1

    @property
    def pairs(self) -> list[tuple[int, int]]:
        n = self.ndim
        place = [(i, k) for k in range(n - 1) for i in (k, k + 1)]
        parameter = [(i, n - 1) for i in range(n)]
        turn = [(i, n + c) for c in range(n - 1) for i in range(2 * n)]
        return place + parameter + turn

    def expand(self) -> str:
        n = self.ndim
        at = {pair: index for index, pair in enumerate(self.pairs)}
        each = range(n)
        lines = [
            f"const double* stretch = numbers.data; const double* limit = stretch + {n}; const double* delta_a = stretch + {4 * n};",
            f"const double* delta_w = stretch + {5 * n}; const double* slop = stretch + {6 * n};",
        ]
        for k in each:
            lines.append(f"const V p{k} = (low[{k}] + high[{k}]) * 0.5, rp{k} = (high[{k}] - low[{k}]) * 0.5;")
            j = n + 1 + k
            lines.append(f"const V m{k} = (low[{j}] + high[{j}]) * 0.5, rm{k} = (high[{j}] - low[{j}]) * 0.5;")
        # the entries without width; p may have none
        for name in ("p", "m"):
            lines.append(f"V f{name} = zero + {n - 1}.0;")
            lines += [f"f{name} = r{name}{k} == zero ? zero + {k}.0 : f{name};" for k in range(n - 2, -1, -1)]
        squares = " + ".join(f"m{k} * m{k}" for k in each)
        lines.append(f"const V norm = root({squares}); const V shrink = 1.0 / norm;")
        lines += [f"const V u{k} = m{k} * shrink;" for k in each]
        lines.append(f"const V turned = {' + '.join(f'rm{k} * rm{k}' for k in each)}; V nearest = zero;")
        for k in each:
            lines.append(
                f"{{ V s = (m{k} < zero ? -m{k} : m{k}) - rm{k}; s = s > zero ? s : zero; nearest += s * s; }}"
            )
        lines.append(
            f"const V curved = turned * {SECOND} / nearest, third = turned * {THIRD} / nearest * root(turned / nearest);"
        )
        for i in each:
            lines.append(
                f"const V w{i} = u{i} * stretch[{i}], ew{i} = curved * stretch[{i}] + delta_w[{i}] + slop[{i}];"
            )
            lines.append(f"V ww{i} = ew{i};")
            for c in range(n - 1):

                def jacobian(j: int, i: int = i) -> str:
                    own = "1.0 - " if i == j else "-"
                    return f"({own}u{i} * u{j}) * rm{j}"

                lines.append(
                    f"const V gw{i}_{c} = (fm > {c}.0 ? {jacobian(c)} : {jacobian(c + 1)}) * (shrink * stretch[{i}]);"
                )
                lines.append(f"ww{i} += gw{i}_{c} < zero ? -gw{i}_{c} : gw{i}_{c};")
        # cut at the domain
        lines.append(f"V t_most = high[{n}];")
        for i in each:
            lines.append(
                f"{{ const V speed = (w{i} < zero ? -w{i} : w{i}) - ww{i}; const V room = limit[{i}] + delta_a[{i}] + slop[{i}] + rp{i}"
                f" + (w{i} < zero ? -p{i} : p{i}); const V end = room / (speed > zero ? speed : zero + 1.0);"
                f" t_most = speed > zero ? (end < t_most ? end : t_most) : t_most; }}"
            )
        lines.append(f"dead = t_most < low[{n}] ? zero + 1.0 : zero; t_most = t_most < low[{n}] ? low[{n}] : t_most;")
        lines.append(f"high[{n}] = t_most; const V t = (low[{n}] + t_most) * 0.5, rt = (t_most - low[{n}]) * 0.5;")
        for k in range(n - 1):
            lines.append(
                f"gen[{at[k, k]}] = fp > {k}.0 ? rp{k} : zero; gen[{at[k + 1, k]}] = fp > {k}.0 ? zero : rp{k + 1};"
            )
        for i in each:
            lines.append(f"center[{i}] = p{i} - t * w{i}; center[{n + i}] = w{i};")
            lines.append(
                f"noise[{i}] = delta_a[{i}] + slop[{i}] + t_most * ew{i} + rt * (ww{i} - ew{i}); noise[{n + i}] = ew{i};"
            )
            lines.append(f"rest[{n + i}] = third * stretch[{i}] + delta_w[{i}] + slop[{i}];")
            lines.append(
                f"rest[{i}] = delta_a[{i}] + slop[{i}] + t_most * rest[{n + i}] + rt * (curved * stretch[{i}]);"
            )
            more = f" + (fp > {n - 2}.0 ? rp{i} : zero)" if i == n - 1 else ""
            lines.append(f"gen[{at[i, n - 1]}] = -rt * w{i}{more};")
            for c in range(n - 1):
                lines.append(f"gen[{at[i, n + c]}] = -t * gw{i}_{c}; gen[{at[n + i, n + c]}] = gw{i}_{c};")
        return "\n".join(lines)

    def constraints(self) -> list[tuple[str, list[tuple[int, str]]]]:
        """Followed backwards, a ray leaves the domain on the side that it comes from."""
        rows = []
        for i in range(self.ndim):
            side = f"(w{i} < zero ? zero + 1.0 : zero - 1.0)"
            rows.append((f"{side} * center[{i}] - noise[{i}] - limit[{i}]", [(i, side)]))
        return rows

    def realize(self) -> str:
        n = self.ndim
        lines = [f"const double* lower = numbers.data + {2 * n}; const double* upper = lower + {n};"]
        for k in range(n):
            s = f"slope[{k}]" if k == 0 else f"(fp < {k}.0 ? slope[{k - 1}] : slope[{k}])"
            lines.append(f"z[{k}] = {s} > zero ? low[{k}] : high[{k}];")
            j, last = n + 1 + k, min(n + k, 2 * n - 2)
            s = f"slope[{n}]" if k == 0 else f"(fm < {k}.0 ? slope[{n + k - 1}] : slope[{last}])"
            lines.append(f"z[{j}] = {s} > zero ? low[{j}] : high[{j}];")
        squares = " + ".join(f"z[{n + 1 + k}] * z[{n + 1 + k}]" for k in range(n))
        lines.append(f"V t_ = slope[{n - 1}] > zero ? low[{n}] : high[{n}]; const V inverse = 1.0 / root({squares});")
        for k in range(n):
            lines.append(f"h[{n + k}] = z[{n + 1 + k}] * inverse * stretch[{k}];")
            lines.append(
                f"{{ const V speed = h[{n + k}] < zero ? -h[{n + k}] : h[{n + k}]; const V room = h[{n + k}] < zero ? upper[{k}] - z[{k}] : z[{k}] - lower[{k}];"
                f" const V end = room / (speed > 1e-30 ? speed : zero + 1e-30); t_ = end < t_ ? end : t_; }}"
            )
        lines.append(f"t_ = t_ > zero ? t_ : zero; z[{n}] = t_;")
        lines += [f"h[{k}] = z[{k}] - t_ * h[{n + k}];" for k in range(n)]
        for k in range(2 * n):  # and as far off as a computed one may be
            delta = f"delta_a[{k}]" if k < n else f"delta_w[{k - n}]"
            lines.append(f"h[{k}] -= gradient[{k}] < zero ? zero - {delta} : zero + {delta};")
        return "\n".join(lines)

    def owners(self) -> str:
        n = self.ndim
        lines = [f"owner[{k}] = fp > {k}.0 ? zero + {k}.0 : zero + {k + 1}.0;" for k in range(n - 1)]
        lines.append(f"owner[{n - 1}] = high[{n}] > low[{n}] ? zero + {n}.0 : zero + {n - 1}.0;")
        lines += [f"owner[{n + c}] = fm > {c}.0 ? zero + {n + 1 + c}.0 : zero + {n + 2 + c}.0;" for c in range(n - 1)]
        return " ".join(lines)

    def blame(self) -> str:
        """The loss by the direction's remainder goes to its entries, by the squares of their widths, and to t."""
        n = self.ndim
        lines = ["V bent = zero, twisted = zero;"]
        for i in range(n):
            lines.append(
                f"{{ const V by_a = gradient[{i}] < zero ? -gradient[{i}] : gradient[{i}], by_w = gradient[{n + i}] < zero ? -gradient[{n + i}] : gradient[{n + i}];"
                f" bent += (by_a * t_most + by_w) * (third * stretch[{i}]); twisted += by_a * rt * (curved * stretch[{i}]); }}"
            )
        lines.append(f"score[{n - 1}] += twisted * 0.5; bent = turned > zero ? (bent + twisted * 0.5) / turned : zero;")
        widths = [f"(fm > {c}.0 ? rm{c} : rm{c + 1})" for c in range(n - 1)]
        lines += [f"score[{n + c}] += bent * ({width} * {width});" for c, width in enumerate(widths)]
        return " ".join(lines)

    def bend(self, squares: list[tuple[int, int]]) -> str:
        """The quadratic terms are those of u, and the product of the changes of t and w."""
        n = self.ndim
        lines = [
            f"{{ V along = zero; {' '.join(f'V by{i} = (gradient[{n + i}] - t * gradient[{i}]) * stretch[{i}]; along += by{i} * u{i};' for i in range(n))}"
        ]
        lines.append("const V scale = shrink * shrink;")
        for c in range(n - 1):
            for name, of in (("r", "rm"), ("e", "u"), ("b", "by")):
                lines.append(f"const V {name}_{c} = fm > {c}.0 ? {of}{c} : {of}{c + 1};")
        for c in range(n - 1):
            own = squares.index((n + c, n + c))
            lines.append(
                f"square[{own}] += scale * r_{c} * r_{c} * (along * (e_{c} * e_{c} * 1.5 - 0.5) - e_{c} * b_{c});"
            )
            for d in range(c + 1, n - 1):
                both = squares.index((n + c, n + d))
                lines.append(
                    f"square[{both}] += scale * r_{c} * r_{d} * (along * e_{c} * e_{d} * 3.0 - e_{c} * b_{d} - e_{d} * b_{c});"
                )
            with_t = squares.index((n - 1, n + c))
            lines.append(f"square[{with_t}] -= rt * ({' + '.join(f'gradient[{i}] * gw{i}_{c}' for i in range(n))});")
        return " ".join([*lines, "}"])

    def coordinates(self, z: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        n, m = self.ndim, z[:, self.ndim + 1 :]
        w = m / np.linalg.norm(m, axis=1, keepdims=True) * numbers[:n]
        return np.concatenate([z[:, :n] - z[:, n : n + 1] * w, w], axis=1)
