"""A video backend in the pipeline: windows are tasks, their frames go through the store, overlaps are blended."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from tests.in_process import run_here
from tests.tiny_shot import write_tiny_shot
from yesnt.core.stage_id import StageId
from yesnt.decompose.registry import open_backend
from yesnt.decompose.window import blend, estimate_clip, make_clip
from yesnt.io.shot_inputs import read_plate
from yesnt.io.store import FrameStore
from yesnt.planning import settings as of
from yesnt.planning.stages import DECOMPOSE
from yesnt.runtime.session import Session
from yesnt.runtime.sweep import sweep_transients

FRAMES, LICENCE = 5, "NVIDIA-NonCommercial"
LANE_0, LANE_1 = (StageId("window", lane=lane) for lane in (0, 1))
KNOBS = {"steps": 1, "patch": 64, "window": 3, "window_overlap": 1, "precision": "float32"}


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory, tiny_diffusion_renderer) -> Path:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return tiny_diffusion_renderer(tmp_path_factory.mktemp("video") / "checkpoint")


def video_shot(folder: Path, checkpoint: Path) -> Path:
    decompose = {"backend": "diffusion-renderer", "weights": str(checkpoint), "samples": 2, "knobs": KNOBS}
    return write_tiny_shot(folder, FRAMES, decompose={**decompose, "accept_license": [LICENCE]})


def test_windows_and_frames_are_linked(tmp_path: Path, checkpoint: Path) -> None:
    session = Session(video_shot(tmp_path / "shot", checkpoint))
    graph = session.graph()
    assert graph.nodes[LANE_0, 0].frames == (1001, 1002, 1003)
    assert graph.nodes[LANE_1, 1].frames == (1003, 1004, 1005)
    assert graph.nodes[DECOMPOSE, 2].needs == ((LANE_0, 0), (LANE_1, 1))
    assert graph.nodes[DECOMPOSE, 4].needs == ((LANE_1, 1),)
    assert session.plan().keyframes == {}


@pytest.mark.filterwarnings("ignore")
def test_overlaps_are_blended_and_a_run_in_pieces_gives_the_same_frames(tmp_path: Path, checkpoint: Path) -> None:
    session = run_here(video_shot(tmp_path / "whole", checkpoint))
    pieces = video_shot(tmp_path / "pieces", checkpoint)
    run_here(pieces, frames="1005", order=1)
    again = run_here(pieces, order=2)
    for name in ("observed", "spread"):
        for position in range(FRAMES):
            one, two = (FrameStore(s.output.store).read(name, position) for s in (session, again))
            np.testing.assert_allclose(one, two, atol=0, rtol=0)
    sweep_transients(session.graph(), session.book, session.output)
    assert not list(session.output.store.glob("window.*")), "windows are swept away once they are blended"
    job, backend = session.job, open_backend("diffusion-renderer", checkpoint, [LICENCE], KNOBS)
    estimates = []
    for window in session.plan().windows:
        frames = [job.frames[p] for p in window.span]
        plates = [read_plate(job, frame) for frame in frames]
        clip = make_clip([p.color for p in plates], [p.matte for p in plates], frames, 3)
        estimates.append(estimate_clip(clip, backend, of.ensemble_settings(job.shot), job.shot.seed))
    one, two = estimates
    mean, std = blend([one.mean[2], two.mean[0]], [one.std[2], two.std[0]], [0.5, 0.5])
    store = FrameStore(session.output.store)
    np.testing.assert_allclose(store.read("observed", 2), mean, atol=0, rtol=0)
    np.testing.assert_allclose(store.read("spread", 2), std, atol=0, rtol=0)
    np.testing.assert_allclose(store.read("observed", 0), one.mean[0], atol=0, rtol=0)
    assert (one.mean[2] != two.mean[0]).any(), "the windows must disagree for the blend to mean anything"
    facts = session.book.find("decompose", 1003).facts
    assert facts["nfe"] == pytest.approx(2 * 2 * 2 / 3)
