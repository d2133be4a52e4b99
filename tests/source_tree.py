"""The package's source as syntax trees: modules (links included), their imports, functions, names and docstrings."""

from __future__ import annotations

import ast
import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGE = "yesnt"

FunctionNode = ast.FunctionDef | ast.AsyncFunctionDef
Documented = FunctionNode | ast.ClassDef


@dataclass(frozen=True)
class Function:
    """A function or method.

    Attributes:
        name: qualified name inside its module, as `Class.method`.
        node: its syntax tree.
        module: the module's name without the package's.
    """

    name: str
    node: FunctionNode
    module: str

    def __str__(self) -> str:
        return f"{self.module}.{self.name}"

    @property
    def lines(self) -> int:
        """Lines from `def` to the end, without decorators and docstring."""
        whole = (self.node.end_lineno or self.node.lineno) - self.node.lineno + 1
        if ast.get_docstring(self.node, clean=False) is None:
            return whole
        docstring = self.node.body[0]
        return whole - ((docstring.end_lineno or docstring.lineno) - docstring.lineno + 1)

    @property
    def parameters(self) -> int:
        """Parameters without `self`, `cls`, `*args` and `**kwargs`."""
        found = self.node.args
        names = [a.arg for a in (*found.posonlyargs, *found.args, *found.kwonlyargs)]
        return len(names) - (names[:1] in (["self"], ["cls"]))


@dataclass(frozen=True)
class Module:
    """A module.

    Attributes:
        name: dotted name without the package's; "" for the package itself.
        path: its file, through links.
    """

    name: str
    path: Path

    def __str__(self) -> str:
        return self.name

    @cached_property
    def tree(self) -> ast.Module:
        """The syntax tree."""
        return ast.parse(self.path.read_text(encoding="utf-8"))

    @cached_property
    def imports(self) -> frozenset[str]:
        """Everything imported anywhere, in functions and for type checkers too, as dotted names."""
        names: set[str] = set()
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                names.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                names.update(f"{self._base(node)}.{alias.name}" for alias in node.names)
        return frozenset(names)

    def _base(self, node: ast.ImportFrom) -> str:
        """The absolute name of what a `from` import imports from."""
        if not node.level:
            return node.module or ""
        package = [PACKAGE, *self.name.split(".")]
        package = package[: len(package) - node.level + (self.path.name == "__init__.py")]
        return ".".join([*package, *([node.module] if node.module else [])])

    @cached_property
    def functions(self) -> tuple[Function, ...]:
        """All functions and methods, nested ones too."""
        return tuple(self._functions(self.tree, ""))

    def _functions(self, node: ast.AST, prefix: str) -> Iterator[Function]:
        for child in ast.iter_child_nodes(node):
            name = f"{prefix}{child.name}" if isinstance(child, Documented) else ""
            if isinstance(child, FunctionNode):
                yield Function(name, child, self.name)
            yield from self._functions(child, f"{name}." if name else prefix)

    @cached_property
    def documented(self) -> tuple[tuple[str, Documented], ...]:
        """Classes, functions and methods with qualified names."""
        return tuple(self._documented(self.tree, ""))

    def _documented(self, node: ast.AST, prefix: str) -> Iterator[tuple[str, Documented]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, Documented):
                yield f"{prefix}{child.name}", child
                if isinstance(child, ast.ClassDef):
                    yield from self._documented(child, f"{prefix}{child.name}.")

    @cached_property
    def called(self) -> frozenset[str]:
        """Names of what is called: `open`, `.read_text`."""
        names = set()
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Call):
                if isinstance(node.func, ast.Name):
                    names.add(node.func.id)
                elif isinstance(node.func, ast.Attribute):
                    names.add(f".{node.func.attr}")
        return frozenset(names)

    @cached_property
    def identifiers(self) -> frozenset[str]:
        """Names that the module gives: functions, classes, variables, parameters, attributes, keyword arguments."""
        names: set[str] = set(self.name.split("."))
        for node in ast.walk(self.tree):
            if isinstance(node, Documented):
                names.add(node.name)
            elif isinstance(node, ast.Name):
                names.add(node.id)
            elif isinstance(node, ast.arg):
                names.add(node.arg)
            elif isinstance(node, ast.keyword) and node.arg:
                names.add(node.arg)
            elif isinstance(node, ast.Attribute):
                names.add(node.attr)
        return frozenset(names)

    @cached_property
    def docstrings(self) -> tuple[str, ...]:
        """Docstrings of the module, its classes, functions and variables (a bare string after an assignment)."""
        found = []
        for node in ast.walk(self.tree):
            body = getattr(node, "body", None)
            for statement in body if isinstance(body, list) else ():
                if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
                    if isinstance(statement.value.value, str):
                        found.append(statement.value.value)
        return tuple(found)


@dataclass(frozen=True)
class SourceTree:
    """All modules of a package.

    Attributes:
        root: the folder that holds the package's folder.
    """

    root: Path = ROOT

    @cached_property
    def modules(self) -> tuple[Module, ...]:
        """Every module, in linked folders too, sorted by name."""
        home = self.root / PACKAGE
        paths = (Path(folder) / f for folder, _, files in os.walk(home, followlinks=True) for f in files)
        found = [Module(self._name(path), path) for path in paths if path.suffix == ".py"]
        return tuple(sorted(found, key=lambda module: module.name))

    def _name(self, path: Path) -> str:
        parts = path.relative_to(self.root / PACKAGE).with_suffix("").parts
        return ".".join(part for part in parts if part != "__init__")

    @cached_property
    def functions(self) -> tuple[Function, ...]:
        """Functions and methods of all modules."""
        return tuple(function for module in self.modules for function in module.functions)

    @cached_property
    def edges(self) -> dict[str, frozenset[str]]:
        """Which modules of the package each module imports, by name."""
        names = frozenset(module.name for module in self.modules)
        return {module.name: frozenset(_imported(module, names)) for module in self.modules}


def _imported(module: Module, names: frozenset[str]) -> Iterator[str]:
    for dotted in module.imports:
        first, _, name = dotted.partition(".")
        if first == "workflows":  # the linked folder under its own name
            name = dotted
        elif first != PACKAGE:
            continue
        while name and name not in names:  # `from yesnt.a.b import f` imports the module a.b
            name = name.rpartition(".")[0]
        if name and name != module.name:
            yield name
