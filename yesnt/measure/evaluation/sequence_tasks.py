"""Tasks that measure a whole shot: materials and flow against truth, the solve of true materials, videos."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.stage_id import StageId
from yesnt.io import shot_inputs
from yesnt.io.file_digests import file_digest
from yesnt.io.pictures.shot_raster import shot_camera
from yesnt.measure.evaluation.nets import open_nets
from yesnt.measure.evaluation.pictures import write_materials
from yesnt.measure.evaluation.scorer import VIDEO_ROWS
from yesnt.measure.evaluation.subjects import Subject
from yesnt.measure.evaluation.task_records import MaterialTask, TrueSolveTask, VideoTask
from yesnt.metrics.definitions import Metric, named
from yesnt.metrics.image import psnr
from yesnt.metrics.material import measure_material, sparsification
from yesnt.metrics.motion import Video, measure_flow, measure_lengths, path_length, tpsnr_diff, tpsnr_warp
from yesnt.metrics.occlusion import visible_in_next
from yesnt.metrics.score import SOLID, Truth
from yesnt.planning import settings as of
from yesnt.planning.stages import DECOMPOSE, FLOW, SOLVE
from yesnt.tasks.workspace import Workspace

F32 = NDArray[np.float32]

PLANES = ("roughness", "metallic")

MATERIAL_STRIP = "materials.jpg"
"""Name of a shot's strip of materials among its pictures."""

LARGEST_SPREAD = 0.5
"""Standard deviation that is drawn white: the largest that values in 0..1 can have."""


def solve_true(space: Workspace[TrueSolveTask]) -> None:
    """Solves the true materials along true and along our flow, to measure what the solve itself changes."""
    from yesnt.decompose.confidence import confidence
    from yesnt.temporal import solve

    job, subject = space.job, space.task.subject
    mattes = np.stack([shot_inputs.read_matte(job, frame) for frame in job.frames])
    pairs = zip(job.frames, mattes, strict=True)
    true = np.stack([subject.read_material(frame, matte).planes for frame, matte in pairs], axis=1)
    weights = np.ones_like(true)
    if space.task.own:
        spreads = [space.read(DECOMPOSE, "spread", frame) for frame in job.frames]
        weights = np.stack([confidence(spread) for spread in spreads], axis=1)
    links = {}
    if "solved_own_flow_material" in space.task.arrays:
        links["solved_own_flow_material"] = _own_links(space)
    if "solved_true_flow_material" in space.task.arrays:
        links["solved_true_flow_material"] = _true_links(space, subject) if len(job.frames) > 1 else _no_links(space)
    solved = {}
    with space.kernel():
        for name, (flow, validity) in links.items():
            params, tolerance = of.energy_params(job.shot), job.shot.temporal.tolerance
            solved[name] = solve(true, weights, flow, validity, params, mattes > 0.5, tolerance).value
    for t, frame in enumerate(job.frames):
        space.commit(frame, {name: value[:, t] for name, value in solved.items()})


def material(space: Workspace[MaterialTask]) -> None:
    """Errors of mean and solved materials over all frames, calibration of the spread, and flow."""
    job, subject, first = space.job, space.task.subject, space.frame
    columns: dict[str, list[F32]] = {"true": [], "observed": [], "own": [], "spread": []}
    for frame in job.frames:
        matte = shot_inputs.read_matte(job, frame)
        inside = matte > SOLID
        columns["true"].append(subject.read_material(frame, matte).planes[:, inside])
        for name, (stage, array) in _STORED.items():
            columns[name].append(space.read(stage, array, frame)[:, inside])
    values = {name: np.concatenate(parts, axis=1) for name, parts in columns.items()}
    facts: dict[str, Any] = {"material": {}, "sparsification": {}}
    with space.kernel():
        for i, plane in enumerate(PLANES):
            true, mean, spread = values["true"][i], values["observed"][i], values["spread"][i]
            error, metal = mean - true, plane == "metallic"
            facts["material"][plane] = {
                "observed": _as_dict(measure_material(mean, true, spread, metal)),
                "own": _as_dict(measure_material(values["own"][i], true, None, metal)),
            }
            facts["sparsification"][plane] = {
                "spread": sparsification(error, spread).tolist(),
                "oracle": sparsification(error, np.abs(error)).tolist(),
            }
        if subject.has_flow(job.frames):
            facts["flow"] = _as_dict(_flow_numbers(space, subject))
    space.commit(first, {}, _material_strip(space, subject), facts)


def _material_strip(space: Workspace[Any], subject: Subject) -> dict[str, str]:
    """True and solved materials and the ensemble's spread of the middle frame, for the page."""
    frame = space.job.frames[len(space.job.frames) // 2]
    plate = shot_inputs.read_plate(space.job, frame)
    true = subject.read_material(frame, plate.matte).planes
    own, spread = space.read(SOLVE, "material", frame), space.read(DECOMPOSE, "spread", frame)
    path = space.output.root / "pictures" / MATERIAL_STRIP
    maps = [plane for i in range(2) for plane in (true[i], own[i], spread[i] / LARGEST_SPREAD)]
    write_materials(path, plate.color, maps, plate.matte)
    return {str(path.relative_to(space.output.root)): file_digest(path)}


def video(space: Workspace[VideoTask]) -> None:
    """Measures the relit videos of one map, with and without temporal regularisation."""
    stage = StageId("score", part=space.task.map)

    def pictures(row: str) -> Iterator[F32]:
        return (space.read(stage, f"relit.{row}", frame).transpose(1, 2, 0) for frame in space.job.frames)

    with space.kernel():
        facts = video_numbers(space, {row: pictures(row) for row in VIDEO_ROWS}, of_truth=True)
    space.commit(space.frame, {}, facts={"video": facts})


def video_numbers(
    space: Workspace[Any], pictures: Mapping[str, Iterable[F32]], of_truth: bool = False
) -> dict[str, dict[str, float]]:
    """Metrics of videos under the map of a task, by row.

    Args:
        space: of a task with a subject and a map.
        pictures: straight radiance [H, W, 3] of every frame, by row.
        of_truth: whether the true video is measured too.
    """
    job, subject, name = space.job, space.task.subject, space.task.map
    truths = [_truth(space, subject, name, frame) for frame in job.frames]
    matte = np.stack([truth.inside for truth in truths])
    true = np.stack([truth.display for truth in truths])
    nets = open_nets(None)[:1]
    links = _true_links(space, subject) if subject.has_flow(job.frames) else None
    lengths = [path_length(true, net) for net in nets]
    facts: dict[str, dict[str, float]] = {}
    for row, frames in pictures.items():
        shown = np.stack([truth.shown(picture) for truth, picture in zip(truths, frames, strict=True)])
        numbers = _video_numbers(shown, true, matte, links)
        for net, length in zip(nets, lengths, strict=True):
            numbers += measure_lengths(path_length(shown, net), length)
        facts[row] = _as_dict(numbers)
    if of_truth:
        facts["truth"] = _as_dict(_video_numbers(true, true, matte, links))
        for length in lengths:
            facts["truth"]["ppl"] = float(length.mean())
    return facts


def _truth(space: Workspace[Any], subject: Subject, name: str, frame: int) -> Truth:
    radiance, opacity = subject.read_relit(name, frame)
    return Truth.of(radiance, opacity, shot_inputs.read_matte(space.job, frame))


_STORED = {"observed": (DECOMPOSE, "observed"), "own": (SOLVE, "material"), "spread": (DECOMPOSE, "spread")}


def _video_numbers(shown: Video, true: Video, matte: NDArray[np.bool_], links: tuple[F32, F32] | None) -> list[Metric]:
    frames = [psnr(a, b, inside) for a, b, inside in zip(shown, true, matte, strict=True)]
    numbers = [named("psnr_frames", float(np.mean(frames))), named("tpsnr_diff", tpsnr_diff(shown, true, matte))]
    if links is not None:
        flow, seen = links
        numbers.append(named("tpsnr_warp", tpsnr_warp(shown, flow, seen > 0, matte)))
    return numbers


def _flow_numbers(space: Workspace[Any], subject: Subject) -> list[Metric]:
    flow, validity = _own_links(space)
    true, seen = _true_links(space, subject)
    matte = np.stack([shot_inputs.read_matte(space.job, frame) > SOLID for frame in space.job.frames[:-1]])
    return measure_flow(flow, true, validity > 0.5, seen > 0.5, matte)


def _own_links(space: Workspace[Any]) -> tuple[F32, F32]:
    """Our flow [T-1, H, W, 2] and its validity [T-1, H, W]."""
    job = space.job
    flow = np.zeros((len(job.frames) - 1, job.height, job.width, 2), np.float32)
    validity = np.zeros(flow.shape[:-1], np.float32)
    for t, frame in enumerate(job.frames[:-1]):
        flow[t] = space.read(FLOW, "flow", frame).transpose(1, 2, 0)
        validity[t] = space.read(FLOW, "validity", frame)[0]
    return flow, validity


def _true_links(space: Workspace[Any], subject: Subject) -> tuple[F32, F32]:
    """True flow [T-1, H, W, 2], and where its point is visible in the next frame [T-1, H, W]."""
    job = space.job
    camera = shot_camera(job)
    flow = np.stack([subject.read_flow(frame) for frame in job.frames[:-1]])
    depth = np.stack([shot_inputs.read_surface(job, frame, camera).z for frame in job.frames])
    matte = np.stack([shot_inputs.read_matte(job, frame) > 0.5 for frame in job.frames])
    seen = [visible_in_next(flow[t], depth[t], depth[t + 1], matte[t], matte[t + 1]) for t in range(len(flow))]
    return flow, np.stack(seen).astype(np.float32)


def _no_links(space: Workspace[Any]) -> tuple[F32, F32]:
    """Empty flow and validity, for shots of one frame."""
    shape = (0, space.job.height, space.job.width)
    return np.zeros((*shape, 2), np.float32), np.zeros(shape, np.float32)


def _as_dict(numbers: Iterable[Metric]) -> dict[str, float]:
    return {metric.name: metric.value for metric in numbers if not math.isnan(metric.value)}
