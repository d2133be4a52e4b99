"""Finds the source files that the machine code of a package's kernels depends on.

Numba freezes global values into machine code. A kernel module therefore depends on each module from which it imports a
kernel, a constant or a named tuple, or a function that it calls to compute a constant, and on what these modules depend
on in turn. All other functions and classes cannot reach a kernel: changes to them recompile nothing.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

PACKAGE = Path(__file__).parent.parent
"""The folder of `yesnt`."""

DECORATORS = ("yesnt.core.compiled", "yesnt.relight.compiled")
"""Modules that offer a decorator of kernels."""


def kernel_sources(package: str) -> tuple[Path, ...]:
    """Source files on which the kernels of a package (`yesnt.temporal`) depend, sorted; empty if it has no kernels."""
    folder = PACKAGE.joinpath(*package.split(".")[1:])
    waiting = [source for path in folder.glob("*.py") if (source := Source(path)).declares_kernels]
    found: set[Path] = set()
    while waiting:
        source = waiting.pop()
        if source.path not in found:
            found.add(source.path)
            waiting += source.dependencies()
    return tuple(sorted(found))


class Source:
    """One source file of yesnt."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.text = path.read_text(encoding="utf-8")

    @classmethod
    def of_module(cls, name: str) -> Source | None:
        """The source of a module by its dotted name, or None if yesnt has no such module."""
        base = PACKAGE.joinpath(*name.split(".")[1:])
        path = next((p for p in (base.with_suffix(".py"), base / "__init__.py") if p.is_file()), None)
        return None if path is None else cls(path)

    @property
    def tree(self) -> ast.Module:
        """The parsed file."""
        return _parse(self.text)

    @property
    def declares_kernels(self) -> bool:
        """Whether the file imports a decorator of kernels."""
        return any(f"from {module} import" in self.text for module in DECORATORS)

    def dependencies(self) -> Iterator[Source]:
        """Modules of yesnt from which this one imports something that can become part of a kernel."""
        computing = self._names_that_compute_globals()
        for node in ast.walk(self.tree):
            if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith("yesnt."):
                continue
            module = Source.of_module(node.module or "")
            for alias in node.names:
                submodule = Source.of_module(f"{node.module}.{alias.name}")
                if submodule is not None:
                    yield submodule
                elif module is not None and (alias.name in computing or module.offers_to_kernels(alias.name)):
                    yield module

    def offers_to_kernels(self, name: str) -> bool:
        """Whether a global name of this file is a kernel, a constant or a named tuple: no plain function or class."""
        for node in self.tree.body:
            if isinstance(node, ast.FunctionDef) and node.name == name:
                return bool(node.decorator_list) and self.declares_kernels
            if isinstance(node, ast.ClassDef) and node.name == name:
                return any("NamedTuple" in ast.unparse(base) for base in node.bases)
        return True

    def _names_that_compute_globals(self) -> set[str]:
        """Names in statements that run on import, apart from the bodies of functions and classes."""
        kinds = (ast.FunctionDef, ast.ClassDef, ast.Import, ast.ImportFrom)
        statements = [statement for statement in self.tree.body if not isinstance(statement, kinds)]
        return {node.id for one in statements for node in ast.walk(one) if isinstance(node, ast.Name)}


@lru_cache(maxsize=64)
def _parse(text: str) -> ast.Module:
    return ast.parse(text)
