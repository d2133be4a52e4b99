"""The settings that enter a commit key: values that differ from their defaults, and nothing else.

A new optional setting with a default therefore leaves every key as it was. In return, a stage whose default changes
must raise its version (`stages.py`).
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from yesnt.io.records import SharedSettings

if TYPE_CHECKING:
    from pydantic import BaseModel

    from yesnt.core.capture_input import CaptureCameras


def changed_fields(record: Any) -> dict[str, Any]:
    """Fields of a frozen dataclass that differ from their defaults, records inside it included; without a default: all.

    Args:
        record: a dataclass whose values are JSON values, tuples of them, or such dataclasses.
    """
    found = {}
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if value != _default(field):
            found[field.name] = changed_fields(value) if dataclasses.is_dataclass(value) else value
    return found


def _default(field: dataclasses.Field[Any]) -> Any:
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default  # MISSING equals no value


def changed_keys(section: BaseModel, without: Any = None) -> dict[str, Any]:
    """Keys of a section of the job file that differ from their defaults, as JSON values.

    Args:
        section: the section.
        without: keys that are left out, as pydantic's `exclude`; paths are, since the files' digests enter instead.
    """
    return section.model_dump(mode="json", exclude_defaults=True, exclude=without)


def picture_keys(capture: CaptureCameras) -> dict[str, Any]:
    """What the pictures of a capture are read by, for keys; its files enter by their digests, made mattes too."""
    return changed_keys(capture, {"cameras", "images", "mattes", "matting"})


def shared(**settings: Any) -> SharedSettings:
    """Settings of many tasks, without the sections in which nothing differs from the defaults."""
    return SharedSettings({name: value for name, value in settings.items() if value not in (None, {}, (), [])})
