"""A job whose plate, G-buffer and proxy come from Gaussian fields: made first, then read like files of the user."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.gaussians.scenes import shell
from tests.tiny_shot import write_tiny_shot
from yesnt.core.errors import JobError
from yesnt.gaussians.field import GaussianField
from yesnt.inspect.forecast import AWAITING, forecast
from yesnt.inspect.frame_states import DONE, states
from yesnt.io.exr import read_planes
from yesnt.io.gaussian_ply import write_field
from yesnt.io.mesh import read_mesh
from yesnt.runtime.control.share import run_shared
from yesnt.runtime.run_options import RunOptions
from yesnt.runtime.session import Session

RADIUS = 0.5


def write_field_shot(folder: Path, frames: int = 2, **changes: Any) -> Path:
    """The tiny shot without plates, G-buffers and proxies: a sphere of Gaussians that moves to the right instead."""
    bare = {"plate": None, "gbuffer": None, "proxy": None, "gaussians": {"path": "field.####.ply"}}
    job = write_tiny_shot(folder, frames, (24, 20), **bare | changes)
    for path in [*folder.glob("plate.*"), *folder.glob("gbuffer.*"), *folder.glob("proxy.*")]:
        path.unlink()
    for i in range(frames):
        write_field(folder / f"field.{1001 + i}.ply", moved(shell(300, RADIUS), 0.03 * i))
    return job


def moved(field: GaussianField, shift: float) -> GaussianField:
    harmonics = np.full_like(field.harmonics, 0.4)
    return GaussianField(
        field.positions + np.float32([shift, 0, 0]), field.log_scales, field.rotations, field.opacity_logits, harmonics
    )


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    job = write_field_shot(tmp_path_factory.mktemp("fields"))
    result = run_shared(Session(job), RunOptions())
    assert not result.missing
    return job


def test_the_whole_run_follows_from_the_fields(ran: Path) -> None:
    session = Session(ran)
    assert not session.resolved.awaiting
    assert {one.state for one in states(session)} == {DONE}
    delivered = read_planes(session.output.exr_path("tiny", 1001))
    assert delivered["relit.A"].max() > 0.9
    assert np.isfinite(delivered["relit.R"]).all()


def test_the_view_is_plate_and_g_buffer(ran: Path) -> None:
    session = Session(ran)
    view = read_planes(session.output.root / "gaussians" / "view.1001.exr")
    centre = (10, 12)
    assert view["A"][centre] > 0.9
    assert view["depth.Z"][centre] == pytest.approx(3.0 - RADIUS, abs=0.02)
    assert view["depth.Z"][0, 0] == 0
    assert view["N.Y"][centre] < -0.98  # towards the camera at -Y
    linear = ((0.5 + 0.4 * 0.28209479177387814 + 0.055) / 1.055) ** 2.4
    assert view["R"][centre] / view["A"][centre] == pytest.approx(linear, rel=1e-3)


def test_the_proxy_is_the_surface_in_both_formats(ran: Path) -> None:
    import trimesh

    folder = Session(ran).output.root / "gaussians"
    mesh = read_mesh(folder / "proxy.1002.ply")
    assert mesh.vertices.mean(axis=0) == pytest.approx([0.03, 0, 0], abs=0.01)
    glb = trimesh.load(folder / "proxy.1002.glb", force="mesh", process=False)
    assert np.allclose(np.asarray(glb.vertices)[:, [0, 2, 1]] * [1, -1, 1], mesh.vertices)


def test_a_finished_job_makes_nothing_again_and_a_changed_field_makes_all_again(tmp_path: Path) -> None:
    job = write_field_shot(tmp_path, 1)
    assert Session(job).resolved.awaiting
    first = run_shared(Session(job), RunOptions())
    assert {stage.name for stage, _ in first.outcome.done} >= {"mesh", "view", "relight", "composite"}
    again = run_shared(Session(job), RunOptions())
    assert not again.outcome.done
    before = (tmp_path / "out/gaussians/view.1001.exr").read_bytes()
    write_field(tmp_path / "field.1001.ply", moved(shell(300, RADIUS), 0.1))
    assert Session(job).resolved.awaiting
    changed = run_shared(Session(job), RunOptions())
    assert {stage.name for stage, _ in changed.outcome.done} >= {"mesh", "view", "relight", "composite"}
    assert (tmp_path / "out/gaussians/view.1001.exr").read_bytes() != before


def test_the_plan_of_a_job_without_views_says_what_comes_later(tmp_path: Path) -> None:
    found = forecast(Session(write_field_shot(tmp_path, 2)))
    assert [(row.stage, row.todo) for row in found.stages] == [("mesh", 2), ("view", 2)]
    assert AWAITING in found.notes


def test_until_a_stage_stops_there(tmp_path: Path) -> None:
    session = Session(write_field_shot(tmp_path, 2))
    result = run_shared(session, RunOptions(frames="1002", until="mesh"))
    assert {(stage.name, index) for stage, index in result.outcome.done} == {("mesh", 1)}
    assert not (tmp_path / "out/gaussians/view.1002.exr").exists()


def test_a_plate_of_the_user_stays(tmp_path: Path) -> None:
    job = write_tiny_shot(tmp_path, 1, (24, 20), gbuffer=None, proxy=None, gaussians={"path": "field.####.ply"})
    write_field(tmp_path / "field.1001.ply", moved(shell(300, RADIUS), 0))
    shot = Session(job).job.shot
    assert (shot.plate.path, shot.gbuffer.path) == ("plate.####.exr", "out/gaussians/view.####.exr")


def test_jobs_that_contradict_themselves_are_refused(tmp_path: Path) -> None:
    job = write_tiny_shot(tmp_path / "a", 1, (24, 20), gaussians={"path": "field.####.ply"})
    with pytest.raises(JobError, match="`gaussians` is not used: `plate`, `gbuffer` and `proxy` are all given"):
        Session(job)
    job = write_field_shot(tmp_path / "b", 1, gaussians={"path": "field.####.ply", "knobs": {"trinagles": 5}})
    with pytest.raises(JobError, match=r"Unknown knob 'trinagles'.*gaussians\.knobs"):
        Session(job)


@pytest.mark.parametrize("section", [{"device": "cuda"}, {"knobs": {"device": "cuda"}}])
def test_a_gpu_for_fields_is_refused_by_name(tmp_path: Path, section: dict[str, Any]) -> None:
    with pytest.raises(JobError, match="`device` is not known: fields are fitted, rendered and meshed on the CPU"):
        Session(write_field_shot(tmp_path, 1, gaussians={"path": "field.####.ply"} | section))
    assert not (tmp_path / "out").exists()


def test_a_field_that_the_camera_does_not_see_is_refused_before_work(tmp_path: Path) -> None:
    job = write_field_shot(tmp_path, 1)
    write_field(tmp_path / "field.1001.ply", moved(shell(50, RADIUS), 40.0))
    with pytest.raises(JobError, match="The camera sees 0 % of the Gaussians in frame 1001"):
        run_shared(Session(job), RunOptions())
    assert not (tmp_path / "out/gaussians").exists()
