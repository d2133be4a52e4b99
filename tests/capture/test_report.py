"""What is said of a bad capture before anything is fitted."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.capture.balls import silhouettes
from tests.capture.capture_shot import write_capture_shot, write_view
from tests.decompose.evidence.scenes import FRAME
from yesnt.capture.report import pose_problems, report_capture
from yesnt.cli.app import app
from yesnt.io.cameras import CalibratedCamera
from yesnt.runtime.checks.preflight import resolve

WAYS = [(1, 0, 0.2), (0.2, 1, 0.3), (-1, 0.3, 0.1), (-0.2, -1, 0.4)]


def rig(change=None):
    cameras = [view.camera for view in silhouettes(WAYS, 16)]
    return {f"c{i}": CalibratedCamera(_posed(camera, change, i)) for i, camera in enumerate(cameras)}


def _posed(camera, change, number):
    pose = camera.poses[FRAME].copy()
    pose = pose if change is None else change(pose, number)
    return replace(camera, poses={0: pose})


def scaled(pose, _):
    pose[:3, 3] *= 1000
    return pose


def turned_away(pose, number):
    if number == 2:
        pose[:3, 0], pose[:3, 2] = -pose[:3, 0], -pose[:3, 2].copy()
    return pose


def y_up(pose, _):
    return np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]) @ pose


def test_a_good_rig_has_no_problem() -> None:
    assert list(pose_problems(rig(), 1)) == []


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (scaled, "m from what they look at: millimetres or centimetres read as metres. Expected: 0.05 to 100 m. "
                 "Do: set `capture.units`"),
        (turned_away, "Camera c2 has no overlap: nothing that the other cameras see together lies in its picture."),
        (y_up, "The tops of the pictures point along y of the world, whose Z must point up. Do: set `capture.up`"),
    ],
)  # fmt: skip
def test_bad_calibrations_are_named(change, expected) -> None:
    (said,) = pose_problems(rig(change), 1)
    assert expected in said


def test_a_single_camera_is_too_few() -> None:
    assert "The capture has one camera" in next(pose_problems({"c0": rig()["c0"]}, 1))


@pytest.fixture(scope="module")
def shot(tmp_path_factory):
    return write_capture_shot(tmp_path_factory.mktemp("shot"), frames=1)


def called(*arguments):
    """Exit status and output of the command line."""
    result = CliRunner().invoke(app, list(map(str, arguments)), standalone_mode=False)
    assert result.exception is None
    return result.return_value, result.output


def test_a_good_capture_is_reported_as_such(shot) -> None:
    status, output = called("capture", shot, "--json")
    found = json.loads(output)
    assert status == 0
    assert found["problems"] == []
    assert found["cameras"] == 5
    assert found["subject"] == pytest.approx([2.15, 2.15, 2.15], abs=0.15)  # the hull of a ball of diameter 2
    status, output = called("capture", shot)
    assert status == 0
    assert "subject" in output


def test_an_inverted_matte_ends_with_status_1(tmp_path) -> None:
    path = write_capture_shot(tmp_path, frames=1)
    matte = np.ones((24, 24), np.float32)
    matte[8:16, 8:16] = 0
    write_view(tmp_path, "c02", 1001, np.full((24, 24, 3), 0.3), matte)
    status, output = called("capture", path)
    assert status == 1
    assert "Problem: The matte of camera c02 is inverted: it covers the picture's border" in " ".join(output.split())


def test_a_darker_camera_is_named_with_its_gain(tmp_path) -> None:
    from tests.capture.capture_shot import pictures_of

    path = write_capture_shot(tmp_path, frames=1)
    _, color, matte, *_ = pictures_of(5)[3]
    write_view(tmp_path, "c02", 1001, 0.6 * color, matte)
    found = report_capture(resolve(path).job, 1001)
    ratio = found.gains["c02"][0] / np.median([gain[0] for name, gain in found.gains.items() if name != "c02"])
    assert ratio == pytest.approx(1 / 0.6, rel=0.25)
    assert any("Camera c02 shows the subject differently bright" in said for said in found.problems)
