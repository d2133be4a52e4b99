"""In words, where what a record depends on differs from what the job asks for."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

NOT_SET = "not set"
"""What is said of a value that only one side has: settings at their defaults are not recorded."""

_DIGEST = re.compile(r"[0-9a-f]{32,128}")

JOB_DIGEST = "job"
"""Setting that holds the digest of the whole job, which the EXR's header carries."""

OTHER_JOB = "other settings of the job changed, and the EXR's header holds their digest"


@dataclass(frozen=True)
class Differences:
    """What makes a frame stale.

    Attributes:
        causes: its own changes, such as `relight.texels was 8, is 9`, or `plate: its file has changed`.
        follows: stages whose new results it takes; nothing but their change is a reason.
    """

    causes: tuple[str, ...] = ()
    follows: tuple[str, ...] = ()


def differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> Differences:
    """Compares the fields of a record with those that the job asks for."""
    if old.get("version") != new.get("version"):
        text = f"another version of yesnt made it: the stage's version was {old.get('version')}, is {new['version']}"
        return Differences((text,))
    causes = [*_settings(old.get("settings") or {}, new.get("settings") or {})]
    causes += _inputs(old.get("inputs") or {}, new.get("inputs") or {})
    known = {"settings", "inputs", "upstream", "version", "stage", "frame"}
    for name in sorted((set(old) | set(new)) - known):
        causes += _values(old.get(name, NOT_SET), new.get(name, NOT_SET), name)
    before, after = old.get("upstream") or {}, new.get("upstream") or {}
    follows = sorted(stage for stage in set(before) | set(after) if before.get(stage) != after.get(stage))
    if follows or len(causes) > 1:
        causes = [cause for cause in causes if cause != OTHER_JOB]  # the others say more
    return Differences(tuple(causes), tuple(follows))


def _settings(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[str]:
    yield from _values({**old, JOB_DIGEST: None}, {**new, JOB_DIGEST: None}, "")
    if old.get(JOB_DIGEST) != new.get(JOB_DIGEST):
        yield OTHER_JOB


def _inputs(old: Mapping[str, str], new: Mapping[str, str]) -> Iterator[str]:
    for role in sorted(set(old) | set(new)):
        if role not in old:
            yield f"{role}: it was not used before"
        elif role not in new:
            yield f"{role}: it is no longer used"
        elif old[role] != new[role]:
            yield f"{role}: its file has changed"


def _values(old: Any, new: Any, path: str) -> Iterator[str]:
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in sorted(set(old) | set(new), key=str):
            yield from _values(old.get(key, NOT_SET), new.get(key, NOT_SET), f"{path}.{key}" if path else str(key))
    elif _plain(old) != _plain(new):
        yield f"{path} has changed" if _is_digest(old) or _is_digest(new) else f"{path} was {old}, is {new}"


def _is_digest(value: Any) -> bool:
    return isinstance(value, str) and _DIGEST.fullmatch(value) is not None


def _plain(value: Any) -> Any:
    """JSON gives lists where Python has tuples."""
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value
