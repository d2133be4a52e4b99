"""Checks of a job's input files before any work starts: sizes, damaged pixels, absent channels, room for results.

Decoding every picture is linear in bytes. What a check found is remembered by the digests of the files that it read, so
a later `plan` or `run` decodes only what has changed.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core import camera as camera_module
from yesnt.core.camera import Camera
from yesnt.core.job_progress import Progress, no_progress
from yesnt.core.material_input import MATERIAL
from yesnt.core.parallel import parallel_map
from yesnt.core.shot import Job
from yesnt.inspect.camera_facts import oddities
from yesnt.io import env_maps, shot_inputs
from yesnt.io.color_statements import Statement
from yesnt.io.fact_cache import FactCache
from yesnt.io.job_colors import check_statement, first_statements
from yesnt.io.jobfile import correction_patterns, frame_path, frames_on_disk, has_frame_number, pass_files
from yesnt.io.mesh import read_proxy
from yesnt.io.output import OutputFolder
from yesnt.io.pictures.describe import alpha_warnings, describe_raster, describe_reads, raster_warnings
from yesnt.io.pictures.image import read_header
from yesnt.io.pictures.material_pass import refuse_coded
from yesnt.io.pictures.placed import check_fits
from yesnt.io.pictures.shot_raster import shot_camera
from yesnt.io.preview import has_video
from yesnt.io.records import digest_of
from yesnt.planning.shot_plan import MATTES
from yesnt.runtime.checks.capture import CaptureChecks
from yesnt.runtime.checks.consistency.coded import refuse_coded_alpha
from yesnt.runtime.checks.consistency.contradictions import contradictions
from yesnt.runtime.checks.corrections import CorrectionChecks, correction_facts, corrections_of
from yesnt.runtime.checks.fields import check_field, check_views
from yesnt.runtime.checks.fitted import FittedChecks
from yesnt.runtime.checks.light import light_warnings, sun_facts, sun_warnings
from yesnt.runtime.checks.matting import MattingChecks
from yesnt.runtime.checks.preflight import READERS, Resolved

STORE_BYTES_PER_PIXEL = 80
"""All arrays of the store and the EXR of one frame, before compression."""

NEGATIVE = "plate: negative values that are read as 0"
NOT_FINITE = "plate: pixels outside the matte that are NaN or infinite and read as 0"
UNCOVERED = "plate: pixels with colour but no coverage, added to the composite as they are (or set `alpha: straight`)"
NO_DEPTH = "gbuffer: pixels wholly inside the matte without depth"
ALPHA_BEYOND = "plate: alpha outside 0 to 1 that is read as 0 or 1"
NO_ALPHA = "plate: frames without alpha, and the job names no `matte:`, so that every pixel counts as the subject"

EMPTY = "plate: frames whose matte is empty"
MATERIAL_BEYOND = "decompose: roughness or metallic outside 0 to 1 that is read as 0 or 1"

WHOLE = 0.99
"""Coverage from which a pixel must have a depth: those at an edge may have been sampled beside it."""

UNSEEN = 0.01
"""Colour without coverage up to which nothing is reported."""

_ASPECT = 0.01
"""Share of a map's width by which it may differ from twice its height."""


class InputChecks:
    """Checks of one job.

    Args:
        resolved: the job, and the digests of its files.
        progress: called while pictures are decoded.

    Attributes:
        notes: how files are read where the job leaves it to them; nothing to worry about.
        facts: what checks found, by what they read.
    """

    def __init__(self, resolved: Resolved, progress: Progress = no_progress) -> None:
        self._job, self._digests, self._progress = resolved.job, resolved.digests, progress
        self.notes, self._capture, self._awaiting = resolved.notes, resolved.capture, resolved.awaiting
        self.facts = FactCache(OutputFolder.of(self._job).run / "facts.json")
        self._keys: dict[int, str] = {}

    def form(self, beside_others: bool = False) -> list[str]:
        """Quick checks: frames outside the range, sizes, room for the results; returns warnings.

        Args:
            beside_others: a driver may run the job; else it is refused.

        Raises:
            JobError: as said.
        """
        job = self._job
        warnings = [*self._capture.notes, *_no_video(job), *raster_warnings(job, self._camera)]
        warnings += list(_one_for_all(job)) if self._awaiting else [*alpha_warnings(job), *_one_for_all(job)]
        if job.shot.made:
            check_views(job, self._camera)
        warnings += [f"camera: {odd}" for odd in oddities(self._camera, job.frames)] + list(light_warnings(job))
        made = job.shot.made if self._awaiting else ()
        for pattern in (one for one in (job.shot.plate.path, job.shot.gbuffer.path) if one not in made):
            for frame in (frame for frame in job.frames if made or not self.facts.knows(self._frame_key(frame))):
                check_fits(job, read_header(frame_path(job.root, pattern, frame)))
        output = OutputFolder.of(job)
        output.refuse_inputs(job.shot.name, job.frames, self._digests)
        output.check(len(job.frames) * job.width * job.height * STORE_BYTES_PER_PIXEL // 2)
        if not beside_others:
            output.refuse_if_running()
        return warnings

    def content(self) -> list[str]:
        """Decodes every picture, mesh and map that no earlier check has decoded; returns warnings.

        Raises:
            JobError: one of them cannot be used.
        """
        counts, corrections = Counter[str](), CorrectionChecks(self._job)
        try:
            if self._awaiting:
                return [*self._before_views(), *self._maps()]
            self._check_capture()
            for done, found in enumerate(parallel_map(self._frame, self._job.frames, READERS), 1):
                counts += Counter(found["counts"])
                corrections.add(found.get("corrections"))
                self._progress("Checking frames", done, len(self._job.frames))
            warnings = [f"{what}: {count} in the shot" for what, count in sorted(counts.items())]
            return [*warnings, *corrections.warnings(), *self._maps(), *self._contradictions()]
        finally:
            self.facts.save()

    def _before_views(self) -> Iterable[str]:
        """Reads what is known before plates, G-buffers or proxies are made from fields."""
        job, gaussians = self._job, self._job.shot.gaussians
        for done, frame in enumerate(job.frames, 1):
            if "background" in self._statements and job.shot.background is not None:
                file = frame_path(job.root, job.shot.background.path, frame)
                check_statement(file, job.shot, "background", self._statements["background"])
                shot_inputs.read_background(job, frame)
            if self._matting is not None:
                self._matting.headers(frame)
            elif self._fitted is not None:
                self._fitted.headers(frame)
            if gaussians is not None and gaussians.path is not None:
                digest = self._digests[str(frame_path(job.root, gaussians.path, frame))]
                key = digest_of({"check": "field", "code": code_digest(), "file": digest})
                self.facts.fetch(key, partial(check_field, job, frame))
            self._progress("Checking frames", done, len(job.frames))
        if self._matting is not None:
            yield from self._matting.poses()
        elif self._fitted is not None:
            yield from self._fitted.agreement()

    @cached_property
    def _matting(self) -> MattingChecks | None:
        """Checks of the pictures that mattes are still to be made from; None where they are there or given."""
        if self._awaiting != MATTES:
            return None
        return MattingChecks(self._job, self.facts, self._digests, self._statements["capture"], code_digest())

    @cached_property
    def _fitted(self) -> FittedChecks | None:
        """Checks of the pictures that fields are fitted to; None of a job that fits none."""
        gaussians = self._job.shot.gaussians
        if gaussians is None or gaussians.path is not None:
            return None
        return FittedChecks(self._job, self.facts, self._digests, self._statements["capture"], code_digest())

    def fit_sizes(self) -> list[tuple[int, int]]:
        """Pixels of each camera's picture and of its crop around the subject; none of a job that fits no fields."""
        return [] if self._fitted is None else self._fitted.sizes()

    def material_ranges(self) -> tuple[tuple[float, float], tuple[float, float]] | None:
        """Smallest and largest roughness and metallic inside the mattes, of passes that the job brings; else None."""
        shot = self._job.shot
        exact = not shot.decompose.samples_backend and not shot.materials
        found = [self._frame(frame)["range"] for frame in self._job.frames if exact]
        ranges = np.array([one for one in found if one is not None])  # [frames, (least, most), (roughness, metallic)]
        if not len(ranges):
            return None
        least, most = ranges[:, 0].min(axis=0).tolist(), ranges[:, 1].max(axis=0).tolist()
        return (least[0], most[0]), (least[1], most[1])

    def reads(self) -> list[str]:
        """Which channels serve what, for `plan`; where frames differ, how many read which."""
        job, counts = self._job, Counter[tuple[str, str]]()
        for frame in () if self._awaiting else job.frames:
            counts.update(self._frame(frame)["reads"].items())
        frames = len(job.frames)
        lines = [f"{role}: {how}{'' if n == frames else f' ({n} frames)'}" for (role, how), n in counts.items()]
        return [*lines, *self._capture.reads, *(f"pixels: {line}" for line in describe_raster(job))]

    def _frame(self, frame: int) -> dict[str, Any]:
        fact: dict[str, Any] = self.facts.fetch(self._frame_key(frame), lambda: self._check_frame(frame))
        return fact

    def _check_frame(self, frame: int) -> dict[str, Any]:
        """Decodes all of a frame's inputs; counts what is used although it is odd."""
        job = self._job
        for role in (role for role in ("plate", "background") if role in self._statements):
            path = frame_path(job.root, getattr(job.shot, role).path, frame)
            check_statement(path, job.shot, role, self._statements[role])
        plate = shot_inputs.read_plate(job, frame, working=True)
        surface = shot_inputs.read_surface(job, frame, self._camera)
        if job.shot.proxy:
            read_proxy(job, frame)
        samples = job.shot.decompose.samples_backend
        inside = None if samples else shot_inputs.stored_passes(job, frame)[0][:, plate.matte > 0]
        if job.shot.flow.path and frame != job.frames[-1]:
            shot_inputs.read_flow(job, frame)
        shot_inputs.read_background(job, frame)
        counts = {
            NEGATIVE: plate.clamped,
            NO_DEPTH: int(((plate.matte > WHOLE) & (surface.z == 0)).sum()),
            ALPHA_BEYOND: plate.alpha_clamped,
            NO_ALPHA: int(not plate.has_alpha),
            NOT_FINITE: plate.not_finite,
            UNCOVERED: 0 if plate.uncovered is None else _uncovered(plate.matte, plate.uncovered),
            EMPTY: int(not (plate.matte > 0.5).any()),
            MATERIAL_BEYOND: 0 if inside is None else int(((inside < 0) | (inside > 1)).sum()),
        }
        refuse_coded_alpha(plate, f"frame {frame}")
        for name, values in zip(MATERIAL, () if inside is None else inside, strict=False):
            refuse_coded(values, f"decompose, frame {frame}", name)
        known = inside is not None and inside.size > 0
        inside = np.clip(inside, 0, 1) if inside is not None else None
        span = [inside.min(axis=1).tolist(), inside.max(axis=1).tolist()] if known and inside is not None else None
        met = {"corrections": correction_facts(job, frame, plate.matte)} if job.shot.corrected else {}
        kept = {what: count for what, count in counts.items() if count}
        return {"counts": kept, "range": span, "reads": describe_reads(job, frame), **met}

    def _contradictions(self) -> Iterable[str]:
        """Compares the inputs of a few frames with one another."""
        found = {}
        for frame in self._job.probe_frames:
            key = digest_of(self._depends(frame) | {"check": "consistency", "light": self._capture_light(frame)})
            found[frame] = self.facts.fetch(key, partial(self._measure, frame))
        return contradictions(found, self._job.shot)

    def _measure(self, frame: int) -> dict[str, Any]:
        from yesnt.runtime.checks.consistency.measure import measure_frame  # imports Numba's kernels

        return measure_frame(self._job, frame, self._camera)

    def _capture_light(self, frame: int) -> list[Any]:
        """The capture light's settings and the digest of its map."""
        spec = self._job.shot.capture_light
        if spec is None:
            return []
        digest = self._digests[str(frame_path(self._job.root, spec.path, frame))] if spec.path else None
        return [spec.model_dump(mode="json"), asdict(self._job.colors.capture_light), digest]

    def _frame_key(self, frame: int) -> str:
        """Digest of everything that the check of a frame depends on."""
        if frame not in self._keys:
            self._keys[frame] = digest_of(self._depends(frame))
        return self._keys[frame]

    def _depends(self, frame: int) -> dict[str, Any]:
        job, shot = self._job, self._job.shot
        patterns: dict[str, str | None] = {
            "plate": shot.plate.path, "matte": shot.matte.path if shot.matte else None,
            "gbuffer": shot.gbuffer.path, "camera": shot.camera,
            "proxy": shot.proxy.path if shot.proxy else None,
            "background": shot.background.path if shot.background else None,
            "flow": shot.flow.path if frame != job.frames[-1] else None,
        }  # fmt: skip
        patterns |= pass_files(shot.decompose) | correction_patterns(shot)
        files = {role: self._digests[str(frame_path(job.root, p, frame))] for role, p in patterns.items() if p}
        return {"check": "frame", "files": files, "frame": frame, **self._of_all_frames}

    @cached_property
    def _of_all_frames(self) -> dict[str, Any]:
        """What the checks of all frames depend on alike."""
        job, shot = self._job, self._job.shot
        sections = shot.plate, shot.matte, shot.background, shot.gbuffer, shot.proxy
        return {
            "code": code_digest(), "window": str(job.window), "display": job.display_size,
            "reads": [section.model_dump(mode="json") for section in sections if section],
            "colors": [asdict(getattr(job.colors, role)) for role in ("plate_working", "background")],
            "stated": [asdict(self._statements[role]) for role in ("plate", "background") if role in self._statements],
            "corrects": corrections_of(shot),
        }  # fmt: skip

    @cached_property
    def _statements(self) -> dict[str, Statement]:
        return first_statements(self._job)

    @cached_property
    def _camera(self) -> Camera:
        return shot_camera(self._job)

    def _check_capture(self) -> None:
        """Looks at the pictures of the cameras that measure the materials."""
        if not self._capture.views:
            return
        checks = CaptureChecks(self._job, self._capture, self._statements["capture"])
        for done, (frame, depends) in enumerate(checks.depends(self._digests), 1):
            self.facts.fetch(digest_of(depends | {"code": code_digest()}), partial(checks.check, frame))
            self._progress("Checking the capture", done, len(self._capture.views))

    def _maps(self) -> Iterable[str]:
        """Decodes every map of both lights once."""
        job = self._job
        for role, light in (("light", job.shot.light), ("capture_light", job.shot.capture_light)):
            pattern = light.path if light is not None else None
            for path in dict.fromkeys(frame_path(job.root, pattern, f) for f in job.frames if pattern is not None):
                stated, conversion = asdict(self._statements[role]), asdict(getattr(job.colors, role))
                depends = {"file": self._digests[str(path)], "stated": stated, "color": conversion}
                own = light and {"clamp": light.clamp, "layer": light.layer, **self._divided(role)}
                key = digest_of({"check": "map", "code": code_digest(), "light": own, **depends})
                found = self.facts.fetch(key, partial(self._check_map, path, role))
                yield from (f"{role}: {count} {what} ({path})" for what, count in found["counts"].items())
                width, height = found["size"]
                if abs(width - 2 * height) > max(1, _ASPECT * width):
                    yield (
                        f"{role}: {path} is {width}x{height}, {width / height:.3g} to 1, and a lat-long map is 2 to 1: "
                        "it is stretched over the sphere; a cube or a mirror ball must be converted first"
                    )
                if "sun" in found:
                    yield from sun_warnings(path, found["sun"])

    def _divided(self, role: str) -> dict[str, bool]:
        """Whether the sun of a map is divided off; empty if not."""
        return {"sun": True} if role == "light" and self._job.shot.light_groups else {}

    def _check_map(self, path: Path, role: str) -> dict[str, Any]:
        """Decodes a map; counts what is used although it is odd."""
        check_statement(path, self._job.shot, role, self._statements[role])
        light = getattr(self._job.shot, role)
        found = env_maps.read_radiance(path, getattr(self._job.colors, role), light.clamp, light.layer)
        counts = {"negative values are read as 0": found.negative, "infinite values are clamped": found.infinite}
        size = [found.values.shape[1], found.values.shape[0]]
        facts = {"counts": {what: count for what, count in counts.items() if count}, "size": size}
        return facts | ({"sun": sun_facts(found.values, light.clamp)} if self._divided(role) else {})


def _uncovered(matte: NDArray[np.float32], uncovered: NDArray[np.float32]) -> int:
    """How many pixels have colour but no coverage.

    Not those beside covered ones, where reconstruction filters and denoisers leave some, and not what nobody sees.
    """
    from scipy.ndimage import binary_dilation

    near = binary_dilation(matte > 0, np.ones((3, 3), np.bool_))
    return int(((np.abs(uncovered) > UNSEEN).any(-1) & ~near).sum())


@cache
def code_digest() -> str:
    """Digest of the modules that read and check inputs: after a change of theirs nothing is taken from memory."""
    digest = hashlib.blake2b(digest_size=16)
    cameras = Path(camera_module.__file__).parent.glob("*.py")
    readers, checks = Path(shot_inputs.__file__).parent.rglob("*.py"), Path(__file__).parent.rglob("*.py")
    for module in sorted([*readers, *cameras, *checks]):
        digest.update(module.read_bytes())
    return digest.hexdigest()


def inspect(resolved: Resolved) -> list[str]:
    """Makes all checks; returns notes and warnings.

    Raises:
        JobError: an input or the output folder cannot be used.
    """
    checks = InputChecks(resolved)
    return [*checks.notes, *checks.form(), *checks.content()]


def _one_for_all(job: Job) -> Iterable[str]:
    """Sequences whose path has no frame number: often a path that was pasted from a file browser."""
    shot, count = job.shot, len(job.frames)
    matte = shot.matte.path if shot.matte else None
    for role, pattern in (("plate", shot.plate.path), ("gbuffer", shot.gbuffer.path), ("matte", matte)):
        if pattern is not None and count > 1 and not has_frame_number(pattern):
            yield f"{role}: {pattern} serves all {count} frames; a sequence has #### where the frame number stands"


def _no_video(job: Job) -> Iterable[str]:
    """Pictures of which no preview video can be made; their EXRs are delivered."""
    if not has_video(job):
        yield f"no preview video is made: the pictures are {job.width}x{job.height}, and a video needs at least 2x2"


def handles(job: Job) -> Iterable[str]:
    """Frames of a sequence outside the job's range, as editorial adds them at both ends."""
    for pattern in (job.shot.plate.path, job.shot.gbuffer.path):
        extra = sorted(frames_on_disk(job.root, pattern) - set(job.frames))
        if extra:
            count = f"{len(extra)} frame{'s' if len(extra) > 1 else ''} on disk"
            yield f"{pattern}: {count} outside `frames:` ({extra[0]} to {extra[-1]}) not used"
