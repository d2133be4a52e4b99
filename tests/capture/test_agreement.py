from dataclasses import replace

import numpy as np
import pytest

from tests.capture.balls import silhouettes
from yesnt.capture.agreement import Agreement, estimate_gains, estimate_offsets, find_mistakes
from yesnt.capture.hull import visual_hull

BODY = (((0, 0, 0.2), 0.45), ((0.5, 0.1, 0.7), 0.2), ((-0.2, 0.4, -0.6), 0.25), ((0.25, -0.3, -0.7), 0.15))
"""A lopsided subject: its mirror image is another."""

HEIGHTS = (0.1, 0.5, 0.2, -0.3, 0.4, 0.1, 0.6)
WAYS = [(np.cos(a), np.sin(a), e) for a, e in zip(np.linspace(0.3, 5.4, 7), HEIGHTS, strict=True)]


@pytest.fixture(scope="module")
def views():
    return silhouettes(WAYS, 80, BODY)


def changed(views, number, matte):
    return [replace(view, matte=matte) if n == number else view for n, view in enumerate(views)]


def test_cameras_that_agree_have_no_finding(views) -> None:
    assert Agreement(views).covered([view.matte for view in views]).min() > 0.97
    assert find_mistakes(views) == ()


def test_an_inverted_matte_is_named(views) -> None:
    (found,) = find_mistakes(changed(views, 2, 1 - views[2].matte))
    assert found.cameras == ("c02",)
    assert "The matte of camera c02 is inverted: it covers the picture's border" in found.text
    assert "Do: write coverage as 1 on the subject and 0 around it." in found.text


def test_a_mirrored_camera_is_named(views) -> None:
    (found,) = find_mistakes(changed(views, 4, np.ascontiguousarray(views[4].matte[:, ::-1])))
    assert found.cameras == ("c04",)
    assert found.text.startswith("The picture of camera c04 is mirrored (of the worst matte ")
    assert found.after > 0.95


def test_cameras_in_the_wrong_order_are_named(views) -> None:
    swapped = changed(changed(views, 1, views[5].matte), 5, views[1].matte)
    (found,) = find_mistakes(swapped)
    assert found.cameras == ("c01", "c05")
    assert "Cameras c01 and c05 are in the wrong order: each has the other's pictures" in found.text


def test_a_camera_that_contradicts_all_others_is_named(views) -> None:
    elsewhere = silhouettes(WAYS, 80, (((0.9, 0, 0.0), 0.1),))
    (found,) = find_mistakes(changed(views, 3, elsewhere[3].matte))
    assert found.cameras == ("c03",)
    assert "Camera c03 contradicts all others" in found.text
    assert "`capture.offsets`" in found.text


def moving(frame):
    shift = np.array([0.12 * frame, 0.05 * frame, 0.03 * frame])
    return tuple((tuple(np.array(centre) + shift), radius) for centre, radius in BODY)


def test_a_camera_out_of_time_is_found() -> None:
    moments = {frame: silhouettes(WAYS[:5], 64, moving(frame)) for frame in range(-2, 4)}
    late = {f: [replace(v, matte=moments[max(f - 1, -2)][n].matte) if n == 3 else v for n, v in enumerate(views)]
            for f, views in moments.items()}  # fmt: skip
    assert estimate_offsets(moments, 1) == dict.fromkeys(("c00", "c01", "c02", "c03", "c04"), 0)
    found = estimate_offsets(late, 1)
    assert found["c03"] == 1
    assert set(found[name] for name in ("c00", "c01", "c02", "c04")) <= {0}


def test_gains_are_found(views) -> None:
    hull = visual_hull(views, 40)
    pictures = [np.full((80, 80, 3), 0.4 * (2.0 if n == 2 else 1.0), np.float32) for n in range(len(views))]
    gains = estimate_gains(hull.points, hull.normals, list(zip(views, pictures, strict=True)))
    assert gains["c02"][0] / gains["c00"][0] == pytest.approx(0.5, rel=1e-3)
    assert gains["c01"][1] / gains["c00"][1] == pytest.approx(1, rel=1e-3)
