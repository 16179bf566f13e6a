"""The paper's figures of speed: what its tables say of each other, and Eq. 6."""

import math

import pytest

from paper.columns import COLUMNS, PAPER
from paper.speed.figures import (
    PAPER_MS,
    PAPER_RATIO,
    TABLE_2,
    break_even,
    paper_early_out,
    paper_ms,
)

MISPRINTED = "aabb"  # Table 2 has it with the k-DOP's false positives


def test_every_row_has_every_column():
    assert {len(row) for row in PAPER_MS.values()} == {len(COLUMNS)}
    assert set(PAPER_MS) == set(PAPER) - {"relu-field"}
    assert paper_ms("voxels", TABLE_2) is None


@pytest.mark.parametrize("method", PAPER_RATIO)
def test_table_2_follows_from_the_supplement_by_eq_6(method):
    column = COLUMNS.index(TABLE_2)
    rate, ours = PAPER[method][column] / 100, PAPER["mlp-early"][column] / 100
    rate = PAPER["kdop"][column] / 100 if method == MISPRINTED else rate
    found = break_even(paper_ms("mlp-early", TABLE_2), ours, paper_ms(method, TABLE_2), rate)
    assert found.least == pytest.approx(PAPER_RATIO[method], rel=5e-3)
    assert found.most == math.inf
    assert found.factor == pytest.approx(found.least / paper_ms(method, TABLE_2))


def test_the_example_of_the_paper():
    assert break_even(5.0, 0.1, 1.0, 0.3).least == pytest.approx(20.0)
    assert break_even(5.0, 0.1, 1.0, 0.3).factor == pytest.approx(20.0)


@pytest.mark.parametrize("price", [0.0, 1e-3, 0.7, 3.0, 50.0, 1e6])
@pytest.mark.parametrize("rate", [0.0, 0.1, 0.3, 0.9])
@pytest.mark.parametrize("time", [0.5, 1.0, 5.0])
def test_break_even_is_where_the_costs_cross(time, rate, price):
    found = break_even(time, rate, 1.0, 0.3)
    pays = time + rate * price < 1.0 + 0.3 * price
    assert pays == (found.least < price < found.most or (price == found.least == 0 and time < 1.0))
    assert found.always == (time <= 1.0 and rate <= 0.3 and (time, rate) != (1.0, 0.3))
    assert found.never == (time >= 1.0 and rate >= 0.3)


def test_the_papers_early_out():
    gains = paper_early_out()
    assert sum(gain < 1 for gain in gains.values()) == 5  # its text says four
    assert max(gains.values()) == gains[COLUMNS[4]] == pytest.approx(70.32 / 35.97)
