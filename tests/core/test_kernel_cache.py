"""The cache of machine code: its place, its name, and that a changed source never runs stale code."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from yesnt.core import kernel_cache, kernel_sources

MODULES = {
    "calls": """
        from yesnt.core.compiled import compiled
        from yesnt.fake.callee import callee
        from yesnt.fake.constants import WEIGHT
        from yesnt.fake.records import Pair
        from yesnt.fake.tables import table
        from yesnt.fake.plain import Plain, plain
        TABLE = table()
        @compiled()
        def kernel(x):
            return callee(x) + WEIGHT
    """,
    "callee": """
        from yesnt.core.compiled import compiled
        @compiled()
        def callee(x):
            return 10 * x
    """,
    "constants": "from yesnt.fake.deep import DEEP\nWEIGHT = DEEP",
    "deep": "DEEP = 1",
    "records": "from typing import NamedTuple\nclass Pair(NamedTuple):\n    a: int",
    "tables": "def table():\n    return 1",
    "plain": "class Plain:\n    pass\ndef plain():\n    return 1",
}
"""A package of kernels; only `plain` cannot reach them."""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """`yesnt.fake` beside the real `yesnt.core`."""
    root = tmp_path / "yesnt"
    (root / "fake").mkdir(parents=True)
    (root / "__init__.py").touch()
    (root / "core").symlink_to(kernel_sources.PACKAGE / "core")
    for name, text in MODULES.items():
        lines = text.splitlines()
        (root / "fake" / f"{name}.py").write_text("\n".join(line.removeprefix(8 * " ") for line in lines) + "\n")
    monkeypatch.setattr(kernel_sources, "PACKAGE", root)
    monkeypatch.setattr(kernel_cache, "PACKAGE", root)
    return root / "fake"


def run_kernel(package: Path, cache: Path) -> str:
    environment = {**os.environ, "PYTHONPATH": str(package.parent.parent), "YESNT_CACHE_DIR": str(cache)}
    code = "from yesnt.fake.calls import kernel; print(kernel(1), sum(kernel.stats.cache_hits.values()))"
    command = [sys.executable, "-P", "-c", code]
    return subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout.strip()


def test_a_changed_callee_of_another_file_is_compiled_again(package, tmp_path):
    cache = tmp_path / "cache"
    assert run_kernel(package, cache) == "11 0"
    assert run_kernel(package, cache) == "11 1", "machine code is reused"
    callee = package / "callee.py"
    callee.write_text(callee.read_text().replace("10 * x", "20 * x"))
    assert run_kernel(package, cache) == "21 0", "stale machine code"


def test_the_digest_changes_with_every_source_that_can_reach_a_kernel_and_with_no_other(package):
    before = kernel_cache.sources_digest("yesnt.fake")
    for name in MODULES:
        path = package / f"{name}.py"
        text = path.read_text()
        path.write_text(text + "# changed\n")
        assert (kernel_cache.sources_digest("yesnt.fake") == before) == (name == "plain"), name
        path.write_text(text)
    assert kernel_cache.sources_digest("yesnt.fake") == before


def test_the_digest_changes_with_the_processor(monkeypatch):
    before = kernel_cache.sources_digest("yesnt.temporal")
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    assert kernel_cache.sources_digest("yesnt.temporal") != before


def test_settings_and_documents_do_not_recompile_relighting():
    names = {path.name for path in kernel_sources.kernel_sources("yesnt.relight")}
    assert {"lobes.py", "kernels.py", "brdf.py", "color.py"} <= names
    assert not names & {"settings.py", "envmap.py", "frame.py", "precompile.py"}


def test_the_root_is_the_users_choice_then_his_cache_then_a_private_temporary_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("YESNT_CACHE_DIR", str(tmp_path / "chosen"))
    assert kernel_cache.cache_root() == tmp_path / "chosen"
    monkeypatch.delenv("YESNT_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert kernel_cache.cache_root() == tmp_path / "xdg" / "yesnt"
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr(kernel_cache.tempfile, "gettempdir", lambda: str(tmp_path))
    private = tmp_path / f"yesnt-{os.getuid()}"
    assert kernel_cache.cache_root() == private
    assert private.stat().st_mode & 0o777 == 0o700
    private.chmod(0o777)
    assert kernel_cache.cache_root() is None, "others could put machine code there"


def test_without_a_writable_root_nothing_is_cached(tmp_path, monkeypatch):
    from yesnt.core.compiled import compiled

    kernel_cache.kernel_folder.cache_clear()
    monkeypatch.setattr(kernel_cache, "cache_root", lambda: None)
    kernel = compiled()(lambda x: x + 1)
    kernel_cache.kernel_folder.cache_clear()
    assert kernel(1) == 2
    assert type(kernel._cache).__name__ == "NullCache"


def test_numbas_own_setting_is_left_alone():
    from numba import config

    from yesnt.core.compiled import compiled

    before = config.CACHE_DIR
    compiled()(lambda x: x)
    assert before == config.CACHE_DIR


def test_old_folders_are_removed_but_none_that_is_in_use(tmp_path):
    now = time.time()
    ages = {"relight-" + 16 * str(i): i for i in range(8)}
    for name, days in ages.items():
        (tmp_path / name).mkdir()
        os.utime(tmp_path / name, (now, now - 86400 * days - 60))
    (tmp_path / ("temporal-" + 16 * "9")).mkdir()
    kernel_cache.prune(tmp_path, "relight")
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {name for name, days in ages.items() if days < kernel_cache.KEPT} | {"temporal-" + 16 * "9"}
    for name in ages:
        (tmp_path / name).mkdir(exist_ok=True)
        os.utime(tmp_path / name, (now, now - 60))
    kernel_cache.prune(tmp_path, "relight")
    assert len(list(tmp_path.glob("relight-*"))) == 8


def test_every_kernel_is_declared_with_our_decorator():
    """Machine code of `numba.njit(cache=True)` alone is not renewed when a callee of another file changes."""
    modules = [path for path in kernel_sources.PACKAGE.rglob("*.py") if path.name != "compiled.py"]
    assert [path for path in modules if re.search(r"\bnjit\b|numba\.jit", path.read_text())] == []
