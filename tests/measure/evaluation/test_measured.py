"""Rows whose materials a capture measures, and the errors that are put into its inputs."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
import yaml

from tests.measure.evaluation.conftest import FRAMES, SIDE, maps, rgb, write_shot
from yesnt.capture_stage.rigs import pose_on_sphere
from yesnt.core.camera import Camera
from yesnt.core.capture_input import EvidenceInput
from yesnt.core.errors import UsageError
from yesnt.io.exr import write_exr
from yesnt.io.jobfile import load_shot
from yesnt.io.pictures.image import read_image
from yesnt.io.shot_inputs import read_matte
from yesnt.io.store import FrameStore
from yesnt.measure.evaluation.evidence_rows import EVIDENCE_ROWS, MEASURED, InputErrors
from yesnt.measure.evaluation.run import EvalOptions, open_plan, run_evaluation
from yesnt.measure.evaluation.spoilt_inputs import smooth_factor, spoilt, turned_normals
from yesnt.measure.evaluation.subjects import find_subjects
from yesnt.measure.evaluation.table import tables
from yesnt.metrics.score import Truth, score_briefly
from yesnt.planning.stages import RELIGHT
from yesnt.relight import EnvMap, GBuffer, RelightSettings, shade
from yesnt.runtime.session import Session
from yesnt.tasks.run import run_node

OPTIONS = EvalOptions(workers=0, probes=1, thorough=1, maps=("noon",))
WAYS = ((-40, 12), (35, 40), (20, -30), (-25, -20))
"""Azimuth and elevation of the cameras, degrees."""


def write_capture(folder, ways=WAYS):
    """Adds a proxy and cameras to the shot of conftest.py, whose ball is metal above and paint below."""
    ball = trimesh.creation.icosphere(4)
    for frame in FRAMES:
        ball.export(folder / f"proxy.{frame}.ply")
    lens = {"width": SIDE, "height": SIDE, "fx": 48.0, "fy": 48.0, "cx": SIDE / 2, "cy": SIDE / 2}
    cameras = {}
    for number, (azimuth, elevation) in enumerate(ways):
        name, pose = f"c{number}", pose_on_sphere(azimuth, elevation, 3.0, 0.0)
        cameras[name] = lens | {"world_from_camera": pose.ravel().tolist()}
        color, matte = picture(lens, pose)
        for frame in FRAMES:
            target = folder / "capture" / name / f"plate.{frame}.exr"
            target.parent.mkdir(parents=True, exist_ok=True)
            write_exr(target, {**rgb(color * matte[..., None]), "A": matte})
    (folder / "cameras.json").write_text(json.dumps({"cameras": cameras}))
    document = yaml.safe_load((folder / "shot.yaml").read_text())
    document |= {"proxy": {"path": "proxy.####.ply"}}
    (folder / "shot.yaml").write_text(yaml.safe_dump(document))
    images = "capture/{camera}/plate.####.exr"
    document |= {"capture": {"cameras": "cameras.json", "images": images}, "output": "out-measured"}
    (folder / "measured.yaml").write_text(yaml.safe_dump(document))
    return folder


def picture(lens, pose):
    """What a camera sees of the ball under the capture light: colour [H, W, 3] and coverage [H, W]."""
    camera = Camera.from_dict({**lens, "frames": {"1": {"world_from_camera": pose.ravel().tolist()}}})
    rays, eye = camera.rays(1).astype(float), camera.position(1)
    a, b, c = (rays**2).sum(-1), 2 * rays @ eye, eye @ eye - 1
    root = b**2 - 4 * a * c
    hit = root > 0
    z = np.where(hit, (-b - np.sqrt(np.maximum(root, 0))) / (2 * a), 0)
    normal = ((eye + z[..., None] * rays) * hit[..., None]).astype(np.float32)
    upper = (normal[..., 2] > 0).astype(np.float32)
    base = np.clip(0.35 + 0.3 * np.sin(9 * normal), 0.05, 0.9).astype(np.float32)
    planes, matte = (0.25 + 0.5 * upper, 0.9 * upper), hit.astype(np.float32)
    gbuffer = GBuffer(base, *planes, normal, z.astype(np.float32), matte)
    light = EnvMap.from_array(maps()["capture"])
    settings = RelightSettings(texels=128, capture_texels=64, clusters=16, capture_clusters=16, bounce=0)
    return shade(gbuffer, light, camera, settings, shadows=False, frame=1).radiance, matte


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """The shot with a capture, evaluated once."""
    home = tmp_path_factory.mktemp("measured")
    folder = write_capture(write_shot(home / "set" / "ball"))
    return folder, home / "out", run_evaluation(folder.parent, home / "out", OPTIONS)


def test_there_is_a_row_for_every_number_of_cameras_that_the_capture_has(measured):
    document = measured[2].document
    assert [row["name"] for row in document["rows"] if row["group"] == "evidence"] == [
        "cameras_1", "cameras_2", "cameras_4",
    ]  # fmt: skip
    assert set(document["cells"]["cameras_4"]) == {"ball / noon"}
    assert set(document["measured"]["mean"]["cameras_4"]["metallic"]) >= {"rmse", "auc"}


def test_the_row_is_measured_by_so_many_cameras(measured):
    session = Session(measured[1] / "shots" / "ball" / "cameras_2")
    assert session.job.shot.evidence == EvidenceInput(use=True, cameras=2)
    assert len(session.resolved.capture.views[FRAMES[0]]) == 2
    facts = session.book.find("evidence", FRAMES[0]).facts
    assert 1 < facts["views"] <= 3  # the plate is one


def test_full_is_what_the_plate_alone_gives(measured):
    folder, output, _ = measured
    assert load_shot(output / "shots" / "ball" / "shot.yaml").capture is None
    assert load_shot(folder / "measured.yaml").capture is not None


def test_the_table_puts_the_rows_between_full_and_true_materials(measured):
    table = next(t for t in tables(measured[2].document) if t.title.startswith("Materials measured"))
    assert [line[0] for line in table.lines] == [
        "Full", "No Decomposition, constant per shot", "Full with 1 camera", "Full with 2 cameras",
        "Full with 4 cameras", "Full with true materials",
    ]  # fmt: skip


def test_the_video_of_the_row_of_most_cameras_is_measured(measured):
    document = measured[2].document
    video = document["video"]["videos"]["ball / noon"]
    assert set(video) == {"unregularised", "full", "truth", "cameras_4"}
    of_frame = document["cells"]["cameras_4"]["ball / noon"]["psnr"]
    assert video["cameras_4"]["psnr_frames"] == pytest.approx(of_frame, abs=1.5)
    table = next(t for t in tables(document) if t.title == "Videos")
    assert [line[0] for line in table.lines][-2:] == ["Full with 4 cameras", "the truth itself"]


def test_the_page_shows_what_the_cameras_make_of_it_before_full(measured):
    worst = measured[2].document["worst"]
    assert [(one["cell"], one["row"]) for one in worst] == [("ball / noon", "cameras_4"), ("ball / noon", "full")]
    assert all((measured[1] / one["picture"]).is_file() for one in worst)
    assert "(Full with 4 cameras)" in measured[2].page.read_text()


def test_a_row_is_what_the_product_delivers(measured):
    """With the base colour that the cameras tell, as `yesnt run` takes it."""
    session = Session(measured[1] / "shots" / "ball" / "cameras_4")
    plan, graph, job, number = session.plan(), session.graph(), session.job, FRAMES[0]
    assert plan.base_from_views
    FrameStore.create(session.output.store, plan.arrays(), job.frames, job.height, job.width)
    run_node(job, next(node for node in graph if node.stage == RELIGHT and node.frames == (number,)))
    store, made = FrameStore(session.output.store), session.book.find("relight", number).arrays
    lit = sum(store.read(name, 0, made[name]) for name in ("diffuse", "specular")).transpose(1, 2, 0)
    truth = Truth.of(*find_subjects(measured[0])[0].read_relit("noon", number), read_matte(job, number))
    found = {metric.name: metric.value for metric in score_briefly(lit, truth)}
    assert measured[2].document["cells"]["cameras_4"]["ball / noon"] == pytest.approx(found)


def test_rows_can_be_chosen(measured):
    folder, output, _ = measured
    subject = find_subjects(folder)[0]
    chosen = open_plan(subject, output / "chosen", replace(OPTIONS, capture_rows=("cameras_2",))).measured
    assert list(chosen) == ["cameras_2"]
    assert not open_plan(subject, output / "none", replace(OPTIONS, capture_rows=())).measured
    with pytest.raises(UsageError, match=r"No shot with a capture has the row 'cameras_3'.* cameras_1, cameras_2, "):
        open_plan(subject, output / "wrong", replace(OPTIONS, capture_rows=("cameras_3",)))


def test_frames_can_be_chosen(measured):
    folder, output, _ = measured
    subject = find_subjects(folder)[0]
    plan = open_plan(subject, output / "at", replace(OPTIONS, capture_rows=(), chosen="1002"))
    assert plan.scored_frames("noon") == (1002,)
    assert plan.page_frame("noon") == 1002
    with pytest.raises(UsageError, match=r"no truth under \w+ at these frames.*1001-1002"):
        open_plan(subject, output / "wrong", replace(OPTIONS, capture_rows=(), chosen="1003-1009"))


def test_a_second_evaluation_measures_nothing_again(measured):
    folder, output, result = measured
    events = []
    again = run_evaluation(folder.parent, output, OPTIONS, events.append)
    assert not [event for event in events if event.get("event") == "start"]
    assert again.document["cells"] == result.document["cells"]


def test_more_cameras_than_there_are_make_no_row(measured):
    folder, output, _ = measured
    found = open_plan(find_subjects(folder)[0], output / "again", OPTIONS).measured
    assert list(found) == ["cameras_1", "cameras_2", "cameras_4"] == [n for n, m in MEASURED.items() if m.cameras <= 4]


def test_every_measured_row_is_defined():
    assert set(MEASURED) == set(EVIDENCE_ROWS)


@pytest.mark.parametrize("degrees", [5, 10])
def test_normals_are_off_by_the_angle_that_is_asked_for(degrees):
    y, x = np.mgrid[-1:1:64j, -1:1:64j]
    inside = x**2 + y**2 < 0.9
    normal = np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], axis=-1) * inside[..., None]
    normal[inside] /= np.linalg.norm(normal[inside], axis=1, keepdims=True)
    turned = turned_normals(normal, degrees)
    assert np.allclose(np.linalg.norm(turned[inside], axis=1), 1)
    assert not turned[~inside].any()
    angle = np.degrees(np.arccos(np.clip((normal * turned).sum(axis=-1)[inside], -1, 1)))
    assert np.sqrt((angle**2).mean()) == pytest.approx(degrees, rel=0.05)
    beside = np.degrees(np.arccos(np.clip((turned[:, 1:] * turned[:, :-1]).sum(-1), -1, 1)))
    assert np.median(beside[inside[:, 1:] & inside[:, :-1]]) < 4  # smooth: neighbours are off alike


def test_a_map_is_off_by_the_share_that_is_asked_for():
    factor = smooth_factor((64, 128), 0.1)
    assert factor.std() == pytest.approx(0.1, rel=0.02)
    assert factor.mean() == pytest.approx(1, abs=1e-6)
    assert np.abs(np.diff(factor, axis=1)).mean() < 0.03  # of neighbouring texels: it is smooth
    assert np.abs(factor[:, 0] - factor[:, -1]).mean() < 0.03  # and closed around the horizon


def test_errors_enter_the_files_that_they_are_said_to(measured, tmp_path):
    folder = measured[0]
    shot = load_shot(folder / "measured.yaml")
    paths = {"gbuffer": str(folder / shot.gbuffer.path), "capture_light": str(folder / shot.capture_light.path)}
    changes = {name: getattr(shot, name).model_copy(update={"path": path}) for name, path in paths.items()}
    captured = shot.capture.model_copy(update={"cameras": str(folder / "cameras.json")})
    shot = shot.model_copy(update=changes | {"capture": captured})
    assert spoilt(shot, InputErrors(), FRAMES, tmp_path) == {}
    made = spoilt(shot, InputErrors(0, 0.01, 0.1, 0.05), FRAMES[:1], tmp_path)
    assert set(made) == {"gbuffer", "capture_light", "capture"}
    z, other = (read_image(f / "gbuffer.1001.exr").channels["depth.Z"] for f in (folder, tmp_path))
    assert np.allclose(other, 1.01 * z)
    gains = [camera["gain"] for camera in json.loads((tmp_path / "cameras.json").read_text())["cameras"].values()]
    assert 0.02 < np.std(np.log(gains)) < 0.09
    assert spoilt(shot, InputErrors(gain=0.05), FRAMES[:1], tmp_path).keys() == {"capture"}
