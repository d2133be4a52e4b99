"""Fields that a run fits itself: a capture of a sphere goes in, fields, views and proxies come out."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.gaussians.scenes import look_at, shell
from tests.runtime.test_gaussian_job import RADIUS, moved
from tests.tiny_shot import write_tiny_shot
from yesnt.core.camera import Camera
from yesnt.core.errors import JobError
from yesnt.core.gaussian_input import held_out_of
from yesnt.gaussians.cost import BEGIN, FitLoad, fit_bytes, fit_seconds
from yesnt.gaussians.field import GaussianField
from yesnt.gaussians.settings import FitSettings
from yesnt.inspect.forecast import forecast
from yesnt.io.exr import read_planes, write_exr
from yesnt.planning.builders.gaussians import starts_of
from yesnt.planning.stages import FIT
from yesnt.report import write_report
from yesnt.report.fits import fit_picture
from yesnt.runtime.control.share import run_shared
from yesnt.runtime.run_options import RunOptions
from yesnt.runtime.session import Session
from yesnt.tasks import fit as fit_task
from yesnt.tasks.fit_progress import DIFFERENCE_GAIN
from yesnt.tasks.gaussians import view_planes

SIDE, FOCAL = 32, 44.0
KNOBS = {"steps": 90, "check": 30, "count": 150, "most": 200, "triangles": 600}


def eyes(count: int = 9) -> list[np.ndarray]:
    index = np.arange(count)
    turn, height = 2 * np.pi * index / count, np.where(index % 3 == 0, 1.2, np.where(index % 3 == 1, 0.2, -0.9))
    return [np.array([2 * np.cos(a), 2 * np.sin(a), h]) for a, h in zip(turn, height, strict=True)]


def write_capture_shot(folder: Path, frames: int = 1, **changes: Any) -> Path:
    """The tiny shot with a capture of a sphere in place of plates, G-buffers and proxies."""
    section = {"cameras": "cameras.json", "images": "capture/{camera}/plate.####.exr"}
    bare: dict[str, Any] = {"plate": None, "gbuffer": None, "proxy": None, "evidence": {"use": False}}
    bare |= {"capture": section, "gaussians": {"every": 2, "held_out": 1, "knobs": KNOBS}}
    job = write_tiny_shot(folder, frames, (24, 20), **bare | changes)
    for path in [*folder.glob("plate.*"), *folder.glob("gbuffer.*"), *folder.glob("proxy.*")]:
        path.unlink()
    cameras = {}
    for number, eye in enumerate(eyes()):
        pose = look_at(tuple(eye))
        one = {"width": SIDE, "height": SIDE, "fx": FOCAL, "fy": FOCAL, "cx": SIDE / 2, "cy": SIDE / 2}
        cameras[f"c{number:02d}"] = one | {"world_from_camera": pose.ravel().tolist()}
        camera = Camera(SIDE, SIDE, FOCAL, FOCAL, SIDE / 2, SIDE / 2, {0: pose})
        for i in range(frames):
            path = folder / "capture" / f"c{number:02d}" / f"plate.{1001 + i}.exr"
            path.parent.mkdir(parents=True, exist_ok=True)
            planes = view_planes(moved(colored(), 0.03 * i), camera, None)
            write_exr(path, {name: planes[name].astype(np.float16) for name in "RGBA"})
    (folder / "cameras.json").write_text(json.dumps({"cameras": cameras}))
    return job


def colored() -> GaussianField:
    """Stripes along z on a sphere."""
    field = shell(500, RADIUS, logit=7.0)
    harmonics = np.zeros_like(field.harmonics)
    harmonics[:, 0, 0] = np.sin(9 * field.positions[:, 2])
    return GaussianField(field.positions, field.log_scales, field.rotations, field.opacity_logits, harmonics)


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    job = write_capture_shot(tmp_path_factory.mktemp("capture"), 2)
    result = run_shared(Session(job), RunOptions())
    assert not result.missing
    return job


def field_bytes_of(job: Path, frame: int = 1001) -> bytes:
    return (job.parent / f"out/gaussians/field.{frame}.ply").read_bytes()


def test_a_run_goes_from_a_capture_to_relit_frames(ran: Path) -> None:
    session = Session(ran)
    assert not session.resolved.awaiting
    for frame in session.job.frames:
        assert session.output.exr_path("tiny", frame).exists()
        record = session.book.find("fit", frame)
        assert record is not None
        assert record.facts["psnr"] > 20
        looks = json.loads((session.output.run / f"fit/{frame}.json").read_text())["looks"]
        assert looks[-1]["psnr"] == record.facts["psnr"]
    assert not list((session.output.root / "gaussians/checkpoints").glob("*"))


def test_the_report_shows_a_held_out_camera_of_every_fit(ran: Path) -> None:
    session = Session(ran)
    page = write_report(session).read_text()
    assert "Gaussian fields fitted to the capture" in page
    facts = json.loads((session.output.run / "report.json").read_text())["fits"]
    assert [(one["frame"], one["step"]) for one in facts] == [(1001, 90), (1002, 90)]
    told = json.loads((session.output.run / "fit/1001.json").read_text())["view"]
    picture = cv2.imdecode(np.frombuffer(fit_picture(session) or b"", np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    given, seen, difference, normals, proxy = np.split(
        picture[: told["height"], : 5 * told["width"]] / 255.0, 5, axis=1
    )
    assert np.abs(np.abs(given - seen) * DIFFERENCE_GAIN - difference)[difference < 1].max() < 0.04
    inside = seen.sum(axis=-1) > 0.5
    assert np.median(np.abs(normals - proxy)[inside]) < 0.12, "the mesh faces where the field does"
    assert proxy[inside][:, 0].mean() > 0.7, "blue is z: towards the camera"


def test_the_report_shows_a_fit_that_runs(ran: Path, tmp_path: Path) -> None:
    session = Session(write_capture_shot(tmp_path, 1))
    assert fit_picture(session) is None
    (session.output.run / "fit").mkdir(parents=True)
    for name in ("fit/1001.json", "fit/1001.png"):
        (session.output.run / name).write_bytes((Session(ran).output.run / name).read_bytes())
    page = write_report(session).read_text()
    assert "<td>1001<td>90<td>90" in page
    assert "a held-out camera, the field" in page


def test_frames_between_keyframes_start_from_one(ran: Path) -> None:
    session = Session(ran)
    first, second = (session.graph().committer(FIT, frame) for frame in (1001, 1002))
    assert (first.task.keyframe, second.task.keyframe) == (None, 1001)
    assert second.needs == (first.id,)
    assert first.task.held_out == ("c04",)


@pytest.mark.parametrize("chosen", [1001, 1002], ids=["keyframe", "following"])
def test_a_fit_that_is_killed_goes_on_to_the_same_bytes(
    ran: Path, tmp_path: Path, monkeypatch: Any, chosen: int
) -> None:
    job, tell = write_capture_shot(tmp_path, chosen - 1000), fit_task.tell_progress
    seen = []

    def dies(run: Path, frame: int, looks: list[dict[str, Any]], *shown: Any) -> None:
        if frame == chosen:
            seen.append(looks[-1]["step"])
            if looks[-1]["step"] == 60:
                raise KeyboardInterrupt
        tell(run, frame, looks, *shown)

    monkeypatch.setattr(fit_task, "tell_progress", dies)
    with pytest.raises(KeyboardInterrupt):
        run_shared(Session(job), RunOptions(until="fit"))
    monkeypatch.setattr(fit_task, "tell_progress", lambda run, frame, looks, *shown: seen.append(looks[-1]["step"]))
    run_shared(Session(job), RunOptions(until="fit"))
    assert seen == [30, 60, 60, 90]
    assert field_bytes_of(job, chosen) == field_bytes_of(ran, chosen)


def test_the_plan_names_the_fit(tmp_path: Path) -> None:
    rows = forecast(Session(write_capture_shot(tmp_path, 2))).stages
    assert [(row.stage, row.todo) for row in rows] == [("fit", 2), ("mesh", 2), ("view", 2)]
    assert not rows[0].measured
    assert 2 * BEGIN < rows[0].seconds < 10


def test_the_cost_of_a_fit_follows_from_its_settings(ran: Path) -> None:
    load, few = FitLoad(8, 1, 1024, 900), FitSettings(**{n: KNOBS[n] for n in ("steps", "check", "count")}, every=1000)
    many = replace(few, steps=900)
    large = replace(many, count=20_000)
    assert fit_seconds(many, load) - BEGIN == pytest.approx(10 * (fit_seconds(few, load) - BEGIN), rel=0.05)
    assert fit_seconds(large, load) > 10 * fit_seconds(many, load)
    assert fit_bytes(large, load) > fit_bytes(many, load) > 4e8
    whole = replace(load, whole=1920 * 1080)
    assert fit_seconds(few, whole) - fit_seconds(few, load) == pytest.approx(9 * 0.62, rel=0.01), "pictures are read"
    assert forecast(Session(ran)).stages[0].measured


def test_mattes_that_do_not_agree_are_reported_before_the_fit(tmp_path: Path) -> None:
    job = write_capture_shot(tmp_path / "a", 1)
    path = tmp_path / "a/capture/c03/plate.1001.exr"
    planes = read_planes(path)
    write_exr(path, {name: (np.roll(plane, 8, axis=1)).astype(np.float16) for name, plane in planes.items()})
    (said,) = (line for line in forecast(Session(job)).warnings if line.startswith("capture"))
    assert said.startswith("capture, frame 1001: Camera c03 contradicts all others (of the worst matte")
    assert not (tmp_path / "a/out/gaussians").exists()


def test_mattes_that_agree_nowhere_are_refused(tmp_path: Path) -> None:
    job = write_capture_shot(tmp_path, 1)
    for path in (tmp_path / "capture").rglob("*.exr"):
        write_exr(path, {name: np.zeros((SIDE, SIDE), np.float16) for name in "RGBA"})
    with pytest.raises(
        JobError, match="cannot be fitted in frame 1001: Camera c00 is not used in this frame: its matte is empty"
    ):
        forecast(Session(job))


@pytest.mark.parametrize(
    ("every", "expected"), [(1, [None] * 6), (4, [None, 0, 0, 4, None, 4]), (8, [None, 0, 0, 0, 0, 0])]
)
def test_each_frame_has_the_nearest_keyframe(every: int, expected: list[int | None]) -> None:
    assert starts_of(range(6), every) == dict(enumerate(expected))


def test_the_next_frame_takes_the_place_of_a_keyframe_that_is_lost() -> None:
    assert starts_of(range(10, 19), 4, {10, 14}) == {11: None, 12: 11, 13: 11, 15: None, 16: 15, 17: 18, 18: None}
    assert starts_of(range(6), 2, {2, 3}) == {0: None, 1: 0, 4: None, 5: 4}
    assert starts_of(range(3), 1, {0, 1, 2}) == {}


def test_one_camera_in_twelve_is_held_out() -> None:
    names = [f"c{i:02d}" for i in range(24)]
    assert held_out_of(names, None) == ("c06", "c18")
    assert held_out_of(names[:4], None) == ()
    assert held_out_of(names, 1) == ("c12",)


def test_a_fit_without_pictures_and_a_picture_of_another_size_are_refused(tmp_path: Path) -> None:
    with pytest.raises(JobError, match="`gaussians` needs `path`, or `capture` with the pictures"):
        Session(write_tiny_shot(tmp_path / "a", 1, proxy=None, gaussians={}))
    job = write_capture_shot(tmp_path / "b", 1)
    write_exr(tmp_path / "b/capture/c03/plate.1001.exr", {c: np.zeros((8, 8), np.float16) for c in "RGBA"})
    with pytest.raises(JobError, match="The picture of camera c03 is 8x8"):
        run_shared(Session(job), RunOptions())
    assert not (tmp_path / "b/out/gaussians").exists()
