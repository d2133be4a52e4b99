"""`yesnt gof` from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.runtime.test_gaussian_job import write_field_shot
from yesnt.cli.app import app
from yesnt.cli.gof import GofAction, path_of
from yesnt.cli.results import result_lines
from yesnt.core.camera import Camera
from yesnt.core.errors import JobError, UsageError
from yesnt.inspect.field_views import render_views
from yesnt.io.exr import read_planes
from yesnt.io.output import OutputFolder
from yesnt.runtime.session import Session


def test_an_orbit_is_written_with_its_camera(tmp_path: Path) -> None:
    job = write_field_shot(tmp_path / "shot", 1)
    out = tmp_path / "orbit"
    found = CliRunner().invoke(
        app, ["gof", "render", str(job), "--path", "orbit", "--views", "3", "--out", str(out), "--json"]
    )
    assert found.exit_code == 0, found.output
    assert json.loads(found.stdout)["files"] == [str(out / f"view.{n:04d}.exr") for n in (1, 2, 3)]
    camera = Camera.open(out / "camera.json")
    views = [read_planes(out / f"view.{n:04d}.exr") for n in camera.poses]
    assert all(view["A"][10, 12] > 0.9 for view in views)
    assert np.allclose([view["depth.Z"][10, 12] for view in views], 2.5, atol=0.03)
    facing = [view["N.Y"][10, 12] for view in views]
    assert facing[0] < -0.95
    assert facing[1] > 0.3


def test_options_that_do_not_go_together_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="A camera path needs a folder, and is only rendered"):
        path_of(GofAction.mesh, "orbit", 3, tmp_path)
    with pytest.raises(UsageError, match="needs a folder"):
        path_of(GofAction.render, "orbit", 3, None)
    with pytest.raises(UsageError, match="The path 'c00' has one camera"):
        path_of(GofAction.render, "c00", 3, tmp_path)
    assert path_of(GofAction.render, None, 24, None) is None


def test_unknown_cameras_and_jobs_without_fields_are_refused(tmp_path: Path) -> None:
    from tests.tiny_shot import write_tiny_shot

    session = Session(write_field_shot(tmp_path / "a", 1))
    with pytest.raises(UsageError, match=r"The capture has no camera 'c07'.*\(none\)"):
        render_views(session, 1001, ("c07", "c08"), 3, tmp_path / "out")
    with pytest.raises(JobError, match="The job has no Gaussian fields"):
        render_views(Session(write_tiny_shot(tmp_path / "b", 1)), 1001, (), 3, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_only_results_that_there_are_are_named(tmp_path: Path) -> None:
    output = OutputFolder(tmp_path / "out")
    assert result_lines(output) == []
    fields = output.root / "gaussians"
    fields.mkdir(parents=True)
    (fields / "field.1001.ply").touch()
    assert result_lines(output) == [f"Gaussians:    {fields} (field)"], "yesnt gof fit leaves no EXR sequence"
    output.exr.mkdir()
    output.run.mkdir()
    (output.run / "preview.mp4").touch()
    assert [line.split(":")[0] for line in result_lines(output)] == ["Gaussians", "EXR sequence", "Preview"]
