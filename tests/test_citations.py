"""Every citation in code and documents leads to something that the repository holds.

Checked: names of documents with their sections ("method.md section 4", `contract.md, "A shot"`), names of Python files
in comments, docstrings and documents, paths in backticks, links, dotted module names, make targets and verbs.
"""

from __future__ import annotations

import ast
import importlib.util
import io
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SOURCES = ("yesnt", "workflows", "tests", "deploy", "docker")
CODE = sorted(p for name in SOURCES for p in (ROOT / name).rglob("*.py") if "yesnt/workflows" not in str(p))
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "deploy").glob("*.md")])
OTHER = [ROOT / "Makefile", ROOT / "pyproject.toml", *(ROOT / "deploy").rglob("*.yaml"), *(ROOT / "docker").iterdir()]
FOLDERS = ("", "yesnt", "docs", "yesnt/training", "yesnt/training/synthetic", "tests", "tests/benchmarks")
"""Where a relative path in a citation may start, beside the citing file's own folder."""

WRITTEN = {"evaluation.md", "scaling.json", "LICENSE", "NAME_layers.py"}
"""Files that a command writes, or that lie in other people's packages."""


@cache
def prose(path: Path) -> str:
    """A page as it is; of Python code the comments and docstrings."""
    text = path.read_text()
    if path.suffix != ".py":
        return text
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    comments = [token.string for token in tokens if token.type == tokenize.COMMENT]
    strings = [
        node.value.value
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    ]
    return "\n".join(comments + strings)


def found(name: str, citing: Path) -> bool:
    """Whether a cited path exists, from the citing file's folder or one of `FOLDERS`; `*` matches as in a shell."""
    name = name.rstrip("/")
    starts = [citing.parent, citing.parent.parent, *(ROOT / folder for folder in FOLDERS)]
    return any(list(start.glob(name)) for start in starts)


@cache
def modules() -> frozenset[str]:
    """Bare names of all Python files."""
    return frozenset(path.name for path in CODE)


@cache
def headings(page: Path) -> tuple[str, ...]:
    """Headings of a page, without their marks."""
    return tuple(re.findall(r"^#+ (.+)$", page.read_text(), re.M))


def page_of(name: str, citing: Path) -> Path | None:
    """The document that a name in a citation means."""
    for start in (citing.parent, ROOT, ROOT / "docs"):
        if (start / name).is_file():
            return start / name
    return None


def ids(path: Path) -> str:
    """Test id: the path from the root."""
    return str(path.relative_to(ROOT))


def wrong_documents(path: Path) -> Iterator[str]:
    """Names of documents, with section numbers and quoted headings."""
    text = prose(path)
    pattern = r"\]?\(?([\w./-]*\w\.md)\)?(?:,? section (\d+\w?)|, \"([^\"]+)\")?"
    for name, section, heading in re.findall(pattern, text):
        page = page_of(name, path)
        if page is None:
            if name not in WRITTEN:
                yield f"{name} does not exist"
            continue
        if section and not any(title.startswith(f"{section}.") for title in headings(page)):
            yield f"{name} has no section {section}"
        if heading and not any(" ".join(heading.split()) in title for title in headings(page)):
            yield f"{name} has no heading {heading!r}"


def wrong_files(path: Path) -> Iterator[str]:
    """Python files in parentheses or backticks, and paths in backticks on pages."""
    text = prose(path)
    for name in re.findall(r"(?<![\w/{}.*$-])([\w/]*\w\.py)\b", text):
        if name not in WRITTEN and not (found(name, path) or ("/" not in name and name in modules())):
            yield f"{name} does not exist"
    if path.suffix != ".md":
        return
    tops = "|".join(sorted(p.name for p in (ROOT / "yesnt").iterdir() if p.is_dir()))
    for name in re.findall(rf"`((?:yesnt|tests|workflows|docs|deploy|docker|{tops})/[\w./-]*)`", text):
        if not found(name, path):
            yield f"`{name}` does not exist"
    for link in re.findall(r"\]\(([^)#:]+)(?:#[\w-]*)?\)", text):
        if not (path.parent / link).exists():
            yield f"link to {link} leads nowhere"


def wrong_names(path: Path) -> Iterator[str]:
    """Dotted names such as `yesnt.decompose.reuse` and `embedded.SHRINKAGE_FACTOR`."""
    for name in re.findall(r"\b(yesnt(?:\.[a-z_]\w+)+)", prose(path)):
        parts = name.split(".")
        if parts[-1] in ("jinja", "zarr") or not (_module(name) or _module(".".join(parts[:-1]))):
            yield f"{name} is not a module"
    for module, attribute in re.findall(r"`(\w+)\.([A-Z][A-Z_]{2,})`", prose(path)):
        files = [p for p in CODE if p.stem == module]
        if files and not any(re.search(rf"^{attribute}\b", p.read_text(), re.M) for p in files):
            yield f"{module}.py has no {attribute}"


def wrong_functions(path: Path) -> Iterator[str]:
    """Names in brackets behind a Python file on a page: "`relight/brdf.py` (`evaluate_paper`, ...)"."""
    if path.suffix != ".md":
        return
    for name, inside in re.findall(r"`([\w/]+\.py)` \(((?:`\w+`(?:, )?)+)\)", prose(path)):
        files = [p for p in CODE if str(p).endswith(f"/{name}")]
        text = "\n".join(p.read_text() for p in files)
        for defined in re.findall(r"`(\w+)`", inside):
            if not re.search(rf"^(?:def |class )?{defined}\b", text, re.M):
                yield f"{name} has no {defined}"


@cache
def _module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


def wrong_commands(path: Path) -> Iterator[str]:
    """`make TARGET` and `yesnt VERB`, in backticks or at the start of a line."""
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.M)
    for target in re.findall(r"(?:^|`|&& )make ([a-z-]+)", prose(path), re.M):
        if target not in targets:
            yield f"`make {target}`: the Makefile has no such target"
    if path.name == "roadmap.md":
        return
    written = "".join(re.findall(r"^```\n.*?^```|`[^`]*`", prose(path), re.M | re.S))
    for verb in re.findall(r"(?:^|`|&& )yesnt ([a-z]+(?:-[a-z]+)*)(?!\w)", written, re.M):
        if verb not in verbs():
            yield f"`yesnt {verb}`: there is no such verb"


def wrong_options(path: Path) -> Iterator[str]:
    """Options of benchmarks and verbs, in commands on pages and in docstrings."""
    if path.name == "roadmap.md":
        return
    for name, rest in re.findall(r"tests/benchmarks/(\w+\.py)([^`\n]*)", prose(path)):
        text = (
            (ROOT / "tests" / "benchmarks" / name).read_text()
            if (ROOT / "tests" / "benchmarks" / name).exists()
            else ""
        )
        for option in re.findall(r"(?<= )\[?(--[a-z][a-z-]*)", rest):
            if text and f'"{option}"' not in text:
                yield f"{name} has no option {option}"
    for verb, rest in re.findall(r"(?:^|`|&& )yesnt ([a-z]+(?:-[a-z]+)*)([^`#&\n]*)", prose(path), re.M):
        for option in re.findall(r"(?<= )\[?(--[a-z][a-z-]*)", rest):
            if verb in verbs() and option not in options(verb):
                yield f"`yesnt {verb}` has no option {option}"


@cache
def options(verb: str) -> frozenset[str]:
    """Options of a verb."""
    import typer.main

    from yesnt.cli.app import app

    command = typer.main.get_command(app).commands[verb]  # type: ignore[attr-defined]
    return frozenset(name for parameter in command.params for name in parameter.opts) | {"--help"}


@cache
def verbs() -> frozenset[str]:
    """Verbs of the command line."""
    from yesnt.cli.app import app

    names = [command.name or getattr(command.callback, "__name__", "") for command in app.registered_commands]
    return frozenset(name.replace("_", "-") for name in names)


@pytest.mark.parametrize("path", [*CODE, *PAGES, *OTHER], ids=ids)
def test_every_citation_resolves(path: Path) -> None:
    checks = (wrong_documents, wrong_files, wrong_names, wrong_commands, wrong_options, wrong_functions)
    wrong = [problem for check in checks for problem in check(path)]
    assert not wrong, f"{ids(path)}: " + "; ".join(wrong)


def test_documents_cite_nothing_outside_the_repository() -> None:
    for path in [*CODE, *PAGES, *OTHER]:
        if path != Path(__file__):
            assert not re.search(r"\.\./shared|/work/", path.read_text()), ids(path)


def test_a_wrong_citation_is_seen(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        'method.md section 99, [x](nowhere.md), contract.md, "No such heading", `yesnt/nothing.py`, `relight/none.py`, '
        "`yesnt.nothing.at_all`, `make nothing`, `yesnt nothing`, `embedded.NOT_THERE`, `yesnt run --nothing`, "
        "`python tests/benchmarks/temporal_speed.py --nothing`, `relight/brdf.py` (`nothing`)"
    )
    checks = (wrong_documents, wrong_files, wrong_names, wrong_commands, wrong_options, wrong_functions)
    wrong = [problem for check in checks for problem in check(page)]
    assert len(wrong) >= 12, wrong
