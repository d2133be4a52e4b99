"""Checks of animated lights before a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from yesnt.core.frame_ranges import frame_ranges
from yesnt.core.shot import Job


def light_warnings(job: Job) -> Iterator[str]:
    """Lights whose keys all lie before or all after the shot: their animation is not seen."""
    first, last = job.frames[0], job.frames[-1]
    for role, light in (("light", job.shot.light), ("capture_light", job.shot.capture_light)):
        for name in ("rotation", "exposure") if light is not None else ():
            keys = getattr(light, name)
            if not isinstance(keys, Mapping) or len(set(keys.values())) == 1:
                continue
            if max(keys) < first or min(keys) > last:
                nearest = keys[max(keys) if max(keys) < first else min(keys)]
                yield (
                    f"{role}.{name}: its keys are at frames {frame_ranges(keys)}, and the shot is {first}-{last}: "
                    f"it is {nearest} throughout"
                )
