"""Mutants of a source file: one small change of its meaning each, made in the text so that all other lines stay."""

from __future__ import annotations

import ast
import difflib
import hashlib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

JIT_DECORATORS = {
    "njit", "compiled", "kernel", "exact_kernel", "entry", "exact_entry", "inlined", "exact_inlined", "stencil",
    "listing",
}  # fmt: skip
"""Names under which the project compiles functions."""

ARITHMETIC = {"+": "-", "-": "+", "*": "/", "/": "*", "//": "/", "%": "*", "**": "*", "&": "|", "|": "&", "@": None}
COMPARISON = {
    "<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==", "is": "is not", "is not": "is",
    "in": "not in", "not in": "in",
}  # fmt: skip
BOOLEAN = {"and": "or", "or": "and"}
OPERATORS = ("arithmetic", "comparison", "boolean", "constant", "return", "negation", "argument")

COMMUTATIVE = {"max", "min", "maximum", "minimum", "hypot", "logical_and", "logical_or", "multiply", "isclose"}
"""Functions of two arguments whose order does not matter."""

Span = tuple[int, int]


@dataclass(frozen=True)
class Mutant:
    """One change.

    Attributes:
        file: path from the project's root.
        function: qualified name of the function around it; "" at the top of a module.
        jitted: whether the function, or one around it, is compiled.
        operator: one of `OPERATORS`.
        line: 1-based line in the file that was read.
        span: bytes of the file that are replaced.
        before: their text.
        after: the text that replaces them.
        nth: which of the equal changes in this function it is.
    """

    file: str
    function: str
    jitted: bool
    operator: str
    line: int
    span: Span
    before: str
    after: str
    nth: int = 0

    @property
    def folder(self) -> str:
        """The package's folder that it lies in."""
        return Path(self.file).parts[1]

    @property
    def id(self) -> str:
        """The same for the same change in the same function, wherever that stands in its file."""
        text = "\0".join((self.file, self.function, self.operator, self.before, self.after, str(self.nth)))
        return hashlib.blake2b(text.encode(), digest_size=5).hexdigest()

    def apply(self, source: bytes) -> bytes:
        """The file's bytes with the change."""
        start, stop = self.span
        assert source[start:stop].decode() == self.before
        return source[:start] + self.after.encode() + source[stop:]

    def diff(self, source: bytes) -> str:
        """The change as a unified diff without context."""
        before, after = (text.decode().splitlines() for text in (source, self.apply(source)))
        lines = list(difflib.unified_diff(before, after, self.file, self.file, n=0, lineterm=""))
        return "\n".join(lines[2:])


def find_mutants(root: Path, path: Path) -> list[Mutant]:
    """All mutants of a file."""
    source = path.read_bytes()
    visitor = _Visitor(source, str(path.relative_to(root)))
    visitor.visit(ast.parse(source))
    seen, numbered = Counter[str](), []
    for mutant in visitor.found:
        numbered.append(Mutant(**{**mutant.__dict__, "nth": seen[mutant.id]}))
        seen[mutant.id] += 1
    return numbered


class _Visitor(ast.NodeVisitor):
    """Walks a module and collects changes; leaves out what is no behaviour (see `_skipped`)."""

    def __init__(self, source: bytes, file: str) -> None:
        self._source, self._file = source, file
        self._starts = [0]
        for line in source.splitlines(keepends=True):
            self._starts.append(self._starts[-1] + len(line))
        self._names: list[str] = []
        self._jitted = [False]
        self.found: list[Mutant] = []

    def generic_visit(self, node: ast.AST) -> None:
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list", "type_comment", "bases", "type_params"):
                continue
            for child in value if isinstance(value, list) else (value,):
                if isinstance(child, ast.AST) and not _skipped(child):
                    self.visit(child)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        self._jitted.append(self._jitted[-1] or bool(JIT_DECORATORS & set(map(_root_name, node.decorator_list))))
        self._inside(node)
        self._jitted.pop()

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        self._inside(node)

    def _inside(self, node: ast.FunctionDef | ast.ClassDef) -> None:
        self._names.append(node.name)
        self.generic_visit(node)
        self._names.pop()

    def visit_BinOp(self, node: ast.BinOp) -> None:
        self._operator("arithmetic", ARITHMETIC, node.left, node.right)
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        self._operator("arithmetic", ARITHMETIC, node.target, node.value, "=")
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        for left, right in zip([node.left, *node.comparators], node.comparators, strict=False):
            self._operator("comparison", COMPARISON, left, right)
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        self._operator("boolean", BOOLEAN, node.values[0], node.values[1])
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        value = node.value
        if isinstance(value, bool):
            self._replace("constant", node, str(not value))
        elif isinstance(value, int):
            self._replace("constant", node, str(value + 1))
        elif isinstance(value, float):
            self._replace("constant", node, repr(value * 2 if value else 1.0))

    def visit_Return(self, node: ast.Return) -> None:
        if node.value is not None and not self._jitted[-1] and not _is_none(node.value):
            self._replace("return", node.value, "None")
        self.generic_visit(node)

    def visit_If(self, node: ast.If) -> None:
        self._negate(node.test)
        self.generic_visit(node)

    visit_While = visit_If  # type: ignore[assignment]

    def visit_IfExp(self, node: ast.IfExp) -> None:
        self._negate(node.test)
        self.generic_visit(node)

    def visit_comprehension(self, node: ast.comprehension) -> None:
        for test in node.ifs:
            self._negate(test)
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        first, second = (*node.args, None, None)[:2]
        ordered = _root_name(node.func) not in COMMUTATIVE and not isinstance(first, ast.Starred)
        if first is not None and second is not None and ordered:
            span = (self._span(first)[0], self._span(second)[1])
            between = self._text((self._span(first)[1], self._span(second)[0]))
            self._add("argument", span, f"{self._of(second)}{between}{self._of(first)}", node)
        if node.keywords and not self._jitted[-1]:
            last = node.keywords[-1]
            start = self._before_last_keyword(node)
            self._add("argument", (start, self._span(last)[1]), "", last)
        self.generic_visit(node)

    def _before_last_keyword(self, node: ast.Call) -> int:
        """Where what stands before the last keyword ends."""
        others = [*node.args, *(k for k in node.keywords[:-1])]
        ends = [self._span(other)[1] for other in others]
        return max(ends) if ends else self._span(node.keywords[-1])[0]

    def _negate(self, test: ast.expr) -> None:
        self._replace("negation", test, f"(not ({self._of(test)}))")

    def _operator(
        self, kind: str, table: dict[str, str | None] | dict[str, str], left: ast.AST, right: ast.AST, tail: str = ""
    ) -> None:
        """Replaces the operator that stands between two operands, parentheses and comments aside."""
        span = (self._span(left)[1], self._span(right)[0])
        text = self._text(span)
        symbol = text.strip("() \t\r\n\\").removesuffix(tail)
        after = table.get(symbol)
        if after is not None and text.count(symbol) == 1:
            start = span[0] + text.encode().index(symbol.encode())
            self._add(kind, (start, start + len(symbol.encode())), after, right)

    def _replace(self, kind: str, node: ast.AST, after: str) -> None:
        self._add(kind, self._span(node), after, node)

    def _add(self, kind: str, span: Span, after: str, node: ast.AST) -> None:
        line = getattr(node, "lineno", 0)
        where = (self._file, ".".join(self._names), self._jitted[-1], kind, line)
        if self._text(span) != after:
            self.found.append(Mutant(*where, span, self._text(span), after))

    def _span(self, node: ast.AST) -> Span:
        start, stop = ((getattr(node, f"{end}lineno"), getattr(node, f"{end}col_offset")) for end in ("", "end_"))
        return self._starts[start[0] - 1] + start[1], self._starts[stop[0] - 1] + stop[1]

    def _text(self, span: Span) -> str:
        return self._source[span[0] : span[1]].decode()

    def _of(self, node: ast.AST) -> str:
        return self._text(self._span(node))


def _is_none(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def _root_name(node: ast.AST) -> str:
    """`njit` of `@njit(cache=True)` and of `@numba.njit`."""
    if isinstance(node, ast.Call):
        return _root_name(node.func)
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def _skipped(node: ast.AST) -> bool:
    """What is no behaviour: error messages, assertions for type checkers, log lines, strings with values in them."""
    if isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr | ast.Import | ast.ImportFrom):
        return True
    if isinstance(node, ast.If) and _root_name(node.test) == "TYPE_CHECKING":
        return True
    return isinstance(node, ast.Call) and _talks(node.func)


def _talks(called: ast.expr) -> bool:
    """Whether a call only tells: logs, warnings, errors that are made to be raised."""
    name = _root_name(called)
    owner = _root_name(called.value) if isinstance(called, ast.Attribute) else ""
    return owner in ("logger", "logging", "log", "warnings") or name.endswith(("Error", "Warning"))
