"""What the second opinion learns from: whole subjects as the trunk sees them, and its features at some places."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from yesnt.decompose.auxiliary import OPINION_SIDE, SURVEY_SIDE, displayed, enlarged
from yesnt.decompose.global_context import Square, small_picture
from yesnt.decompose.trunk import Trunk
from yesnt.io.durable import durable_path
from yesnt.training.pictures import everybody, open_views, person_path, thing_path
from yesnt.training.synthetic.dataset import Variety, disguise, draw_mix, expose, whole_truth
from yesnt.training.synthetic.materials import Habits
from yesnt.training.synthetic.render import Rendering

Float32 = NDArray[np.float32]

LOOKS = 2
"""Times that each view is surveyed, each time through another camera."""

PLACES = 256
"""Most places of a look that are kept."""

KEPT_BACK = 5
"""Every fifth subject is not shown to the perceptron: how far it may be wrong is learnt from these."""

_VARIETY = Variety(Habits(), turned=0.3, disguised=0.3)


@dataclass(frozen=True)
class Survey:
    """One look at a subject.

    Attributes:
        picture: [4, SURVEY_SIDE, SURVEY_SIDE] straight linear rgb and matte.
        truth: [3, OPINION_SIDE, OPINION_SIDE] roughness, metallic and coverage.
        kind: [OPINION_SIDE, OPINION_SIDE] class, -1 outside the matte.
    """

    picture: Float32
    truth: Float32
    kind: NDArray[np.int64]


class Places(NamedTuple):
    """Examples for the perceptron: features [n, C], roughness and metallic [n, 2] in [0, 1], class [n]."""

    features: NDArray[np.float16]
    truth: NDArray[np.float16]
    kind: NDArray[np.int8]


def subjects(folder: Path, seed: int, people: int, things: int) -> tuple[list[Path], list[Path]]:
    """Files of the archive: those the perceptron learns from, and those kept back."""
    paths = [person_path(folder, seed, number) for number in everybody()[:people]]
    others = [thing_path(folder, seed, number) for number in range(things)]
    learnt = [p for group in (paths, others) for n, p in enumerate(group) if n % KEPT_BACK != KEPT_BACK - 1]
    kept = [p for group in (paths, others) for n, p in enumerate(group) if n % KEPT_BACK == KEPT_BACK - 1]
    return learnt, kept


def draw_survey(rng: np.random.Generator, picture: Rendering, variety: Variety = _VARIETY) -> Survey:
    """Looks at a subject or a part of it, through a camera of its own."""
    if rng.random() < variety.disguised:
        picture = disguise(rng, picture)
    rgb, matte, _ = expose(rng, picture.rgb.astype(np.float32), picture.matte.astype(np.float32))
    if rng.random() < variety.turned:
        rgb = np.einsum("ij,jyx->iyx", draw_mix(rng), rgb)
    square = _draw_square(rng, Square.around(matte))
    shown = small_picture(rgb, matte, square, SURVEY_SIDE)
    truth, kind = whole_truth(picture, square, OPINION_SIDE)
    way = slice(None, None, -1 if rng.random() < 0.5 else 1)  # mirrored or as it is
    return Survey(np.ascontiguousarray(shown[..., way]), truth[..., way], kind[:, way])


def _draw_square(rng: np.random.Generator, square: Square) -> Square:
    """The subject's square, or half of the time another that shows it smaller or a part of it."""
    if rng.random() < 0.5:
        return square
    side = round(square.side * float(np.exp(rng.uniform(-0.6, 0.2))))
    room = abs(square.side - side)
    top, left = (int(v) for v in rng.integers(0, room + 1, 2) - (0 if side < square.side else room))
    return Square(square.top + top, square.left + left, side)


@torch.no_grad()
def describe(trunk: Trunk, survey: Survey, rng: np.random.Generator) -> Places:
    """The trunk's features at up to `PLACES` random places inside the matte."""
    features = trunk(displayed(torch.from_numpy(survey.picture)[None]))
    planes = torch.cat([enlarged(x, OPINION_SIDE) for x in features], 1)[0].flatten(1).numpy()
    inside = np.flatnonzero((survey.truth[2] > 0.5) & (survey.kind >= 0))
    chosen = rng.permutation(inside)[:PLACES]
    return Places(
        planes[:, chosen].T.astype(np.float16),
        survey.truth[:2].reshape(2, -1)[:, chosen].T.astype(np.float16),
        survey.kind.ravel()[chosen].astype(np.int8),
    )


def describe_all(folder: Path, seed: int, paths: Sequence[Path], trunk: Trunk) -> Iterator[Path]:
    """Keeps the examples of every subject below the training's folder; what is there is not made again."""
    for path in paths:
        kept = folder / f"places.{seed}" / f"{path.parent.name}.{path.name}"
        if not kept.exists():
            rng = np.random.Generator(np.random.Philox(key=[seed, 4_000_000 + int(path.stem)]))
            looks = [describe(trunk, draw_survey(rng, view), rng) for view in open_views(path) for _ in range(LOOKS)]
            kept.parent.mkdir(parents=True, exist_ok=True)
            with durable_path(kept) as temporary, temporary.open("wb") as stream:
                np.savez(stream, **_joined(looks)._asdict())
        yield kept


def open_places(paths: Sequence[Path]) -> Places:
    """All examples of some subjects."""
    groups = []
    for path in paths:
        with np.load(path) as data:
            groups.append(Places(*(data[name] for name in Places._fields)))
    return _joined(groups)


def _joined(groups: Sequence[Places]) -> Places:
    return Places(*(np.concatenate(planes) for planes in zip(*groups, strict=True)))
