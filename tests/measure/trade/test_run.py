"""`yesnt trade` on the tiny shot, with few variants: what is written, and that the reference has no error."""

import json

import pytest
import typer
from typer.testing import CliRunner

from tests.tiny_shot import write_tiny_shot
from yesnt.cli.trade import trade
from yesnt.core.errors import UsageError
from yesnt.decompose.settings import EnsembleSettings
from yesnt.measure.trade import TradeOptions, run_trade
from yesnt.measure.trade import run as module
from yesnt.measure.trade.variants import Variant, variants
from yesnt.runtime.session import Session


def few(steps):
    """Two variants a stage, the cheap one first."""
    one = {"tolerance": 0.0, "keyframe_step": 1}
    return [
        Variant("decompose", "K=2", {}, EnsembleSettings(2, **one), {"steps": 1}),
        Variant("decompose", "every 2nd", {}, EnsembleSettings(2, tolerance=0.0, keyframe_step=2), {"steps": 1}),
        Variant("decompose", "K=4", {}, EnsembleSettings(4, **one), {"steps": 1}),
        Variant("flow", "dis-fast", {"flow": {"knobs": {"method": "dis-fast"}}}, method="dis-fast"),
        Variant("flow", "dis-quality", {}),
        Variant("solve", "coarse", {}, tolerance=0.1),
        Variant("solve", "fine", {}, tolerance=1e-6),
        Variant("relight", "draft", {"quality": "draft"}, quality="draft"),
        Variant("relight", "standard", {}, quality="standard"),
    ]


def test_every_stage_is_measured_and_the_reference_has_no_error(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "variants", few)
    session = Session(write_tiny_shot(tmp_path / "shot", 3, decompose={"backend": "embedded", "samples": 2}))
    told = []
    document = run_trade(session, TradeOptions(3), told.append)
    points = {(p["stage"], p["name"]): p for p in document["points"]}
    assert len(points) == 9
    for reference in (("decompose", "K=4"), ("flow", "dis-quality"), ("solve", "fine"), ("relight", "standard")):
        assert points[reference]["error"] == 0
    assert all(p["seconds"] > 0 for p in points.values())
    k2, k4 = points["decompose", "K=2"], points["decompose", "K=4"]
    assert 0 < 2 * k2["evaluations"] == k4["evaluations"]
    assert points["decompose", "every 2nd"]["evaluations"] <= k2["evaluations"]
    assert k2["error"] > 0
    assert len(told) == 5
    written = json.loads((session.output.run / "trade.json").read_text())
    assert written["points"] == document["points"]
    assert (session.output.run / "trade.svg").read_text().startswith("<svg")
    assert run_trade(session, TradeOptions(3, error=0.0))["choice"]["error"] == 0


def test_passes_have_nothing_to_trade(tmp_path):
    with pytest.raises(UsageError, match="backend"):
        run_trade(Session(write_tiny_shot(tmp_path / "shot", 3)), TradeOptions())


def test_the_last_variant_of_a_stage_is_its_reference_and_jobs_are_valid():
    found = variants((1, 2, 4))
    assert [v.name for v in found if v.stage == "decompose"][-1] == "K=16, overlap 0.5"
    assert len({(v.stage, v.name) for v in found}) == len(found)


@pytest.fixture
def command(monkeypatch):
    """`yesnt trade` with the measurement replaced: (run it, the options that it passed on)."""
    passed = []
    points = [{"stage": "flow", "name": "dis-fast", "seconds": 0.5, "error": 0.0125, "evaluations": 0.0, "truth": None}]
    choice = {"names": {"flow": "dis-fast"}, "seconds": 0.5, "error": 0.0125}

    def measured(session, options, listen):
        passed.append((session, options))
        listen("flow: dis-fast")
        fits = options.error is None or options.error >= 0.0125
        job = {"flow": {"knobs": {"method": "dis-fast"}}}
        return {"points": points, "choice": choice if fits else None, "job": job, "files": ["trade.json"]}

    monkeypatch.setattr("yesnt.measure.trade.run_trade", measured)
    monkeypatch.setattr("yesnt.runtime.session.Session", str)
    app = typer.Typer()
    app.command()(trade)

    def run(*arguments):
        done = CliRunner().invoke(app, arguments, catch_exceptions=False, standalone_mode=False)
        return done.return_value, done.stdout

    return run, passed


def test_the_command_passes_its_options_on_and_prints_the_settings(command):
    run, passed = command
    status, printed = run("walk", "--error", "0.02", "--seconds-per-frame", "3", "--frames", "4")
    assert passed == [("walk", TradeOptions(frames=4, error=0.02, seconds=3.0))]
    assert status == 0
    assert "0.01250" in printed
    assert "Take flow: dis-fast: 0.50 s per frame, error 0.01250" in printed
    assert "'method': 'dis-fast'" in printed


def test_the_command_says_when_nothing_fits(command):
    run, _ = command
    status, printed = run("walk", "--error", "0.001")
    assert status == 1
    assert "No combination" in printed
    status, printed = run("walk", "--error", "0.001", "--json")
    assert status == 1
    assert json.loads(printed)["choice"] is None
