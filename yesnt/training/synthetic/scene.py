"""Random synthetic scenes: figures made of capsules, objects, and folded sheets."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from yesnt.training.synthetic.materials import DEFAULT_STYLE, MATERIAL, MaterialStyle, draw_class, paint
from yesnt.training.synthetic.shapes import GeometryBuffer

Float64 = NDArray[np.float64]

_CLOTH = ("woven", "woven", "woven", "woven", "knit", "knit", "denim", "denim", "satin", "leather")
_BAND = ("leather", "brushed metal", "polished metal", "woven", "rubber", "plastic", "worn metal", "knit")
_FITTING = ("polished metal", "brushed metal", "plastic", "worn metal", "ceramic")
_SHOE = ("leather", "leather", "rubber", "woven", "plastic")


@dataclass
class Scene:
    """A canvas and its materials.

    Attributes:
        geometry: geometry buffer at twice the resolution of the image.
        rng: source of every choice.
        style: colour and print statistics of the materials.
        materials: `MATERIAL` records; `geometry.material` holds their indices.
    """

    geometry: GeometryBuffer
    rng: np.random.Generator
    style: MaterialStyle = DEFAULT_STYLE
    materials: list[NDArray[np.void]] = field(default_factory=list)

    def paint(self, names: tuple[str, ...] = ()) -> int:
        """Adds a material of one of the classes (none: of a class from the prior) and returns its index."""
        name = str(self.rng.choice(names)) if names else draw_class(self.rng)
        self.materials.append(paint(self.rng, name, self.style))
        return len(self.materials) - 1

    def paints(self) -> NDArray[np.void]:
        """Returns all materials as one record array."""
        return np.array(self.materials, dtype=MATERIAL)


def draw_scene(rng: np.random.Generator, size: int, style: MaterialStyle = DEFAULT_STYLE) -> Scene:
    """Draws a scene on a canvas of size x size pixels: a figure (35 %), or objects and sheets.

    Args:
        rng: source of every choice.
        size: side of the canvas in pixels.
        style: colour and print statistics of the materials.
    """
    scene = Scene(GeometryBuffer.empty(size), rng, style)
    kind = rng.random()
    if kind < 0.35:
        _figure(scene, size)
    else:
        if kind > 0.88 or rng.random() < 0.3:
            _sheet(scene, size)
        for _ in range(rng.integers(2, 6)):
            _object(scene, size)
    return scene


@dataclass(frozen=True)
class _Body:
    """Coordinate frame of a figure: unit height, origin at the crown, y down, rotated about the vertical."""

    scene: Scene
    scale: float
    origin: Float64
    turn: float

    def place(self, point: tuple[float, float, float], radius: float) -> Float64:
        """Maps a point and a radius of the body's space to the canvas, [4]."""
        x, y, z = point
        c, s = np.cos(self.turn), np.sin(self.turn)
        placed = np.array([c * x + s * z, y, c * z - s * x]) * self.scale + self.origin
        return np.array([*placed, radius * self.scale])

    def limb(
        self, a: tuple[float, float, float], b: tuple[float, float, float], radii: tuple[float, float], material: int
    ) -> None:
        """Draws a limb, in 22 % of cases with a band around it."""
        start, end = self.place(a, radii[0]), self.place(b, radii[1])
        flat = 1.0
        self.scene.geometry.capsule(start, end, flat, material)
        rng = self.scene.rng
        if rng.random() < 0.22:
            low, wide, more = rng.uniform(0, 0.85), rng.uniform(0.04, 0.2), rng.uniform(1.04, 1.18)
            first, last = start + low * (end - start), start + min(1.0, low + wide) * (end - start)
            first[3] *= more
            last[3] *= more
            self.scene.geometry.capsule(first, last, flat, self.scene.paint(_BAND))

    def dot(self, point: tuple[float, float, float], radius: float, material: int) -> None:
        """Draws a small, slightly flattened ball."""
        placed = self.place(point, radius)
        self.scene.geometry.capsule(placed, placed + np.array([0.01, 0, 0, 0]), 0.7, material)


def _figure(scene: Scene, size: int) -> None:
    rng = scene.rng
    scale = 2 * np.exp(rng.uniform(np.log(170), np.log(760)))
    seen = rng.uniform(0.0, 1.0)
    origin = np.array([size / 2 + rng.normal(0, 0.12) * size, size / 2 - seen * scale, 0.0])
    body = _Body(scene, scale, origin, rng.uniform(-np.pi, np.pi) if rng.random() < 0.4 else rng.normal(0, 0.5))
    skin = scene.paint(("skin",) if rng.random() < 0.93 else ())
    top = scene.paint(_CLOTH if rng.random() < 0.85 else ())
    bottom = scene.paint(_CLOTH if rng.random() < 0.85 else ("skin",))
    _torso(body, top, bottom)
    _head(body, skin)
    for side in (-1.0, 1.0):
        _arm(body, side, skin, top)
        _leg(body, side, skin, bottom)


def _torso(body: _Body, top: int, bottom: int) -> None:
    scene, rng = body.scene, body.scene.rng
    wide = rng.uniform(0.85, 1.15)
    capsule = scene.geometry.capsule
    for side in (-1.0, 1.0):
        capsule(
            body.place((0.05 * side * wide, 0.21, 0), 0.062),
            body.place((0.035 * side * wide, 0.42, 0), 0.055),
            1.0,
            top,
        )
        capsule(
            body.place((0.045 * side * wide, 0.45, 0), 0.062),
            body.place((0.05 * side * wide, 0.5, 0), 0.066),
            1.0,
            bottom,
        )
    capsule(body.place((-0.06, 0.185, 0), 0.035), body.place((0.06, 0.185, 0), 0.035), 1.0, top)
    if rng.random() < 0.6:
        _belt(body, wide)
    if rng.random() < 0.3:
        strap = scene.paint(_BAND)
        side = rng.choice([-1.0, 1.0])
        capsule(
            body.place((0.07 * side, 0.18, 0.05), 0.014), body.place((-0.07 * side, 0.42, 0.055), 0.014), 1.0, strap
        )
    if rng.random() < 0.5:
        button = scene.paint(_FITTING)
        for y in np.linspace(0.2, 0.4, int(rng.integers(2, 7))):
            body.dot((0.0, float(y), 0.066), rng.uniform(0.004, 0.01), button)
    if rng.random() < 0.2:
        plate = scene.paint(("brushed metal", "polished metal", "worn metal", "leather", "plastic"))
        capsule(body.place((-0.03, 0.24, 0.03), 0.05), body.place((0.03, 0.24, 0.03), 0.05), 0.9, plate)


def _belt(body: _Body, wide: float) -> None:
    rng = body.scene.rng
    y, belt = rng.uniform(0.42, 0.46), body.scene.paint(_BAND)
    tall = rng.uniform(0.008, 0.02)
    for side in (-1.0, 1.0):
        body.scene.geometry.capsule(
            body.place((0.042 * side * wide, y - tall, 0), 0.066),
            body.place((0.042 * side * wide, y + tall, 0), 0.067),
            1.0,
            belt,
        )
    if rng.random() < 0.8:
        half = np.array([rng.uniform(0.01, 0.022), rng.uniform(0.8, 1.2) * tall, 0.006]) * body.scale
        centre = body.place((0.0, y, 0.072), 0)[:3]
        c, s = np.cos(body.turn), np.sin(body.turn)
        body.scene.geometry.box(
            centre, half, np.array([[c, 0, -s], [0, 1.0, 0], [s, 0, c]]), body.scene.paint(_FITTING)
        )


def _head(body: _Body, skin: int) -> None:
    scene, rng = body.scene, body.scene.rng
    size = rng.uniform(0.9, 1.15)
    body.limb((0, 0.2, 0), (0, 0.12, 0), (0.033, 0.03), skin)
    scene.geometry.capsule(body.place((0, 0.06, 0), 0.05 * size), body.place((0, 0.095, 0.01), 0.038 * size), 1.0, skin)
    for side in (-1.0, 1.0):
        body.dot((0.018 * side * size, 0.068, 0.046 * size), 0.008 * size, scene.paint(("ceramic", "plastic")))
        body.dot((0.05 * side * size, 0.075, 0), 0.012 * size, skin)
    body.dot((0, 0.082, 0.056 * size), 0.009 * size, skin)
    body.dot((0, 0.103, 0.046 * size), 0.01 * size, scene.paint(("skin",)))
    if rng.random() < 0.85:
        cap = scene.paint(
            ("hair",)
            if rng.random() < 0.75
            else ("knit", "woven", "brushed metal", "plastic", "leather", "polished metal")
        )
        low = rng.uniform(0.05, 0.2)
        scene.geometry.capsule(
            body.place((0, 0.045, -0.014), 0.053 * size), body.place((0, low, -0.03), 0.045 * size), 1.0, cap
        )


def _arm(body: _Body, side: float, skin: int, top: int) -> None:
    rng = body.scene.rng
    upper, fore = (top if rng.random() < 0.8 else skin), (top if rng.random() < 0.5 else skin)
    hand = skin if rng.random() < 0.8 else body.scene.paint(("leather", "rubber", "knit", "brushed metal"))
    shoulder = (0.1 * side, 0.185, 0.0)
    swing, forward = rng.uniform(-0.2, 1.7), rng.uniform(-0.6, 0.8)
    elbow = (shoulder[0] + side * 0.155 * np.sin(swing), shoulder[1] + 0.155 * np.cos(swing), 0.1 * forward)
    bend = swing + rng.uniform(-2.0, 0.6)
    wrist = (elbow[0] + side * 0.14 * np.sin(bend), elbow[1] + 0.14 * np.cos(bend), elbow[2] + rng.uniform(-0.03, 0.1))
    body.limb(shoulder, elbow, (0.034, 0.027), upper)
    body.limb(elbow, wrist, (0.027, 0.02), fore)
    along = tuple(w + 0.3 * (w - e) for w, e in zip(wrist, elbow, strict=True))
    body.limb(wrist, (along[0], along[1], along[2]), (0.021, 0.017), hand)


def _leg(body: _Body, side: float, skin: int, bottom: int) -> None:
    rng = body.scene.rng
    shin = bottom if rng.random() < 0.75 else skin
    shoe = body.scene.paint(_SHOE) if rng.random() < 0.9 else skin
    swing = rng.normal(0, 0.15)
    knee = (0.055 * side + 0.2 * swing * side, 0.73, rng.normal(0, 0.04))
    ankle = (knee[0] + rng.normal(0, 0.03), 0.94, knee[2] - abs(rng.normal(0, 0.04)))
    body.limb((0.05 * side, 0.5, 0), knee, (0.06, 0.042), bottom)
    body.limb(knee, ankle, (0.041, 0.027), shin)
    if rng.random() < 0.3:
        body.limb((ankle[0], 0.85, ankle[2]), ankle, (0.038, 0.032), shoe)
    body.limb((ankle[0], 0.965, ankle[2] - 0.01), (ankle[0] + 0.01 * side, 0.98, ankle[2] + 0.09), (0.03, 0.022), shoe)


def _object(scene: Scene, size: int) -> None:
    rng = scene.rng
    centre = np.array([*(rng.uniform(0.1, 0.9, 2) * size), rng.normal(0, 0.1) * size])
    reach = size * rng.uniform(0.08, 0.42)
    material = scene.paint()
    if rng.random() < 0.35:
        axes, _ = np.linalg.qr(rng.standard_normal((3, 3)))
        scene.geometry.box(centre, reach * rng.uniform(0.25, 1, 3), axes, material)
        return
    step = rng.standard_normal(3) * reach
    a = np.array([*centre, reach * rng.uniform(0.3, 1)])
    b = np.array([*(centre + step), reach * rng.uniform(0.3, 1)])
    scene.geometry.capsule(a, b, rng.uniform(0.4, 1), material)
    if rng.random() < 0.4:
        low, wide = rng.uniform(0, 0.8), rng.uniform(0.03, 0.25)
        first, last = a + low * (b - a), a + min(1, low + wide) * (b - a)
        first[3], last[3] = 1.05 * first[3], 1.05 * last[3]
        scene.geometry.capsule(first, last, 1.0, scene.paint())


def _sheet(scene: Scene, size: int) -> None:
    rng = scene.rng
    count = int(rng.integers(2, 6))
    angle, frequency = rng.normal(rng.uniform(0, 2 * np.pi), 0.5, count), np.exp(rng.uniform(-4.2, -2.6, count))
    waves = np.stack(
        [
            frequency * np.cos(angle),
            frequency * np.sin(angle),
            rng.uniform(0, 6.3, count),
            rng.uniform(0.1, 0.5, count) / frequency,
        ],
        1,
    )
    for _ in range(int(rng.integers(1, 4))):
        half = rng.uniform(0.15, 0.8, 2) * size
        place = rng.uniform(0.2, 0.8, 2) * size
        plane = np.array([place[0], place[1], rng.normal(0, 4) - 0.1 * size, half[0], half[1], rng.uniform(0, np.pi)])
        scene.geometry.sheet(plane, waves, scene.paint(_CLOTH if rng.random() < 0.6 else ()))
