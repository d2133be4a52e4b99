"""From four videos and a calibration to a relit shot by one command; what contradicts itself is refused before work."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.capture.recorded_shot import FIRST, SIDE, cameras, picture, place, write_recorded_shot, write_video
from yesnt.capture import person
from yesnt.cli.app import app
from yesnt.core.camera import Camera
from yesnt.core.errors import JobError, MissingPartError
from yesnt.inspect.forecast import AWAITING_MATTES, forecast
from yesnt.io.exr import read_planes
from yesnt.io.jobfile import load_shot, parse_frames
from yesnt.io.mesh import read_mesh
from yesnt.runtime.control.share import run_shared
from yesnt.runtime.run_options import RunOptions
from yesnt.runtime.session import Session


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    job = write_recorded_shot(tmp_path_factory.mktemp("recorded"))
    result = run_shared(Session(job), RunOptions())
    assert not result.missing
    return job


def matte_of(job: Path, camera: str, frame: int) -> np.ndarray:
    import cv2

    return np.asarray(cv2.imread(str(job.parent / f"out/mattes/{camera}/matte.{frame}.png"), 0)) / 255


def test_the_mattes_are_those_of_the_ball(ran: Path) -> None:
    for number, (name, camera) in enumerate(cameras().items()):
        for frame in (1005, 1006):
            inside, truth = matte_of(ran, name, frame) > 0.5, picture(camera, place(frame - FIRST), number)[1]
            assert (inside & truth).sum() / (inside | truth).sum() > 0.88, (name, frame)


def test_the_ball_stands_relit_in_the_delivered_picture(ran: Path) -> None:
    delivered = read_planes(Session(ran).output.exr_path("recorded", 1006))
    covered = delivered["relit.A"] > 0.9
    assert 0.05 < covered.mean() < 0.4
    assert np.isfinite(delivered["R"]).all()
    red, blue = delivered["relit.R"][covered].mean(), delivered["relit.B"][covered].mean()
    assert red > 2 * blue, "the ball is orange, the wall blue"
    proxy = read_mesh(Session(ran).output.root / "gaussians" / "proxy.1006.ply")
    middle = 0.5 * (proxy.vertices.min(axis=0) + proxy.vertices.max(axis=0))
    assert middle[:2] == pytest.approx(place(1006 - FIRST)[:2], abs=0.2)  # four views leave corners


def test_a_finished_shot_makes_nothing_again(ran: Path) -> None:
    session = Session(ran)
    assert session.resolved.awaiting == ""
    assert not run_shared(session, RunOptions()).outcome.done
    status = CliRunner().invoke(app, ["capture", str(ran), "--json"], standalone_mode=False)
    assert json.loads(status.output)["cameras"] == 4


def test_mattes_are_the_same_bytes_in_whatever_order_they_are_made(ran: Path, tmp_path: Path) -> None:
    job = Path(shutil.copytree(ran.parent, tmp_path / "again", ignore=shutil.ignore_patterns("out"))) / "shot.yaml"
    session = Session(job)
    assert session.resolved.awaiting == "mattes"
    found = forecast(session)
    assert [(row.stage, row.todo) for row in found.stages] == [("matte", 6)]
    assert AWAITING_MATTES in found.notes
    with pytest.raises(
        JobError, match=r"The mattes of this job's capture are made .* Do: `yesnt run SHOT --until matte`"
    ):
        CliRunner().invoke(app, ["capture", str(job)], standalone_mode=False, catch_exceptions=False)
    for frame in ("1006", "1005"):
        run_shared(Session(job), RunOptions(frames=frame, until="matte"))
    names = sorted(path.relative_to(ran.parent) for path in (ran.parent / "out" / "mattes").rglob("*.*"))
    assert len(names) == 12
    assert all((ran.parent / name).read_bytes() == (job.parent / name).read_bytes() for name in names)
    assert Session(job).resolved.awaiting == "views"
    write_video(job.parent / "videos" / "c1.mkv", [np.full((SIDE, SIDE, 3), 0.4)] * 11)
    assert Session(job).resolved.awaiting == "mattes", "another video needs other mattes"


def test_a_camera_that_is_late_is_named_with_its_offset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("yesnt.capture.agreement._GRIDS", (20, 28))  # the pictures are small
    matting = {"background": "median", "consistent": False}
    section = {"cameras": "cameras.json", "images": "videos/{camera}.mkv", "first": FIRST, "matting": matting}
    job = write_recorded_shot(tmp_path, "1004-1008", {"c2": 1}, capture=section)
    run_shared(Session(job), RunOptions(until="matte"))
    session = Session(job)
    said = [line for line in session.checks.content() if "out of sync" in line]
    assert len(said) == 1
    assert "Camera c2 is out of sync: its silhouettes agree with the others' +1 frames later." in said[0]
    assert "add `c2: 1` to `capture.offsets`, on top of what stands there; `yesnt capture SHOT --sync 4`" in said[0]


def test_the_example_of_the_documents_is_a_job() -> None:
    folder = Path(__file__).parents[2] / "docs" / "examples" / "four-cameras"
    shot = load_shot(folder / "shot.yaml")
    assert shot.matted is not None
    assert shot.capture is not None
    assert shot.capture.mattes == "out/mattes/{camera}/matte.####.png"
    Camera.open(folder / "camera.json").check(parse_frames(shot.frames, "frames"))
    assert shot.light.path is not None
    assert (folder / shot.light.path).is_file()


def test_mattes_lie_in_the_pictures_of_lenses_that_distort(tmp_path: Path) -> None:
    job = write_recorded_shot(tmp_path, "1004", bend=0.5)
    run_shared(Session(job), RunOptions(until="matte"))
    for number, (name, camera) in enumerate(cameras(0.5).items()):
        inside, truth = matte_of(job, name, 1004) > 0.5, picture(camera, place(1004 - FIRST), number)[1]
        assert (inside & truth).sum() / (inside | truth).sum() > 0.88, name


def section_of(**matting: object) -> dict[str, object]:
    return {"cameras": "cameras.json", "images": "videos/{camera}.mkv", "first": FIRST, "matting": matting}


def test_a_clean_plate_serves_a_subject_that_stays(tmp_path: Path) -> None:
    from tests.capture.recorded_shot import wall

    for number in range(4):
        write_video(tmp_path / "clean" / f"c{number}.mkv", [wall(number)] * 3)
    job = write_recorded_shot(tmp_path, "1006", capture=section_of(background="clean/{camera}.mkv"))
    run_shared(Session(job), RunOptions(until="matte"))
    truth = picture(cameras()["c0"], place(1006 - FIRST), 0)[1]
    inside = matte_of(job, "c0", 1006) > 0.5
    assert (inside & truth).sum() / (inside | truth).sum() > 0.93


@pytest.mark.parametrize(
    ("capture", "expected"),
    [
        (section_of() | {"mattes": "{camera}.png"}, "capture has both `mattes` and `matting`, which makes them"),
        (section_of(background="none"), "without `person: true` there is nothing to make mattes from"),
        (section_of(weights="models"), "`weights` are those of `person: true`"),
        (section_of(background="clean.png"), "`background` is `median`, `none`, or a pattern with {camera}"),
        (section_of(background="clean/{camera}.png"), r"clean/c0\.png"),
        (section_of() | {"matting": {"colour": "green"}}, "colour"),
    ],
)
def test_jobs_that_contradict_themselves_are_refused(tmp_path: Path, capture: dict, expected: str) -> None:
    job = write_recorded_shot(tmp_path, "1006", capture=capture)
    with pytest.raises(JobError, match=expected):
        run_shared(Session(job), RunOptions(until="matte"))
    assert not (tmp_path / "out" / "mattes").exists()


def test_a_moving_camera_has_no_background(tmp_path: Path) -> None:
    job = write_recorded_shot(tmp_path, "1006")
    document = json.loads((tmp_path / "cameras.json").read_text())
    moving = document["cameras"]["c1"]
    moving["frames"] = {"1006": {"world_from_camera": moving.pop("world_from_camera")}}
    (tmp_path / "cameras.json").write_text(json.dumps(document))
    with pytest.raises(
        JobError, match=r"Camera c1 of the capture moves, and its background with it.*`background: none`"
    ):
        run_shared(Session(job), RunOptions(until="matte"))


def test_a_median_of_two_pictures_is_refused(tmp_path: Path) -> None:
    job = write_recorded_shot(tmp_path, "1001")
    write_video(tmp_path / "videos" / "c2.mkv", [np.full((SIDE, SIDE, 3), 0.4)] * 2)
    with pytest.raises(JobError, match=r"Camera c2 has 2 pictures, whose median is not the background.*clean plates"):
        run_shared(Session(job), RunOptions(until="matte"))


def test_persons_without_their_parts_are_refused_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job = write_recorded_shot(tmp_path, "1006", capture=section_of(person=True, weights="models"))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(
        MissingPartError, match=r"package ai-edge-litert, which is not installed.*pip install 'yesnt\[mat"
    ):
        Session(job)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object() if name == "ai_edge_litert" else None)
    with pytest.raises(MissingPartError, match="models of the package mediapipe, which is not installed"):
        person.find_models(None)
    with pytest.raises(
        JobError, match=r"A model that finds persons is missing.*pose_detection.*capture\.matting\.weights"
    ):
        Session(job)
