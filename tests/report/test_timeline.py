"""The timeline: bars lie where and in the lane in which tasks ran, in the colour of their stage."""

import xml.etree.ElementTree as ElementTree

from yesnt.planning.stages import STAGES
from yesnt.report.timeline import LANE, WIDTH, timeline_svg

TASKS = [
    {"stage": "flow", "frame": 1001, "worker": 70, "begin": 10.0, "end": 15.0},
    {"stage": "relight", "frame": 1002, "worker": 30, "begin": 15.0, "end": 20.0},
    {"stage": "relight", "frame": 1003, "worker": 70, "begin": 19.999, "end": 20.0},
]


def elements(tasks, tag):
    root = ElementTree.fromstring(timeline_svg(tasks))
    return [element for element in root.iter() if element.tag.rpartition("}")[2] == tag]


def test_bars_lie_where_tasks_ran():
    bars = elements(TASKS, "rect")[: len(TASKS)]
    assert [(float(bar.get("x")), float(bar.get("width"))) for bar in bars] == [
        (0, WIDTH / 2),
        (WIDTH / 2, WIDTH / 2),
        (WIDTH - 0.1, 0.5),
    ]
    assert [int(bar.get("y")) for bar in bars] == [LANE, 0, LANE], "lanes are sorted by process"


def test_bars_have_the_colour_of_their_stage_and_say_what_they_are():
    bars = elements(TASKS, "rect")[: len(TASKS)]
    assert [bar.get("fill") for bar in bars] == [STAGES[task["stage"]].color for task in TASKS]
    assert elements(TASKS, "title")[0].text == "flow 1001: 5.00 s"


def test_the_legend_names_every_stage_and_the_time():
    legend = elements(TASKS, "rect")[len(TASKS) :]
    assert [box.get("fill") for box in legend] == [row.color for row in STAGES.values()]
    assert [text.text for text in elements(TASKS, "text")] == [*(row.name for row in STAGES.values()), "10 s"]


def test_a_run_without_tasks_has_no_timeline():
    assert timeline_svg([]) == ""
