"""Rows whose plate, G-buffer and proxy come from a field that is fitted to the capture's pictures alone."""

import copy
import hashlib
import shutil
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
import yaml

from tests.measure.evaluation.conftest import write_shot
from tests.measure.evaluation.test_measured import OPTIONS, write_capture
from yesnt.core.color import srgb_encode
from yesnt.io.durable import write_json
from yesnt.io.file_digests import file_digest
from yesnt.measure.evaluation import measured_jobs, run
from yesnt.measure.evaluation.evidence_rows import MEASURED
from yesnt.measure.evaluation.run import open_plan, run_evaluation
from yesnt.measure.evaluation.subjects import find_subjects
from yesnt.measure.evaluation.summary import summarise
from yesnt.measure.evaluation.table import tables
from yesnt.metrics.score import Truth, score_briefly
from yesnt.planning.graph import Graph
from yesnt.runtime.session import Session

KNOBS = {"steps": 100, "check": 50, "count": 300, "most": 400, "triangles": 800}
WAYS = tuple((40 * i, (10, 50, -30)[i % 3]) for i in range(9))
"""Azimuth and elevation of cameras all around, degrees."""


CONSTANTS = {"ball": {"no_decomposition": (0.5, 0.0), "no_decomposition_each": (0.5, 0.0)}}


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """One frame of the shot with a capture, fitted and evaluated once; the other rows have tests of their own."""
    home = tmp_path_factory.mktemp("fitted")
    folder = write_capture(write_shot(home / "set" / "ball"), WAYS)
    for name in ("shot.yaml", "measured.yaml"):
        (folder / name).write_text(yaml.safe_dump(yaml.safe_load((folder / name).read_text()) | {"frames": "1001"}))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measured_jobs, "MEASURED", {"cameras_8": MEASURED["cameras_8"]})
        for graph in ("evaluation_graph", "ablation_graph"):
            patch.setattr(run, graph, lambda plan: Graph())
        patch.setattr(run, "constants_graph", lambda plan, constants: Graph())
        patch.setattr(run, "best_constants", lambda plans: CONSTANTS)
        return home / "out", run_evaluation(folder.parent, home / "out", replace(OPTIONS, fit_knobs=KNOBS))


def test_nothing_of_the_given_geometry_enters(fitted):
    shot = Session(fitted[0] / "shots" / "ball" / "fitted").job.shot
    assert shot.plate.path == shot.gbuffer.path == "out/gaussians/view.####.exr"
    assert shot.proxy.path == "out/gaussians/proxy.####.ply"


def test_rows_from_cameras_alone_stand_beside_what_geometry_costs(fitted):
    document = copy.deepcopy(fitted[1].document)
    rows = [row["name"] for row in document["rows"] if row["group"] == "fitted"]
    assert rows == ["fitted_true", "fitted_model", "fitted_cameras", "fitted_blender"]
    psnr = {name: document["cells"][name]["ball / noon"]["psnr"] for name in rows[:3]}
    true = document["geometry_parts"]["given"]["psnr"]["mean"]  # what the row full_true would have
    assert 12 < psnr["fitted_true"] < min(40, true)
    document["cells"]["full_true"] = {"ball / noon": {"psnr": true}}
    table = next(t for t in tables(document) if t.title.startswith("From the cameras"))
    assert float(table.lines[0][-1]) == pytest.approx(true - psnr["fitted_true"], abs=0.01)
    assert table.lines[1][-1] == "-", "the model's materials on the given geometry are not measured here"
    given = document["cells"]["cameras_8"]["ball / noon"]["psnr"]
    assert float(table.lines[2][-1]) == pytest.approx(given - psnr["fitted_cameras"], abs=0.01)


def test_each_part_of_the_fitted_geometry_costs_something(fitted):
    document = fitted[1].document
    parts = {part: values["psnr"]["mean"] for part, values in document["geometry_parts"].items()}
    assert set(parts) == {"given", "plate", "normals", "z", "proxy"}
    assert parts["given"] > 60, "the truth is relit by the same code"
    assert all(parts[part] < parts["given"] - 1 for part in ("plate", "normals", "z", "proxy"))
    table = next(t for t in tables(document) if t.title.startswith("What the fitted geometry"))
    assert float(table.lines[2][4]) == pytest.approx(parts["given"] - parts["normals"], abs=0.01)


def test_the_page_shows_the_picture_from_the_cameras_alone(fitted):
    one = fitted[1].document["fitted"][0]
    assert one["cell"] == "ball / noon"
    assert (fitted[0] / one["picture"]).stat().st_size > 1000
    assert "From the cameras alone" in fitted[1].page.read_text()


def test_the_matte_of_the_fit_is_part_of_its_picture():
    radiance, solid = np.full((24, 24, 3), 0.5, np.float32), np.ones((24, 24), np.float32)
    truth = Truth.of(radiance, solid, solid)
    holed = solid.copy()
    holed[8:16, 8:16] = 0.5
    found = {m.name: m.value for m in score_briefly(radiance, truth, holed)}
    error = float(srgb_encode(np.float32(0.5)) - srgb_encode(np.float32(0.25)))
    assert found["psnr"] == found["psnr_whole"] == pytest.approx(-10 * np.log10(error**2 / 9), abs=1e-3)
    assert {m.name: m.value for m in score_briefly(radiance, truth)}["psnr"] == np.inf


def test_blenders_picture_of_the_mesh_counts_only_for_the_fit_that_it_shows(fitted, tmp_path):
    output, options = tmp_path / "out", replace(OPTIONS, fit_knobs=KNOBS)
    shutil.copytree(fitted[0], output)
    home = output / "shots" / "ball" / "fitted"
    view, mesh = (home / "out" / "gaussians" / name for name in ("view.1001.exr", "proxy.1001.ply"))
    (home / "truth").mkdir()
    picture = shutil.copy(view, home / "truth" / "proxy_noon.1001.exr")
    files = {"truth/proxy_noon.1001.exr": hashlib.sha256(picture.read_bytes()).hexdigest()}
    record = {"job": {"fit": f"{file_digest(view)}-{file_digest(mesh)}"}, "files": files}
    (home / "stage").mkdir()
    write_json(home / "stage" / "record.json", record)
    (subject,) = find_subjects(fitted[0].parent / "set", ["noon"])
    plan = open_plan(subject, output, options)
    assert plan.fitted_reference("noon", 1002) is None, "no such picture"
    with ExitStack() as stack:
        run.drive_fitted(plan, run._Drive(options, lambda event: None, stack))
    cells = summarise([plan], CONSTANTS)["cells"]
    assert cells["fitted_true"] == fitted[1].document["cells"]["fitted_true"]
    assert 5 < cells["fitted_blender"]["ball / noon"]["psnr"] < 25
    mesh.write_bytes(mesh.read_bytes() + b" ")
    assert plan.fitted_reference("noon", 1001) is None, "the picture shows another fit"


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
