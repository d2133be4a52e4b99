import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.in_process import run_here
from yesnt.capture_stage.jobs import render_jobs
from yesnt.capture_stage.reference import fill_outwards, fitted_picture
from yesnt.capture_stage.render import find_receipt, render
from yesnt.capture_stage.shotfiles import shot_folder
from yesnt.capture_stage.tools import Tools, run_anny
from yesnt.cli.staging import drive_stage
from yesnt.core.camera import Camera
from yesnt.core.errors import JobError, MissingPartError, UsageError, YesntError
from yesnt.io.cameras import read_cameras
from yesnt.io.exr import write_exr
from yesnt.io.jobfile import load_shot
from yesnt.io.pictures.image import read_image
from yesnt.runtime.capture_stage_run import CaptureStageContext, render_node
from yesnt.workflows.capture_stage import capture_stage_graph

SETS_WITH_CAPTURE = ("objects", "objects_capture")
PER_JOB = 1 + 1 + 3  # geometry, proxy, three lights


@pytest.fixture
def counter(tmp_path, monkeypatch):
    path = tmp_path / "counter"
    path.write_text("0")
    monkeypatch.setenv("FAKE_BLENDER_COUNTER", str(path))
    return path


@pytest.fixture
def fake(tmp_path, counter):
    program = tmp_path / "blender"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} {Path(__file__).with_name("fake_blender.py")} "$@"\n')
    program.chmod(0o755)
    return Tools(str(program), None, str(tmp_path / "cache"))


@pytest.fixture
def job():
    return render_jobs("objects", small=True)[0]


def _bytes(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file() and "stage" not in p.parts}


def test_a_job_leaves_a_shot_in_the_form_of_the_contract(job, fake, tmp_path):
    receipt = render(job, tmp_path / "out", fake)
    folder = Path(receipt.folder)
    shot = load_shot(folder / "shot.yaml")
    assert shot.name == job.subject
    assert set(Camera.open(folder / "camera.json").poses) == set(job.frames)
    expected = {"plate.1001.exr", "gbuffer.1001.exr", "proxy.1001.ply", "camera.json", "shot.yaml"}
    expected |= {
        "truth/material.1001.exr",
        "truth/flow.1001.exr",
        "truth/relit_sky.1001.exr",
        "truth/relit_studio.1001.exr",
    }
    assert set(receipt.files) == expected | {f"env/{name}.exr" for name in job.lights}
    assert all((folder / name).is_file() for name in receipt.files)
    assert not list(folder.rglob("raw-*"))


def test_a_second_call_renders_nothing(job, fake, tmp_path, counter):
    first = render(job, tmp_path / "out", fake)
    second = render(job, tmp_path / "out", fake)
    assert (first.rendered, second.rendered) == (PER_JOB, 0)
    assert second.files == first.files
    assert counter.read_text() == str(PER_JOB)


def test_a_killed_job_goes_on_where_it_was(job, fake, tmp_path, counter, monkeypatch):
    whole = render(job, tmp_path / "whole", fake)
    counter.write_text("0")
    monkeypatch.setenv("FAKE_BLENDER_LIMIT", "3")
    with pytest.raises(YesntError, match=r"status 7: out of luck"):
        render(job, tmp_path / "out", fake)
    assert find_receipt(job, tmp_path / "out") is None
    monkeypatch.delenv("FAKE_BLENDER_LIMIT")
    resumed = render(job, tmp_path / "out", fake)
    assert resumed.rendered == PER_JOB - 3
    assert _bytes(Path(resumed.folder)) == _bytes(Path(whole.folder))


@pytest.mark.parametrize("damage", ["delete", "cut", "flip"])
def test_damage_is_found_and_made_good(job, fake, tmp_path, damage):
    before = render(job, tmp_path / "out", fake)
    victim = Path(before.folder) / "truth" / "relit_sky.1001.exr"
    data = bytearray(victim.read_bytes())
    if damage == "delete":
        victim.unlink()
    elif damage == "cut":
        victim.write_bytes(data[: len(data) // 2])
    else:
        data[len(data) // 2] ^= 1
        victim.write_bytes(data)
    assert find_receipt(job, tmp_path / "out") is None
    assert render(job, tmp_path / "out", fake).files == before.files


def test_a_damaged_record_is_no_record(job, fake, tmp_path):
    render(job, tmp_path / "out", fake)
    record = next((shot_folder(job, tmp_path / "out") / "stage").glob("*.json"))
    record.write_text(json.dumps({"key": job.key}))
    assert find_receipt(job, tmp_path / "out") is None


def test_the_reference_completes_a_shot_and_needs_it(fake, tmp_path):
    reference, job = (render_jobs(name, small=True)[0] for name in ("reference", "objects"))
    with pytest.raises(JobError, match="render its set first"):
        render(reference, tmp_path / "out", fake)
    shot = render(job, tmp_path / "out", fake)
    receipt = render(reference, tmp_path / "out", fake)
    assert receipt.folder == shot.folder
    assert set(receipt.files) == {"truth/proxy_sky.1001.exr", "truth/proxy_studio.1001.exr"}
    assert find_receipt(job, tmp_path / "out") is not None


def _write_fit(evaluation, subject, side):
    home = evaluation / "shots" / subject / "fitted" / "out" / "gaussians"
    home.mkdir(parents=True)
    plane = np.ones((side, side), np.float32)
    write_exr(home / "view.1001.exr", dict.fromkeys("RGBA", plane))
    (home / "proxy.1001.ply").write_bytes(b"ply\n")
    return home


def test_the_reference_of_a_fit_is_rendered_beside_it_and_again_after_another_fit(fake, tmp_path, counter):
    home = _write_fit(tmp_path, "vase", 64)
    context = CaptureStageContext(str(tmp_path), fake, fits=True)
    (node,) = capture_stage_graph(["reference"], True, tmp_path)
    render_node(context, node)
    folder = tmp_path / "shots" / "vase" / "fitted"
    assert sorted(path.name for path in folder.glob("truth/*")) == ["proxy_sky.1001.exr", "proxy_studio.1001.exr"]
    assert fitted_picture(folder, "sky", 1001) == folder / "truth" / "proxy_sky.1001.exr"
    assert fitted_picture(folder, "city", 1001) is None, "not rendered"
    (home / "proxy.1001.ply").write_bytes(b"ply another\n")
    assert fitted_picture(folder, "sky", 1001) is None, "shows another fit"
    (again,) = capture_stage_graph(["reference"], True, tmp_path)
    assert again.key != node.key
    render_node(context, again)
    assert counter.read_text() == "4"
    assert fitted_picture(folder, "sky", 1001) is not None
    (folder / "truth" / "proxy_sky.1001.exr").unlink()
    with pytest.raises(JobError, match="fitted again meanwhile"):
        render(node.task.job, tmp_path, fake)


def test_fits_of_another_size_or_none_at_all_are_refused(fake, tmp_path):
    with pytest.raises(UsageError, match="no fitted field here"):
        capture_stage_graph(["reference"], True, tmp_path)
    _write_fit(tmp_path, "vase", 32)
    (node,) = capture_stage_graph(["reference"], True, tmp_path)
    with pytest.raises(JobError, match="The plate has 32x32 pixels"):
        render(node.task.job, tmp_path, fake)
    with pytest.raises(UsageError, match="Only reference takes fits"):
        drive_stage(["objects"], tmp_path, tmp_path, True, tmp_path, 1, "local")


def test_a_capture_completes_a_shot_with_a_job_that_is_measured(fake, tmp_path, counter):
    shot, job = (render(render_jobs(name, small=True)[0], tmp_path / "out", fake) for name in SETS_WITH_CAPTURE)
    assert job.folder == shot.folder
    folder, names = Path(job.folder), [f"c{i:02d}" for i in range(16)]
    pictures = {f"capture/{name}/plate.1001.exr" for name in names}
    assert set(job.files) == {*pictures, "cameras.json", "measured.yaml"}
    measured, plain = (load_shot(folder / name) for name in ("measured.yaml", "shot.yaml"))
    assert measured.captured.images == "capture/{camera}/plate.####.exr"
    assert measured.model_dump() | {"capture": None, "output": "out"} == plain.model_dump()
    cameras = read_cameras(folder / "cameras.json")
    assert list(cameras) == names
    assert read_image(folder / "capture" / "c03" / "plate.1001.exr").channels["R"].shape == (64, 64)
    assert render(render_jobs("objects_capture", small=True)[0], tmp_path / "out", fake).rendered == 0


def test_held_out_cameras_have_geometry_and_the_true_surface_is_written(fake, tmp_path, monkeypatch):
    job = replace(render_jobs("multiview_capture")[4], width=64, height=64)  # the vase needs nothing but Blender
    receipt = render(job, tmp_path / "out", fake)
    held_out = {f"heldout/h0{i}/{what}.1001.exr" for i in range(6) for what in ("plate", "gbuffer")}
    pictures = {f"capture/c{i:02d}/plate.1001.exr" for i in range(24)}
    static = {"cameras.json", "heldout.json", "measured.yaml", "truth/mesh.1001.ply"}
    assert set(receipt.files) == held_out | pictures | static
    assert set(read_cameras(Path(receipt.folder) / "heldout.json")) == {f"h0{i}" for i in range(6)}


def test_colours_are_carried_outwards():
    color = np.zeros((3, 5, 3), dtype=np.float32)
    color[:, 1], color[:, 3] = 0.25, 0.75
    solid = np.zeros((3, 5), dtype=bool)
    solid[:, [1, 3]] = True
    filled = fill_outwards(color, solid)
    assert (filled[:, :2] == 0.25).all()
    assert (filled[:, 3:] == 0.75).all()
    assert (fill_outwards(color, np.zeros_like(solid)) == color).all()


def test_without_anny_the_error_says_how_to_get_it(fake, tmp_path):
    with pytest.raises(MissingPartError, match="make blender"):
        run_anny(fake, [], tmp_path)


@pytest.mark.blender
def test_a_rendered_capture_measures_its_shot(tools, tmp_path):
    shot, _ = (render(render_jobs(name, small=True)[0], tmp_path, tools) for name in SETS_WITH_CAPTURE)
    session = run_here(Path(shot.folder) / "measured.yaml", "evidence")
    assert len(session.resolved.capture.views[1001]) == 12
    facts = session.book.find("evidence", 1001).facts
    assert facts["left_out"] == {}
    assert facts["views"] > 3


@pytest.mark.blender
def test_the_small_objects_render_and_render_the_same(tools, tmp_path):
    jobs = render_jobs("objects", small=True)
    first = [render(job, tmp_path / "first", tools) for job in jobs]
    assert [receipt.rendered for receipt in first] == [PER_JOB] * len(jobs)
    assert render(jobs[0], tmp_path / "second", tools).files == first[0].files
    reference = render_jobs("reference", small=True)[0]
    folder = Path(render(reference, tmp_path / "first", tools).folder)
    matte, proxy = (read_image(folder / "truth" / f"{k}_studio.1001.exr").stack("RGBA") for k in ("relit", "proxy"))
    assert np.abs(matte[..., 3] - proxy[..., 3]).mean() < 0.01  # the mesh lies where the shot does
    assert np.corrcoef(matte[..., 0].ravel(), proxy[..., 0].ravel())[0, 1] > 0.8
