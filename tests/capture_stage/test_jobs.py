import dataclasses
import json
import subprocess
import sys

import numpy as np
import pytest

from yesnt.capture_stage.assets import MANIFEST
from yesnt.capture_stage.cameras import look_at
from yesnt.capture_stage.jobs import CAPTURE, SETS, RenderJob, render_jobs
from yesnt.capture_stage.subjects import SUBJECTS, Human, Model, Shape
from yesnt.capture_stage.tools import BLENDER_VARIABLE, find_tools, stage_tools
from yesnt.core.errors import MissingPartError, UsageError
from yesnt.decompose.settings import keyframe_after


def test_objects_are_ten_by_eleven():
    jobs = render_jobs("objects")
    assert len({job.subject for job in jobs}) == 10
    assert all(len([light for light in job.lights if light != CAPTURE]) == 11 for job in jobs)
    kinds = [SUBJECTS[job.subject] for job in jobs]
    assert sum(isinstance(k, Human) for k in kinds) == 2
    assert sum(isinstance(k, Model) and "fox" not in k.asset for k in kinds) == 4
    assert sum(isinstance(k, Shape) for k in kinds) == 3


def test_sequences_are_three_by_twenty_four_by_three():
    jobs = render_jobs("sequences")
    frames = {(job.subject, frame) for job in jobs for frame in job.frames}
    assert len(frames) == sum(len(job.frames) for job in jobs) == 3 * 24
    assert all(len(job.lights) == 1 + 3 for job in jobs)


def test_a_capture_surrounds_the_subject_and_what_is_held_out_stands_between():
    job = next(job for job in render_jobs("multiview_capture") if job.subject == "boxer")
    rig = SETS["multiview_capture"].rig
    assert (len(rig.cameras), len(rig.held_out_cameras)) == (24, 6)
    assert [elevation for _, elevation in rig.cameras.values()] == [10] * 12 + [45] * 6 + [-25] * 6
    places = np.array([job.camera_pose(name)[:3, 3] for name in rig.cameras])
    azimuths = np.sort(np.degrees(np.arctan2(places[:12, 1], places[:12, 0])) % 360)
    assert np.allclose(np.diff(azimuths), 30)
    held_out = [job.camera_pose(name)[:3, 3] for name in rig.held_out_cameras]
    assert min(np.linalg.norm(p - q) for p in places for q in held_out) > 0.2


@pytest.mark.parametrize(("name", "count"), [("objects", 16), ("smooth", 16), ("sequences", 12), ("embedded", 8)])
def test_captures_have_cameras_at_three_elevations_and_look_at_the_subject(name, count):
    jobs, rig = render_jobs(f"{name}_capture"), SETS[f"{name}_capture"].rig
    assert {len(job.cameras) for job in jobs} == {len(rig.cameras)} == {count}
    assert len({elevation for _, elevation in rig.cameras.values()}) == 3
    assert {job.subject for job in jobs} == set(SETS[name].subjects)
    pose, middle = jobs[0].camera_pose("c00"), np.array([0, 0, SUBJECTS[jobs[0].subject].middle])
    assert np.allclose(np.cross(pose[:3, 2], middle - pose[:3, 3]), 0)


@pytest.mark.parametrize("name", ["embedded", "sequences"])
def test_a_capture_has_every_frame_that_its_job_file_measures(name):
    stage_set, rig = SETS[name], SETS[f"{name}_capture"].rig
    first, last = stage_set.frames
    length = last - first + 1
    assert {first + keyframe_after(i, length, rig.every) for i in range(length)} <= set(rig.frames)


def test_a_subject_that_stands_still_is_rendered_once():
    frames = {job.subject: 0 for job in render_jobs("multiview_capture")}
    for job in render_jobs("multiview_capture"):
        frames[job.subject] += len(job.frames)
    assert frames == {"boxer": 4, "vase": 1, "fox": 4}


def test_keys_of_rendered_sets_stay():
    """A set is an hour of rendering: its keys change on purpose only."""
    known = {"objects": "2489308d7e53f380", "sequences": "cd65098a93edb60c", "embedded": "3bbc6e59080319a2"}
    assert {name: render_jobs(name)[0].key[:16] for name in known} == known


def test_the_embedded_shot_is_in_no_set_that_is_evaluated():
    embedded = set(SETS["embedded"].subjects)
    assert all(embedded.isdisjoint(s.subjects) for name, s in SETS.items() if not name.startswith("embedded"))


def test_small_objects_need_nothing_fetched():
    jobs = render_jobs("objects", small=True)
    assert len(jobs) == 2
    assert all(job.lights == (CAPTURE, "sky", "studio") and job.width == job.height == 64 for job in jobs)
    assert all(isinstance(SUBJECTS[job.subject], Shape) for job in jobs)


@pytest.mark.parametrize("name", sorted(SETS))
def test_jobs_survive_json_and_have_keys_of_their_own(name):
    jobs = (*render_jobs(name), *render_jobs(name, small=True))
    back = [RenderJob.from_json(json.loads(json.dumps(job.to_json()))) for job in jobs]
    assert back == list(jobs)
    assert [job.key for job in back] == [job.key for job in jobs]
    assert len({job.key for job in jobs}) == len(jobs)


def test_a_key_changes_with_what_decides_the_pixels():
    job = render_jobs("objects")[0]
    changed = [dataclasses.replace(job, samples=job.samples + 1), dataclasses.replace(job, lights=(CAPTURE,))]
    assert len({job.key, *(other.key for other in changed)}) == 3


def test_keys_are_the_same_in_another_process():
    code = "from yesnt.capture_stage.jobs import render_jobs; print(render_jobs('sequences')[3].key)"
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert other.stdout.strip() == render_jobs("sequences")[3].key


def test_unknown_sets_are_refused():
    with pytest.raises(UsageError, match="objects"):
        render_jobs("nothing")


def test_every_model_is_in_the_manifest_with_licence_and_digest():
    assert {s.asset for s in SUBJECTS.values() if isinstance(s, Model)} <= set(MANIFEST)
    for asset in MANIFEST.values():
        assert len(asset.sha256) == 64
        assert asset.licence
        assert asset.author
        assert asset.version


def test_cameras_are_right_handed_and_upright():
    pose = look_at([1.0, -3.0, 1.5], [0.0, 0.0, 0.9])
    right, down, forward = pose[:3, :3].T
    assert np.allclose(np.cross(right, down), forward)
    assert right[2] == pytest.approx(0)
    assert down[2] < 0
    assert np.allclose(np.cross(forward, np.array([0.0, 0.0, 0.9]) - pose[:3, 3]), 0)
    with pytest.raises(ValueError, match="vertical"):
        look_at([0, 0, 3], [0, 0, 0])


def test_without_blender_the_error_says_how_to_get_it(monkeypatch, tmp_path):
    monkeypatch.delenv(BLENDER_VARIABLE, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(MissingPartError, match="make blender"):
        find_tools(tmp_path)


@pytest.mark.parametrize(("version", "good"), [("3.4.1", False), ("4.1.9", False), ("4.2.0", True), ("10.0.1", True)])
def test_an_old_blender_is_refused_before_the_stage_is_rendered(monkeypatch, tmp_path, version, good):
    program = tmp_path / "blender"
    program.write_text(f'#!/bin/sh\necho "Blender {version}"\n')
    program.chmod(0o755)
    monkeypatch.setenv(BLENDER_VARIABLE, str(program))
    assert find_tools(tmp_path).blender == str(program), "scenes of users are rendered by older ones too"
    if good:
        assert stage_tools(tmp_path).blender == str(program)
        return
    with pytest.raises(MissingPartError, match=f"too old for the virtual stage: Blender {version[:3]}.*4.2 or newer"):
        stage_tools(tmp_path)
