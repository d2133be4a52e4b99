"""Mutation run: how many small changes of the code do the tests of its folder notice? Resumes where it stopped.

    python -m tests.mutation.run            judge what is still wanted, then report
    python -m tests.mutation.run --again    judge the survivors again, after tests were added
    python -m tests.mutation.run --report   print the figures and the survivors

A mutant is applied in a private copy of the tree and tried against the tests of its own folder alone. Verdicts are
lines of JSON in `.mutation/` (not in git); a mutant that was judged stays judged when other code changes. Mutants that
change no behaviour are listed with a reason in `equivalent.json`.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.mutation.mutants import OPERATORS, Mutant, find_mutants
from tests.source_tree import ROOT

SEED = 15
PLAIN = {"relight": 30, "temporal": 26, "decompose": 26, "planning": 20, "runtime": 18}
"""Mutants outside jitted code by folder: 120."""

JITTED = {"relight": 15, "temporal": 15}
"""Mutants inside jitted functions: 30."""

WANTED_SHARE = 0.85
TEST_SECONDS, RUN_SECONDS = 300, 1200
TESTS_FAILED = (1, 2)
"""Exit statuses of pytest for a failed test and for a module that cannot be imported."""

NOT_COPIED = (".git", ".venv*", "demo", "out", "build", "*.egg-info", ".mutation", ".pytest_cache", ".mypy_cache")

NOT_TRIED = ("test_kills.py",)
"""Test files that take minutes a run: what they alone notice counts as not noticed."""

Verdict = dict[str, Any]


@dataclass(frozen=True)
class Book:
    """Verdicts in a folder: one JSON object a line, the last of a mutant counts."""

    folder: Path

    @property
    def path(self) -> Path:
        """The file of verdicts."""
        return self.folder / "verdicts.jsonl"

    def verdicts(self) -> dict[str, Verdict]:
        """Verdicts by mutant."""
        lines = self.path.read_text().splitlines() if self.path.exists() else []
        return {verdict["id"]: verdict for verdict in map(json.loads, lines)}

    def add(self, verdict: Verdict) -> None:
        """Appends one."""
        self.folder.mkdir(exist_ok=True)
        with self.path.open("a") as stream:
            stream.write(json.dumps(verdict) + "\n")


def equivalent() -> dict[str, str]:
    """Mutants that change no behaviour, with the reason."""
    path = Path(__file__).with_name("equivalent.json")
    return {row["id"]: row["reason"] for row in json.loads(path.read_text())}


def all_mutants(root: Path, folder: str) -> list[Mutant]:
    """Mutants of a folder of the package, those of other interpreters aside."""
    files = sorted(p for p in (root / "yesnt" / folder).rglob("*.py") if "inside_" not in str(p.relative_to(root)))
    return [mutant for path in files for mutant in find_mutants(root, path)]


def chosen(root: Path, folder: str, jitted: bool, judged: Mapping[str, Verdict]) -> Iterator[Mutant]:
    """Mutants that are not judged yet, in a seeded order: an operator by chance, then one of its mutants by chance."""
    chance = random.Random(f"{SEED} {folder} {jitted} {len(judged)}")
    pools: dict[str, list[Mutant]] = {operator: [] for operator in OPERATORS}
    for mutant in all_mutants(root, folder):
        if mutant.jitted == jitted and mutant.id not in judged:
            pools[mutant.operator].append(mutant)
    while any(pools.values()):
        pool = pools[chance.choice([operator for operator in OPERATORS if pools[operator]])]
        mutant = pool.pop(chance.randrange(len(pool)))
        if is_valid(root, mutant):
            yield mutant


def is_valid(root: Path, mutant: Mutant) -> bool:
    """Whether the changed file is still Python of another meaning."""
    source = (root / mutant.file).read_bytes()
    try:
        return ast.dump(ast.parse(mutant.apply(source))) != ast.dump(ast.parse(source))
    except SyntaxError:
        return False


class Copy:
    """A private copy of the tree in which mutants are tried.

    Kernels are cached in a folder of its own. It is named by their sources, so that a mutant never runs machine code of
    another.

    Args:
        home: a folder of its own.
    """

    def __init__(self, home: Path) -> None:
        self.root, self._caches = home / "tree", home / "caches"
        shutil.copytree(ROOT, self.root, symlinks=True, ignore=shutil.ignore_patterns(*NOT_COPIED))
        self._seconds: dict[str, float] = {}

    def baseline(self, folder: str) -> None:
        """Runs a folder's tests unchanged, and notes how long each file takes.

        Raises:
            SystemExit: they fail, so that nothing can be judged.
        """
        paths = sorted(p for p in (self.root / "tests" / folder).glob("test_*.py") if p.name not in NOT_TRIED)
        files = [str(path.relative_to(self.root)) for path in paths]
        status, output, _ = self._test([*files, "--durations=0", "--durations-min=0.02"])
        if status:
            sys.exit(f"The tests of {folder} fail without a mutant:\n{output[-3000:]}")
        self._seconds |= dict.fromkeys(files, 0.0)
        for seconds, name in re.findall(r"^([\d.]+)s \w+ +(tests/[^:]+)::", output, re.M):
            self._seconds[name] += float(seconds)

    def _tests(self, mutant: Mutant) -> list[str]:
        """Test files of a mutant's folder, those that import its module first, then the fast ones."""
        module = mutant.file.removesuffix(".py").replace("/", ".")
        imported = re.compile(
            rf"{re.escape(module)}\b|from {re.escape(module.rpartition('.')[0])} import .*\b{Path(mutant.file).stem}\b"
        )
        files = [name for name in self._seconds if name.startswith(f"tests/{mutant.folder}/")]
        related = {name for name in files if imported.search((self.root / name).read_text())}
        return sorted(files, key=lambda name: (name not in related, self._seconds[name]))

    def judge(self, mutant: Mutant) -> Verdict:
        """Tries one mutant and takes it back."""
        path = self.root / mutant.file
        source, times = path.read_bytes(), path.stat()
        path.write_bytes(mutant.apply(source))
        try:
            status, output, seconds = self._test(self._tests(mutant))
        finally:
            path.write_bytes(source)
            os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
        return {
            "id": mutant.id, "folder": mutant.folder, "jitted": mutant.jitted, "operator": mutant.operator,
            "where": f"{mutant.file}:{mutant.line} {mutant.function}", "diff": mutant.diff(source),
            "killed": status in TESTS_FAILED, "status": status, "by": _failed(output), "seconds": round(seconds, 1),
        }  # fmt: skip

    def _test(self, tests: list[str]) -> tuple[int, str, float]:
        """Exit status of pytest, the end of its output, and seconds."""
        command = [
            sys.executable, "-m", "pytest", *tests, "-x", "-q", "-p", "no:cacheprovider", "--tb=line",
            f"--timeout={TEST_SECONDS}", "-m", "not slow and not blender",
        ]  # fmt: skip
        environment = os.environ | {"PYTHONPATH": str(self.root), "YESNT_CACHE_DIR": str(self._caches)}
        start = time.monotonic()
        with _group(command, self.root, environment) as process:
            with suppress(subprocess.TimeoutExpired):
                output, _ = process.communicate(timeout=RUN_SECONDS)
                return process.returncode, output, time.monotonic() - start
        return TESTS_FAILED[0], "it did not end", time.monotonic() - start


@contextmanager
def _group(command: list[str], folder: Path, environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """A process whose children end with it."""
    process = subprocess.Popen(
        command, cwd=folder, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        start_new_session=True,
    )  # fmt: skip
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, 9)
        process.wait()


def _failed(output: str) -> str:
    """The first test that failed."""
    lines = [line for line in output.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return lines[0].split(" ")[1] if lines else ""


Wanted = Callable[[Path], Iterator[Mutant]]


def judge_all(book: Book, wanted: Wanted) -> None:
    """Judges mutants of a private copy one by one and writes each verdict down at once."""
    with tempfile.TemporaryDirectory(prefix="yesnt-mutation-") as home:
        copy, ready = Copy(Path(home)), set[str]()
        for mutant in wanted(copy.root):
            if mutant.folder not in ready:
                copy.baseline(mutant.folder)
                ready.add(mutant.folder)
            verdict = copy.judge(mutant)
            book.add(verdict)
            fate = "killed  " if verdict["killed"] else "SURVIVED"
            print(f"{fate} {verdict['seconds']:6.1f} s  {verdict['where']}", flush=True)


def still_wanted(root: Path, book: Book, folders: list[str]) -> Iterator[Mutant]:
    """What is missing to the numbers of `PLAIN` and `JITTED`."""
    judged, gone = book.verdicts(), gone_survivors(root, book)
    for jitted, numbers in ((False, PLAIN), (True, JITTED)):
        for folder, number in ((folder, numbers[folder]) for folder in folders if folder in numbers):
            counted = (v for name, v in judged.items() if name not in gone)
            had = sum(v["folder"] == folder and v["jitted"] == jitted for v in counted)
            for _, mutant in zip(range(number - had), chosen(root, folder, jitted, judged), strict=False):
                yield mutant


def survivors(root: Path, book: Book, folders: list[str]) -> Iterator[Mutant]:
    """Mutants that survived, are not equivalent, and still exist in the code."""
    alive = surviving(book)
    for folder in folders:
        yield from (mutant for mutant in all_mutants(root, folder) if mutant.id in alive)


def surviving(book: Book) -> set[str]:
    """Mutants that survived and are not equivalent."""
    known = equivalent()
    return {name for name, verdict in book.verdicts().items() if not verdict["killed"] and name not in known}


def gone_survivors(root: Path, book: Book) -> set[str]:
    """Survivors whose code has been rewritten since: they count for nothing, and others are drawn in their place."""
    return surviving(book) - {mutant.id for folder in PLAIN for mutant in all_mutants(root, folder)}


def report(book: Book) -> bool:
    """Prints the shares of mutants that were killed and the survivors; whether the share is reached."""
    gone, alive = gone_survivors(ROOT, book), surviving(book)
    verdicts = {name: verdict for name, verdict in book.verdicts().items() if name not in gone}
    counts: dict[tuple[str, str], Counter[str]] = {}
    for name, verdict in verdicts.items():
        row = (verdict["folder"], "jitted" if verdict["jitted"] else "plain")
        fate = "killed" if verdict["killed"] else "survived" if name in alive else "equivalent"
        counts.setdefault(row, Counter())[fate] += 1
    total = sum(counts.values(), Counter[str]())
    for row, count in [*sorted(counts.items()), (("all", ""), total)]:
        effective = count["killed"] + count["survived"]
        share = count["killed"] / effective if effective else 1.0
        print(
            f"{row[0]:10} {row[1]:7} judged {count.total():4}  equivalent {count['equivalent']:3}  {share:6.1%} killed"
        )
    for name, verdict in verdicts.items():
        if name in alive:
            print(f"\n{name} {verdict['where']} ({verdict['operator']})\n{verdict['diff']}")
    return total["killed"] >= WANTED_SHARE * (total["killed"] + total["survived"])


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--again", action="store_true", help="judge the survivors again")
    parser.add_argument("--report", action="store_true", help="only print the figures")
    parser.add_argument("--only", nargs="+", choices=PLAIN, default=list(PLAIN), help="folders of the package to judge")
    parser.add_argument("--folder", type=Path, default=ROOT / ".mutation", help="where verdicts are kept")
    options = parser.parse_args()
    book = Book(options.folder)
    if not options.report:
        choose = survivors if options.again else still_wanted
        judge_all(book, lambda root: choose(root, book, options.only))
    sys.exit(0 if report(book) else 1)


if __name__ == "__main__":
    main()
