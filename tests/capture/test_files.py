"""Layouts, videos and distortion: what is read is the picture of the frame and camera that the job means."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tests.decompose.evidence.scenes import look_from
from yesnt.capture.files import camera_files
from yesnt.capture.pictures import read_camera_picture, read_view, scaled_camera
from yesnt.capture.undistort import resampling, undistorted_camera
from yesnt.core.capture_input import CaptureCameras
from yesnt.core.color_spaces import Conversion
from yesnt.core.distortion import Distortion
from yesnt.core.errors import JobError
from yesnt.core.shot import Job, Shot
from yesnt.io.cameras import CalibratedCamera
from yesnt.io.exr import write_exr
from yesnt.io.video import read_picture, read_pictures, video_index
from yesnt.runtime.checks.fitted import refuse_other_rates

SIZE = 32


def a_job(root, **capture):
    section = {"cameras": "cameras.json", "images": "{camera}.exr", **capture}
    shot = Shot.model_validate({
        "version": 1, "name": "s", "frames": "1-9", "plate": {"path": "p.exr"}, "gbuffer": {"path": "g.exr"},
        "camera": "camera.json", "light": {"path": "l.exr"}, "proxy": {"path": "p.ply"}, "capture": section,
    })  # fmt: skip
    job = Job(shot=shot, root=str(root), frames=tuple(range(1, 10)), width=8, height=8)
    return job


def calibrated(size=SIZE, **changes):
    return CalibratedCamera(replace(look_from((0, -1, 0), size), **changes))


def write_video(path, levels, rate=25, size=(32, 32), skip=()):
    """A video whose pictures are flat greys, losslessly; positions in `skip` are dropped."""
    import av

    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=rate, options={"crf": "0", "g": "4", "bf": "2"})
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        stream.codec_context.time_base = Fraction(1, rate)
        for position, level in enumerate(levels):
            if position in skip:
                continue
            planes = np.full((size[1] * 3 // 2, size[0]), 128, np.uint8)
            planes[: size[1]] = level
            picture = av.VideoFrame.from_ndarray(planes, format="yuv420p")
            picture.pts, picture.time_base = position, Fraction(1, rate)
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    return path


@pytest.mark.parametrize(
    ("images", "mattes", "expected"),
    [
        ("capture/{camera}/plate.####.exr", "capture/{camera}/matte.####.png",
         ("capture/c1/plate.0007.exr", "capture/c1/matte.0007.png")),
        ("frames/####/{camera}.png", "frames/####/{camera}_m.png", ("frames/0007/c1.png", "frames/0007/c1_m.png")),
        ("user@host/f%03d/{camera}.png", None, ("user@host/f007/c1.png",)),
        ("videos/{camera}.mp4", "mattes/{camera}.mov", ("videos/c1.mp4", "mattes/c1.mov")),
        ("{camera}.%04d.exr", None, ("c1.0007.exr",)),
    ],
)  # fmt: skip
def test_layouts(images, mattes, expected) -> None:
    capture = CaptureCameras(cameras="c.json", images=images, mattes=mattes)
    assert tuple(camera_files("/job", capture, "c1", 7).values()) == tuple(Path("/job", part) for part in expected)


def test_files_of_a_late_camera_have_later_numbers() -> None:
    capture = CaptureCameras(cameras="c.json", images="{camera}.####.exr", offsets={"c2": 3})
    assert camera_files("/", capture, "c2", 7)["view"].name == "c2.0010.exr"
    assert camera_files("/", capture, "c1", 7)["view"].name == "c1.0007.exr"


def grey(picture):
    """Luma of a flat picture as the encoder was given it."""
    return float(np.rint(16 + 219 * picture.mean()))


LEVELS = [20 + 7 * i for i in range(24)]


def test_every_picture_of_a_video_is_the_one_that_was_put_in(tmp_path) -> None:
    path = write_video(tmp_path / "v.mp4", LEVELS)
    assert len(video_index(path).stamps) == len(LEVELS)
    assert [grey(picture) for picture in read_pictures(path, range(24))] == LEVELS
    assert [grey(read_picture(path, position)) for position in (23, 5, 6, 0)] == [LEVELS[i] for i in (23, 5, 6, 0)]
    assert [grey(p) for p in read_pictures(path, (3, 11, 19))] == [LEVELS[i] for i in (3, 11, 19)]


def test_a_video_with_dropped_pictures_is_refused(tmp_path) -> None:
    path = write_video(tmp_path / "v.mp4", LEVELS, skip=(9,))
    with pytest.raises(JobError, match=r"not evenly spaced: after picture 9 of 23 the next comes 2 frames later"):
        video_index(path)


def test_videos_of_different_rates_are_refused(tmp_path) -> None:
    """Drop-frame rates drift by a frame in 33 seconds; a video of another length at the same rate is fine."""
    videos = {f"view c{i}": write_video(tmp_path / f"{i}.mp4", LEVELS[: 12 + i], rate=25) for i in range(3)}
    refuse_other_rates(videos)
    videos["view c3"] = write_video(tmp_path / "3.mp4", LEVELS, rate=24)
    said = r"another frame rate than the others \(view c3: 24 frames a second\).*3\.mp4.*25 frames a second, as most"
    with pytest.raises(JobError, match=said):
        refuse_other_rates(videos)


def test_a_picture_beyond_the_video_is_refused(tmp_path) -> None:
    path = write_video(tmp_path / "v.mp4", LEVELS)
    with pytest.raises(JobError, match=r"The video has no picture 25\. Where: .*pictures 1 to 24.*capture.first"):
        read_picture(path, 24)
    with pytest.raises(JobError, match="The video is missing"):
        read_picture(tmp_path / "absent.mp4", 0)


@pytest.mark.parametrize(("space", "weights"), [(1, (0.2126, 0.0722)), (5, (0.299, 0.114))])
def test_colours_of_a_video_are_those_of_its_matrix(tmp_path, space, weights) -> None:
    import av

    color = np.array([0.8, 0.4, 0.1])
    kr, kb = weights
    luma = kr * color[0] + (1 - kr - kb) * color[1] + kb * color[2]
    coded = [16 + 219 * luma, 128 + 112 * (color[2] - luma) / (1 - kb), 128 + 112 * (color[0] - luma) / (1 - kr)]
    path = tmp_path / "v.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"crf": "0"})
        stream.width, stream.height, stream.pix_fmt = 32, 32, "yuv444p"
        stream.codec_context.colorspace = space
        planes = np.broadcast_to(np.rint(coded).astype(np.uint8)[:, None, None], (3, 32, 32))
        picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(planes), format="yuv444p")
        picture.colorspace = space
        container.mux(stream.encode(picture))
        container.mux(stream.encode())
    assert np.abs(read_picture(path, 0) - color).max() < 1.5 / 255


def test_a_view_of_videos_takes_frame_offset_and_matte(tmp_path) -> None:
    write_video(tmp_path / "v/c1.mp4", LEVELS)
    write_video(tmp_path / "m/c1.mp4", [16] * 6 + [235] * 18)
    job = a_job(tmp_path, images="v/{camera}.mp4", mattes="m/{camera}.mp4", first=2, offsets={"c1": 1})
    early, late = (read_view(job, "c1", calibrated(), frame) for frame in (6, 7))
    assert grey(early.radiance) == LEVELS[5], "frame 6 of a camera that is one late, first picture 2: position 5"
    assert (early.matte.max(), late.matte.min()) == (0, 1)


def gradient(size):
    """A smooth picture as function of pixel place, and its planes."""
    x, y = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
    return x.astype(np.float32), y.astype(np.float32)


BENT = Distortion("brown", (-0.12, 0.03, 0.001, -0.002))


def test_undistortion_takes_each_point_to_where_a_pinhole_sees_it() -> None:
    camera = replace(look_from((0, -1, 0), 64), distortion=BENT)
    taken = resampling(camera, None, "c")
    straight = undistorted_camera(camera, None, taken)
    assert not straight.lens().distortion.acts
    shown = np.stack([taken.apply(plane) for plane in gradient(64)], axis=-1)
    points = np.array([[0.2, 0.1, -0.3], [-0.5, 0, 0.6], [0.7, 0.2, 0.7]])
    for bent, plain in zip(camera.project(points), straight.project(points), strict=True):
        column, row = plain[0] - 0.5, plain[1] - 0.5
        left, top = int(column), int(row)
        a, b = column - left, row - top
        patch = shown[top : top + 2, left : left + 2]
        found = (1 - b) * ((1 - a) * patch[0, 0] + a * patch[0, 1]) + b * ((1 - a) * patch[1, 0] + a * patch[1, 1])
        assert np.allclose(found, bent[:2], atol=0.02)


@pytest.mark.parametrize("k", [(-0.2, 0.05, 0, 0), (0.15, -0.02, 0, 0)])
def test_an_undistorted_picture_has_a_source_at_every_pixel(k) -> None:
    camera = replace(look_from((0, -1, 0), 64), distortion=Distortion("brown", k))
    taken = resampling(camera, None, "c")
    for part in (taken.x, taken.y):
        assert part.min() > -0.01
        assert part.max() < 63.01
    assert taken.x.shape[1] > 50
    assert resampling(look_from((0, -1, 0), 64), None, "c") is None, "without distortion nothing is resampled"


def test_a_lens_too_wide_for_a_plane_is_refused() -> None:
    camera = replace(look_from((0, -1, 0), 64), fx=21.0, fy=21.0, distortion=Distortion("fisheye", (0, 0, 0, 0)))
    with pytest.raises(JobError, match=r"cannot be undone in the whole picture|sees so wide"):
        resampling(camera, None, "camera c9")


def test_a_distorted_capture_is_undistorted_when_it_is_read(tmp_path) -> None:
    x, y = gradient(SIZE)
    write_exr(tmp_path / "c1.exr", {"R": x, "G": y, "B": x, "A": np.ones_like(x)})
    view = read_view(a_job(tmp_path), "c1", calibrated(distortion=BENT), 1)
    assert view.radiance.shape[:2] == view.matte.shape == (view.camera.height, view.camera.width)
    assert not view.camera.distortion.acts
    plain = read_view(a_job(tmp_path), "c1", calibrated(), 1)
    assert np.array_equal(plain.radiance[..., 0], x)


def test_resize_fit_scales_and_centres_the_calibration(tmp_path) -> None:
    camera = look_from((0, -1, 0), SIZE)
    fitted = scaled_camera(camera, (24, 48))
    assert (fitted.width, fitted.height) == (24, 48)
    where = camera.project([[0.3, 0.2, 0.4]])[0, :2]
    assert np.allclose(fitted.project([[0.3, 0.2, 0.4]])[0, :2], 0.75 * where + [0, 12])
    planes = {c: np.ones((48, 24), np.float32) for c in "RGBA"}
    write_exr(tmp_path / "c1.exr", planes)
    with pytest.raises(JobError, match=r"camera c1 is 24x48.*32x32, as the calibration says.*`resize: fit`"):
        read_camera_picture(a_job(tmp_path), "c1", calibrated(), 1)
    assert read_camera_picture(a_job(tmp_path, resize="fit"), "c1", calibrated(), 1).camera.cy == fitted.cy


def test_videos_are_read_as_srgb(tmp_path) -> None:
    write_video(tmp_path / "v/c1.mp4", [126] * 12)
    job = a_job(tmp_path, images="v/{camera}.mp4")
    job = job.model_copy(update={"colors": replace(job.colors, capture=Conversion("srgb", "lin_rec709"))})
    encoded = (126 - 16) / 219
    linear = ((encoded + 0.055) / 1.055) ** 2.4
    assert read_camera_picture(job, "c1", calibrated(), 1).radiance.mean() == pytest.approx(linear, abs=1e-3)
