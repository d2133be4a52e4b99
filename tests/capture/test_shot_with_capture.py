"""A job with a capture from its file to the delivered EXR, in the test's own process."""

import cv2
import numpy as np
import pytest

from tests.capture.capture_shot import SIZE, pictures_of, truth, write_cameras, write_capture_shot, write_view
from tests.decompose.evidence.scenes import smooth_light
from tests.in_process import run_here, shard_digests
from yesnt.core.errors import JobError
from yesnt.io.exr import write_exr
from yesnt.io.pictures.image import read_image
from yesnt.io.store import FrameStore
from yesnt.planning.stages import EVIDENCE, RELIGHT
from yesnt.relight.envmap import uv_to_direction
from yesnt.report import write_report
from yesnt.report.pictures import draw
from yesnt.runtime.checks.inputs import inspect
from yesnt.runtime.checks.preflight import resolve
from yesnt.runtime.session import Session
from yesnt.tasks.light import frame_map


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A shot of three frames, every second one measured, run to the end."""
    path = write_capture_shot(tmp_path_factory.mktemp("captured"), evidence={"every": 2})
    for camera in range(5):  # between measured frames no picture is read
        (path.parent / f"capture/c{camera:02d}/plate.1002.exr").unlink()
    return run_here(path, "composite")


def delivered(session, frame):
    return read_image(session.output.exr_path("captured", frame)).channels


def test_materials_are_measured_and_the_number_of_cameras_is_delivered(finished) -> None:
    painted, inside = truth()
    planes = delivered(finished, 1001)
    for i, name in enumerate(("roughness", "metallic")):
        found = np.sqrt(np.square(planes[f"{name}.Y"][inside] - painted[i][inside]).mean())
        guess = np.sqrt(np.square((0.5, 0.3)[i] - painted[i][inside]).mean())
        assert found < 0.85 * guess, name
    views = planes["views.Y"]
    assert views[inside].max() <= 6
    assert views[inside].mean() > 2
    assert not views[~inside].any()
    assert np.array_equal(views, np.rint(views))


def test_frames_between_take_the_result_along_the_flow(finished) -> None:
    measured, carried = (finished.book.find(EVIDENCE, frame).fields["inputs"] for frame in (1003, 1002))
    assert any(role.startswith("view ") for role in measured)
    assert not any(role.startswith("view ") for role in carried)
    inside = truth()[1]
    a, b = delivered(finished, 1002), delivered(finished, 1003)
    assert np.abs(a["metallic.Y"] - b["metallic.Y"])[inside].mean() < 0.05, "the subject is at rest"
    assert a["views.Y"][inside].mean() > 1.5


def test_the_record_says_which_cameras_agree(finished) -> None:
    facts = finished.book.find(EVIDENCE, 1001).facts
    assert facts["left_out"] == {}
    assert set(facts["gains"]) <= {"plate", *(f"c{i:02d}" for i in range(5))}
    assert facts["views"] > 2


def test_the_report_shows_what_the_capture_changed(finished) -> None:
    assert "Materials measured by the capture" in write_report(finished).read_text()
    drawn = cv2.imdecode(np.frombuffer(draw(finished)["measured"], np.uint8), cv2.IMREAD_GRAYSCALE)
    before, roughness, _, metallic, views = np.split(drawn / 255, 5, axis=1)
    painted, inside = truth()
    for panel, true in ((roughness, painted[0]), (metallic, painted[1])):
        assert np.abs(panel - true)[inside].mean() < 0.25
    assert np.ptp(before[inside]) < np.ptp(roughness[inside])  # the guess is the same everywhere
    assert views[inside].max() == 1
    assert not views[~inside].any()


def test_the_same_job_gives_the_same_bytes_in_any_order(finished, tmp_path) -> None:
    path = write_capture_shot(tmp_path, evidence={"every": 2})
    again = run_here(path, "evidence", order=5)
    arrays = ("measured", "measured_spread", "views")
    assert shard_digests(again, *arrays) == shard_digests(finished, *arrays)


def calibration():
    return {f"c{i:02d}": view[0] for i, view in enumerate(pictures_of(5)[1:])}


def keys(path, stage="evidence"):
    return {node.frames[0]: node.key for node in Session(path).graph() if node.stage.name == stage}


def test_without_a_capture_nothing_changes(tmp_path) -> None:
    with_capture = write_capture_shot(tmp_path / "a")
    off = write_capture_shot(tmp_path / "b", evidence={"use": False})
    bare = write_capture_shot(tmp_path / "c", capture=None)
    assert keys(with_capture)
    for path in (off, bare):
        assert not keys(path)
        assert "measured" not in Session(path).plan().arrays()
    assert keys(off, "solve") == keys(bare, "solve") != keys(with_capture, "solve")
    assert keys(off, "composite") != {}, "a job file that names a capture is another job, but no other work"
    assert keys(off, "relight") == keys(bare, "relight")


def test_keys_followpictures_of_cameras_and_the_capture_light(tmp_path) -> None:
    path = write_capture_shot(tmp_path)
    before = keys(path)
    write_exr(tmp_path / "light.exr", {c: np.full((4, 8), 2.0, np.float32) for c in "RGB"})
    assert keys(path) == before, "the new light does not change what the cameras saw"
    _, color, matte, *_ = pictures_of(5)[1]
    write_view(tmp_path, "c00", 1002, 0.9 * color, matte)
    after = keys(path)
    assert [frame for frame in before if before[frame] != after[frame]] == [1002]
    write_cameras(
        tmp_path, {f"c{i:02d}": view[0] for i, view in enumerate(pictures_of(5)[1:])}, c01={"gain": [1, 1, 1.1]}
    )
    assert all(keys(path)[frame] != after[frame] for frame in after)


def test_knobs_are_settings_of_the_evidence_and_defaults_change_no_key(tmp_path) -> None:
    path = write_capture_shot(tmp_path, evidence={"every": 2})
    before = keys(path)
    write_capture_shot(tmp_path, evidence={"every": 2, "knobs": {"step": 2}})
    assert keys(path) == before
    write_capture_shot(tmp_path, evidence={"every": 2, "knobs": {"step": 4}})
    assert all(key != before[name] for name, key in keys(path).items()), "carried frames follow their keyframe"
    write_capture_shot(tmp_path, evidence={"knobs": {"stepp": 4}})
    with pytest.raises(JobError, match=r"Unknown knob 'stepp'.*key evidence.knobs.*one of relative, floor"):
        Session(path)


def test_auto_needs_four_cameras_and_says_so(tmp_path) -> None:
    path = write_capture_shot(tmp_path, cameras=3)
    assert not keys(path)
    assert any("since 3 of 3 cameras see the subject and 4 are needed" in line for line in inspect(resolve(path)))
    assert keys(write_capture_shot(tmp_path, cameras=3, evidence={"use": True}))
    few = resolve(write_capture_shot(tmp_path, cameras=5, evidence={"cameras": 4}))
    assert few.capture.reads == (
        "capture: 4 of 5 cameras measure the materials of a frame; expected: less gain than with 8, most of all in "
        "roughness (docs/evidence.md)",
    )


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"capture": None, "evidence": {"every": 2}}, "`capture`, which is absent"),
        ({"proxy": None}, "`capture` needs `proxy`"),
        ({"capture": {"cameras": "cameras.json", "images": "capture/plate.####.exr"}}, "capture.images"),
        ({"evidence": {"tracks": True}}, "Unknown key 'evidence.tracks'"),
        ({"evidence": {"use": "yes"}}, "'evidence.use"),
    ],
)
def test_a_job_that_contradicts_itself_is_refused(tmp_path, changes, expected) -> None:
    with pytest.raises(JobError, match=expected):
        resolve(write_capture_shot(tmp_path, **changes))


def broken(tmp_path, damage):
    """The error of a shot after `damage(folder)`."""
    path = write_capture_shot(tmp_path)
    damage(tmp_path)
    with pytest.raises(JobError) as error:
        inspect(resolve(path))
    return str(error.value)


def test_a_missing_picture_is_named(tmp_path) -> None:
    said = broken(tmp_path, lambda folder: (folder / "capture/c02/plate.1002.exr").unlink())
    assert "capture/c02/plate.1002.exr" in said


def test_a_picture_of_another_size_names_its_camera(tmp_path) -> None:
    small = np.zeros((8, 8, 3), np.float32), np.ones((8, 8), np.float32)
    said = broken(tmp_path, lambda folder: write_view(folder, "c01", 1003, *small))
    assert "The picture of camera c01 is 8x8" in said
    assert f"{SIZE}x{SIZE}, as the calibration says" in said


def testpictures_of_without_a_matte_are_refused(tmp_path) -> None:
    planes = {c: np.zeros((SIZE, SIZE), np.float32) for c in "RGB"}
    said = broken(tmp_path, lambda folder: write_exr(folder / "capture/c01/plate.1001.exr", planes))
    assert "The pictures of camera c01 have no alpha, and `capture` names no mattes" in said


def test_a_capture_that_does_not_see_the_subject_is_refused(tmp_path) -> None:
    from tests.decompose.evidence.scenes import FRAME

    def away(folder):
        views = calibration()
        moved = {n: {"world_from_camera": _moved(c.poses[FRAME])} for n, c in views.items()}
        write_cameras(folder, views, **moved)

    said = broken(tmp_path, away)
    assert "No camera of the capture sees the subject in frame 1001" in said
    assert "check `axes` and `units` of the cameras" in said


def _moved(pose):
    """The same pose in millimetres that are read as metres."""
    far = pose.copy()
    far[:3, 3] *= -1000
    return far.ravel().tolist()


def test_mattes_may_have_files_of_their_own(tmp_path) -> None:
    capture = {
        "cameras": "cameras.json", "images": "capture/{camera}/plate.####.exr",
        "mattes": "capture/{camera}/matte.####.exr",
    }  # fmt: skip
    path = write_capture_shot(tmp_path, frames=1, capture=capture)
    for i, (_, color, matte, *_) in enumerate(pictures_of(5)[1:]):
        folder = tmp_path / f"capture/c{i:02d}"
        write_exr(folder / "matte.1001.exr", {"Y": matte.astype(np.float32)})
        planes = {c: np.ascontiguousarray(color[..., k] + 0.3 * (1 - matte)) for k, c in enumerate("RGB")}
        write_exr(folder / "plate.1001.exr", planes)
    session = run_here(path, "evidence")
    assert session.book.find(EVIDENCE, 1001).facts["left_out"] == {}


def test_a_camera_that_contradicts_the_others_is_named_at_the_end_of_the_run(tmp_path) -> None:
    from yesnt.runtime.clamps import clamp_lines

    path = write_capture_shot(tmp_path, frames=1)
    _, color, matte, *_ = pictures_of(5)[4]
    write_view(tmp_path, "c03", 1001, 0 * color, matte)
    session = run_here(path, "evidence")
    lines = clamp_lines(session.job.frames, session.graph(), session.open_index())
    assert sum(line.startswith("evidence: pixels measured without a camera that contradicts") for line in lines) == 1
    line = " ".join(lines)
    assert "c03: " in line
    reason = session.book.find(EVIDENCE, 1001).facts["left_out"]["c03"]
    assert reason == "its picture is black where the others see the subject"


def test_an_estimated_capture_light_follows_the_pictures_of_all_cameras(tmp_path) -> None:
    path = write_capture_shot(tmp_path, capture_light="estimate")
    session = run_here(path, "composite")
    estimated = frame_map(session.job, session.job.shot.capture_light, 1001)
    levels = estimated.radiance.mean(axis=-1)
    true = smooth_light().lookup(estimated_directions(levels.shape)).mean(axis=-1)
    assert np.corrcoef(levels.ravel(), true.ravel())[0, 1] > 0.7
    before = keys(path, "relight")
    _, color, matte, *_ = pictures_of(5)[1]
    write_view(tmp_path, "c00", 1002, 0.9 * color, matte)
    assert all(key != before[frame] for frame, key in keys(path, "relight").items()), "one light for all frames"
    cameras = {f"c{i:02d}": view[0] for i, view in enumerate(pictures_of(5)[1:])}
    after = keys(path, "relight")
    write_cameras(tmp_path, cameras, c01={"gain": [1, 1, 1.1]})
    assert all(key != after[frame] for frame, key in keys(path, "relight").items())


def test_with_a_given_capture_light_relighting_does_not_read_the_cameras(tmp_path) -> None:
    path = write_capture_shot(tmp_path)
    node = next(node for node in Session(path).graph() if node.stage.name == "relight")
    assert not [role for role in node.inputs if role.startswith("probe")]
    assert "light_from" not in node.fields["settings"]


def estimated_directions(shape):
    u, v = np.meshgrid((np.arange(shape[1]) + 0.5) / shape[1], (np.arange(shape[0]) + 0.5) / shape[0])
    return uv_to_direction(u, v).astype(np.float32)


def test_base_colour_takes_what_all_cameras_tell_where_every_frame_is_measured(tmp_path) -> None:
    found = {}
    for name, knobs in (("views", {}), ("plate", {"sight_error": 1e6})):
        path = write_capture_shot(tmp_path / name, frames=1, evidence={"knobs": knobs})
        store = FrameStore(run_here(path, "relight").output.store)
        found[name] = {one: store.read(one, 0) for one in ("base_color", "base_views", "material")}
    views, plate = found["views"], found["plate"]
    np.testing.assert_array_equal(views["material"], plate["material"])
    assert plate["base_views"][3].max() < 1e-6, "its weight"
    base, weight = views["base_views"][:3], views["base_views"][3]
    expected = plate["base_color"] + weight * (base - plate["base_color"])
    inside = truth()[1]
    assert np.abs(expected - plate["base_color"])[:, inside].max() > 0.02
    np.testing.assert_allclose(views["base_color"][:, inside], expected[:, inside], atol=1e-5)


@pytest.mark.parametrize(
    ("changes", "shifted"),
    [
        ({}, True),
        ({"evidence": {"every": 2}}, False),
        ({"materials": [{"mask": "plate.####.exr", "channel": "A", "metallic": 1.0}]}, False),
        ({"relight": {"base_color": "plate", "texels": 8}}, False),
        ({"evidence": {"use": False}}, False),
    ],
)
def test_relighting_reads_the_evidence_in_all_frames_or_in_none(tmp_path, changes, shifted) -> None:
    nodes = [node for node in Session(write_capture_shot(tmp_path, **changes)).graph() if node.stage == RELIGHT]
    assert [node.task.base_from_views for node in nodes] == [shifted] * 3
    assert [any(stage == EVIDENCE for stage, _ in node.needs) for node in nodes] == [shifted] * 3


def test_one_camera_over_time_measures_without_a_capture(tmp_path) -> None:
    path = write_capture_shot(tmp_path, capture=None, evidence={"time": True}, frames=3)
    session = run_here(path, "composite")
    graph = session.graph()
    tasks = {node.frames[0]: node.task for node in graph if node.stage == EVIDENCE}
    assert {frame: task.moments for frame, task in tasks.items()} == {
        1001: (1002, 1003), 1002: (1003, 1001), 1003: (1002, 1001),
    }  # fmt: skip
    views = delivered(session, 1002)["views.Y"]
    inside = truth()[1]
    assert views[inside].max() == 3
    facts = session.book.find(EVIDENCE, 1002).facts
    assert facts["views"] > 2
    assert facts["left_out"] == {}


def test_what_is_measured_over_time_follows_every_frame_that_it_reads(tmp_path) -> None:
    path = write_capture_shot(tmp_path, capture=None, evidence={"time": True, "every": 2, "cameras": 1}, frames=5)
    before = keys(path)
    assert {n.frames[0]: n.task for n in Session(path).graph() if n.stage == EVIDENCE}[1002].keyframe == 1003
    (tmp_path / "plate.1004.exr").write_bytes((tmp_path / "plate.1003.exr").read_bytes())
    assert keys(path) == before, "the same bytes"
    color = np.full((SIZE, SIZE), 0.3, np.float32)
    write_exr(tmp_path / "plate.1004.exr", {c: color for c in "RGBA"})
    after = keys(path)
    assert sorted(f for f in before if before[f] != after[f]) == [1002, 1003, 1004, 1005], "1003 reads 1004 beside it"


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"evidence": {"time": True}}, "evidence.time: on measures by the plate's camera alone"),
        ({"evidence": {"time": True, "use": False}, "capture": None}, "evidence.use: false says that nothing does"),
        ({"evidence": {"time": True}, "capture": None, "proxy": None}, "evidence.time: on needs `proxy`"),
    ],
)
def test_time_that_contradicts_the_job_is_refused(tmp_path, changes, expected) -> None:
    with pytest.raises(JobError, match=expected):
        Session(write_capture_shot(tmp_path, **changes))
