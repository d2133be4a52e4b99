"""Reads the instructions of a Dockerfile, as far as ours use them."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

KNOWN = ("FROM", "WORKDIR", "COPY", "RUN", "ENV", "USER", "ENTRYPOINT")


@dataclass(frozen=True)
class Step:
    """One instruction: its word, and its argument."""

    word: str
    argument: str


def steps_of(path: Path) -> list[Step]:
    """All instructions in order, comments and continued lines resolved; one that is not known is an error."""
    text = re.sub(r"^\s*#.*\n", "", path.read_text(), flags=re.M).replace("\\\n", " ")
    steps = [Step(*line.split(maxsplit=1)) for line in text.splitlines() if line.strip()]
    unknown = [step.word for step in steps if step.word not in KNOWN]
    assert not unknown, f"{path}: {unknown}"
    assert steps[0].word == "FROM"
    return steps


def entry_point(steps: list[Step]) -> list[str]:
    """The words that a container runs."""
    (found,) = (step.argument for step in steps if step.word == "ENTRYPOINT")
    return list(json.loads(found))
