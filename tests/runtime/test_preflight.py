"""Bad input is refused in one paragraph before anything is written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.tiny_shot import write_tiny_shot
from yesnt.core.errors import JobError, YesntError
from yesnt.io.exr import write_exr
from yesnt.io.output import OutputFolder
from yesnt.io.pictures.image import read_image
from yesnt.runtime.checks.inputs import STORE_BYTES_PER_PIXEL, InputChecks, handles, inspect
from yesnt.runtime.checks.preflight import resolve
from yesnt.runtime.run_options import RunOptions
from yesnt.runtime.session import Session
from yesnt.temporal.flow import LEARNED


def check(path: Path) -> list[str]:
    return inspect(resolve(path))


def rewrite(path: Path, drop: str = "", **channels) -> None:
    image = read_image(path)
    planes = {name: plane for name, plane in image.channels.items() if name != drop}
    write_exr(path, planes | {name.replace("_", "."): plane for name, plane in channels.items()})


def spoiled(path: Path, channel: str, value: float, at: Sequence[int] = (16, 20)) -> None:
    plane = read_image(path).channels[channel].copy()
    plane[tuple(at)] = value
    rewrite(path, **{channel.replace(".", "_"): plane})


def test_a_good_shot_passes_without_warnings(tiny_shot: Path) -> None:
    assert check(tiny_shot) == []


SPOILERS = {
    "missing plate": (lambda d: (d / "plate.1002.exr").unlink(), r"missing.*plate\.1002"),
    "missing gbuffer": (lambda d: (d / "gbuffer.1004.exr").unlink(), r"missing.*gbuffer\.1004"),
    "missing proxy": (lambda d: (d / "proxy.1001.ply").unlink(), r"missing.*proxy\.1001"),
    "missing env map": (lambda d: (d / "light.exr").unlink(), r"missing.*light\.exr"),
    "folder in a plate's place": (
        lambda d: ((d / "plate.1002.exr").unlink(), (d / "plate.1002.exr").mkdir()),
        r"Is a directory.*plate\.1002",
    ),
    "truncated plate": (
        lambda d: (d / "plate.1003.exr").write_bytes((d / "plate.1003.exr").read_bytes()[:600]),
        "damaged|opened",
    ),
    "NaN in plate": (lambda d: spoiled(d / "plate.1002.exr", "R", np.nan), r"1 values are NaN or Inf in R.*x=20 y=16"),
    "Inf in plate": (lambda d: spoiled(d / "plate.1002.exr", "G", np.inf), "NaN or Inf"),
    "NaN in z": (lambda d: spoiled(d / "gbuffer.1002.exr", "depth.Z", np.nan), r"NaN or Inf in depth\.Z"),
    "NaN in env map": (lambda d: spoil_light(d, np.nan), r"NaN or Inf in R, G, B.*light"),
    "absent z": (lambda d: rewrite(d / "gbuffer.1002.exr", drop="depth.Z"), r"no channel depth\.Z.*it has"),
    "other size": (
        lambda d: write_exr(d / "plate.1002.exr", {c: np.zeros((8, 8), np.float16) for c in "RGBA"}),
        "8x8.*40x32",
    ),
    "a header of 10^6 x 10^6 pixels": (lambda d: claim(d / "plate.1002.exr", 1_000_000), r"limit|claims.*plate\.1002"),
    "no camera": (lambda d: (d / "camera.json").unlink(), "camera file is missing"),
    "broken camera": (lambda d: (d / "camera.json").write_text("{"), "camera file cannot be read"),
    "no pose": (lambda d: repose(d), r"no pose for frame 1004.*camera\.json.*1001-1003"),
    "broken mesh": (lambda d: (d / "proxy.1001.ply").write_text("ply\n"), "proxy mesh is damaged|no usable triangles"),
}


def claim(path: Path, side: int) -> None:
    """Makes an EXR's header claim a picture of this side; its pixels stay as they are."""
    import struct

    data = bytearray(path.read_bytes())
    for window in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
        start = data.index(window) + len(window) + 4
        data[start : start + 16] = struct.pack("<4i", 0, 0, side - 1, side - 1)
    path.write_bytes(data)


def spoil_light(folder: Path, value: float) -> None:
    plane = read_image(folder / "light.exr").channels["R"].copy()
    plane[0, 0] = value
    rewrite(folder / "light.exr", R=plane)


def repose(folder: Path) -> None:
    import json

    camera = json.loads((folder / "camera.json").read_text())
    del camera["frames"]["1004"]
    (folder / "camera.json").write_text(json.dumps(camera))


@pytest.mark.parametrize("name", SPOILERS)
def test_bad_input_is_refused_and_nothing_written(tiny_shot: Path, name: str) -> None:
    spoil, message = SPOILERS[name]
    spoil(tiny_shot.parent)
    before = sorted(p.name for p in tiny_shot.parent.iterdir())
    with pytest.raises(YesntError, match=message) as caught:
        Session(tiny_shot).run(RunOptions())
    assert "\n" not in str(caught.value)
    assert caught.value.do
    assert sorted(p.name for p in tiny_shot.parent.iterdir()) == before


def test_negative_radiance_is_clamped_with_a_warning_that_counts(tiny_shot: Path) -> None:
    spoiled(tiny_shot.parent / "plate.1001.exr", "R", -0.5)
    spoil_light(tiny_shot.parent, -1.0)
    warnings = check(tiny_shot)
    assert any("plate: negative values that are read as 0: 1 in the shot" in w for w in warnings)
    assert any("light: 1 negative values" in w for w in warnings)


def test_what_lies_outside_the_matte_stops_nothing_and_is_counted(tiny_shot: Path) -> None:
    outside = np.argwhere(read_image(tiny_shot.parent / "plate.1001.exr").channels["A"] == 0)[0]
    for name, channel in (("plate", "R"), ("gbuffer", "depth.Z"), ("gbuffer", "N.X")):
        spoiled(tiny_shot.parent / f"{name}.1001.exr", channel, np.nan, outside)
    spoiled(tiny_shot.parent / "plate.1002.exr", "G", 0.25, outside)
    assert check(tiny_shot) == [
        "plate: pixels outside the matte that are NaN or infinite and read as 0: 1 in the shot",
        "plate: pixels with colour but no coverage, added to the composite as they are (or set `alpha: straight`): "
        "1 in the shot",
    ]


@pytest.mark.parametrize(
    ("output", "plate"),
    [(".", "exr/tiny.####.exr"), ("out", "out/exr/tiny.####.exr"), ("out", "out/run/plate.####.exr")],
)
def test_results_are_not_written_over_the_inputs(tiny_shot: Path, output: str, plate: str) -> None:
    job = yaml.safe_load(tiny_shot.read_text()) | {"output": output, "plate": {"path": plate}}
    tiny_shot.write_text(yaml.safe_dump(job))
    for path in tiny_shot.parent.glob("plate.*.exr"):
        target = tiny_shot.parent / plate.replace("####", path.name.split(".")[1])
        target.parent.mkdir(parents=True, exist_ok=True)
        path.rename(target)
    with pytest.raises(JobError, match=r"results would be written over an input.*1001\.exr.*set `output:`"):
        Session(tiny_shot).run(RunOptions())


def test_one_file_for_all_frames_is_reported(tiny_shot: Path) -> None:
    job = yaml.safe_load(tiny_shot.read_text()) | {"plate": {"path": "plate.1001.exr"}}
    tiny_shot.write_text(yaml.safe_dump(job))
    expected = "plate: plate.1001.exr serves all 4 frames; a sequence has #### where the frame number stands"
    assert expected in check(tiny_shot)


def test_handles_are_normal(tiny_shot: Path) -> None:
    for frame in (1000, 1009):
        (tiny_shot.parent / f"plate.{frame}.exr").write_bytes(b"")
    assert check(tiny_shot) == []
    counted = "plate.####.exr: 2 frames on disk outside `frames:` (1000 to 1009) not used"
    assert list(handles(resolve(tiny_shot).job)) == [counted]


def test_the_former_key_of_extra_frames_says_what_to_do(tmp_path: Path) -> None:
    path = write_tiny_shot(tmp_path / "s", extra_frames="ignore")
    with pytest.raises(JobError, match=r"'extra_frames' is no longer used.*line \d+.*handles.*remove the line"):
        resolve(path)


@pytest.mark.parametrize(
    ("section", "value", "message"),
    [
        ("relight", {"texel": 8}, "Unknown knob 'texel'.*key relight"),
        ("relight", {"film": 0.1}, "`film` is now called `pixel_filter`.*key relight: film.*rename it"),
        ("relight", {"brdf": "phong"}, "brdf"),
        ("temporal", {"knobs": {"lambda1": -1.0}}, r"lambda1.*key temporal\.knobs"),
        ("flow", {"knobs": {"methid": "dis-fast"}}, "Unknown knob 'methid'"),
        ("flow", {"knobs": {"method": LEARNED[0]}}, "flow and its weights belong together.*add the other"),
        ("flow", {"weights": "flow.pt"}, "flow and its weights belong together.*remove the one"),
        ("decompose", {"backend": "magic"}, "there is no backend 'magic'"),
        ("decompose", {"backend": "rgbx", "weights": "/"}, "forbids commercial use.*--accept-license"),
    ],
)
def test_wrong_knobs_are_refused_by_name(tmp_path: Path, section: str, value: dict, message: str) -> None:
    path = write_tiny_shot(tmp_path / "s", **{section: value})
    with pytest.raises(JobError, match=message):
        resolve(path)


def test_ranges_of_the_passes_are_those_inside_the_mattes(tiny_shot: Path) -> None:
    folder = tiny_shot.parent
    for frame, value in ((1002, 0.9), (1003, 0.1)):
        inside = read_image(folder / f"plate.{frame}.exr").channels["A"] > 0
        rewrite(folder / f"material.{frame}.exr", roughness_Y=np.where(inside, value, 0.0).astype(np.float32))
    roughness, metallic = InputChecks(resolve(tiny_shot)).material_ranges() or ((), ())
    assert roughness == pytest.approx((0.1, 0.9), abs=1e-3)
    assert metallic == (0.0, 1.0)
    unknown = write_tiny_shot(folder.parent / "embedded", decompose={"backend": "embedded"})
    assert InputChecks(resolve(unknown)).material_ranges() is None


def test_checks_report_their_progress(tiny_shot: Path) -> None:
    reported: list[tuple[str, int, int]] = []
    InputChecks(resolve(tiny_shot), lambda *progress: reported.append(progress)).content()
    assert reported == [("Checking frames", done, 4) for done in (1, 2, 3, 4)]


def test_room_is_asked_for_by_pixels_of_all_frames(tiny_shot: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    monkeypatch.setattr(OutputFolder, "check", lambda self, needed: asked.append(needed))
    InputChecks(resolve(tiny_shot)).form()
    assert asked == [4 * 40 * 32 * STORE_BYTES_PER_PIXEL // 2]


def test_inputs_may_be_links_and_absolute_paths(tmp_path: Path) -> None:
    real = write_tiny_shot(tmp_path / "real")
    (tmp_path / "linked").symlink_to(real.parent)
    moved = write_tiny_shot(tmp_path / "job", plate={"path": str(tmp_path / "linked" / "plate.####.exr")})
    assert check(moved) == []


def test_an_output_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    path = write_tiny_shot(tmp_path / "s", output=str(tmp_path / "file" / "out"))
    with pytest.raises(JobError, match="output folder cannot be written"):
        check(path)


def test_a_full_disk_is_foreseen(tiny_shot: Path) -> None:
    with pytest.raises(JobError, match=r"GB free.*another disk"):
        OutputFolder.of(resolve(tiny_shot).job).check(1 << 60)


def test_a_second_driver_is_refused_and_named(tiny_shot: Path) -> None:
    output = OutputFolder.of(resolve(tiny_shot).job)
    with output.lock(), pytest.raises(JobError, match=r"run already by .*pid"), output.lock():
        pass


def test_a_second_driver_is_told_before_it_starts_workers(tiny_shot: Path) -> None:
    output = OutputFolder.of(resolve(tiny_shot).job)
    output.refuse_if_running()
    assert not output.root.exists()
    with output.lock(), pytest.raises(JobError, match=r"run already by .*pid"):
        check(tiny_shot)
    assert check(tiny_shot) == []
