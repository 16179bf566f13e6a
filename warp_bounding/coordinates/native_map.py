"""The C text from a query's numbers to the coordinates ``v``, one function a kind of query; ``regions`` states what it rounds.

Given are ``V q[]`` (the numbers in object space), ``center scale limit`` (n each) and ``extra`` (see ``Domain.header``), a
``V zero`` and the functions ``root`` and ``over`` (``source.TOOLS``); the text sets ``V v[]`` and declares two masks: ``finite`` (false: *maybe*, whatever else holds) and ``inside``
(false: *no*). V is a vector of queries or a float, so masks are combined with ``&`` and ``|`` and never negated.

Where a shape is placed, q are numbers in the world and ``place`` is ``Placement.values``: q is moved first, in place. ``drift`` in
there is what the move rounds per distance; it widens the domain for a ray or a plane from farther away than FAR.
"""

from warp_bounding.arithmetic import UNIT32

__all__ = ["FAR", "GUARD", "SMALLEST", "SUMMED", "extra_count", "locate"]

FAR = 8.0  # domain half-widths: a region given from farther away, and not certainly outside, is answered with maybe
SMALLEST = 2.0**-90  # largest entry of a direction under which it is answered with maybe
LARGEST = 2.0**90
FARTHEST = 2.0**60  # the sum of absolute values of a point's coordinates beyond which a region is answered with maybe
PARALLEL = 2.0**-80  # of w: a ray that moves less than this along an axis does not cross a face
GUARD = 16 * UNIT32  # relative room in the test against the domain: over three times its rounding
SUMMED = 2.0**-17  # of an offset: above what a sum of n <= 64 products rounds, n + 12 units
LATER = 4 * GUARD  # of a ray's time: above the rounding of its end, n + 18 units


def extra_count(query: str, ndim: int, time: bool) -> int:
    """Numbers behind the threshold in ``parameters``: a ray's displacement per axis, or a normal's factors; then time's limit.

    The latter is the largest coordinate that certainly lies inside the range of time, whatever the map of the region rounds.
    """
    if query == "point":
        return 0
    return (ndim if query in ("ray", "plane") else 0) + time


def locate(query: str, space: str, n: int, time: bool, placed: bool = False) -> str:
    """The C text.

    Args:
        query: Kind of query; points are ``located`` by ``Source`` itself, because a placement may come before.
        space: ``"geometric"`` or ``"parametric"``.
        n: Dimension of the indicator.
        time: Coordinate 0 is time: a region that lies wholly outside its range is answered with maybe; so may be one that
            only just reaches into it.
        placed: ``q`` are in the world, and the text may change them.
    """
    lines = ["auto finite = (q[0] - q[0]) == zero;"]  # false for NaN and for infinity
    lines += [f"finite = finite & ((q[{k}] - q[{k}]) == zero);" for k in range(1, 2 * n)]
    if placed:
        lines += ["{", *(_move_box(n) if query == "box" else _move(query, n)), "}"]
        lines += [f"finite = finite & ((q[{k}] - q[{k}]) == zero);" for k in range(2 * n)]  # an overflow
    if query == "box":
        lines += _box(n, time)
    elif query == "ray":
        lines += _ray(n, time, placed)
    elif space == "parametric":
        lines += _plane_parameters(n, time)
    else:
        lines += _plane(n, time, placed)
    return "\n".join(lines)


def _move(query: str, n: int) -> list[str]:
    """A ray's or a plane's point, and its direction; one that is nearly as short as rounding is answered with maybe."""
    point, turn, at = (0, n, n) if query == "ray" else (n, 0, 2 * n + n * n)
    lines = [f"const V d{k} = q[{point + k}] - place[{k}]; const V e{k} = q[{turn + k}];" for k in range(n)]
    lines += [_longest([f"e{k}" for k in range(n)])]
    for k in range(n):
        lines.append(f"q[{point + k}] = {' + '.join(f'd{j} * place[{n + n * k + j}]' for j in range(n))};")
        lines.append(f"q[{turn + k}] = {' + '.join(f'e{j} * place[{at + n * k + j}]' for j in range(n))};")
    return [*lines, _longest([f"q[{turn + k}]" for k in range(n)])]


def _longest(names: list[str]) -> str:
    """``finite`` only if the largest of these has a size that directions may have."""
    sizes = (f"{{ {_absolute('s_', name)} longest = s_ > longest ? s_ : longest; }}" for name in names)
    bounds = f"(longest >= zero + {_number(SMALLEST)}) & (longest <= zero + {_number(LARGEST)})"
    return f"{{ V longest = zero; {' '.join(sizes)} finite = finite & {bounds}; }}"


def _move_box(n: int) -> list[str]:
    """The box around the moved one (Arvo 1990)."""
    lines = [f"finite = finite & (q[{k}] <= q[{n + k}]);" for k in range(n)]
    for k in range(n):
        lines.append(f"const V c{k} = q[{k}] - place[{k}]; const V d{k} = q[{n + k}] - place[{k}];")
        lines.append(f"finite = finite & ((c{k} - c{k}) == zero) & ((d{k} - d{k}) == zero);")
    for k in range(n):
        lines.append("{ V low = zero, high = zero;")
        for j in range(n):
            at = n + n * k + j
            lines.append(f"{{ const V s_ = c{j} * place[{at}]; const V t_ = d{j} * place[{at}];")
            lines.append("low = low + (s_ < t_ ? s_ : t_); high = high + (s_ < t_ ? t_ : s_); }")
        lines.append(f"q[{k}] = low; q[{n + k}] = high; }}")
    return lines


def _number(value: float) -> str:
    return f"{float(value).hex()}f"


def _absolute(target: str, x: str) -> str:
    return f"const V {target} = {x} < zero ? -{x} : {x};"


def _box(n: int, time: bool) -> list[str]:
    lines = []
    for k in range(n):
        lines += [
            f"finite = finite & (q[{k}] <= q[{n + k}]);",
            f"const V lo{k} = (q[{k}] - center[{k}]) * scale[{k}]; const V hi{k} = (q[{n + k}] - center[{k}]) * scale[{k}];",
            f"const V top{k} = zero + limit[{k}]; const V bottom{k} = zero - limit[{k}];",
            f"auto inside{k} = (lo{k} <= top{k}) & (hi{k} >= bottom{k});",
        ]
        for index, name in ((k, f"lo{k}"), (n + k, f"hi{k}")):
            lines.append(f"v[{index}] = {name} < bottom{k} ? bottom{k} : {name};")
            lines.append(f"v[{index}] = v[{index}] > top{k} ? top{k} : v[{index}];")
    lines.append(f"auto inside = {' & '.join(f'inside{k}' for k in range(n))};")
    if time:
        lines.append("finite = finite & (lo0 <= zero + extra[0]) & (hi0 >= zero - extra[0]);")
    return lines


def _origin(n: int, first: int) -> list[str]:
    """``a{k}`` and ``far``, the sum of their absolute values."""
    lines = ["V far = zero;"]
    for k in range(n):
        lines.append(f"const V a{k} = (q[{first + k}] - center[{k}]) * scale[{k}];")
        lines.append(f"{_absolute(f'size{k}', f'a{k}')} far = far + size{k};")
    return lines


def _unit(n: int, first: int) -> list[str]:
    """``u{k}``, the direction at ``q[first]`` with Euclidean length 1; false in ``finite`` where there is none."""
    lines = ["V longest = zero;"]
    lines += [f"{{ {_absolute('d_', f'q[{first + k}]')} longest = d_ > longest ? d_ : longest; }}" for k in range(n)]
    lines.append(f"finite = finite & (longest >= zero + {_number(SMALLEST)}) & (longest <= zero + {_number(LARGEST)});")
    lines.append("longest = longest > zero ? longest : zero + 1.0f;")  # no division by zero in lanes that are maybe
    lines += [f"const V e{k} = over(q[{first + k}], longest);" for k in range(n)]
    squares = " + ".join(f"e{k} * e{k}" for k in range(n))
    lines.append(f"const V norm = root({squares});")
    lines += [f"const V u{k} = over(e{k}, norm);" for k in range(n)]
    return lines


def _wide(placed: bool) -> str:
    """Declare ``wide``: how far away a placed region is given from, where that is beyond FAR."""
    return f"const V wide = far > {_number(FAR)} ? far : zero;" if placed else ""


def _ray(n: int, time: bool, placed: bool) -> list[str]:
    lines = [*_origin(n, 0), *_unit(n, n), _wide(placed), "V enter = zero; V leave = zero + 1.0f;"]
    for k in range(n):
        drift = f" + wide * place[{n + n * n + k}]" if placed else ""
        lines += [
            f"const V w{k} = u{k} * extra[{k}]; {{ const V room = zero + limit[{k}] + size{k} * {_number(GUARD)}{drift};",
            f"{_absolute('speed', f'w{k}')} const V cross = speed > {_number(PARALLEL)} ? w{k} : zero + 1.0f;",
            f"V first = over(-room - a{k}, cross); V last = over(room - a{k}, cross);",
            "const V near = first < last ? first : last; const V away = first < last ? last : first;",
            f"const V always = size{k} <= room ? zero : zero + 2.0f; const V never = size{k} <= room ? zero + 1.0f : zero - 1.0f;",
            f"first = speed > {_number(PARALLEL)} ? near : always; last = speed > {_number(PARALLEL)} ? away : never;",
            "enter = first > enter ? first : enter; leave = last < leave ? last : leave; }",
        ]
    lines.append(f"enter = enter * {_number(1 - GUARD)}; leave = leave * {_number(1 + GUARD)};")
    lines.append("auto inside = enter <= leave;")
    lines.append(f"finite = finite & (far <= {_number(FARTHEST)}) & ((far <= {_number(FAR)}) | (enter > leave));")
    for k in range(n):
        lines.append(f"{{ const V top = zero + limit[{k}]; const V at = a{k} + enter * w{k};")
        lines.append(f"v[{k}] = at < -top ? -top : at; v[{k}] = v[{k}] > top ? top : v[{k}]; v[{n + k}] = w{k}; }}")
    if time:
        lines.append(f"{{ const V top = zero + extra[{n}] - size0 * {_number(LATER)}; const V end = a0 + w0;")
        lines.append("finite = finite & ((a0 <= top) | (end <= top)) & ((a0 >= -top) | (end >= -top)); }")
    return lines


def _plane(n: int, time: bool, placed: bool) -> list[str]:
    drift = f" + wide * place[{n + n * n}]" if placed else ""
    lines = [*_origin(n, n), _wide(placed), *(f"const V e{k} = q[{k}] * extra[{k}];" for k in range(n))]
    lines.append(f"V pivot = e0; {_absolute('d0', 'e0')} V longest = d0;")
    for k in range(1, n):
        lines.append(
            f"{_absolute(f'd{k}', f'e{k}')} pivot = d{k} > longest ? e{k} : pivot; longest = d{k} > longest ? d{k} : longest;"
        )
    widest = f"float widest = 1.0f; for (int k = 0; k < {n}; ++k) widest = extra[k] > widest ? extra[k] : widest;"
    lines.append(widest)  # entries that are subnormal, or flushed, may be stretched as far as that
    lines.append(
        f"finite = finite & (longest >= zero + {_number(SMALLEST)} * widest) & (longest <= {_number(LARGEST)});"
    )
    lines.append("pivot = longest > zero ? pivot : zero + 1.0f; V offset = zero, summed = zero, reach = zero;")
    for k in range(n):
        lines.append(f"v[{k}] = over(e{k}, pivot); {{ const V part = v[{k}] * a{k}; {_absolute('size', 'part')}")
        lines.append(f"offset = offset + part; summed = summed + size; {_absolute('tilt', f'v[{k}]')}")
        lines.append(f"reach = reach + tilt * limit[{k}]; }}")
    lines.append(f"v[{n}] = offset; {_absolute('away', 'offset')}")
    lines.append(f"const V room = reach * {_number(1 + GUARD)} + summed * {_number(SUMMED)}{drift};")
    lines.append("auto inside = away <= room;")
    lines.append(f"finite = finite & (far <= {_number(FARTHEST)}) & ((far <= {_number(FAR)}) | (away > room));")
    if time:  # a plane of constant time, outside the range
        still = " + ".join(f"d{k}" for k in range(1, n))
        lines.append(f"finite = finite & ((({still}) > zero) | (size0 <= zero + extra[{n}]));")
    return lines


def _plane_parameters(n: int, time: bool) -> list[str]:
    """Unit normal and point as they are given; a point outside the domain is answered with maybe."""
    lines = [*_origin(n, n), *_unit(n, 0)]
    for k in range(n):
        lines.append(f"finite = finite & (size{k} <= limit[{k}]); v[{k}] = u{k}; v[{n + k}] = a{k};")
    if time:
        lines.append(f"finite = finite & (size0 <= zero + extra[{n}]);")
    lines.append("auto inside = (zero <= zero);")
    return lines
