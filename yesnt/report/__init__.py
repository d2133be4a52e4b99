"""`yesnt report`: one self-contained page about a run; numbers to JSON first, pictures from the store."""

from __future__ import annotations

import base64
import json
from pathlib import Path

from yesnt.io.durable import write_bytes, write_json
from yesnt.report.facts import gather
from yesnt.report.pictures import draw
from yesnt.report.timeline import timeline_svg
from yesnt.runtime.session import Session

TEMPLATE = Path(__file__).parent.parent / "data" / "report.html.jinja"


def write_report(session: Session) -> Path:
    """Writes `report.json` and `report.html` into the run folder; returns the page.

    What is not done yet is left out and said.
    """
    import jinja2

    facts = gather(session)
    write_json(session.output.run / "report.json", facts)
    images = {name: "data:image/png;base64," + base64.b64encode(png).decode() for name, png in draw(session).items()}
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    template = environment.from_string(TEMPLATE.read_text())
    curve = session.output.run / "trade.svg"
    page = template.render(
        facts=facts,
        images=images,
        timeline=timeline_svg(facts["tasks"]),
        curve=curve.read_text() if curve.exists() else "",
        job=json.dumps(facts["job"], indent=1),
    )
    path = session.output.run / "report.html"
    write_bytes(path, page.encode())
    return path
