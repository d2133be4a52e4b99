"""The rules of ARCHITECTURE.md and CONTRIBUTING.md hold for every module, linked ones too, and each rule can fail."""

from __future__ import annotations

import statistics
import subprocess
import sys
from pathlib import Path

import pytest

from tests.architecture_rules import RULES
from tests.source_tree import SourceTree

TREE = SourceTree()


@pytest.mark.parametrize("rule", RULES)
def test_the_rule_holds(rule: str) -> None:
    found = list(RULES[rule](TREE))
    assert not found, "\n".join(found)


def test_linked_modules_are_seen() -> None:
    names = {module.name for module in TREE.modules}
    assert {"workflows.shot", "core.errors", "capture_stage.inside_blender.main", "cli.app"} <= names


PLANTED = {
    "without_layer": ("elsewhere.py", '"""A module."""\n', "elsewhere has no layer"),
    "upward_imports": (
        "workflows/shot.py",
        '"""A workflow."""\n\n\ndef f():\n    """Does."""\n    from yesnt.runtime.driver import g\n',
        "workflows.shot (workflows) imports runtime.driver (runs)",
    ),
    "imports_from_other_interpreters": (
        "capture_stage/inside_blender/main.py",
        '"""Runs in Blender."""\nfrom yesnt.core import errors\n',
        "capture_stage.inside_blender.main imports core.errors",
    ),
    "files_in_kernels": (
        "relight/kernels.py",
        '"""A kernel."""\n\n\ndef f(path):\n    """Does."""\n    return path.read_text()\n',
        "relight.kernels uses .read_text",
    ),
    "prints_below_the_command_line": ("io/exr.py", '"""Files."""\nprint("x")\n', "io.exr"),
    "cycles": (
        "core/errors.py",
        '"""Errors."""\nfrom yesnt.runtime import driver\n',
        "core.errors imports itself through others",
    ),
    "long_files": ("io/exr.py", '"""Files."""\n' + "x = 1\n" * 400, "io.exr: 401 lines"),
    "long_functions": (
        "io/exr.py",
        '"""Files."""\n\n\ndef f():\n    """Does."""\n' + "    x = 1\n" * 50,
        "io.exr.f: 51 lines",
    ),
    "many_parameters": (
        "io/exr.py",
        '"""Files."""\n\n\nclass A:\n    """Is."""\n\n    def f(self, a, b, c, d, e, f, g, h, *, i): ...\n',
        "io.exr.A.f: 9 parameters",
    ),
    "without_docstring": (
        "io/exr.py",
        '"""Files."""\n\n\nclass A:\n    """Is."""\n\n    def f(self): ...\n',
        "io.exr.A.f",
    ),
    "forbidden_words": (
        "io/exr.py",
        '"""Files."""\n\n\ndef read(glow_scale):\n    """Reads."""\n',
        "io.exr: glow, write indirect radiance",
    ),
    "archaic_phrases": ("io/exr.py", '"""Reads,\nas ever."""\n', "io.exr: as ever"),
    "idle_grants": ("core/camera.py", '"""A camera."""\n', "core.camera no longer uses .read_text"),
}
"""For each rule a module that breaks it, and what the rule must say."""


def small_package(root: Path) -> Path:
    """A package that keeps every rule of imports, with workflows/ behind a link as in the project."""
    home = root / "yesnt"
    modules = {
        "core/errors.py": "",
        "core/camera.py": "def open(path):\n    return path.read_text()\n",
        "io/exr.py": "",
        "runtime/driver.py": "from yesnt.core import errors\n",
    }
    (root / "workflows").mkdir(parents=True)
    home.mkdir()
    (home / "workflows").symlink_to("../workflows")
    for name, code in modules.items():
        (home / name).parent.mkdir(exist_ok=True)
        (home / name).write_text(f'"""A module."""\n{code}')
    return home


@pytest.mark.parametrize("rule", RULES)
def test_the_rule_finds_what_breaks_it(rule: str, tmp_path: Path) -> None:
    name, text, expected = PLANTED[rule]
    home = small_package(tmp_path)
    assert expected not in list(RULES[rule](SourceTree(tmp_path)))
    (home / name).parent.mkdir(parents=True, exist_ok=True)
    (home / name).write_text(text)
    assert expected in list(RULES[rule](SourceTree(tmp_path)))


def test_functions_are_short() -> None:
    lengths = sorted(function.lines for function in TREE.functions)
    assert statistics.median(lengths) <= 8
    assert lengths[int(0.95 * len(lengths))] <= 30


def test_help_is_fast_because_nothing_heavy_is_imported() -> None:
    heavy = "torch numba zarr distributed dask cv2 trimesh OpenImageIO OpenEXR pydantic yaml numpy scipy".split()
    code = f"import sys, yesnt.cli.app; print([m for m in {heavy} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"


def test_no_module_is_called_utils() -> None:
    assert not [module for module in TREE.modules if "util" in module.name]
