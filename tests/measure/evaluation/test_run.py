"""The evaluation of a shot whose answers are known, in this process."""

import json
import math

import numpy as np
import pytest

from tests.measure.evaluation.conftest import rgb, write_shot
from yesnt.core.errors import UsageError
from yesnt.io.exr import write_exr
from yesnt.io.pictures.image import read_image
from yesnt.measure.evaluation.rows import ROWS
from yesnt.measure.evaluation.run import EvalOptions, run_evaluation
from yesnt.measure.evaluation.table import tables

HERE = EvalOptions(workers=0)


def psnr(result, row, cell="ball / noon"):
    return result.document["cells"][row][cell]["psnr"]


def test_rows_stand_in_the_order_that_they_must(evaluated):
    result = evaluated[2]
    assert psnr(result, "full_true") > 45  # same kernels, same lights: only the recovered base colour differs
    assert psnr(result, "no_relighting") < psnr(result, "no_decomposition") < psnr(result, "full")
    assert psnr(result, "unregularised") < psnr(result, "full") < psnr(result, "full_true")
    assert psnr(result, "no_decomposition") <= psnr(result, "no_decomposition_each") + 1e-9


def test_full_is_the_last_of_the_term_by_term_rows(evaluated):
    cells = evaluated[2].document["cells"]
    for own, last in (("full", "bounce_own"), ("full_true", "bounce_true")):
        assert cells[own]["ball / dusk"]["psnr"] == cells[last]["ball / dusk"]["psnr"]


def test_every_row_has_numbers_or_says_why_not(evaluated):
    document = evaluated[2].document
    assert {row["name"] for row in document["rows"]} == {r.name for r in ROWS.values() if r.group != "separation"}
    for row in document["rows"]:
        assert bool(row["values"]) != bool(row["absent"])
    blender = next(row for row in document["rows"] if row["name"] == "blender_proxy")
    assert "proxy_dusk.1001.exr: not rendered" in blender["absent"]


def test_a_set_without_a_capture_has_no_rows_of_one(evaluated):
    document = evaluated[2].document
    assert not any(row["group"] == "evidence" for row in document["rows"])
    assert not any(table.title.startswith("Materials measured") for table in tables(document))


def test_the_noise_of_the_passes_is_found_to_be_the_largest_error(evaluated):
    found = {one["stage"]: one for one in evaluated[2].document["separation"]}
    assert found["decomposition"]["largest"]
    assert found["light transport"]["rmse"] < 1e-3
    assert found["flow"]["rmse"] is not None
    assert sum(one["largest"] for one in found.values()) == 1


def test_the_spread_of_honest_noise_is_calibrated(evaluated):
    roughness = evaluated[2].document["material"]["mean"]["roughness"]
    assert roughness["observed"]["spearman"]["mean"] > 0.2
    assert roughness["observed"]["ause"]["mean"] < 0.5
    assert roughness["own"]["rmse"]["mean"] < roughness["observed"]["rmse"]["mean"]


def test_regularisation_shows_in_the_film(evaluated):
    video = evaluated[2].document["video"]["mean"]
    assert video["full"]["tpsnr_diff"]["mean"] > video["unregularised"]["tpsnr_diff"]["mean"]
    assert video["full"]["tpsnr_warp"]["mean"] > video["unregularised"]["tpsnr_warp"]["mean"]


def test_every_number_has_its_definition_and_json_has_no_infinities(evaluated):
    document = json.loads(evaluated[2].json.read_text(), parse_constant=pytest.fail)
    for row in document["rows"]:
        assert set(row["values"]) <= set(document["definitions"])


def test_margins_are_told_apart(evaluated):
    margins = {m["title"]: m for m in evaluated[2].document["margins"]}
    missing = margins["Full over the proxy mesh in Blender, PSNR"]
    assert missing["holds"] is None
    assert "Proxy mesh relit in Blender" in missing["why"]
    held = margins["Full over No Relighting, PSNR"]
    assert held["holds"] == (held["measured"] >= 7.35)
    assert held["holds"] or "largest error" in held["why"]


def test_page_and_markdown_stand_alone(evaluated):
    result = evaluated[2]
    page, text = result.page.read_text(), result.markdown.read_text()
    assert page.count("data:image/jpeg;base64") == 3  # two maps and the materials
    assert "http" not in page
    assert "Largest error: decomposition" in page
    assert " ± " in text
    assert text.count("10 log10(1 / MSE)") >= 1
    worst = [one["psnr"] for one in result.document["worst"]]
    assert worst == sorted(worst)


def test_a_second_run_does_nothing_and_a_new_truth_redoes_its_map_alone(shot, tmp_path):
    ran = []

    def listen(event):
        ran.extend([event["stage"]] if event["event"] == "done" else [])

    first = run_evaluation(shot, tmp_path / "out", HERE, listen)
    assert "score.noon" in ran
    ran.clear()
    again = run_evaluation(shot, tmp_path / "out", HERE, listen)
    assert ran == []
    assert again.document["cells"] == first.document["cells"]

    path = shot / "truth" / "relit_noon.1001.exr"
    picture = read_image(path).stack("RGBA")
    write_exr(path, {**rgb(picture[..., :3] * 0.9), "A": picture[..., 3]})
    changed = run_evaluation(shot, tmp_path / "out", HERE, listen)
    assert ran
    assert all("dusk" not in stage for stage in ran)
    assert changed.document["cells"]["full"] != first.document["cells"]["full"]


def test_full_is_what_the_product_delivers(evaluated):
    """The same picture, to the bit, that the job of `yesnt run` would composite."""
    from yesnt.io.store import FrameStore
    from yesnt.planning.graph import Graph
    from yesnt.planning.stages import RELIGHT
    from yesnt.runtime.session import Session
    from yesnt.tasks.run import run_node

    home = evaluated[1] / "shots" / "ball"
    session = Session(home)
    graph = session.graph()
    for node in Graph(graph.closure([(RELIGHT, 0)])):
        if node.stage == RELIGHT:
            arrays, job = session.plan().arrays(), session.job
            FrameStore.create(session.output.store, arrays, job.frames, job.height, job.width)
            run_node(session.job, node)
    store, position = FrameStore(session.output.store), 0
    product = session.book.find("relight", 1001).arrays
    lit = sum(store.read(name, position, product[name]) for name in ("diffuse", "specular"))
    judged = session.book.find("score.noon", 1001).arrays["score.noon.relit.full"]
    np.testing.assert_array_equal(store.read("score.noon.relit.full", position, judged), lit)


def test_new_materials_leave_rows_without_decomposition_as_they_are(shot, tmp_path):
    ran = []

    def listen(event):
        ran.extend([event["stage"]] if event["event"] == "done" else [])

    run_evaluation(shot, tmp_path / "out", HERE)
    path = shot / "passes.1001.exr"
    write_exr(path, {n: np.sqrt(read_image(path).stack([n])[..., 0]) for n in ("roughness.Y", "metallic.Y")})
    run_evaluation(shot, tmp_path / "out", HERE, listen)
    assert "score.noon" in ran
    assert not [stage for stage in ran if stage.startswith(("independent", "search"))]


def test_blenders_row_appears_when_it_is_rendered(shot, tmp_path):
    options = EvalOptions(maps=("dusk",), thorough=1, workers=0)
    for frame in (1001, 1002):
        (shot / "truth" / f"proxy_dusk.{frame}.exr").write_bytes((shot / f"truth/relit_dusk.{frame}.exr").read_bytes())
    result = run_evaluation(shot, tmp_path / "out", options)
    assert result.document["cells"]["blender_proxy"]["ball / dusk"]["ssim"] == pytest.approx(1)
    assert all("noon" not in cell for cell in result.document["cells"]["full"])


def test_without_weights_the_rest_is_measured(shot, tmp_path):
    text = (shot / "shot.yaml").read_text().replace("path: passes.####.exr", "weights: nowhere.safetensors")
    (shot / "shot.yaml").write_text(text)
    result = run_evaluation(shot, tmp_path / "out", EvalOptions(maps=("dusk",), thorough=1, workers=0))
    rows = {row["name"]: row for row in result.document["rows"]}
    assert "no decomposition: the weights" in rows["full"]["absent"]
    assert rows["full_true"]["values"]["psnr"]["n"] == 1
    assert math.isfinite(result.document["worst"][0]["psnr"])


def test_a_folder_without_truth_is_refused(tmp_path, shot):
    with pytest.raises(UsageError, match="no shot with truth"):
        run_evaluation(tmp_path / "empty", tmp_path / "out", HERE)
    with pytest.raises(UsageError, match="No shot has the map 'mars'"):
        run_evaluation(shot, tmp_path / "out", EvalOptions(maps=("mars",), workers=0))


@pytest.mark.slow
def test_workers_give_the_same_numbers(evaluated, tmp_path):
    folder, _, here = evaluated
    there = run_evaluation(folder, tmp_path / "out", EvalOptions(workers=1))
    assert there.failed == {}
    assert there.document["cells"] == here.document["cells"]


def test_unmodelled_effects_are_measured_from_truths_that_end_early_and_from_variants(shot, tmp_path):
    for name in ("dusk", "noon"):
        picture = read_image(shot / f"truth/relit_{name}.1001.exr").stack("RGBA")
        for number, light in ((0, 0.8), (1, 1.0)):
            path = shot / "truth" / f"bounces{number}_{name}.1001.exr"
            write_exr(path, {**rgb(picture[..., :3] * light), "A": picture[..., 3]})
    write_shot(shot.parent / "ball+dust")
    options = EvalOptions(thorough=1, probes=1, workers=0)
    (tmp_path / "scaling").mkdir()
    (tmp_path / "scaling" / "scaling.json").write_text(
        json.dumps({"quality": "draft", "stages": {"flow": {"8x4": {"seconds": 2, "peak_bytes": 3e9}}}, "lengths": {}})
    )
    result = run_evaluation(shot.parent, tmp_path / "unmodelled", options)
    lines = {line["effect"]: line for line in result.document["unmodelled"]}
    assert lines["light after bounce 1"]["rmse"] == 0
    assert lines["light after bounce 0"]["rmse"] > 0.01
    assert lines["light after bounce 0"]["with"] < lines["light after bounce 0"]["without"]
    assert lines["dust"]["rmse"] == lines["dust"]["share"] == 0  # the same shot under another name
    assert lines["dust"]["n"] == 2
    page = result.page.read_text()
    assert "Effects that are not modelled" in page
    assert "2.00 s / 3.00 GB" in page


def test_another_page_shows_what_was_measured_beside_it(tmp_path):
    from yesnt.measure.evaluation.run import measured_elsewhere

    (tmp_path / "unmodelled").mkdir()
    (tmp_path / "unmodelled" / "evaluation.json").write_text(json.dumps({"unmodelled": [{"effect": "hair"}]}))
    assert measured_elsewhere(tmp_path / "objects") == {"unmodelled": [{"effect": "hair"}]}
    assert measured_elsewhere(tmp_path / "elsewhere" / "objects") == {}
