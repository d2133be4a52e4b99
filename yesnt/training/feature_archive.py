"""Training samples of the auxiliary predictor: backbone features of whole subjects at random locations."""

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
from yesnt.training.image_archive import interleaved_people, object_path, open_views, person_path
from yesnt.training.synthetic.dataset import Augmentation, context_truth, draw_mix, expose, recolour_garments
from yesnt.training.synthetic.materials import MaterialStyle
from yesnt.training.synthetic.render import Rendering

Float32 = NDArray[np.float32]

EXAMPLES_PER_VIEW = 2
"""Augmented examples of each view, each with its own camera degradation."""

SAMPLES_PER_EXAMPLE = 256
"""Most locations of an example that are stored."""

HELD_OUT_STRIDE = 5
"""Every fifth subject is held out from the perceptron; the weighting of both predictions is trained on these."""

_AUGMENTATION = Augmentation(MaterialStyle(), colour_mixing=0.3, recoloured=0.3)


@dataclass(frozen=True)
class AuxiliaryExample:
    """Augmented image of a subject with ground truth.

    Attributes:
        image: [4, S, S] straight linear rgb and matte, S = AUXILIARY_INPUT_SIDE.
        truth: [3, s, s] roughness, metallic and coverage, s = AUXILIARY_OUTPUT_SIDE.
        kind: [s, s] material class, -1 outside the matte.
    """

    image: Float32
    truth: Float32
    kind: NDArray[np.int64]


class FeatureSamples(NamedTuple):
    """Samples for the perceptron.

    Attributes:
        features: [n, C] features of the backbone.
        truth: [n, 2] roughness and metallic in [0, 1].
        kind: [n] material class.
    """

    features: NDArray[np.float16]
    truth: NDArray[np.float16]
    kind: NDArray[np.int8]


def subjects(folder: Path, seed: int, people: int, objects: int) -> tuple[list[Path], list[Path]]:
    """Returns the archive files of the subjects to train on, and of those that are held out.

    Args:
        folder: folder of the training.
        seed: seed of the archive.
        people: number of people.
        objects: number of procedural objects.
    """
    paths = [person_path(folder, seed, number) for number in interleaved_people()[:people]]
    others = [object_path(folder, seed, number) for number in range(objects)]
    training = [
        p for group in (paths, others) for n, p in enumerate(group) if n % HELD_OUT_STRIDE != HELD_OUT_STRIDE - 1
    ]
    held_out = [
        p for group in (paths, others) for n, p in enumerate(group) if n % HELD_OUT_STRIDE == HELD_OUT_STRIDE - 1
    ]
    return training, held_out


def draw_example(
    rng: np.random.Generator, image: Rendering, augmentation: Augmentation = _AUGMENTATION
) -> AuxiliaryExample:
    """Draws an augmented example of a subject or a part of it.

    Args:
        rng: source of every choice.
        image: rendering of the subject.
        augmentation: probabilities of colour changes.
    """
    if rng.random() < augmentation.recoloured:
        image = recolour_garments(rng, image)
    rgb, matte, _ = expose(rng, image.rgb.astype(np.float32), image.matte.astype(np.float32))
    if rng.random() < augmentation.colour_mixing:
        rgb = np.einsum("ij,jyx->iyx", draw_mix(rng), rgb)
    square = _draw_square(rng, Square.around(matte))
    shown = context_image(rgb, matte, square, AUXILIARY_INPUT_SIDE)
    truth, kind = context_truth(image, square, AUXILIARY_OUTPUT_SIDE)
    way = slice(None, None, -1 if rng.random() < 0.5 else 1)  # mirrored or as it is
    return AuxiliaryExample(np.ascontiguousarray(shown[..., way]), truth[..., way], kind[:, way])


def _draw_square(rng: np.random.Generator, square: Square) -> Square:
    """The subject's square or, half of the time, one that shows it smaller or shows a part of it."""
    if rng.random() < 0.5:
        return square
    side = round(square.side * float(np.exp(rng.uniform(-0.6, 0.2))))
    room = abs(square.side - side)
    top, left = (int(v) for v in rng.integers(0, room + 1, 2) - (0 if side < square.side else room))
    return Square(square.top + top, square.left + left, side)


@torch.no_grad()
def extract_features(backbone: Backbone, example: AuxiliaryExample, rng: np.random.Generator) -> FeatureSamples:
    """Computes backbone features at up to `SAMPLES_PER_EXAMPLE` random locations inside the matte."""
    features = backbone(display_encode(torch.from_numpy(example.image)[None]))
    planes = torch.cat([upsample(x, AUXILIARY_OUTPUT_SIDE) for x in features], 1)[0].flatten(1).numpy()
    inside = np.flatnonzero((example.truth[2] > 0.5) & (example.kind >= 0))
    chosen = rng.permutation(inside)[:SAMPLES_PER_EXAMPLE]
    return FeatureSamples(
        planes[:, chosen].T.astype(np.float16),
        example.truth[:2].reshape(2, -1)[:, chosen].T.astype(np.float16),
        example.kind.ravel()[chosen].astype(np.int8),
    )


def extract_all(folder: Path, seed: int, paths: Sequence[Path], backbone: Backbone) -> Iterator[Path]:
    """Stores the samples of every subject below the folder and yields the paths; existing files are kept.

    Args:
        folder: folder of the training.
        seed: seed of the archive.
        paths: archive files of the subjects.
        backbone: frozen backbone.
    """
    for path in paths:
        archive = folder / f"features.{seed}" / f"{path.parent.name}.{path.name}"
        if not archive.exists():
            rng = np.random.Generator(np.random.Philox(key=[seed, 4_000_000 + int(path.stem)]))
            examples = [
                extract_features(backbone, draw_example(rng, view), rng)
                for view in open_views(path)
                for _ in range(EXAMPLES_PER_VIEW)
            ]
            archive.parent.mkdir(parents=True, exist_ok=True)
            with durable_path(archive) as temporary, temporary.open("wb") as stream:
                np.savez(stream, **_joined(examples)._asdict())
        yield archive


def open_samples(paths: Sequence[Path]) -> FeatureSamples:
    """Reads and concatenates the samples of several subjects."""
    groups = []
    for path in paths:
        with np.load(path) as data:
            groups.append(FeatureSamples(*(data[name] for name in FeatureSamples._fields)))
    return _joined(groups)


def _joined(groups: Sequence[FeatureSamples]) -> FeatureSamples:
    return FeatureSamples(*(np.concatenate(planes) for planes in zip(*groups, strict=True)))
