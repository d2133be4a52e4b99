"""`yesnt eval` as a command."""

import json
import re

import typer
from typer.testing import CliRunner

from yesnt.cli.evaluate import evaluate


def test_json_and_tables(shot, tmp_path):
    app = typer.Typer()
    app.command()(evaluate)
    asked = [str(shot.parent.parent), "--set", "set", "--output", str(tmp_path / "out"), "--workers", "0"]
    asked += ["--frames", "1", "--maps", "dusk"]
    printed = CliRunner().invoke(app, [*asked, "--json"], catch_exceptions=False)
    document = json.loads(printed.stdout)
    assert document["failed"] == {}
    assert document["cells"]["full"]["ball / dusk"]["psnr"] > 0
    again = CliRunner().invoke(app, asked, catch_exceptions=False)
    assert re.search(r"(\d\d) tasks, \1 done already", again.stdout)
    assert "## Accuracy" in again.stdout
    assert "evaluation.html" in again.stdout
