"""The archives of people's and things' pictures: made once, resumable, each a function of (seed, number)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from yesnt.io.durable import durable_path
from yesnt.training.people import draw_person, open_body, render_person
from yesnt.training.procedural_objects import draw_object, render_object
from yesnt.training.synthetic.materials import DEFAULT_STYLE, MaterialStyle
from yesnt.training.synthetic.render import Rendering

STYLE_GROUPS = (
    (400, DEFAULT_STYLE),
    (150, MaterialStyle(cloth_print=0.6)),
    (250, MaterialStyle(cloth_print=0.3, borrowed_colour=0.5)),
)
"""How many people have which style, in the order of their numbers; everyday hardly shows a print or a beige shirt."""

PEOPLE = sum(count for count, _ in STYLE_GROUPS)
"""People in the whole archive."""

VIEWS = 3
"""Poses, cameras and lights that each dressed person is seen in."""

OBJECTS = 600
"""Single things in the archive."""

OBJECT_VIEWS = 2
"""Cameras and lights that each thing is seen in."""


def style_of(number: int) -> MaterialStyle:
    """What the number-th person likes to wear."""
    for count, style in STYLE_GROUPS:
        if number < count:
            return style
        number -= count
    raise ValueError(f"the archive has {PEOPLE} people")


def interleaved_people() -> list[int]:
    """Numbers of all people in the order they are made and shown: any beginning has its share of every wardrobe."""
    starts = np.cumsum([0, *(count for count, _ in STYLE_GROUPS)])
    turns = []
    for start, (count, _) in zip(starts[:-1], STYLE_GROUPS, strict=True):
        turns += [((k + 0.5) / count, int(start) + k) for k in range(count)]
    return [number for _, number in sorted(turns)]


def person_path(folder: Path, seed: int, number: int) -> Path:
    """Where the number-th person's pictures are kept."""
    return folder / f"people.{seed}" / f"{number:05d}.npz"


def make_person(folder: Path, seed: int, number: int, bodies: Sequence[Path]) -> bool:
    """Makes one person's pictures; False if they were there."""
    path = person_path(folder, seed, number)
    if path.exists():
        return False
    rng = np.random.Generator(np.random.Philox(key=[seed, number]))
    body = open_body(bodies[number % len(bodies)])
    person = draw_person(rng, body, style_of(number))
    _keep(path, [render_person(rng, person) for _ in range(VIEWS)])
    return True


def object_path(folder: Path, seed: int, number: int) -> Path:
    """Where the number-th thing's pictures are kept."""
    return folder / f"things.{seed}" / f"{number:05d}.npz"


def make_object(folder: Path, seed: int, number: int) -> bool:
    """Makes one thing's pictures; False if they were there."""
    path = object_path(folder, seed, number)
    if path.exists():
        return False
    rng = np.random.Generator(np.random.Philox(key=[seed, 1_000_000 + number]))
    thing = draw_object(rng)
    _keep(path, [render_object(rng, thing) for _ in range(OBJECT_VIEWS)])
    return True


def _keep(path: Path, views: Sequence[Rendering]) -> None:
    """Writes pictures in half precision, whole or not at all."""
    planes = {name: np.stack([getattr(view, name) for view in views]) for name in ("rgb", "matte", "truth", "kind")}
    path.parent.mkdir(parents=True, exist_ok=True)
    half = {name: plane.astype(np.int8 if name == "kind" else np.float16) for name, plane in planes.items()}
    with durable_path(path) as temporary, temporary.open("wb") as stream:
        np.savez(stream, **half)  # type: ignore[arg-type]


@lru_cache(maxsize=2048)
def open_views(path: Path) -> tuple[Rendering, ...]:
    """The views of a person or thing, as they were rendered but for half precision."""
    with np.load(path) as data:
        rgb, matte, truth, kind = (data[name] for name in ("rgb", "matte", "truth", "kind"))
    return tuple(Rendering(*planes) for planes in zip(rgb, matte, truth, kind, strict=True))
