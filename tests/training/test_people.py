import numpy as np
import pytest

from tests.training.puppet import puppet
from yesnt.capture_stage.garments import athlete, courtier, explorer, performer
from yesnt.training.bodies import PHENOTYPE, draw_phenotype, draw_pose
from yesnt.training.garments import draw_garments
from yesnt.training.image_archive import (
    PEOPLE,
    STYLE_GROUPS,
    VIEWS,
    interleaved_people,
    make_person,
    open_views,
    person_path,
    style_of,
)
from yesnt.training.people import HEIGHT, WIDTH, draw_person, render_person
from yesnt.training.synthetic.materials import CLASSES


@pytest.fixture(scope="module")
def body():
    return puppet()


@pytest.fixture(scope="module")
def views(body):
    rng = np.random.default_rng(3)
    person = draw_person(rng, body)
    return person, [render_person(rng, person) for _ in range(4)]


def test_phenotypes_are_shapes_and_differ():
    drawn = [draw_phenotype(0, n) for n in range(10)]
    assert all(set(shape) == set(PHENOTYPE) and all(0 <= v <= 1 for v in shape.values()) for shape in drawn)
    assert len({tuple(shape.values()) for shape in drawn}) == 10
    assert drawn[3] == draw_phenotype(0, 3)


def test_poses_turn_bones_that_exist(body):
    for seed in range(20):
        pose = draw_pose(np.random.default_rng(seed), body)
        assert set(pose) <= set(body.bones)
        for rotation in pose.values():
            np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)


def test_everybody_has_skin_and_every_garment_a_material():
    metals = 0
    for seed in range(60):
        garments = draw_garments(np.random.default_rng(seed))
        assert garments.layers[0].name == "skin"
        assert garments.layers[0].where == ()
        assert len(garments.materials()) == len(garments.frozen_layers())
        assert ((garments.materials()["roughness"] > 0) & (garments.materials()["roughness"] <= 1)).all()
        metals += int((garments.materials()["metallic"] == 1).any())
    assert 15 < metals < 60


def test_no_garment_of_the_stage_is_drawn():
    """Regions are drawn from intervals: only those that the body determines equal a region of a measured subject."""
    measured = {layer.where for make in (athlete, courtier, explorer, performer) for layer in make() if layer.where}
    drawn = [layer for seed in range(200) for layer in draw_garments(np.random.default_rng(seed)).layers]
    assert {layer.name for layer in drawn if layer.where in measured} <= {"lips", "eyes", "collar", "toe caps"}


def test_images_are_plausible(views):
    person, images = views
    for image in images:
        assert image.rgb.shape == (3, HEIGHT, WIDTH)
        inside = image.matte > 0
        assert 0.02 < inside.mean() < 1
        assert np.isfinite(image.rgb).all()
        assert (image.rgb >= 0).all()
        assert (image.rgb[:, ~inside] == 0).all()
        assert (image.kind[inside] >= 0).all()
        assert (image.kind[~inside] == -1).all()
        roughness, metallic = image.truth[:, inside]
        assert (roughness >= 0.02).all()
        assert (roughness <= 1).all()
        assert set(np.unique(metallic)) <= {0, 1}
    worn = {list(CLASSES)[kind] for kind in person.garments.materials()["kind"]}
    shown = {list(CLASSES)[k] for image in images for k in np.unique(image.kind) if k >= 0}
    assert shown <= worn


def test_a_plate_is_no_brighter_than_its_light_allows(views):
    """Mean radiance of the light is 1: a surface that only reflects stays near or below its brightest panels."""
    _, images = views
    assert all(np.median(image.rgb[:, image.matte == 1]) < 1.2 for image in images)


def test_an_archive_is_made_once_and_is_a_function_of_seed_and_number(tmp_path, monkeypatch, body):
    monkeypatch.setattr("yesnt.training.image_archive.open_body", lambda path: body)
    first, second = tmp_path / "a", tmp_path / "b"
    assert make_person(first, 0, 5, [tmp_path])
    assert not make_person(first, 0, 5, [tmp_path])
    assert make_person(second, 0, 5, [tmp_path])
    for a, b in zip(open_views(person_path(first, 0, 5)), open_views(person_path(second, 0, 5)), strict=True):
        for name in ("rgb", "matte", "truth", "kind"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert len(open_views(person_path(first, 0, 5))) == VIEWS


def test_any_beginning_of_the_archive_has_its_share_of_every_wardrobe():
    numbers = interleaved_people()
    assert sorted(numbers) == list(range(PEOPLE))
    beginning = [style_of(number) for number in numbers[:80]]
    for count, style in STYLE_GROUPS:
        assert beginning.count(style) == pytest.approx(80 * count / PEOPLE, abs=1)
    with pytest.raises(ValueError, match="people"):
        style_of(PEOPLE)
