"""Choosing among measured settings: laws of the frontier and of the cheapest combination."""

import itertools
import math
import xml.etree.ElementTree as ElementTree

import pytest

from yesnt.measure.trade.choose import Point, cheapest, combinations, frontier
from yesnt.measure.trade.plot import HEIGHT, plot_svg

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


def shapes(points):
    """Tag -> elements of the drawing of these points."""
    found = {}
    for element in ElementTree.fromstring(plot_svg(points)).iter():
        found.setdefault(element.tag.rpartition("}")[2], []).append(element)
    return found


def test_the_plot_has_a_panel_a_stage_and_a_dot_a_setting():
    drawn = shapes(POINTS)
    assert len(drawn["g"]) == 4
    assert len(drawn["circle"]) == len(POINTS)
    assert "bad: 2 s, error 0.05" in [title.text for title in drawn["title"]]
    labels = [text.text for text in drawn["text"]]
    assert "good" in labels
    assert "bad" not in labels, "only the frontier is labelled"
    assert len(shapes(POINTS[:3])["g"]) == 1


def test_every_panel_lies_inside_the_picture():
    for points in (POINTS, [*POINTS, Point("evidence", "8 cameras", 1.0, 0.01)]):
        drawn = shapes(points)
        height = float(drawn["svg"][0].get("viewBox").split()[3])
        places = [group.get("transform")[len("translate(") : -1].split(",") for group in drawn["g"]]
        assert max(float(y) for _, y in places) + HEIGHT == height


def test_slower_settings_lie_farther_right_and_larger_errors_higher():
    fast, bad, good = shapes(POINTS[:3])["circle"]
    x, y = ([float(dot.get(name)) for dot in (fast, bad, good)] for name in ("cx", "cy"))
    assert x[0] < x[1] < x[2]
    assert y[1] < y[0] < y[2], "SVG counts from the top"
    front = shapes(POINTS[:3])["polyline"][0].get("points").split()
    assert front == [f"{dot.get('cx')},{dot.get('cy')}" for dot in (fast, good)]


def test_names_in_the_plot_are_escaped():
    drawn = shapes([Point("flow", "K<2 & more", 1.0, 0.5)])
    assert "K<2 & more" in [text.text for text in drawn["text"]]
