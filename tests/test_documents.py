"""Documents that tell of the code must tell the truth."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from yesnt.core.channels import CHANNELS, DELIVERED, STORED
from yesnt.planning.stages import STAGES

ROOT = Path(__file__).parent.parent


def stage_table() -> str:
    rows = ["| stage | a task holds | reads | writes |", "|---|---|---|---|"]
    for stage in STAGES.values():
        files = {
            "window": "its frames' observed, spread",
            "composite": "EXR sequence",
            "preview": "film, contact sheet",
        }
        writes = ", ".join(stage.arrays) or files[stage.name]
        rows.append(f"| {stage.name} | {stage.per} | {stage.reads} | {writes} |")
    return "\n".join(rows)


def test_stage_table_is_fresh() -> None:
    text = (ROOT / "ARCHITECTURE.md").read_text()
    found = re.search(r"<!-- stages -->\n(.*?)<!-- /stages -->", text, re.S)
    assert found
    assert found.group(1).strip() == stage_table()


def test_architecture_is_one_page() -> None:
    assert len((ROOT / "ARCHITECTURE.md").read_text().splitlines()) <= 120


def test_every_file_that_the_documents_name_exists() -> None:
    for document in ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md"):
        for name in re.findall(
            r"`((?:yesnt|tests|workflows|docs|deploy|docker)/[\w./-]+)`", (ROOT / document).read_text()
        ):
            assert (ROOT / name).exists(), f"{document} names {name}"
        for name in re.findall(r"`((?:decompose|temporal|relight)/[\w.]+)`", (ROOT / document).read_text()):
            assert (ROOT / "yesnt" / name).exists(), f"{document} names {name}"


def test_every_verb_of_the_readme_exists() -> None:
    out = subprocess.run([sys.executable, "-m", "yesnt", "--help"], capture_output=True, text=True, check=True).stdout
    for verb in set(re.findall(r"`yesnt (\w+)", (ROOT / "README.md").read_text())):
        assert re.search(rf"^\s+{verb}\b", out, re.M), verb


def test_channel_registry_is_whole() -> None:
    assert set(STORED) | set(DELIVERED) == set(CHANNELS)
    for name in DELIVERED:
        assert len(CHANNELS[name].exr) == CHANNELS[name].components


def test_no_stage_writes_what_is_not_a_channel() -> None:
    assert {array for stage in STAGES.values() for array in stage.arrays} == set(STORED)
