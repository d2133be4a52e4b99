"""Colour of whole jobs: what the job says against what files say, working and output space, view, keys."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest

from tests.cases.shots import (
    ACES_AP1,
    FRAME,
    HEIGHT,
    WIDTH,
    Outcome,
    check,
    deliver,
    rgba,
    sky,
    sphere,
    write,
    write_shot,
)
from tests.io.test_color_config import write_config
from yesnt.core.color_spaces import ACESCG, LIN_REC709, PRIMARIES, JobColors, matrix_to_rec709
from yesnt.io import preview
from yesnt.io.color_config import BUILT_IN, convert, open_config
from yesnt.planning.stages import RELIGHT
from yesnt.runtime.clamps import clamp_lines
from yesnt.runtime.session import Session
from yesnt.tasks.light import LightFiles, _Known
from yesnt.tasks.workspace import Workspace

SPHERE = sphere()
PLATE = f"plate.{FRAME}.exr"
TO_ACESCG = np.linalg.inv(matrix_to_rec709(PRIMARIES["lin_ap1_scene"]))
RAMP = np.linspace(0.15, 0.75, WIDTH)
COLORS = np.stack(np.broadcast_arrays(RAMP, RAMP[::-1], np.linspace(0.2, 0.6, HEIGHT)[:, None]), axis=-1)
"""[H, W, 3] colours inside Rec.709, all of them such that a surface can have them."""

WITH_BACKGROUND = {"background": {"path": "background.exr"}, "capture_light": {"path": "capture.exr"}}


def smooth_light() -> np.ndarray:
    """[16, 32, 1]: a wide lamp in a sky. Texels of equal light are chosen by rounding errors, which differ by space."""
    v, u = np.mgrid[0:16, 0:32] + 0.5
    lamp = np.exp(-((v - 5.3) ** 2 / 12 + (u - 20.7) ** 2 / 30))
    return (0.25 + 0.02 * np.sin(u / 5.1) + 0.013 * np.cos(v / 3.3) + 4 * lamp)[..., None]


def write_colors(folder: Path, matrix: Any, chromaticities: tuple[float, ...] | None, **job: Any) -> Path:
    """A shot in which plate, background and both lights have colours; they are multiplied by a matrix."""
    write_shot(folder, **{**WITH_BACKGROUND, **job})
    stated = {"chromaticities": chromaticities} if chromaticities else {}
    write(folder / PLATE, rgba(COLORS @ matrix.T, SPHERE.matte), **stated)
    write(folder / "background.exr", rgba(COLORS[::-1] @ matrix.T, np.full((HEIGHT, WIDTH), 0.7)), **stated)
    write(folder / "light.exr", sky(smooth_light() * [1, 0.8, 0.5] @ matrix.T), **stated)
    write(folder / "capture.exr", sky(np.array([1.1, 1, 0.9]) @ matrix.T), **stated)
    return folder


def rgb(outcome: Outcome, layer: str) -> np.ndarray:
    """[H, W, 3] of a delivered layer."""
    return np.stack([outcome.planes[f"{layer}{c}"] for c in "RGB"], axis=-1)


@pytest.mark.parametrize("working", [LIN_REC709, ACESCG])
def test_acescg_in_and_out_equals_the_run_whose_inputs_were_converted_before(tmp_path: Path, working: str) -> None:
    output = {"working": working, "output": "ACEScg"}
    aces = deliver(write_colors(tmp_path / "aces", TO_ACESCG, ACES_AP1, color=output))
    rec709 = deliver(write_colors(tmp_path / "rec709", np.eye(3), None, color={"working": working}))
    assert aces.refusal == rec709.refusal == ""
    for layer in ("", "relit.", "diffuse.", "specular."):
        found, wanted = rgb(aces, layer), rgb(rec709, layer) @ TO_ACESCG.T
        np.testing.assert_allclose(found, wanted, rtol=1e-3, atol=1e-6)
        assert np.ptp(wanted) > 0.1 or layer == "specular."
    assert tuple(aces.header["chromaticities"]) == pytest.approx(ACES_AP1)
    assert (aces.header["colorInteropID"], rec709.header["colorInteropID"]) == ("lin_ap1_scene", "lin_rec709_scene")


@pytest.mark.parametrize("working", [LIN_REC709, ACESCG])
def test_the_same_coloured_light_in_and_out_gives_the_plate(tmp_path: Path, working: str) -> None:
    folder = write_colors(tmp_path / "s", TO_ACESCG, ACES_AP1, color={"working": working, "output": "ACEScg"})
    (folder / "light.exr").write_bytes((folder / "capture.exr").read_bytes())
    y, x = HEIGHT // 2, WIDTH // 2
    assert deliver(folder).at(y, x) == pytest.approx((COLORS @ TO_ACESCG.T)[y, x].tolist(), rel=2e-3)


def test_a_worker_keeps_a_plate_and_a_map_of_each_space_apart(tmp_path: Path) -> None:
    session = Session(write_colors(tmp_path / "s", np.eye(3), None, color={"working": "acescg"}))
    frame, job = session.job.frames[0], session.job
    space = Workspace(job, next(node for node in session.graph() if node.stage == RELIGHT))
    colors = [space.plate(frame, working).color[HEIGHT // 2, WIDTH // 2] for working in (False, True, False)]
    assert np.array_equal(colors[0], colors[2])
    assert not np.array_equal(colors[0], colors[1])
    plain = job.model_copy(update={"colors": JobColors()})
    spec = job.shot.light
    known = [_Known(LightFiles(one, frame, {"light": "same"}), spec, "light") for one in (job, plain, job)]
    assert known[0] == known[2] != known[1]


def test_clamps_of_frames_that_are_stale_are_not_told(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s")
    write(folder / PLATE, rgba(20.0, SPHERE.matte))
    told = "relight: pixels brighter than a white surface, base colour clamped to 1: "
    assert any(line.startswith(told) and line.endswith("in 1 frame") for line in deliver(folder).warnings)
    write(folder / PLATE, rgba(0.5, SPHERE.matte))
    session = Session(folder)
    assert clamp_lines(session.job.frames, session.graph(), session.open_index()) == []


def test_the_working_space_matters_and_enters_the_keys_of_relighting_alone(tmp_path: Path) -> None:
    keys: dict[str, dict[str, str]] = {}
    for working in (LIN_REC709, ACESCG):
        folder = write_colors(tmp_path / working, np.eye(3), None, color={"working": working})
        keys[working] = {node.stage.label: node.key for node in Session(folder).graph()}
    same = {stage for stage, key in keys[LIN_REC709].items() if keys[ACESCG][stage] == key}
    assert same >= {"decompose", "confidence", "solve"}
    assert same.isdisjoint({"relight", "composite", "preview"})


def test_defaults_that_are_written_out_change_no_key(tmp_path: Path) -> None:
    spelled = {
        "color": {"config": "$OCIO", "working": "lin_rec709", "output": "lin_rec709"},
        "plate": {"path": "plate.####.exr", "colorspace": "lin_rec709"},
        "light": {"path": "light.exr", "colorspace": "lin_rec709"},
    }
    graphs = [Session(write_shot(tmp_path / name, **job)).graph() for name, job in (("a", {}), ("b", spelled))]
    first, second = ([node.key for node in graph] for graph in graphs)
    assert first == second


def test_the_configuration_enters_the_keys_where_it_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def keys(name: str, middle: float) -> dict[str, str]:
        monkeypatch.setenv("OCIO", write_config(tmp_path / "site", middle))
        plate = {"path": "plate.####.exr", "colorspace": name}
        folder = tmp_path / f"{name} {middle}"
        if not folder.exists():
            write_shot(folder, plate=plate)
        return {node.stage.label: node.key for node in Session(folder).graph()}

    assert keys("camlog", 0.25) == keys("camlog", 0.25)
    before, after = keys("camlog", 0.25), keys("lin_rec709", 0.25)
    monkeypatch.setenv("OCIO", write_config(tmp_path / "site", 0.3))
    assert {node.stage.label: node.key for node in Session(tmp_path / "camlog 0.25").graph()} != before
    assert {node.stage.label: node.key for node in Session(tmp_path / "lin_rec709 0.25").graph()} == after


def test_a_configuration_of_the_environment_is_honoured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OCIO", write_config(tmp_path / "site"))
    folder = write_shot(tmp_path / "s", plate={"path": "plate.####.exr", "colorspace": "camlog"})
    assert deliver(folder).centre() == pytest.approx([0.25] * 3, abs=1e-3)


def test_a_configuration_is_not_opened_where_nothing_is_to_convert(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", color={"config": "absent.ocio"})
    assert check(folder) == Outcome()


def stated(folder: Path, colorspace: str | None, **attributes: Any) -> Outcome:
    """What is reported of a plate with these attributes, whose space the job says, or not."""
    plate = {"path": "plate.####.exr", **({"colorspace": colorspace} if colorspace else {})}
    write_shot(folder, plate=plate)
    write(folder / PLATE, rgba(0.5, SPHERE.matte), **attributes)
    return check(folder)


AP0, NONSENSE = PRIMARIES["lin_ap0_scene"], (0.6, 0.35, 0.3, 0.55, 0.2, 0.1, 0.3127, 0.329)


@pytest.mark.parametrize(
    ("colorspace", "attributes", "told"),
    [
        (None, {}, ""),
        (None, {"chromaticities": PRIMARIES["lin_rec709_scene"]}, ""),
        (None, {"colorInteropID": "lin_rec709_scene"}, ""),
        (None, {"chromaticities": AP0}, "plate: read as ACES2065-1, as its files say (chromaticities 0.7347, 0.2653"),
        (None, {"colorInteropID": "lin_ap1_scene"}, "plate: read as acescg, as its files say (colorInteropID lin_ap1"),
        (None, {"chromaticities": NONSENSE}, "and they are of no space that is known. Where:"),
        (None, {"chromaticities": (0.0,) * 8}, "chromaticities are eight finite numbers"),
        (None, {"colorInteropID": "lin_ap1_scene", "chromaticities": AP0}, "which is not acescg"),
        ("ACEScg", {"chromaticities": ACES_AP1}, ""),
        ("ACEScct", {"chromaticities": ACES_AP1}, ""),
        ("acescg", {"colorInteropID": "lin_ap1_scene"}, ""),
        ("lin_rec709", {"chromaticities": ACES_AP1}, "plate says of itself chromaticities 0.713, 0.293"),
        ("acescg", {"colorInteropID": "lin_rec709_scene"}, "colorInteropID lin_rec709_scene, which is not acescg"),
        ("srgb", {"colorInteropID": "lin_rec709_scene"}, "which is not srgb"),
        ("aces_cg", {}, "There is no colour space 'aces_cg'. Where: key plate.colorspace"),
    ],
)  # fmt: skip
def test_files_agree_are_converted_or_are_refused(
    tmp_path: Path, colorspace: str | None, attributes: dict[str, Any], told: str
) -> None:
    outcome = stated(tmp_path / "s", colorspace, **attributes)
    said = outcome.refusal + " ".join(outcome.warnings)
    assert told in said
    assert bool(told) == bool(said)
    if not outcome.refusal:
        checks = Session(tmp_path / "s").checks
        assert not [*checks.form(), *checks.content()], "how a file is read is told, and is nothing to be warned of"


def test_all_files_of_a_sequence_say_the_same(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", (FRAME, FRAME + 1))
    write(folder / f"plate.{FRAME + 1}.exr", rgba(0.5, SPHERE.matte), chromaticities=ACES_AP1)
    refusal = check(folder).refusal
    assert "The pictures of the plate differ in what they say of their colours" in refusal
    assert f"plate.{FRAME + 1}.exr" in refusal


def test_a_logarithmic_dpx_is_refused_until_the_job_names_its_space(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", plate={"path": "plate.####.dpx"})
    spec = oiio.ImageSpec(WIDTH, HEIGHT, 3, oiio.UINT16)
    spec.attribute("oiio:ColorSpace", "KodakLog")
    target = oiio.ImageOutput.create("a.dpx")
    target.open(str(folder / f"plate.{FRAME}.dpx"), spec)
    target.write_image(np.full((HEIGHT, WIDTH, 3), 0.5, np.float32))
    target.close()
    assert "The plate is encoded as KodakLog, and the job does not say" in check(folder).refusal


def test_an_output_space_that_is_not_linear_is_refused(tmp_path: Path) -> None:
    for output in ("ACEScct", "srgb"):
        folder = write_shot(tmp_path / output, color={"output": output})
        assert f"The output space {output} is not linear. Where: key color.output" in check(folder).refusal


def test_an_unusual_output_space_is_described_by_its_chromaticities(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", color={"output": "Linear P3-D65"})
    header = deliver(folder).header
    assert header["colorInteropID"] == "lin_p3d65_scene"
    assert tuple(header["chromaticities"]) == pytest.approx(PRIMARIES["lin_p3d65_scene"])


def test_the_preview_shows_the_output_through_the_view(tmp_path: Path) -> None:
    view = "ACES 2.0 - SDR 100 nits (Rec.709)"
    colors = Session(write_shot(tmp_path / "s", color={"output": "ACEScg", "view": view})).job.colors
    picture = np.full((2, 2, 3), 0.18, np.float32)
    np.testing.assert_allclose(convert(picture, colors.display), 0.349, atol=2e-3)
    plain = Session(write_shot(tmp_path / "t", color={"output": "ACEScg"})).job.colors.display
    green = np.float32([[[0, 1, 0]]]) @ TO_ACESCG.T.astype(np.float32)
    np.testing.assert_allclose(convert(green, plain), [[[0, 1, 0]]], atol=1e-3)


def test_an_unknown_view_is_refused(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", color={"view": "Filmic"})
    assert "no view of the display 'sRGB - Display' 'Filmic'. Where: key color.view" in check(folder).refusal


def test_the_delivered_file_says_which_layers_are_associated(tmp_path: Path) -> None:
    outcome = deliver(write_shot(tmp_path / "s", exr={"layers": ["base_color"]}))
    assert outcome.header["yesnt:associated"] == "RGBA, relit, diffuse, specular"


def test_a_background_in_another_space_passes_with_its_own_alpha(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", background={"path": "background.exr", "colorspace": "ACEScg"})
    write(folder / "background.exr", rgba(np.array([0.5, 0.05, 0.05]), np.full((HEIGHT, WIDTH), 0.5)))
    outcome = deliver(folder)
    wanted = 0.5 * convert(np.float32([[0.5, 0.05, 0.05]]), open_config(BUILT_IN).conversion(ACESCG, LIN_REC709))[0]
    assert outcome.at(0, 0, "") == pytest.approx(wanted.tolist(), rel=1e-3), "its green is below 0 in Rec.709"
    assert float(outcome.planes["A"][0, 0]) == 0.5


def test_thumbnails_take_the_display(tmp_path: Path) -> None:
    write(tmp_path / "a.exr", {c: np.full((4, 4), v, np.float16) for c, v in zip("RGB", (0.5, 0, 0), strict=True)})
    shown = {preview.thumbnail(tmp_path / "a.exr", lambda color, k=k: color * k) for k in (0.0, 1.0)}
    assert len(shown) == 2
