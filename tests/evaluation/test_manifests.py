"""The embedded model has seen nothing of what it is measured on."""

import ast
from pathlib import Path

import pytest

import yesnt
from yesnt.stage.assets import MANIFEST
from yesnt.stage.jobs import SETS

PACKAGE = Path(yesnt.__file__).parent
MAKERS = sorted((PACKAGE / "decompose" / "synthetic").glob("*.py"))
READERS = {
    "open",
    "load",
    "imread",
    "read_image",
    "read_exr",
    "read_text",
    "read_bytes",
    "fromfile",
    "urlopen",
    "fetch",
}


def imports(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""


@pytest.mark.parametrize("path", MAKERS, ids=lambda path: path.stem)
def test_training_pictures_are_made_from_nothing(path):
    """The manifest of the training data is empty: its makers read no file and know nothing of the stage."""
    tree = ast.parse(path.read_text())
    assert not [name for name in imports(tree) if name.startswith(("yesnt.stage", "yesnt.io", "yesnt.data", "urllib"))]
    called = {
        getattr(node.func, "attr", getattr(node.func, "id", ""))
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
    }
    assert not called & READERS


def test_training_takes_its_pictures_from_these_makers_alone():
    tree = ast.parse((PACKAGE / "decompose" / "training.py").read_text())
    assert not [
        name for name in imports(tree) if name.startswith(("yesnt.stage", "yesnt.evaluation", "yesnt.embedded"))
    ]
    assert any(name.startswith("yesnt.training.synthetic") for name in imports(tree))


def test_nothing_of_the_stage_is_named_where_training_pictures_are_made():
    source = "\n".join(path.read_text() for path in MAKERS)
    assert MAKERS
    named = [asset.member for asset in MANIFEST.values()] + [asset.sha256 for asset in MANIFEST.values()]
    named += [subject for stage_set in SETS.values() for subject in stage_set.subjects if "_" in subject]
    assert not [name for name in named if name in source]
