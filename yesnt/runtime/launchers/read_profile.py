"""Reads what `--cluster` names: a kind, an address, a profile by its file or by its name among the site's."""

from __future__ import annotations

import difflib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from yesnt.core.errors import UsageError

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

    from yesnt.runtime.launchers.profile import Profile

KINDS = ("local", "attach", "ssh", "slurm", "kubernetes")
"""Kinds of profile, in the order in which messages name them."""

MAX_PROFILE_BYTES = 1 << 20


def profiles_folder() -> Path:
    """Where profiles are found by name: `$YESNT_CLUSTERS`, else `~/.config/yesnt/clusters`."""
    given = os.environ.get("YESNT_CLUSTERS")
    return Path(given).expanduser() if given else Path.home() / ".config" / "yesnt" / "clusters"


def find_profile(name: str) -> Path | None:
    """The profile that a word names: a file, or one of the site's; None if there is none."""
    if name.endswith((".yaml", ".yml")):
        return Path(name).expanduser()
    path = profiles_folder() / f"{name}.yaml"
    return path if "/" not in name and path.is_file() else None


def read_profile(path: Path) -> Profile:
    """Reads and validates a profile.

    Raises:
        UsageError: not readable, not plain YAML, or a key is unknown, absent or of a wrong type; names the key.
    """
    import yaml

    try:
        if path.stat().st_size > MAX_PROFILE_BYTES:
            raise UsageError("The cluster profile is too large", str(path), f"at most {MAX_PROFILE_BYTES} bytes")
        # Every scalar stays text: YAML 1.1 reads a walltime of 12:30:00 as the number 45000.
        data = yaml.load(path.read_text(encoding="utf-8"), Loader=yaml.BaseLoader)
    except FileNotFoundError as error:
        raise UsageError("The cluster profile is missing", str(path), "a YAML file", "deploy/ has examples") from error
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise UsageError(f"The cluster profile cannot be read ({error})", str(path), "plain YAML") from error
    return parse_profile(data, str(path), path.parent)


def parse_profile(data: Any, where: str, folder: Path | None = None) -> Profile:
    """Validates the content of a profile; relative certificate files are those of `folder`.

    Raises:
        UsageError: names the key, and near names of one that is unknown.
    """
    from pydantic import ValidationError

    from yesnt.runtime.launchers.profile import MODELS, Attach

    kind = data.get("kind") if isinstance(data, dict) else None
    if kind not in MODELS:
        raise UsageError(
            "The cluster profile names no kind of cluster", f"{where}, key kind", f"one of {', '.join(KINDS)}",
            "add a line such as `kind: slurm`",
        )  # fmt: skip
    try:
        profile: Profile = MODELS[kind].model_validate(data)
    except ValidationError as error:
        raise _profile_error(where, MODELS[kind], error) from error
    return _beside(profile, folder) if isinstance(profile, Attach) and folder is not None else profile


def _beside(profile: Any, folder: Path) -> Any:
    names = ("ca_file", "cert_file", "key_file")
    given = {name: value for name in names if (value := getattr(profile, name)) is not None}
    return profile.model_copy(update={n: str(folder / Path(v).expanduser()) for n, v in given.items()})


def _profile_error(where: str, model: type[BaseModel], error: ValidationError) -> UsageError:
    """The most telling problem that pydantic found."""
    # An unknown key is told first: it is most often the misspelling behind an absent one.
    problem = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    location = [str(part) for part in problem["loc"]]
    key = ".".join(location) or "the whole file"
    if problem["type"] == "extra_forbidden":
        known = _keys(model, location[:-1])
        near = difflib.get_close_matches(location[-1], known, 2)
        hint = f"did you mean {' or '.join(map(repr, near))}?" if near else f"the keys are {', '.join(known)}"
        return UsageError(f"Unknown key {key!r} in the cluster profile", where, "a key of the profile", hint)
    if problem["type"] == "missing":
        return UsageError(f"The key {key!r} of the cluster profile is absent", where, "it is required", "add it")
    return UsageError(
        f"The value of {key!r} in the cluster profile cannot be used: {problem['msg']}", where,
        f"see the message; got {problem['input']!r}", "correct it",
    )  # fmt: skip


def _keys(model: type[BaseModel], location: list[str]) -> list[str]:
    """Names of the keys at a place of the profile; parts that are no key (positions in lists) are passed over."""
    from pydantic import BaseModel

    for name in location:
        field = model.model_fields.get(name)
        if field is None:
            continue
        parts = [field.annotation, *getattr(field.annotation, "__args__", ())]
        inner = [p for p in parts if isinstance(p, type) and issubclass(p, BaseModel)]
        model = inner[0] if inner else model
    return list(model.model_fields)
