"""The embedded model has seen nothing of what it is measured on."""

import ast
from pathlib import Path

import pytest

import yesnt
from yesnt.capture_stage import garments
from yesnt.capture_stage.assets import MANIFEST
from yesnt.capture_stage.jobs import SETS
from yesnt.capture_stage.subjects import SUBJECTS, Human
from yesnt.training.bodies import BODIES, draw_phenotype

PACKAGE = Path(yesnt.__file__).parent
TRAINING = sorted((PACKAGE / "training").rglob("*.py"))
SHARED_WITH_THE_STAGE = {"cameras", "material_layers", "pose", "tools", "costume"}
"""How a body is bent and dressed, with no body, garment, motion, map or camera path of the sets among it."""

READERS = {"imread", "read_image", "read_exr", "read_text", "read_bytes", "fromfile", "urlopen", "fetch"}


def imports(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""


@pytest.mark.parametrize("path", TRAINING, ids=lambda path: path.stem)
def test_training_knows_nothing_of_the_sets_and_reads_no_picture_of_others(path):
    tree = ast.parse(path.read_text())
    named = list(imports(tree))
    parts = {name.split(".")[2] for name in named if name.startswith("yesnt.capture_stage.")}
    assert parts <= SHARED_WITH_THE_STAGE
    assert "yesnt.capture_stage" not in named
    elsewhere = ("yesnt.data", "yesnt.io.embedded_shot", "yesnt.measure.evaluation", "urllib")
    assert not [name for name in named if name.startswith(elsewhere)]
    called = {
        getattr(node.func, "attr", getattr(node.func, "id", ""))
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
    }
    assert not called & READERS


def test_no_measured_body_is_trained_on():
    """The manifest of the training's people is their phenotypes; the sets' are those of `SUBJECTS`."""
    measured = [dict(subject.phenotype) for subject in SUBJECTS.values() if isinstance(subject, Human)]
    trained = [draw_phenotype(0, number) for number in range(BODIES)]
    assert measured
    for mine in measured:
        nearest = min(max(abs(mine.get(k, 0.5) - shape[k]) for k in shape) for shape in trained)
        assert nearest > 0.02


def test_nothing_of_the_stage_is_named_where_training_pictures_are_made():
    source = "\n".join(path.read_text() for path in TRAINING)
    assert TRAINING
    named = [asset.member for asset in MANIFEST.values()] + [asset.sha256 for asset in MANIFEST.values()]
    named += [subject for stage_set in SETS.values() for subject in stage_set.subjects if "_" in subject]
    named += [name for name in vars(garments) if name.islower() and not name.startswith("_") and name != "annotations"]
    assert not [name for name in named if name in source]
