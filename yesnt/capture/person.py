"""Finds persons in pictures with MediaPipe's models of the human pose (extra `matting`).

BlazePose finds hips and the reach of a body, turns a square around it upright, and returns the body's coverage there.
Bazarevsky et al. 2020, "BlazePose: On-device Real-time Body Pose tracking". The models come with the package mediapipe,
of which no code is used; ai-edge-litert runs them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import srgb_encode
from yesnt.core.errors import JobError, MissingPartError
from yesnt.core.shot import Job
from yesnt.io.jobfile import frame_path

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

DETECTOR, BODY = "pose_detection/pose_detection.tflite", "pose_landmark/pose_landmark_full.tflite"
"""Files of the models below the folder `mediapipe/modules`."""

MOST_PERSONS = 4
"""Persons of a picture that are looked at; the hull of all cameras later tells which of them is the subject."""

_DETECTED, _PRESENT = 0.4, 0.5  # least scores of a detection and of a body
_STRIDES = ((8, 2), (16, 2), (32, 6))  # pixels between the detector's anchors, and anchors at each place
_WIDER = 1.25  # the square around a body, as a multiple of twice the distance from its hips to its reach
_APART = 0.25  # of the reach, by which the hips of two persons are apart
_MIDDLE = (0.05, 0.5)  # mean radiance that the models take for well exposed
_EXPECTED = "`modules` of the package mediapipe 0.10: pose_detection and pose_landmark (docs/capture.md says how)"


@dataclass(frozen=True)
class Models:
    """Files of the models that find persons.

    Attributes:
        detector: finds bodies in a picture.
        body: covers one body.
    """

    detector: Path
    body: Path


@dataclass(frozen=True)
class View:
    """How a picture is looked at.

    Attributes:
        up: direction in the picture, x and y, that is up in the world.
        centre: pixel, x and y, that all cameras look at.
    """

    up: tuple[float, float]
    centre: tuple[float, float]


def find_models(folder: Path | None) -> Models:
    """The models in a folder, or in the installed package mediapipe.

    Raises:
        JobError: the folder does not hold them.
        MissingPartError: no folder is given and mediapipe is not installed, or ai-edge-litert is absent.
    """
    from importlib.util import find_spec

    if find_spec("ai_edge_litert") is None:
        raise _without("package ai-edge-litert")
    if folder is None:
        package = find_spec("mediapipe")
        if package is None or not package.submodule_search_locations:
            raise _without("models of the package mediapipe")
        folder = Path(next(iter(package.submodule_search_locations))) / "modules"
    models = Models(folder / DETECTOR, folder / BODY)
    for path in (models.detector, models.body):
        if not path.is_file():
            raise JobError(
                "A model that finds persons is missing", str(path), _EXPECTED, "correct `capture.matting.weights`"
            )
    return models


def model_files(job: Job) -> dict[str, Path]:
    """The models of a job by role; none where it does not look for persons.

    Raises:
        JobError, MissingPartError: as `find_models`.
    """
    capture = job.shot.matted
    if capture is None or capture.matting is None or not capture.matting.person:
        return {}
    weights = capture.matting.weights
    models = find_models(None if weights is None else frame_path(job.root, weights, 0))
    return {"detector": models.detector, "body": models.body}


def _without(what: str) -> MissingPartError:
    return MissingPartError(
        f"Finding persons in pictures needs the {what}, which is not installed", "key capture.matting.person",
        "the extra `matting` and the models of mediapipe",
        "`pip install 'yesnt[matting]'` and `pip install --no-deps mediapipe==0.10.14`, or name the models' folder in "
        "`capture.matting.weights`; or leave `person` out and give mattes or a clean plate",
    )  # fmt: skip


def person_probability(picture: F32, view: View, models: Models) -> F32:
    """Probability [H, W] that a pixel shows a person; 0 where nobody is found.

    Args:
        picture: [H, W, 3] linear radiance.
        view: how it is looked at.
        models: files of the models.

    Raises:
        JobError: a file does not hold its model.
    """
    mean = max(float(np.nanmean(picture)), 1e-9)
    exposed = np.nan_to_num(picture) * (np.clip(mean, *_MIDDLE) / mean)
    shown = srgb_encode(np.clip(exposed, 0, 1)).astype(np.float32)
    height, width = shown.shape[:2]
    turn = float(np.arctan2(view.up[0], -view.up[1]))
    whole, middle = (0.5 * width, 0.5 * height), view.centre
    squares = [_Square(whole, max(width, height), turn), _Square(middle, 0.6 * max(width, height), turn)]
    bodies = _apart([one for square in squares for one in _detect(shown, square, models.detector)])
    found = np.zeros((height, width), np.float32)
    for body in bodies[:MOST_PERSONS]:
        found = np.maximum(found, _covered(shown, body, models.body))
    return found


@dataclass(frozen=True)
class _Square:
    """A turned square of a picture: centre and side in pixels, and its angle."""

    centre: tuple[float, float]
    side: float
    turn: float

    def taken(self, shown: F32, pixels: int) -> tuple[F32, F64]:
        """The square as a picture [pixels, pixels, 3], and the map [2, 3] from there to the whole picture."""
        import cv2

        scale, cos, sin = pixels / self.side, np.cos(self.turn), np.sin(self.turn)
        there = scale * np.array([[cos, sin, 0.0], [-sin, cos, 0.0]])
        there[:, 2] = 0.5 * pixels - there[:, :2] @ self.centre
        how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        return cv2.warpAffine(shown, there, (pixels, pixels), flags=how), cv2.invertAffineTransform(there)


@dataclass(frozen=True)
class _Body:
    score: float
    hips: F64  # [2] pixels
    reach: F64  # [2] pixels: a point on the circle around the whole body

    @property
    def length(self) -> float:
        return float(np.linalg.norm(self.reach - self.hips))


def _detect(shown: F32, square: _Square, model: Path) -> list[_Body]:
    size = 224
    part, back = square.taken(shown, size)
    boxes, scores = _run(model, 2 * part - 1)
    scores = 1 / (1 + np.exp(-np.clip(scores[:, 0].astype(np.float64), -60, 60)))
    # Behind the box's centre and size come four points as offsets from the anchor: the hips, the reach, two others.
    points = boxes.astype(np.float64).reshape(-1, 6, 2)[:, 2:4] / size + _anchors(size)[:, None]
    points = size * points @ back[:, :2].T + back[:, 2]
    return [_Body(float(scores[i]), *points[i]) for i in np.flatnonzero(scores >= _DETECTED)]


@lru_cache(maxsize=1)
def _anchors(size: int) -> F64:
    found = []
    for stride, count in _STRIDES:
        side = (np.arange(size // stride) + 0.5) * stride / size
        found.append(np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2).repeat(count, axis=0))
    return np.concatenate(found)


def _apart(bodies: Sequence[_Body]) -> list[_Body]:
    """The best detection of each person, best first."""
    kept: list[_Body] = []
    for one in sorted(bodies, key=lambda body: -body.score):
        if one.length > 1 and all(np.linalg.norm(one.hips - k.hips) > _APART * k.length for k in kept):
            kept.append(one)
    return kept


def _covered(shown: F32, body: _Body, model: Path) -> F32:
    """Coverage of a body in the whole picture, [H, W]; 0 everywhere if there is none."""
    import cv2

    away = body.reach - body.hips
    turn = float(np.arctan2(away[1], away[0])) + 0.5 * np.pi
    part, back = _Square((body.hips[0], body.hips[1]), 2 * _WIDER * body.length, turn).taken(shown, 256)
    _, present, covered, *_ = _run(model, part)
    if float(np.ravel(present)[0]) < _PRESENT:
        return np.zeros(shown.shape[:2], np.float32)
    probability = 1 / (1 + np.exp(-np.clip(covered[..., 0].astype(np.float64), -60, 60)))
    return np.asarray(cv2.warpAffine(probability.astype(np.float32), back, shown.shape[1::-1]))


def _run(path: Path, picture: F32) -> list[Any]:
    """The outputs of a model for a picture [H, W, 3]."""
    status = path.stat()
    model = _model(path, status.st_mtime_ns, status.st_size)
    model.set_tensor(model.get_input_details()[0]["index"], np.ascontiguousarray(picture[None], np.float32))
    model.invoke()
    return [model.get_tensor(one["index"])[0] for one in model.get_output_details()]


@lru_cache(maxsize=4)
def _model(path: Path, _modified: int, _size: int) -> Any:
    from ai_edge_litert.interpreter import Interpreter

    try:
        model = Interpreter(str(path), num_threads=1)  # one thread: the same bits however busy the machine is
        model.allocate_tensors()
    except (ValueError, RuntimeError) as error:
        raise JobError(f"The model cannot be used ({error})", str(path), _EXPECTED, "check the file") from error
    return model
