"""Says in words what the measured frames contradict: warnings with numbers, refusals where the mistake is certain."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from yesnt.core.errors import JobError
from yesnt.core.shot import Shot
from yesnt.runtime.checks.consistency.feet import of_ground
from yesnt.runtime.checks.consistency.sample import GOOD, SLOPES

Facts = Mapping[str, Any]

_RAY = 0.5  # share of distance along the ray in depth: 0.03 at most on the capture stage's shots, 1 if it is that
_NEITHER = 1.6  # and where it explains nothing: 2.7 for fx in millimetres, 25 for depth in 0 to 1
_STEEP = 1.4  # slopes of right shots are 1.01 to 1.04 times those of the normals, of depth in 0 to 1 3 and more
_RAY_GAIN = 1.5  # least gain of misfit: noisy normals gave 1.1, the shots of the capture stage 2 and more
_SIZES = (0.02, 50.0)  # metres: a subject of the capture is between a hand and a truck
_BRIGHT = 0.05  # share of pixels brighter than white paper would be
_ALIKE = 1.01  # misfits that differ by less are the same
_BLACK = 0.02  # median albedo: half of what glass reflects; black plastics of the capture stage had 0.025
_DARK = 0.1  # and albedo that only 1 % of the pixels exceed


def contradictions(frames: Mapping[int, Facts], shot: Shot) -> Iterable[str]:
    """Warnings of the measured frames of a shot.

    Args:
        frames: facts by frame (`measure_frame`).
        shot: of the job.

    Raises:
        JobError: no pixel has a normal, or no triangle of the proxy an area.
    """
    known = {frame: facts for frame, facts in frames.items() if facts}
    if not known:
        return
    facts = list(known.values())
    where = f"frames {', '.join(map(str, known))}" if len(known) > 1 else f"frame {next(iter(known))}"
    if _mean(facts, "zero") == 1:
        raise JobError(
            "The normals have no length at 100 % of the covered pixels", f"{shot.gbuffer.path}, {where}",
            "unit normals", "check the channels that `normal` names, or render the normal pass again",
        )  # fmt: skip
    yield from _of_normals(facts, where)
    yield from _of_depth(facts, where)
    yield from _of_exposure(facts, where)
    yield from _of_proxy([one["proxy"] for one in facts if "proxy" in one], where)
    yield from of_ground(shot.set, [one["proxy"] for one in facts if "proxy" in one], where)


def _of_normals(facts: Sequence[Facts], where: str) -> Iterable[str]:
    unit, facing, along = (_mean(facts, key) for key in ("unit", "facing", "along"))
    if unit < GOOD:
        yield f"gbuffer: {unit:.0%} of the normals have unit length ({where})"
    mend = _mend([one["mends"] for one in facts], GOOD, 'check `normal_space` and the camera\'s `"axes"`')
    if facing < GOOD:
        yield f"gbuffer and camera: {facing:.0%} of the normals face the camera ({where}); {mend}"
    elif along < 1 - SLOPES:
        yield (
            f"gbuffer: depth grows where the normals say that it falls at {1 - along:.0%} of the slopes ({where}); "
            "inverse depth is `z_kind: inverse`, and planar depth is `planar`"
        )
    elif along < SLOPES:
        yield f"gbuffer: depth and normals agree at {along:.0%} of the slopes ({where}); {mend}"


def _of_depth(facts: Sequence[Facts], where: str) -> Iterable[str]:
    known = [one for one in facts if one["ray"] is not None and one["along"] is not None]
    certain = [one["ray"] for one in known if one["ray_gain"] > _RAY_GAIN and one["along"] > SLOPES]
    share = float(np.mean(certain)) if certain else 0.0
    steep = _mean([one for one in known if one["steep"] is not None and one["along"] > SLOPES], "steep")
    if _RAY < share < _NEITHER:
        yield f"gbuffer: by its normals depth is distance along the ray ({share:.0%}; {where}): say `z_kind: ray`"
    elif -_NEITHER < share < -_RAY:
        yield f"gbuffer: by its normals depth is planar and not distance along the ray ({-share:.0%}; {where})"
    elif steep < 1 / _STEEP or steep > _STEEP:
        yield (
            f"gbuffer: depth changes {steep:.3g} times as much as the normals say ({where}): depth from 0 to 1 or "
            "from another plane than the camera's, or another focal length (fx, fy are in pixels)"
        )
    extent = _mean(facts, "extent")
    if 0 < extent < _SIZES[0] or extent > _SIZES[1]:
        yield (
            f"gbuffer: the subject is {extent:.4g} m large by its depth ({where}; expected {_SIZES[0]:g} to "
            f"{_SIZES[1]:g} m): `units` of the G-buffer and of camera.json convert cm and mm"
        )


def _of_exposure(facts: Sequence[Facts], where: str) -> Iterable[str]:
    lit = [one for one in facts if "albedo" in one]
    if not lit:
        return
    bright, (median, high) = _mean(lit, "bright"), np.mean([one["albedo"] for one in lit], axis=0)
    mend = "check the exposure and the colour space of both; without a map, `capture_light: estimate`"
    if bright > _BRIGHT:
        yield (
            f"plate and capture_light: {bright:.0%} of the covered pixels are brighter than a white surface under the "
            f"capture light (median albedo {median:.2g}; {where}): their base colour is clamped at 1; {mend}"
        )
    elif median < _BLACK and high < _DARK:
        yield (
            f"plate and capture_light: 99 % of the covered pixels would reflect less than {high:.2g} of the capture "
            f"light (median albedo {median:.2g}; {where}); {mend}"
        )


def _of_proxy(facts: Sequence[Facts], where: str) -> Iterable[str]:
    if not facts:
        return
    flat, hit, agree = (_mean(facts, key) for key in ("degenerate", "hit", "agree"))
    if flat == 1:
        raise JobError(
            "100 % of the proxy's triangles have no area", f"proxy, {where}", "a triangle mesh", "export it again"
        )
    if flat > 1 - GOOD:
        yield f"proxy: {flat:.0%} of its triangles have no area ({where})"
    if agree >= GOOD:
        return
    mend = _mend([one["mends"] for one in facts], GOOD, "check its place, its scale and its frame numbers")
    ratio = f", at {_mean(facts, 'ratio'):.3g} times their depth" if hit else ""
    yield (
        f"proxy and gbuffer: the proxy lies where depth says at {agree:.0%} of the covered pixels ({where}; "
        f"{hit:.0%} see it{ratio}); {mend}"
    )


def _mend(mends: Sequence[Mapping[str, Sequence[float]]], good: float, otherwise: str) -> str:
    """The mistakes that leave the least misfit, of those that explain enough in every frame that tried them.

    Several may fit alike: with a level camera that looks along +Y, OpenGL's camera axes are those of a Y-up world.
    """
    tried = [one for one in mends if one]
    shares = {name: min(one[name][0] for one in tried) for name in (tried[0] if tried else ())}
    misfit = {name: max(one[name][1] for one in tried) for name, share in shares.items() if share >= good}
    least = min(misfit.values(), default=0.0)
    alike = [name for name, value in misfit.items() if value <= _ALIKE * least + 1e-6]
    return f"it would be {shares[alike[0]]:.0%} if {', or if '.join(alike)}" if alike else otherwise


def _mean(facts: Sequence[Facts], key: str) -> float:
    values = [one[key] for one in facts if one[key] is not None]
    return float(np.mean(values)) if values else float("nan")
