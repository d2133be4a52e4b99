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
    written = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert document == written | {"failed": {}}
    assert {len(cells) for cells in document["cells"].values()} == {1}, "one map"
    assert [shot["maps"] for shot in document["shots"]] == [{"dusk": [1001]}], "one frame"
    cells = {row: found["ball / dusk"]["psnr"] for row, found in document["cells"].items()}
    assert cells["no_relighting"] < cells["no_decomposition"] < cells["full"] < cells["full_true"]
    again = CliRunner().invoke(app, asked, catch_exceptions=False)
    assert re.search(r"(\d\d) tasks, \1 done already", again.stdout)
    full = next(line for line in again.stdout.splitlines() if line.startswith("| Full |"))
    assert f"{cells['full']:.2f}" in full
    assert "evaluation.html" in again.stdout
