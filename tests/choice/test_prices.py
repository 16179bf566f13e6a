"""The lower envelope of costs, against a search over prices."""

import itertools

import numpy as np
import pytest

from warp_bounding.choice import Line, cheapest, duration


def test_it_is_the_least_at_every_price(rng):
    for _ in range(200):
        count = int(rng.integers(1, 12))
        lines = [Line(str(i), float(t), float(p)) for i, (t, p) in enumerate(zip(rng.exponential(50, count), rng.random(count), strict=False))]  # fmt: skip
        lines.append(Line("none", 0.0, 1.0))
        found = cheapest(lines)
        assert found[0].price == 0
        assert all(a.price < b.price for a, b in itertools.pairwise(found))
        by = {line.label: line for line in lines}
        for price in np.geomspace(0.1, 1e6, 60):
            own = [stretch.label for stretch in found if stretch.price <= price][-1]
            assert by[own].cost(price) == pytest.approx(min(line.cost(price) for line in lines), rel=1e-9)


def test_ties_and_nothing():
    assert cheapest([]) == []
    same = [Line("a", 5.0, 0.5), Line("b", 5.0, 0.5), Line("none", 0.0, 1.0)]
    assert [stretch.label for stretch in cheapest(same)] == ["none", "a"]
    assert cheapest(same)[1].price == pytest.approx(10.0)
    free = [Line("none", 0.0, 1.0), Line("free", 0.0, 0.2)]
    assert [stretch.label for stretch in cheapest(free)] == ["free"]
    assert [stretch.label for stretch in cheapest([Line("none", 0.0, 1.0), Line("useless", 3.0, 1.0)])] == ["none"]


@pytest.mark.parametrize(
    ("nanoseconds", "words"),
    [
        (0.0, "0 ns"),
        (0.8641, "0.864 ns"),
        (999.4, "999 ns"),
        (999.7, "1 us"),
        (166_000.0, "166 us"),
        (2.5e12, "2.5e+03 s"),
    ],
)
def test_a_time_in_words(nanoseconds, words):
    assert duration(nanoseconds) == words
