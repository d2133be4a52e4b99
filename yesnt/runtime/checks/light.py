"""Checks of lights before a run: their animation, and the sun that a job with light groups divides off."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

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


def sun_facts(radiance: NDArray[np.float32], clamp: float | None) -> dict[str, Any]:
    """What `find_sun` says of a map [h, w, 3]: the share of the light that its sun gives, and how many other lamps."""
    from yesnt.relight.envmap import EnvMap
    from yesnt.relight.sun import find_sun

    env = EnvMap.from_array(radiance)
    sun = find_sun(env if clamp is None else env.clamped(clamp))
    return {"share": round(sun.share, 4), "others": sun.others}


def sun_warnings(path: Path, found: Mapping[str, Any]) -> Iterator[str]:
    """Maps of a job with light groups that have no sun, or several lamps."""
    if not found["share"]:
        yield (
            f"light: {path} has no small, bright lamp: `light_sun` will be black, and `light_rest` the whole composite"
        )
    elif found["others"]:
        yield (
            f"light: `light_sun` is the strongest lamp of {path}, {found['share']:.0%} of its light; "
            f"{found['others']} more are in `light_rest`"
        )
