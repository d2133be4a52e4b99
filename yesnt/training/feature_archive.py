"""What the second opinion learns from: whole subjects as the backbone sees them, and its features at some places."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from yesnt.decompose.auxiliary import AUXILIARY_INPUT_SIDE, AUXILIARY_OUTPUT_SIDE, display_encode, upsample
from yesnt.decompose.backbone import Backbone
from yesnt.decompose.global_context import Square, context_image
from yesnt.io.durable import durable_path
from yesnt.training.pictures import interleaved_people, object_path, open_views, person_path
from yesnt.training.synthetic.dataset import Augmentation, context_truth, draw_mix, expose, recolour_garments
from yesnt.training.synthetic.materials import MaterialStyle
from yesnt.training.synthetic.render import Rendering

Float32 = NDArray[np.float32]

EXAMPLES_PER_VIEW = 2
"""Times that each view is surveyed, each time through another camera."""

SAMPLES_PER_EXAMPLE = 256
"""Most places of a look that are kept."""

HELD_OUT_STRIDE = 5
"""Every fifth subject is not shown to the perceptron: how far it may be wrong is learnt from these."""

_AUGMENTATION = Augmentation(MaterialStyle(), colour_mixing=0.3, recoloured=0.3)


@dataclass(frozen=True)
class AuxiliaryExample:
    """One look at a subject.

    Attributes:
        picture: [4, AUXILIARY_INPUT_SIDE, AUXILIARY_INPUT_SIDE] straight linear rgb and matte.
        truth: [3, AUXILIARY_OUTPUT_SIDE, AUXILIARY_OUTPUT_SIDE] roughness, metallic and coverage.
        kind: [AUXILIARY_OUTPUT_SIDE, AUXILIARY_OUTPUT_SIDE] class, -1 outside the matte.
    """

    picture: Float32
    truth: Float32
    kind: NDArray[np.int64]


class FeatureSamples(NamedTuple):
    """Examples for the perceptron: features [n, C], roughness and metallic [n, 2] in [0, 1], class [n]."""

    features: NDArray[np.float16]
    truth: NDArray[np.float16]
    kind: NDArray[np.int8]


def subjects(folder: Path, seed: int, people: int, things: int) -> tuple[list[Path], list[Path]]:
    """Files of the archive: those the perceptron learns from, and those kept back."""
    paths = [person_path(folder, seed, number) for number in interleaved_people()[:people]]
    others = [object_path(folder, seed, number) for number in range(things)]
    learnt = [p for group in (paths, others) for n, p in enumerate(group) if n % HELD_OUT_STRIDE != HELD_OUT_STRIDE - 1]
    kept = [p for group in (paths, others) for n, p in enumerate(group) if n % HELD_OUT_STRIDE == HELD_OUT_STRIDE - 1]
    return learnt, kept


def draw_example(
    rng: np.random.Generator, picture: Rendering, augmentation: Augmentation = _AUGMENTATION
) -> AuxiliaryExample:
    """Looks at a subject or a part of it, through a camera of its own."""
    if rng.random() < augmentation.recoloured:
        picture = recolour_garments(rng, picture)
    rgb, matte, _ = expose(rng, picture.rgb.astype(np.float32), picture.matte.astype(np.float32))
    if rng.random() < augmentation.colour_mixing:
        rgb = np.einsum("ij,jyx->iyx", draw_mix(rng), rgb)
    square = _draw_square(rng, Square.around(matte))
    shown = context_image(rgb, matte, square, AUXILIARY_INPUT_SIDE)
    truth, kind = context_truth(picture, square, AUXILIARY_OUTPUT_SIDE)
    way = slice(None, None, -1 if rng.random() < 0.5 else 1)  # mirrored or as it is
    return AuxiliaryExample(np.ascontiguousarray(shown[..., way]), truth[..., way], kind[:, way])


def _draw_square(rng: np.random.Generator, square: Square) -> Square:
    """The subject's square, or half of the time another that shows it smaller or a part of it."""
    if rng.random() < 0.5:
        return square
    side = round(square.side * float(np.exp(rng.uniform(-0.6, 0.2))))
    room = abs(square.side - side)
    top, left = (int(v) for v in rng.integers(0, room + 1, 2) - (0 if side < square.side else room))
    return Square(square.top + top, square.left + left, side)


@torch.no_grad()
def extract_features(backbone: Backbone, survey: AuxiliaryExample, rng: np.random.Generator) -> FeatureSamples:
    """The backbone's features at up to `SAMPLES_PER_EXAMPLE` random places inside the matte."""
    features = backbone(display_encode(torch.from_numpy(survey.picture)[None]))
    planes = torch.cat([upsample(x, AUXILIARY_OUTPUT_SIDE) for x in features], 1)[0].flatten(1).numpy()
    inside = np.flatnonzero((survey.truth[2] > 0.5) & (survey.kind >= 0))
    chosen = rng.permutation(inside)[:SAMPLES_PER_EXAMPLE]
    return FeatureSamples(
        planes[:, chosen].T.astype(np.float16),
        survey.truth[:2].reshape(2, -1)[:, chosen].T.astype(np.float16),
        survey.kind.ravel()[chosen].astype(np.int8),
    )


def extract_all(folder: Path, seed: int, paths: Sequence[Path], backbone: Backbone) -> Iterator[Path]:
    """Keeps the examples of every subject below the training's folder; what is there is not made again."""
    for path in paths:
        kept = folder / f"places.{seed}" / f"{path.parent.name}.{path.name}"
        if not kept.exists():
            rng = np.random.Generator(np.random.Philox(key=[seed, 4_000_000 + int(path.stem)]))
            looks = [
                extract_features(backbone, draw_example(rng, view), rng)
                for view in open_views(path)
                for _ in range(EXAMPLES_PER_VIEW)
            ]
            kept.parent.mkdir(parents=True, exist_ok=True)
            with durable_path(kept) as temporary, temporary.open("wb") as stream:
                np.savez(stream, **_joined(looks)._asdict())
        yield kept


def open_samples(paths: Sequence[Path]) -> FeatureSamples:
    """All examples of some subjects."""
    groups = []
    for path in paths:
        with np.load(path) as data:
            groups.append(FeatureSamples(*(data[name] for name in FeatureSamples._fields)))
    return _joined(groups)


def _joined(groups: Sequence[FeatureSamples]) -> FeatureSamples:
    return FeatureSamples(*(np.concatenate(planes) for planes in zip(*groups, strict=True)))
