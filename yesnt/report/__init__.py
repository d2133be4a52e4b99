"""`yesnt report`: one self-contained page about a run; numbers to JSON first, pictures from the store."""

from __future__ import annotations

import base64
import json
from pathlib import Path

from yesnt.io.durable import write_bytes, write_json
from yesnt.io.templates import render
from yesnt.report.facts import gather
from yesnt.report.pictures import draw
from yesnt.report.timeline import timeline_svg
from yesnt.runtime.session import Session


def write_report(session: Session) -> Path:
    """Writes `report.json` and `report.html` into the run folder; returns the path of the page.

    Stages that are not done have no picture; the page lists them.
    """
    facts = gather(session)
    write_json(session.output.run / "report.json", facts)
    images = {name: "data:image/png;base64," + base64.b64encode(png).decode() for name, png in draw(session).items()}
    curve = session.output.run / "trade.svg"
    page = render(
        "report.html.jinja",
        facts=facts,
        images=images,
        timeline=timeline_svg(facts["tasks"]),
        curve=curve.read_text() if curve.exists() else "",
        job=json.dumps(facts["job"], indent=1),
    )
    path = session.output.run / "report.html"
    write_bytes(path, page.encode())
    return path
