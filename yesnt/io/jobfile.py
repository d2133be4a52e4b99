"""Reads `shot.yaml`: safe YAML, exact types, errors with the line and the fix; resolves paths and frame ranges."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from yesnt.core.errors import JobError, UsageError
from yesnt.core.material_input import DecomposeInput
from yesnt.core.shot import Shot

MAX_JOB_BYTES = 1 << 20
MAX_FRAMES = 1_000_000
_TOO_MANY = f"more than {MAX_FRAMES:,} frames, the most that a shot may have"
REMOVED = {
    "extra_frames": ("nothing: files outside `frames:` (handles) are normal; `plan` counts them", "remove the line"),
}
"""Keys of former versions: what takes their place, and what to do."""

MAX_QUOTED = 80
"""Characters of a wrong frame range that a message quotes."""


def load_shot(path: Path) -> Shot:
    """Reads and validates a job file.

    Raises:
        JobError: not readable, not plain YAML, or a key is unknown, absent or of a wrong type; names the line.
    """
    text = _read_text(path)
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
        data = yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"{path}, line {mark.line + 1}" if mark else str(path)
        raise JobError(
            f"The job file is not plain YAML ({getattr(error, 'problem', error)})",
            where,
            "mappings and scalars, no tags",
            "correct it",
        ) from error
    _refuse_twice(path, node)
    try:
        shot = Shot.model_validate(data)
    except ValidationError as error:
        raise _job_error(path, node, error) from error
    if os.sep == "/":
        _refuse_windows_paths(path, node, shot)
    return shot


def parse_frames(text: str, where: str) -> tuple[int, ...]:
    """A frame range such as `1001-1010x2,1020` as ascending numbers, each once.

    Raises:
        UsageError: the text is no range, or holds more than `MAX_FRAMES` frames.
    """
    return tuple(sorted(frames_in_order(text, where)))


def frames_in_order(text: str, where: str) -> tuple[int, ...]:
    """A frame range as numbers, each once, in the order in which it names them.

    `1-100:10` is all hundred frames, coarse before fine: every tenth, then every ninth of the others, and so on.

    Raises:
        UsageError: the text is no range, or holds more than `MAX_FRAMES` frames.
    """
    from fileseq.exceptions import FileSeqException, MaxSizeException

    found, problem = dict[int, None](), "no frames"
    try:
        for part in text.split(","):
            found.update(dict.fromkeys(_part_of_range(part.strip())))
    except MaxSizeException:
        found, problem = {}, _TOO_MANY
    except (FileSeqException, ValueError, TypeError, OverflowError) as error:
        found, problem = {}, str(error).splitlines()[0].rstrip(": ")
    if len(found) > MAX_FRAMES:
        found, problem = {}, _TOO_MANY
    if not found:
        raise UsageError(
            f"The frame range {_shortened(text)} cannot be used ({problem})", where, "1001-1024 or 1001-1010x2,1020",
            "correct it",
        )  # fmt: skip
    return tuple(found)


def _part_of_range(part: str) -> Iterable[int]:
    """Frames between two commas. A whole list given to fileseq would take quadratic time."""
    from fileseq import FrameSet

    return (int(part),) if part.isdigit() else (_whole(frame) for frame in FrameSet(part)) if part else ()


def _shortened(text: str) -> str:
    """A range as it is quoted in a message."""
    return repr(text if len(text) <= MAX_QUOTED else f"{text[:MAX_QUOTED]}...")


def _whole(frame: object) -> int:
    """The number of a frame; fileseq also knows subframes, the product does not."""
    if int(str(frame).partition(".")[0]) != float(str(frame)):
        raise ValueError(f"{frame} is no whole frame")
    return int(str(frame).partition(".")[0])


_FRAME_SIGN = re.compile(r"#|@|%\d*d|\$F\d*|<UDIM>|%\(UDIM\)d")
"""What stands for a frame number in the name of a file."""


@lru_cache(maxsize=64)
def _sequence(name: str) -> Any:
    from fileseq import FileSequence
    from fileseq.constants import PAD_STYLE_HASH1  # '####' is four digits, as in Nuke and RV
    from fileseq.exceptions import FileSeqException

    try:
        return FileSequence(name, pad_style=PAD_STYLE_HASH1)
    except FileSeqException as error:
        raise JobError(
            "The name of a sequence cannot be understood", name,
            "one frame number, as ####, %04d, @@@@ or $F4, in the file's name", "rename the files",
        ) from error  # fmt: skip


_TAG = "("
"""First character of a tag in the place of an error: no part of the key (core/shot.py)."""

PASS = "{pass}"
"""What stands for the name of a pass in a pattern."""


@lru_cache(maxsize=256)
def has_frame_number(pattern: str) -> bool:
    """Whether a file's name has a place for a frame number (####, %04d, @@@@, $F4); its folders have none."""
    return bool(_FRAME_SIGN.search(os.path.basename(pattern)))


@lru_cache(maxsize=1 << 18)
def frame_path(root: str | Path, pattern: str, frame: int) -> Path:
    """The file of one frame; a pattern without a frame number is the same file for every frame.

    A run of a long shot asks for each a dozen times, and a path takes longer to put together than to look up.
    """
    whole, name = _placed(str(root), pattern)
    return Path(whole, str(_sequence(name).frame(frame)) if has_frame_number(name) else name)


@lru_cache(maxsize=256)
def _placed(root: str, pattern: str) -> tuple[str, str]:
    """Folder of a pattern's files, and the pattern of their names; a long shot asks for each thousands of times."""
    folder, name = os.path.split(os.path.expanduser(pattern))
    return os.path.join(os.path.expanduser(root), folder), name


def pass_patterns(pattern: str) -> dict[str, str]:
    """Patterns of the material passes: `{pass}` in a name stands for roughness and metallic, each with its own file.

    Returns:
        Pattern by pass; the one pattern under "material" where all passes lie in one file.
    """
    if PASS not in pattern:
        return {"material": pattern}
    return {name: pattern.replace(PASS, name) for name in ("roughness", "metallic")}


def pass_files(decompose: DecomposeInput) -> dict[str, str]:
    """Patterns of all material passes that a job brings, by name; none if a backend gives both quantities."""
    if decompose.path is not None:
        return pass_patterns(decompose.path)
    return {name: one.path for name, one in decompose.quantities.items()}


def correction_patterns(shot: Shot) -> dict[str, str]:
    """Patterns of the files that correct the observed materials, by role: `roughness`, `mask 0`, `cryptomatte 1`."""
    single = pass_files(shot.decompose) if shot.decompose.samples_backend else {}
    kinds = ("mask" if one.mask is not None else "cryptomatte" for one in shot.materials)
    masks = zip(kinds, shot.materials, strict=True)
    return single | {f"{kind} {number}": one.path for number, (kind, one) in enumerate(masks)}


def frames_on_disk(root: str | Path, pattern: str) -> set[int]:
    """Frame numbers of a sequence that exist as files; none for a pattern without a frame number."""
    if not has_frame_number(pattern):
        return set()
    sequence, folder = _sequence(os.path.basename(pattern)), frame_path(root, pattern, 0).parent
    name = re.compile(rf"{re.escape(sequence.basename())}(-?\d+){re.escape(sequence.extension())}")
    found = (name.fullmatch(file) for file in (os.listdir(folder) if folder.is_dir() else ()))
    return {int(match[1]) for match in found if match and sequence.frame(int(match[1])) == match[0]}


def _read_text(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_JOB_BYTES:
            raise JobError(
                "The job file is too large", str(path), f"at most {MAX_JOB_BYTES} bytes", "is this a job file?"
            )
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise JobError("The job file is missing", str(path), "a shot.yaml", "`yesnt init DIR` writes one") from error
    except (OSError, UnicodeDecodeError) as error:
        raise JobError(f"The job file cannot be read ({error})", str(path), "UTF-8 text", "check the file") from error


def _job_error(path: Path, node: Any, error: ValidationError) -> JobError:
    """The most telling problem that pydantic found, with the line where it stands."""
    # An unknown key is told first: it is most often the misspelling behind an absent one.
    problem = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    location = [part for part in problem["loc"] if isinstance(part, str | int) and not str(part).startswith(_TAG)]
    line = _line(node, location)
    key = ".".join(str(part) for part in location) or "the whole file"
    kind = problem["type"]
    if kind == "extra_forbidden" and key in REMOVED:
        return JobError(f"The key {key!r} is no longer used", f"{path}, line {line}", *REMOVED[key])
    if kind == "extra_forbidden":
        return JobError(
            f"Unknown key {key!r}", f"{path}, line {line}", "a key of the job file", "check its spelling or remove it"
        )
    if kind == "missing":
        return JobError(f"The key {key!r} is absent", f"{path}, line {line}", "it is required", "add it")
    return JobError(
        f"The value of {key!r} cannot be used: {problem['msg'].replace('tuple', 'list')}",
        f"{path}, line {line}",
        f"see the message; got {problem['input']!r}",
        "correct it",
    )


def _refuse_twice(path: Path, node: Any) -> None:
    """Refuses a key that stands twice in a section: YAML would take the last one and say nothing."""
    if isinstance(node, yaml.MappingNode):
        seen = set[str]()
        for key, value in node.value:
            if key.value in seen:
                raise JobError(
                    f"The key {str(key.value)!r} stands twice", f"{path}, line {key.start_mark.line + 1}",
                    "every key once", "remove one of them",
                )  # fmt: skip
            seen.add(key.value)
            _refuse_twice(path, value)
    elif isinstance(node, yaml.SequenceNode):
        for value in node.value:
            _refuse_twice(path, value)


_PATH_KEYS = ("path", "weights", "camera", "output")


def _refuse_windows_paths(path: Path, node: Any, shot: Shot) -> None:
    """On this system a backslash is a letter of a name and `C:` a folder: both would only be reported as missing."""
    for location, value in _strings(shot.model_dump(mode="json")):
        if location[-1] in _PATH_KEYS and re.search(r"\\|^[A-Za-z]:/", value):
            raise JobError(
                f"The value of {'.'.join(map(str, location))!r} is a Windows path: {value}",
                f"{path}, line {_line(node, location)}",
                "a path of this system with forward slashes, absolute, relative to the job file or beginning with ~",
                "write where the folder is mounted here",
            )


def _strings(value: Any, location: tuple[str | int, ...] = ()) -> Iterable[tuple[tuple[str | int, ...], str]]:
    """Every text of a section with the keys that lead to it."""
    if isinstance(value, str):
        yield location, value
    elif isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _strings(inner, (*location, key))


def _line(node: Any, location: Sequence[str | int]) -> int:
    """1-based line of the deepest existing node on the way to a location."""
    line = node.start_mark.line if node is not None else 0
    for part in location:
        if isinstance(node, yaml.MappingNode):
            found = next(((k, v) for k, v in node.value if k.value == str(part)), None)
            if found is None:
                break
            line, node = found[0].start_mark.line, found[1]
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
            node = node.value[part]
            line = node.start_mark.line
        else:
            break
    return int(line) + 1
