"""The layers of ARCHITECTURE.md: imports run downwards only, kernels touch no files, nothing below the CLI prints."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "yesnt"

LAYERS = (
    ("core",),
    ("temporal", "relight", "decompose", "scene", "metrics"),
    ("io", "capture_stage", "training"),
    ("planning", "tasks"),
    ("workflows",),
    ("runtime", "inspect"),
    ("measure",),
    ("report", "cli", "__main__"),
)
LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names}
FORBIDDEN_IN_KERNELS = {"dask", "distributed", "zarr", "OpenImageIO", "OpenEXR"}

GRANTED = {
    ("relight", "io"),  # EnvMap.open, which contract.md wants as a constructor
}
"""Upward imports that are there on purpose."""

MODULES = sorted(p for p in PACKAGE.rglob("*.py") if "inside_" not in str(p) and p != PACKAGE / "__init__.py")


def _part(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def _imports(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.update([node.module] + [f"{node.module}.{alias.name}" for alias in node.names])
    return names


def _ids(path: Path) -> str:
    return str(path.relative_to(PACKAGE))


@pytest.mark.parametrize("path", MODULES, ids=_ids)
def test_imports_run_downwards(path: Path) -> None:
    here = _part(path)
    assert here in LEVEL, f"{here} has no layer: add it to LAYERS and to ARCHITECTURE.md"
    parts = {name.split(".")[1] for name in _imports(path) if name.startswith("yesnt.") and name.count(".") >= 1}
    upward = {part for part in parts & set(LEVEL) if LEVEL[part] > LEVEL[here] and (here, part) not in GRANTED}
    assert not upward, f"{path} imports {upward} from a layer above"


@pytest.mark.parametrize("path", [p for p in MODULES if LEVEL.get(_part(p)) == 1], ids=_ids)
def test_kernels_know_no_files(path: Path) -> None:
    roots = {name.split(".")[0] for name in _imports(path)}
    assert not roots & FORBIDDEN_IN_KERNELS


@pytest.mark.parametrize("path", [p for p in MODULES if _part(p) != "cli"], ids=_ids)
def test_only_the_command_line_prints(path: Path) -> None:
    calls = [
        n.func.id
        for n in ast.walk(ast.parse(path.read_text()))
        if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)
    ]
    assert "print" not in calls


def test_every_module_has_a_layer_and_every_layer_a_module() -> None:
    parts = {_part(path) for path in MODULES}
    assert parts - {"__init__"} <= set(LEVEL)


def test_help_is_fast_because_nothing_heavy_is_imported() -> None:
    import subprocess
    import sys

    heavy = "torch numba zarr distributed dask cv2 trimesh OpenImageIO OpenEXR pydantic yaml numpy scipy".split()
    code = f"import sys, yesnt.cli.app; print([m for m in {heavy} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"


def test_no_module_is_called_utils() -> None:
    assert not [p for p in PACKAGE.rglob("*.py") if "util" in p.stem]
