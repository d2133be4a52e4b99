import numpy as np
import pytest

from yesnt.capture_stage.shapes import drape, knot, vase
from yesnt.training.image_archive import OBJECT_VIEWS, make_object, object_path, open_views
from yesnt.training.procedural_objects import SIDE, draw_object, render_object
from yesnt.training.solids import SOLIDS, _frames, _volume, block, drapery, tube, vessel
from yesnt.training.synthetic.materials import CLASSES

BUILDERS = sorted({*SOLIDS, block}, key=lambda build: build.__name__)


def rng(*key):
    return np.random.Generator(np.random.Philox(key=list(key)))


@pytest.mark.parametrize("build", BUILDERS, ids=lambda build: build.__name__)
def test_surfaces_are_finite_closed_to_the_outside_and_of_about_unit_size(build):
    for number in range(12):
        solid = build(rng(1, number))
        assert np.isfinite(solid.vertices).all()
        assert 0.3 < np.ptp(solid.vertices, axis=0).max() < 4
        assert solid.faces.min() >= 0
        assert solid.faces.max() < len(solid.vertices)
        assert len(solid.along) == len(solid.uv) == len(solid.vertices)
        assert (solid.along >= 0).all()
        if build is not drapery:  # whose second layer encloses nothing
            assert _volume(solid.vertices, solid.faces) > 0


@pytest.mark.parametrize("closed", [True, False])
def test_frames_of_a_curve_are_orthonormal_and_turn_little(closed):
    t = np.arange(400) / 400 * 2 * np.pi
    curve = np.stack([np.cos(t), np.sin(2 * t), 0.3 * np.sin(3 * t)], -1)
    side, above = _frames(curve, closed)
    np.testing.assert_allclose(np.linalg.norm(side, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(np.einsum("ij,ij->i", side, above), 0, atol=1e-6)
    steps = np.einsum("ij,ij->i", side, np.roll(side, 1, 0))
    assert steps[1:].min() > 0.9
    if closed:
        assert steps[0] > 0.9  # no seam where it closes


def test_no_shape_of_the_stage_is_drawn():
    """Random profiles never meet a measured one: compared by their sorted distances from the middle."""

    def profile(vertices):
        reach = np.sort(np.linalg.norm(vertices - vertices.mean(0), axis=1))
        return np.interp(np.linspace(0, 1, 200), np.linspace(0, 1, len(reach)), reach / reach[-1])

    for shape, build in ((knot, tube), (vase, vessel), (drape, drapery)):
        measured = profile(shape()[0])
        drawn = [profile(build(rng(0, number)).vertices) for number in range(40)]
        assert min(np.abs(other - measured).max() for other in drawn) > 0.01


def test_objects_are_plausible_images():
    for number in range(8):
        source = rng(5, number)
        drawn = draw_object(source)
        image = render_object(source, drawn)
        inside = image.matte > 0
        assert image.rgb.shape == (3, SIDE, SIDE)
        assert 0.01 < inside.mean() < 1
        assert np.isfinite(image.rgb).all()
        assert (image.rgb >= 0).all()
        assert (image.rgb[:, ~inside] == 0).all()
        # Nothing is seen from its back: lit from all sides, no surface is black.
        solid = image.matte == 1
        assert np.median(image.rgb[:, solid].max(0)) > 0.005
        names = {list(CLASSES)[k] for k in np.unique(image.kind) if k >= 0}
        assert names <= {list(CLASSES)[k] for k in drawn.materials["kind"]}
        assert set(np.unique(image.truth[1][inside])) <= {0, 1}


def test_a_third_of_all_objects_have_metal_on_them():
    metals = [bool((draw_object(rng(6, number)).materials["metallic"] == 1).any()) for number in range(150)]
    assert 0.2 < np.mean(metals) < 0.6


def test_an_archive_of_objects_is_a_function_of_seed_and_number(tmp_path):
    assert make_object(tmp_path / "a", 0, 3)
    assert not make_object(tmp_path / "a", 0, 3)
    assert make_object(tmp_path / "b", 0, 3)
    first, second = (open_views(object_path(tmp_path / name, 0, 3)) for name in "ab")
    assert len(first) == OBJECT_VIEWS
    for a, b in zip(first, second, strict=True):
        for name in ("rgb", "matte", "truth", "kind"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
