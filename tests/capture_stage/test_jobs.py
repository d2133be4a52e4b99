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
from yesnt.capture_stage.tools import BLENDER_VARIABLE, find_tools
from yesnt.core.errors import MissingPartError, UsageError


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


def test_rings_hold_24_cameras_that_see_the_subject_from_all_sides():
    jobs = [job for job in render_jobs("multiview") if job.subject == "boxer"]
    positions = np.array([job.pose(frame)[:3, 3] for job in jobs for frame in job.frames])
    assert len(positions) == 24
    azimuths = np.sort(np.degrees(np.arctan2(positions[:, 1], positions[:, 0])) % 360)
    assert np.allclose(np.diff(azimuths), 15)
    held_out = [job.pose(frame)[:3, 3] for job in render_jobs("heldout") for frame in job.frames]
    assert min(np.linalg.norm(p - q) for p in positions for q in held_out) > 0.2


def test_the_embedded_shot_is_in_no_set_that_is_evaluated():
    embedded = set(SETS["embedded"].subjects)
    assert all(embedded.isdisjoint(s.subjects) for name, s in SETS.items() if name != "embedded")


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
