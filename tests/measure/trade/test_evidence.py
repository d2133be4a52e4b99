"""`yesnt trade` on a shot with a capture: what is tried, what it costs, and that the reference has no error."""

from dataclasses import replace

import numpy as np
import pytest

from tests.capture.capture_shot import truth, write_capture_shot
from yesnt.core.capture_input import EvidenceInput
from yesnt.io.exr import write_exr
from yesnt.measure.trade import TradeOptions, run_trade
from yesnt.measure.trade import evidence as module
from yesnt.measure.trade import run as run_module
from yesnt.measure.trade.evidence import EvidenceRunner
from yesnt.measure.trade.variants import Variant, evidence_variants, variants
from yesnt.runtime.session import Session

BASE = replace(variants((1,))[0], quality="draft")
FRAMES = (1001, 1002, 1003)


def write_shot(folder, **changes):
    """The painted sphere at rest, 3 frames, 5 cameras, decomposed by the embedded model."""
    given = {"decompose": {"backend": "embedded"}, "evidence": {"every": 2}, "quality": "draft"}
    return write_capture_shot(folder, **given | changes)


def few(cameras, finest, shot):
    """Three variants, the reference last."""
    found = {v.name: replace(v, quality="draft") for v in evidence_variants(cameras, finest, shot)}
    return [found["every 2nd"], found[f"{cameras} cameras"], found["1 camera"]]


def test_every_setting_is_a_section_of_a_job_and_the_finest_is_the_reference() -> None:
    found = evidence_variants(9, 4, EvidenceInput(every=8, knobs={"temper": 0.2}))
    names = [variant.name for variant in found]
    assert names[:5] == ["1 camera", "2 cameras", "4 cameras", "8 cameras", "9 cameras"]
    assert names[5:7] == ["every 8th", "every 16th"]
    assert len(set(names)) == len(names)
    for variant in found:
        asked = EvidenceInput.model_validate({"use": True, **variant.job["evidence"]})
        assert asked == variant.evidence
        assert asked.knobs["temper"] == 0.2, "the job's own settings are kept"
    best = found[-1].evidence
    assert (best.cameras, best.every, best.knobs["step"], best.knobs["roughness_levels"]) == (9, 4, 1, 15)
    assert [v.name for v in evidence_variants(40, 1, EvidenceInput())][:6][-1] == "16 cameras"


def test_the_finest_step_is_the_least_that_has_pictures(tmp_path) -> None:
    path = write_shot(tmp_path)
    runner = EvidenceRunner.of(Session(path), FRAMES, BASE)
    assert runner.variants[-1].evidence.every == 1
    assert runner.variants[-1].evidence.cameras == 5
    (tmp_path / "capture/c03/plate.1002.exr").unlink()
    runner = EvidenceRunner.of(Session(path), FRAMES, BASE)
    assert runner.variants[-1].evidence.every == 2
    assert EvidenceRunner.of(Session(write_shot(tmp_path, evidence={"use": False})), FRAMES, BASE) is None


def test_the_frames_reach_to_the_keyframe_of_the_coarsest_step(tmp_path) -> None:
    session = Session(write_shot(tmp_path, frames=9, evidence={"every": 1}))
    runner = EvidenceRunner.of(session, session.job.frames[1:3], BASE)
    assert runner.harness.frames == session.job.frames[1:5], "every 4th"
    assert runner.compared == range(2)


@pytest.fixture(scope="module")
def traded(tmp_path_factory):
    """The document of a shot with truth, one variant of each other stage."""
    folder = tmp_path_factory.mktemp("traded")
    path = write_shot(folder, evidence={"every": 1})
    (folder / "truth").mkdir()
    (roughness, metallic), inside = truth()
    planes = {"roughness.Y": roughness, "metallic.Y": metallic, **{f"base_color.{c}": roughness for c in "RGB"}}
    for frame in FRAMES:
        covered = {name: (plane * inside).astype(np.float32) for name, plane in planes.items()}
        write_exr(folder / f"truth/material.{frame}.exr", covered)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "evidence_variants", few)
        others = [Variant(stage, stage, {}, quality="draft") for stage in ("flow", "relight")]
        patch.setattr(run_module, "variants", lambda steps: [BASE, *others])
        session = Session(path)
        document = run_trade(session, TradeOptions(3))
    return {(p["stage"], p["name"]): p for p in document["points"]}, document, session


def test_cameras_cost_seconds_and_bring_the_materials_nearer_to_the_truth(traded) -> None:
    points, document, session = traded
    one, all_five = points["evidence", "1 camera"], points["evidence", "5 cameras"]
    model = points["decompose", BASE.name]
    assert one["seconds"] > 0
    assert all_five["truth"] < 0.8 * model["truth"]
    assert document["choice"]["names"].keys() == {"decompose", "evidence", "flow", "relight"}
    assert points["flow", "flow"]["truth"] is None
    assert "evidence" in (session.output.run / "trade.svg").read_text()


def test_frames_between_cost_less_and_are_the_keyframes_where_nothing_moves(traded) -> None:
    points = traded[0]
    whole, half = points["evidence", "5 cameras"], points["evidence", "every 2nd"]
    assert half["seconds"] < whole["seconds"], "two of three frames are measured"
    assert points["evidence", "1 camera"]["error"] == 0, "it is the reference here"
    assert half["error"] == pytest.approx(whole["error"], rel=0.2)
