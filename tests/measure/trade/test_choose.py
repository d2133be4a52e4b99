"""Choosing among measured settings: laws of the frontier and of the cheapest combination."""

import itertools
import math
import xml.etree.ElementTree as ElementTree

import pytest

from yesnt.measure.trade.choose import Point, cheapest, combinations, frontier
from yesnt.measure.trade.plot import plot_svg

POINTS = [
    Point("decompose", "fast", 1.0, 0.04),
    Point("decompose", "bad", 2.0, 0.05),
    Point("decompose", "good", 4.0, 0.0),
    Point("flow", "fast", 0.1, 0.03),
    Point("flow", "good", 1.0, 0.0),
    Point("solve", "one", 0.5, 0.0),
    Point("relight", "draft", 1.0, 0.02),
    Point("relight", "final", 6.0, 0.0),
]


def test_the_frontier_has_no_setting_that_another_beats():
    assert [p.name for p in frontier(POINTS[:3])] == ["fast", "good"]
    assert frontier([]) == []


def test_seconds_add_and_squares_of_errors_add():
    ways = combinations(POINTS)
    assert len(ways) == 2 * 2 * 1 * 2
    assert ways[0].seconds == pytest.approx(2.6)
    assert ways[0].error == pytest.approx(math.sqrt(0.04**2 + 0.03**2 + 0.02**2))
    assert all(a.seconds <= b.seconds for a, b in itertools.pairwise(ways))


def test_the_cheapest_within_an_error_and_the_best_within_a_time():
    assert cheapest(POINTS, None, None).names["decompose"] == "fast"
    exact = cheapest(POINTS, 0.0, None)
    assert exact.seconds == pytest.approx(11.5)
    within = cheapest(POINTS, 0.045, None)
    assert within.error <= 0.045
    assert all(way.error > 0.045 for way in combinations(POINTS) if way.seconds < within.seconds)
    timed = cheapest(POINTS, None, 6.0)
    assert timed.seconds <= 6.0
    assert all(way.error >= timed.error for way in combinations(POINTS) if way.seconds <= 6.0)
    assert cheapest(POINTS, None, 1.0) is None
    assert cheapest(POINTS, 0.001, 3.0) is None


def test_the_plot_is_whole_and_names_every_setting():
    root = ElementTree.fromstring(plot_svg(POINTS))
    text = "".join(root.itertext())
    assert all(point.name in text for point in POINTS)
