"""Geometry of charts: positions by hand, and shapes that end at the data."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from xmarl_bench.board.charts import Axis, axis_of, half_density, line, steps


def test_positions_by_hand() -> None:
    axis = Axis(-1.0, 3.0)
    assert [axis.at(x) for x in (-1.0, 0.0, 3.0, -9.0, 9.0)] == [0.0, 25.0, 100.0, 0.0, 100.0]
    assert axis.ticks == [-1.0, 0.0, 1.0, 2.0, 3.0]
    assert line([(-1.0, 0.0), (3.0, 1.0)], axis, Axis(0.0, 2.0)) == "0,100 100,50"
    assert steps([(0, 1), (2, 5), (3, 4)]) == [(0, 1), (2, 1), (2, 5), (3, 5), (3, 4)]


@given(st.lists(st.floats(-4000, 4000) | st.none(), max_size=8))
def test_an_axis_holds_what_it_should(values: list[float | None]) -> None:
    axis = axis_of(values, around=(0.0, 1.0))
    assert axis.low < 0.0
    assert axis.high > 1.0
    assert all(axis.low <= value <= axis.high for value in values if value is not None and value >= -1.0)
    assert axis.low > -1.0 - 0.04 * (axis.high + 1.0)  # far values are drawn at the end
    assert 2 <= len(axis.ticks) <= 9


@pytest.mark.parametrize("side", [1, -1])
def test_a_density_ends_at_the_least_and_the_largest_value(side: int) -> None:
    points = [
        tuple(map(float, p.split(",")))
        for p in half_density([0.2, 0.5, 0.5, 0.6, 0.8], Axis(0.0, 1.0), side).split()
    ]
    assert points[0] == (20.0, 50.0)
    assert points[-1] == (80.0, 50.0)
    assert all(20.0 <= x <= 80.0 for x, _ in points)
    heights = [side * (50.0 - y) for _, y in points]
    assert max(heights) == pytest.approx(46.0)
    assert min(heights) == 0.0
    assert 45.0 < points[heights.index(max(heights))][0] < 60.0


def test_equal_values_are_a_bar() -> None:
    assert half_density([0.5] * 9, Axis(0.0, 1.0), 1) == "49.8,50 49.8,4 50.2,4 50.2,50"
