"""Rows whose plate, G-buffer and proxy come from a field that is fitted to the capture's pictures alone."""

from dataclasses import replace

import pytest

from tests.measure.evaluation.conftest import write_shot
from tests.measure.evaluation.test_measured import OPTIONS, write_capture
from yesnt.measure.evaluation import measured_jobs
from yesnt.measure.evaluation.evidence_rows import MEASURED
from yesnt.measure.evaluation.run import open_plan, run_evaluation
from yesnt.measure.evaluation.subjects import find_subjects
from yesnt.measure.evaluation.summary import summarise
from yesnt.measure.evaluation.table import tables
from yesnt.runtime.session import Session

KNOBS = {"steps": 120, "check": 60, "count": 300, "most": 400, "triangles": 800}
WAYS = tuple((40 * i, (10, 50, -30)[i % 3]) for i in range(9))
"""Azimuth and elevation of cameras all around, degrees."""


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """The shot with a capture, fitted and evaluated once."""
    home = tmp_path_factory.mktemp("fitted")
    folder = write_capture(write_shot(home / "set" / "ball"), WAYS)
    with pytest.MonkeyPatch.context() as patch:  # the other rows have tests of their own
        patch.setattr(measured_jobs, "MEASURED", {"cameras_8": MEASURED["cameras_8"]})
        return home / "out", run_evaluation(folder.parent, home / "out", replace(OPTIONS, fit_knobs=KNOBS))


def test_nothing_of_the_given_geometry_enters(fitted):
    shot = Session(fitted[0] / "shots" / "ball" / "fitted").job.shot
    assert shot.plate.path == shot.gbuffer.path == "out/gaussians/view.####.exr"
    assert shot.proxy.path == "out/gaussians/proxy.####.ply"


def test_rows_from_cameras_alone_stand_beside_what_geometry_costs(fitted):
    document = fitted[1].document
    rows = [row["name"] for row in document["rows"] if row["group"] == "fitted"]
    assert rows == ["fitted_true", "fitted_model", "fitted_cameras"]
    psnr = {name: document["cells"][name]["ball / noon"]["psnr"] for name in (*rows, "full_true")}
    assert 12 < psnr["fitted_true"] < psnr["full_true"]
    table = next(t for t in tables(document) if t.title.startswith("From the cameras"))
    assert float(table.lines[0][-1]) == pytest.approx(psnr["full_true"] - psnr["fitted_true"], abs=0.01)
    given = document["cells"]["cameras_8"]["ball / noon"]["psnr"]
    assert float(table.lines[2][-1]) == pytest.approx(given - psnr["fitted_cameras"], abs=0.01)


def test_the_errors_of_the_fitted_geometry_are_told(fitted):
    found = fitted[1].document["geometry"]["ball"]
    assert 0 < found["normals"] < 30
    assert abs(found["bias"]) <= 1000
    assert 0 < found["depth"] < 100  # millimetres; the ball has a radius of 1 m
    assert 0 < found["matte"] < 0.2


def test_without_it_no_field_is_fitted(fitted):
    output = fitted[0]
    plain = open_plan(find_subjects(output.parent / "set", ["noon"])[0], output, OPTIONS)
    document = summarise([plain], {"ball": {}})
    assert "fitted_true" not in {row["name"] for row in document["rows"]}
    assert "fitted_true" not in document["cells"], "records of another evaluation"
