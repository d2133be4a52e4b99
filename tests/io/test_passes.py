"""Material passes that other programs made: one file for all, or one for each, EXR or PNG."""

import cv2
import numpy as np
import pytest

from tests.tiny_shot import write_tiny_shot
from yesnt.core.errors import JobError
from yesnt.io.exr import write_exr
from yesnt.io.jobfile import pass_patterns
from yesnt.io.pictures.image import read_image
from yesnt.io.shot_inputs import read_passes
from yesnt.runtime.checks.preflight import resolve

FRAMES = range(1001, 1005)


def _split(shot, write):
    """Writes the passes of a tiny shot into files of their own; returns the truth by frame."""
    truth = {}
    for frame in FRAMES:
        image = read_image(shot.parent / f"material.{frame}.exr")
        planes = {name: image.stack([f"{name}.Y"])[..., 0] for name in ("roughness", "metallic")}
        for name, plane in planes.items():
            write(shot.parent / "passes", name, frame, plane)
        truth[frame] = np.stack(list(planes.values()))
    return truth


def _png(folder, name, frame, plane):
    folder.mkdir(exist_ok=True)
    depth, top = (np.uint16, 65535) if name == "metallic" else (np.uint8, 255)
    grey = np.round(plane * top).astype(depth)
    cv2.imwrite(str(folder / f"{name}.{frame}.png"), grey if name == "metallic" else np.repeat(grey[..., None], 3, 2))


def _exr(folder, name, frame, plane):
    folder.mkdir(exist_ok=True)
    write_exr(folder / f"{name}.{frame}.exr", {"Y" if name == "metallic" else "roughness.Y": plane})


def test_a_pattern_names_one_file_or_one_a_pass():
    assert pass_patterns("m.####.exr") == {"material": "m.####.exr"}
    assert pass_patterns("{pass}/f.####.png") == {
        "roughness": "roughness/f.####.png",
        "metallic": "metallic/f.####.png",
    }


@pytest.mark.parametrize(("write", "kind", "tolerance"), [(_png, "png", 0.5 / 255), (_exr, "exr", 1e-6)])
def test_passes_of_their_own_files_are_read_as_raw_data(tmp_path, write, kind, tolerance):
    shot = write_tiny_shot(tmp_path, decompose={"path": f"passes/{{pass}}.####.{kind}"})
    truth = _split(shot, write)
    job = resolve(shot).job
    for frame in FRAMES:
        mean, std = read_passes(job, frame)
        np.testing.assert_allclose(mean, truth[frame], atol=tolerance)
        assert not std.any()


def test_a_beauty_in_the_file_of_a_pass_is_not_taken_for_the_pass(tmp_path):
    shot = write_tiny_shot(tmp_path, decompose={"path": "{pass}.exr"})
    plane = np.full((32, 40), 0.25, np.float32)
    beauty = dict.fromkeys("RGBA", np.ones_like(plane))
    write_exr(tmp_path / "roughness.exr", {**beauty, "roughness.V": plane})
    write_exr(tmp_path / "metallic.exr", {**beauty, "ViewLayer.metallic.X": 2 * plane})
    mean, _ = read_passes(resolve(shot).job, 1001)
    np.testing.assert_array_equal(mean, [plane, 2 * plane])
    write_exr(tmp_path / "metallic.exr", {**beauty, "depth.Z": plane})
    with pytest.raises(JobError, match=r"no channel metallic\.Y"):
        read_passes(resolve(shot).job, 1001)


def test_a_missing_pass_is_named(tmp_path):
    shot = write_tiny_shot(tmp_path, decompose={"path": "passes/{pass}.####.png"})
    _split(shot, _png)
    (tmp_path / "passes" / "metallic.1002.png").unlink()
    with pytest.raises(JobError, match="metallic"):
        read_passes(resolve(shot).job, 1002)
