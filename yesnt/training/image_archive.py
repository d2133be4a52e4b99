"""Archive of rendered people and procedural objects: each file is a function of (seed, number) and is made once."""

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
"""Number of people per material style, in the order of their numbers. The default style has few prints and few garments
in colours of skin.
"""

PEOPLE = sum(count for count, _ in STYLE_GROUPS)
"""Number of people in the whole archive."""

VIEWS = 3
"""Views of each person, each with its own pose, camera and light."""

OBJECTS = 600
"""Number of procedural objects in the whole archive."""

OBJECT_VIEWS = 2
"""Views of each object, each with its own camera and light."""


def style_of(number: int) -> MaterialStyle:
    """Returns the material style of a person.

    Raises:
        ValueError: the number is beyond the archive.
    """
    for count, style in STYLE_GROUPS:
        if number < count:
            return style
        number -= count
    raise ValueError(f"the archive has {PEOPLE} people")


def interleaved_people() -> list[int]:
    """Returns the numbers of all people in the order in which they are made and used.

    Any beginning of the order contains every style group in its proportion.
    """
    starts = np.cumsum([0, *(count for count, _ in STYLE_GROUPS)])
    ordered = []
    for start, (count, _) in zip(starts[:-1], STYLE_GROUPS, strict=True):
        ordered += [((k + 0.5) / count, int(start) + k) for k in range(count)]
    return [number for _, number in sorted(ordered)]


def person_path(folder: Path, seed: int, number: int) -> Path:
    """Path of the archive file of a person."""
    return folder / f"people.{seed}" / f"{number:05d}.npz"


def make_person(folder: Path, seed: int, number: int, bodies: Sequence[Path]) -> bool:
    """Renders a person into the archive; returns False if the file exists.

    Args:
        folder: folder of the training.
        seed: seed of the archive.
        number: number of the person.
        bodies: files of the bodies in rest pose.
    """
    path = person_path(folder, seed, number)
    if path.exists():
        return False
    rng = np.random.Generator(np.random.Philox(key=[seed, number]))
    body = open_body(bodies[number % len(bodies)])
    person = draw_person(rng, body, style_of(number))
    _write(path, [render_person(rng, person) for _ in range(VIEWS)])
    return True


def object_path(folder: Path, seed: int, number: int) -> Path:
    """Path of the archive file of a procedural object."""
    return folder / f"objects.{seed}" / f"{number:05d}.npz"


def make_object(folder: Path, seed: int, number: int) -> bool:
    """Renders a procedural object into the archive; returns False if the file exists.

    Args:
        folder: folder of the training.
        seed: seed of the archive.
        number: number of the object.
    """
    path = object_path(folder, seed, number)
    if path.exists():
        return False
    rng = np.random.Generator(np.random.Philox(key=[seed, 1_000_000 + number]))
    drawn = draw_object(rng)
    _write(path, [render_object(rng, drawn) for _ in range(OBJECT_VIEWS)])
    return True


def _write(path: Path, views: Sequence[Rendering]) -> None:
    """Writes views in half precision, atomically."""
    planes = {name: np.stack([getattr(view, name) for view in views]) for name in ("rgb", "matte", "truth", "kind")}
    path.parent.mkdir(parents=True, exist_ok=True)
    half = {name: plane.astype(np.int8 if name == "kind" else np.float16) for name, plane in planes.items()}
    with durable_path(path) as temporary, temporary.open("wb") as stream:
        np.savez(stream, **half)  # type: ignore[arg-type]


@lru_cache(maxsize=2048)
def open_views(path: Path) -> tuple[Rendering, ...]:
    """Reads the views of a person or object: the renderings in half precision."""
    with np.load(path) as data:
        rgb, matte, truth, kind = (data[name] for name in ("rgb", "matte", "truth", "kind"))
    return tuple(Rendering(*planes) for planes in zip(rgb, matte, truth, kind, strict=True))
