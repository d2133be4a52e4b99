"""Random garments of the synthetic people: regions of the body, each painted with a material of a likely class.

Regions are intervals of the fields of `yesnt.capture_stage.costume`. No garment equals one of the subjects of the
capture stage, on which the model is evaluated.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from yesnt.capture_stage.material_layers import Between, Layer, Layers
from yesnt.training.synthetic.materials import DEFAULT_STYLE, MATERIAL, MaterialStyle, draw_class, paint

Classes = tuple[str, ...]

_FAR = 10.0  # metres: anything on that side
_TORSO = Between("arms", high=0.5)
_ARMS = Between("arms", low=0.5)
_HEAD = Between("head", low=0.5)
_FRONT = Between("y", -_FAR, 0.0)
_BELOW_THE_HEAD = (Between("head", high=0.35), Between("neck", high=0.5))
_NOT_HANDS = Between("hands", high=0.5)

METALS: Classes = ("brushed metal", "polished metal", "worn metal")
_CLOTH: Classes = ("woven",) * 5 + ("knit",) * 3 + ("denim",) * 3 + ("satin",) * 3 + ("leather",) * 2 + METALS[:1]
_BAND: Classes = ("leather", "leather", "woven", "rubber", "plastic", "knit", *METALS)
_SHOE: Classes = ("leather", "leather", "leather", "rubber", "woven", "plastic", "satin")
_CAP: Classes = ("hair",) * 9 + ("knit", "woven", "leather", "plastic", "polished metal", "brushed metal")
_ARMOUR: Classes = (*METALS, *METALS, "leather", "plastic")


@dataclass
class Garments:
    """Garments in the order in which they are put on; a later one covers those before it.

    Attributes:
        rng: source of every choice.
        style: colour and print statistics of the materials.
        layers: region and thickness of each garment.
        paints: `MATERIAL` record of each garment.
    """

    rng: np.random.Generator
    style: MaterialStyle = DEFAULT_STYLE
    layers: list[Layer] = field(default_factory=list)
    paints: list[NDArray[np.void]] = field(default_factory=list)

    def add(
        self, name: str, where: tuple[Between, ...], material: NDArray[np.void], thick: float = 0.0, soft: float = 0.015
    ) -> None:
        """Adds a garment.

        Args:
            name: name of the garment.
            where: intervals of the costume's fields that bound the region.
            material: `MATERIAL` record.
            thick: thickness in metres.
            soft: width of the edge in metres.
        """
        ends = (_color(material["base"]), _color(material["second"]))
        rough = float(material["roughness"])
        metal = float(material["metallic"])
        self.layers.append(Layer(name, where, "plain", ends, 10.0, (rough, rough), metal, thick, soft))
        self.paints.append(material)

    def paint(self, classes: Classes = ()) -> NDArray[np.void]:
        """Draws a material of one of the classes, or of a class from the prior if none is given."""
        return paint(self.rng, str(self.rng.choice(classes)) if classes else draw_class(self.rng), self.style)

    def chance(self, probability: float) -> bool:
        """Returns True with the given probability."""
        return bool(self.rng.random() < probability)

    def frozen_layers(self) -> Layers:
        """Returns the garments in the form that `yesnt.capture_stage.costume` takes."""
        return tuple(self.layers)

    def materials(self) -> NDArray[np.void]:
        """Returns the `MATERIAL` records of the garments as one array."""
        return np.array(self.paints, dtype=MATERIAL)


def _color(values: NDArray[np.float32]) -> tuple[float, float, float]:
    red, green, blue = (float(v) for v in values)
    return red, green, blue


def draw_garments(rng: np.random.Generator, style: MaterialStyle = DEFAULT_STYLE) -> Garments:
    """Draws the garments of a person, from the skin outwards.

    Args:
        rng: source of every choice.
        style: colour and print statistics of the materials.
    """
    garments = Garments(rng, style)
    _body(garments)
    _legs(garments)
    _shoes(garments)
    if garments.chance(0.9):
        _top(garments)
    if garments.chance(0.3):
        _jacket(garments)
    _waist(garments)
    _arms(garments)
    _armour(garments)
    return garments


def _body(garments: Garments) -> None:
    rng, skin = garments.rng, garments.paint(("skin",))
    garments.add("skin", (), skin)
    lips, eyes = skin.copy(), garments.paint(("ceramic",))
    lips["base"] *= (0.85, 0.55, 0.5)
    lips["roughness"] = rng.uniform(0.25, 0.4)
    mouth = (_HEAD, Between("z", 1.588, 1.612), Between("y", -_FAR, -0.135), Between("x", -0.024, 0.024))
    garments.add("lips", mouth, lips)
    eyes["base"], eyes["second"], eyes["contrast"] = 0.55, 0.45, 0.2
    garments.add("eyes", (Between("eyes", 0.5),), eyes)
    if garments.chance(0.9):
        line = Between("scalp", rng.uniform(-0.03, 0.02))
        garments.add("hair", (_HEAD, line), garments.paint(_CAP), rng.uniform(0.004, 0.026), 0.02)


def _legs(garments: Garments) -> None:
    rng = garments.rng
    waist = rng.uniform(0.97, 1.06)
    length = rng.choice(["long", "short", "skirt"], p=[0.6, 0.22, 0.18])
    low = {"long": rng.uniform(0.08, 0.25), "short": rng.uniform(0.4, 0.8), "skirt": rng.uniform(0.35, 0.85)}[length]
    thick = rng.uniform(0.018, 0.04) if length == "skirt" else rng.uniform(0.004, 0.018)
    garments.add("bottom", (_TORSO, Between("z", low, waist)), garments.paint(_CLOTH), thick, rng.uniform(0.015, 0.08))
    if length != "long" and garments.chance(0.35):
        under = (_TORSO, Between("z", rng.uniform(0.1, 0.3), low + 0.02))
        garments.add("stockings", under, garments.paint(("knit", "satin", "woven")), 0.004)


def _shoes(garments: Garments) -> None:
    rng = garments.rng
    if garments.chance(0.92):
        high = rng.uniform(0.08, 0.16) if garments.chance(0.55) else rng.uniform(0.16, 0.46)
        garments.add("shoes", (Between("z", high=high),), garments.paint(_SHOE), rng.uniform(0.008, 0.014))
    if garments.chance(0.6):
        garments.add("soles", (Between("z", high=0.022),), garments.paint(("rubber",)))
    if garments.chance(0.1):
        caps = (Between("z", high=0.075), Between("y", -_FAR, -0.10))
        garments.add("toe caps", caps, garments.paint(METALS), 0.016)


def _top(garments: Garments) -> None:
    rng, cloth = garments.rng, garments.paint(_CLOTH)
    thick = rng.uniform(0.004, 0.014)
    torso = Between("z", rng.uniform(0.9, 1.06), rng.uniform(1.36, 1.5))
    garments.add("top", (_TORSO, torso, *_BELOW_THE_HEAD), cloth, thick)
    if garments.chance(0.78):
        sleeve = Between("sleeve", -1, rng.uniform(0.35, 1.92))
        material = cloth if garments.chance(0.85) else garments.paint(_CLOTH)
        garments.add("sleeves", (_ARMS, sleeve, _NOT_HANDS), material, thick)
    if garments.chance(0.25):
        garments.add("collar", (_TORSO, Between("neck", 0.3), Between("head", high=0.2)), garments.paint(_BAND), 0.01)


def _jacket(garments: Garments) -> None:
    rng, cloth = garments.rng, garments.paint(_CLOTH)
    thick, low, high = rng.uniform(0.014, 0.03), rng.uniform(0.6, 1.0), rng.uniform(1.42, 1.5)
    garments.add("jacket", (_TORSO, Between("z", low, high), *_BELOW_THE_HEAD), cloth, thick, 0.03)
    if garments.chance(0.6):
        sleeves = (_ARMS, Between("sleeve", -1, rng.uniform(0.5, 1.9)), _NOT_HANDS)
        garments.add("jacket sleeves", sleeves, cloth, 0.7 * thick)
    if garments.chance(0.6):
        strip = Between("x", -rng.uniform(0.01, 0.09), rng.uniform(0.01, 0.09))
        open_front = (_TORSO, Between("z", low, high - 0.04), strip, _FRONT, *_BELOW_THE_HEAD)
        garments.add("front", open_front, garments.paint((*_CLOTH, *METALS, *METALS)), thick)


def _waist(garments: Garments) -> None:
    rng = garments.rng
    if garments.chance(0.12):
        sash = Between("z", rng.uniform(0.98, 1.04), rng.uniform(1.08, 1.16))
        garments.add("sash", (_TORSO, sash), garments.paint(("woven", "satin", "knit", "leather")), 0.018)
    if not garments.chance(0.55):
        return
    low, tall = rng.uniform(0.97, 1.02), rng.uniform(0.03, 0.09)
    garments.add("belt", (_TORSO, Between("z", low, low + tall)), garments.paint(_BAND), 0.02)
    if garments.chance(0.7):
        half = rng.uniform(0.02, 0.09)
        buckle = (_TORSO, Between("z", low - 0.008, low + tall + 0.008), Between("x", -half, half), _FRONT)
        garments.add("buckle", buckle, garments.paint((*METALS, *METALS, "plastic")), 0.027)


def _arms(garments: Garments) -> None:
    rng = garments.rng
    if garments.chance(0.22):
        long = Between("sleeve", rng.uniform(0.6, 1.2) if garments.chance(0.25) else rng.uniform(1.6, 2.0))
        glove = (long, _side(garments)) if garments.chance(0.3) else (long,)
        kinds = ("leather", "leather", "rubber", "knit", "satin", "polished metal")
        garments.add("gloves", glove, garments.paint(kinds), rng.uniform(0.003, 0.02), 0.05)
    for _ in range(rng.choice([0, 1, 2], p=[0.5, 0.3, 0.2])):
        start = rng.uniform(0.2, 1.7)
        ring = Between("sleeve", start, start + rng.uniform(0.06, 0.5))
        garments.add("band", (_ARMS, ring, _side(garments)), garments.paint(_BAND), 0.012)


def _side(garments: Garments) -> Between:
    return Between("x", high=0.0) if garments.chance(0.5) else Between("x", low=0.0)


def _armour(garments: Garments) -> None:
    rng = garments.rng
    if garments.chance(0.18):
        plates = (Between("shoulder", high=rng.uniform(0.07, 0.13)), *_BELOW_THE_HEAD)
        garments.add("shoulder plates", plates, garments.paint(_ARMOUR), 0.026)
    if garments.chance(0.1):
        around = Between("shoulder", 0.10, rng.uniform(0.12, 0.17))
        garments.add("chain", (around, *_BELOW_THE_HEAD), garments.paint(METALS), 0.03)
    if garments.chance(0.13):
        chest = (_TORSO, Between("z", rng.uniform(1.08, 1.2), 1.4), Between("x", -0.15, 0.15), _FRONT, *_BELOW_THE_HEAD)
        garments.add("breastplate", chest, garments.paint(_ARMOUR), 0.022)
    if garments.chance(0.15):
        knees = (_TORSO, Between("z", rng.uniform(0.4, 0.46), rng.uniform(0.54, 0.62)), Between("y", -_FAR, 0.02))
        garments.add("knee pads", knees, garments.paint(_ARMOUR), 0.02)
    if garments.chance(0.1):
        shins = (_TORSO, Between("z", 0.16, rng.uniform(0.38, 0.46)), Between("y", -_FAR, 0.03))
        garments.add("greaves", shins, garments.paint(_ARMOUR), 0.018)
