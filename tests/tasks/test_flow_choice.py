"""Flow in a job: a learned one with its weights, a precomputed one from EXR."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.in_process import run_here
from tests.temporal.test_flow import spynet_state
from tests.tiny_shot import write_tiny_shot
from yesnt.core.errors import JobError
from yesnt.io.exr import write_exr
from yesnt.io.store import FrameStore
from yesnt.planning.stages import FLOW
from yesnt.runtime.checks.inputs import InputChecks
from yesnt.runtime.session import Session

SIZE = (40, 32)
SPEED = 0.03 * 1.6 * 40 / 2.5
"""Pixels a frame that the sphere's nearest point moves to the right (tiny_shot.py)."""


def flow_of(path: Path) -> tuple[np.ndarray, float]:
    """Stored flow of the first frame and the share of the frame where it is valid."""
    session = run_here(path, until="flow")
    store = FrameStore(session.output.store)
    return store.read("flow", 0), float(store.read("validity", 0)[0].mean())


def precomputed(folder: Path, sign: float) -> Path:
    path = write_tiny_shot(folder, 3, SIZE, flow={"path": "flow.####.exr"})
    for frame in (1001, 1002):
        u = np.full(SIZE[::-1], sign * SPEED, np.float32)
        write_exr(path.parent / f"flow.{frame}.exr", {"forward.u": u, "forward.v": np.zeros_like(u)})
    return path


def test_a_precomputed_flow_points_to_the_next_frame_x_right(tmp_path: Path) -> None:
    flow, valid = flow_of(precomputed(tmp_path / "right", 1.0))
    np.testing.assert_allclose(flow[0], SPEED, rtol=1e-6)
    assert not flow[1].any()
    assert valid > 1.2 * flow_of(precomputed(tmp_path / "turned", -1.0))[1]


def test_a_learned_flow_takes_its_weights_from_the_job(tmp_path: Path) -> None:
    path = write_tiny_shot(tmp_path / "shot", 3, SIZE, flow={"weights": "spynet.pth", "knobs": {"method": "spynet"}})
    torch.save(spynet_state(0.01), path.parent / "spynet.pth")
    flow, _ = flow_of(path)
    assert flow[0].mean() == pytest.approx(0.01 * (2**6 - 1) * SIZE[0] / 64, rel=1e-3)
    session = Session(path)
    torch.save(spynet_state(0.02), path.parent / "spynet.pth")
    before, after = (next(n for n in s.graph() if n.stage == FLOW).key for s in (session, Session(path)))
    assert before != after, "other weights are another flow"


@pytest.mark.parametrize("flow", [{"weights": "w.pth"}, {"knobs": {"method": "spynet"}}])
def test_weights_and_a_learned_method_belong_together(tmp_path: Path, flow: dict) -> None:
    path = write_tiny_shot(tmp_path, 3, SIZE, flow=flow)
    (path.parent / "w.pth").write_bytes(b"")
    with pytest.raises(JobError, match="belong together"):
        InputChecks(Session(path).resolved).form()
