"""Painted materials: appearance, roughness and metallic of each material class.

The table is the prior of the embedded model. Roughness is Disney's r as in production assets. Within a class it is
drawn per material, and varies over the surface with the paint, so that appearance predicts it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.training.synthetic.tiles import CYCLES, SIZE, tile_index

Colours = tuple[tuple[float, float, float], ...]

MATERIAL = np.dtype(
    [
        ("kind", "i4"),  # number of the class in CLASSES
        ("base", "f4", 3),  # linear Rec.709 albedo (or F0 of a metal)
        ("second", "f4", 3),  # colour at the pattern's other end
        ("pattern", "i4"),  # tile of the fine pattern
        ("frequency", "f4"),  # texels of the fine tile per pixel
        ("turn", "f4"),  # angle of the pattern, radians
        ("contrast", "f4"),  # how far the pattern moves the colour towards `second`
        ("mottle", "f4"),  # relative change of albedo by slow noise
        ("slow", "f4"),  # texels of the slow tile per pixel
        ("roughness", "f4"),
        ("roughness_pattern", "f4"),  # change of roughness by the fine pattern
        ("roughness_slow", "f4"),  # change of roughness by the slow noise
        ("metallic", "f4"),
        ("patina", "f4"),  # share of a metal covered by dull, non-metallic dirt
        ("bump", "f4"),  # height of the fine pattern, pixels
        ("fold", "f4"),  # height of folds, pixels
        ("fold_frequency", "f4"),  # texels of the fold tile per pixel
    ]
)
"""One painted material; the renderer takes a record array of these."""

_SKIN: Colours = ((0.68, 0.44, 0.34), (0.60, 0.33, 0.22), (0.45, 0.24, 0.15), (0.28, 0.14, 0.08), (0.10, 0.05, 0.03))
_HAIR: Colours = (
    (0.010, 0.008, 0.007), (0.03, 0.018, 0.012), (0.08, 0.04, 0.02), (0.16, 0.08, 0.035), (0.38, 0.26, 0.12),
    (0.28, 0.08, 0.03), (0.35, 0.34, 0.33), (0.65, 0.63, 0.60),
)  # fmt: skip
_LEATHER: Colours = (
    (0.012, 0.011, 0.010), (0.02, 0.018, 0.016), (0.08, 0.035, 0.018), (0.16, 0.07, 0.03), (0.33, 0.17, 0.08),
    (0.12, 0.015, 0.015), (0.5, 0.46, 0.40),
)  # fmt: skip
_DENIM: Colours = ((0.03, 0.05, 0.12), (0.06, 0.10, 0.20), (0.16, 0.23, 0.36), (0.015, 0.018, 0.03), (0.2, 0.2, 0.21))
_WOOD: Colours = ((0.30, 0.17, 0.08), (0.14, 0.06, 0.03), (0.5, 0.34, 0.19), (0.06, 0.03, 0.018))
_METAL: Colours = (
    (0.58, 0.57, 0.55), (0.80, 0.80, 0.81), (0.42, 0.41, 0.40), (0.95, 0.72, 0.35), (0.90, 0.60, 0.47),
    (0.85, 0.70, 0.42), (0.18, 0.18, 0.19), (0.55, 0.55, 0.58), (0.66, 0.60, 0.48),
)  # fmt: skip
_RUBBER: Colours = ((0.015, 0.015, 0.015), (0.03, 0.03, 0.032), (0.07, 0.07, 0.07), (0.3, 0.05, 0.04), (0.7, 0.7, 0.68))
_CERAMIC: Colours = ((0.8, 0.79, 0.76), (0.75, 0.72, 0.65), (0.05, 0.12, 0.3), (0.35, 0.10, 0.05), (0.1, 0.25, 0.2))
_STONE: Colours = ((0.4, 0.38, 0.35), (0.2, 0.2, 0.2))
_ANY: Colours = ()


@dataclass(frozen=True)
class MaterialClass:
    """Statistics of a material class.

    Attributes:
        name: name of the class.
        roughness: (mean, standard deviation, lowest, highest) of a material's mean roughness.
        colours: palette of linear Rec.709 albedos; empty: any colour.
        tiles: fine patterns.
        off_palette: probability of a colour outside the palette.
        metallic: 1 for bare metal, else 0.
        contrast: largest colour contrast of the fine pattern.
        variation: largest change of roughness within one material.
        bump: largest height of the fine pattern in pixels.
        fold: largest height of folds in pixels.
    """

    name: str
    roughness: tuple[float, float, float, float]
    colours: Colours
    tiles: tuple[str, ...]
    off_palette: float
    metallic: float
    contrast: float
    variation: float
    bump: float
    fold: float


_PRINTS = ("stripes", "checks", "dots", "blotches")
_LARGE_PRINTS = ("checks", "checks", "chequers", "chequers", "stripes", "stripes", "dots")
_CLOTH = ("woven", "knit", "satin", "denim", "leather")
_SOLID = ("ceramic", "plastic", "moulded plastic", "wood")
RECOLOURABLE = (*_CLOTH, "rubber", "plastic", "moulded plastic")
"""Classes that occur in any colour."""
_COLOUR_DONORS = ("skin", "skin", "skin", "hair", "leather", "polished metal")
"""Classes whose colours other materials may have: a beige shirt, a grey glove."""


@dataclass(frozen=True)
class MaterialStyle:
    """Colour and print statistics beyond those of the class.

    Attributes:
        cloth_print: probability that cloth is printed with checks, chequers, stripes or dots.
        borrowed_colour: probability that a recolourable material has a colour of skin, hair, leather or metal.
        solid_print: probability that ceramic, plastic or wood is printed.
    """

    cloth_print: float = 0.0
    borrowed_colour: float = 0.0
    solid_print: float = 0.0


DEFAULT_STYLE = MaterialStyle()
"""Style without large prints and borrowed colours."""

_TABLE = (
    # name, (mean, std, lowest, highest) of roughness, colours, tiles,
    #   off_palette, metallic, contrast, variation, bump, fold
    ("woven", (0.84, 0.08, 0.6, 1.0), _ANY, ("weave", "weave", "plain", "gritty", "mottled", *_PRINTS),
        0.1, 0, 0.3, 0.06, 0.4, 6),
    ("knit", (0.88, 0.07, 0.65, 1.0), _ANY, ("knit", "knit", "gritty", "stripes"), 0.1, 0, 0.3, 0.06, 0.6, 5),
    ("satin", (0.45, 0.10, 0.25, 0.65), _ANY, ("plain", "twill", "blotches"), 0.1, 0, 0.3, 0.06, 0.1, 7),
    ("denim", (0.80, 0.08, 0.55, 0.95), _DENIM, ("twill", "twill", "weave"), 0.05, 0, 0.5, 0.08, 0.4, 6),
    ("skin", (0.50, 0.08, 0.3, 0.72), _SKIN, ("mottled", "pores", "plain"), 0.02, 0, 0.15, 0.08, 0.15, 1),
    ("hair", (0.48, 0.12, 0.2, 0.8), _HAIR, ("strands",), 0.03, 0, 0.6, 0.10, 1.0, 2),
    ("leather", (0.43, 0.11, 0.2, 0.72), _LEATHER, ("pores", "mottled", "plain"), 0.15, 0, 0.3, 0.12, 0.4, 3),
    ("wood", (0.50, 0.13, 0.2, 0.8), _WOOD, ("grain",), 0.02, 0, 0.8, 0.08, 0.2, 0),
    ("brushed metal", (0.36, 0.08, 0.2, 0.55), _METAL, ("streaks",), 0.03, 1, 0.15, 0.08, 0.2, 0),
    ("polished metal", (0.17, 0.07, 0.03, 0.35), _METAL, ("plain", "cloudy", "hammered"), 0.03, 1, 0.1, 0.05, 0.2, 1),
    ("worn metal", (0.50, 0.10, 0.3, 0.75), _METAL, ("mottled", "pores", "gritty"), 0.03, 1, 0.35, 0.12, 0.3, 0),
    ("plastic", (0.35, 0.13, 0.08, 0.65), _ANY, ("plain", "plain", "gritty"), 0.1, 0, 0.1, 0.06, 0.1, 0),
    ("rubber", (0.70, 0.12, 0.4, 0.95), _RUBBER, ("plain", "gritty", "stripes"), 0.1, 0, 0.15, 0.08, 0.3, 0),
    ("ceramic", (0.16, 0.07, 0.03, 0.35), _CERAMIC, ("plain", "cloudy", "blotches"), 0.4, 0, 0.3, 0.04, 0.1, 0),
    ("stone", (0.78, 0.11, 0.5, 1.0), _STONE, ("gritty", "mottled"), 0.3, 0, 0.5, 0.10, 0.8, 0),
    ("moulded plastic", (0.72, 0.12, 0.45, 0.95), _ANY, ("plain", "gritty", "gritty"), 0.1, 0, 0.1, 0.05, 0.15, 0),
)  # fmt: skip

CLASSES = {row[0]: MaterialClass(*row) for row in _TABLE}
"""Every class by name."""

PRIOR = {
    "woven": 4, "knit": 2, "satin": 1, "denim": 1.5, "skin": 3, "hair": 1.5, "leather": 2.5, "wood": 1,
    "brushed metal": 1.5, "polished metal": 1.5, "worn metal": 1, "plastic": 2, "rubber": 1, "ceramic": 1, "stone": 0.7,
    "moulded plastic": 1.5,
}  # fmt: skip
"""Relative frequency of a class where the scene does not restrict it."""


CLASS_WEIGHTS = {"satin": 0.3, "leather": 0.45}
"""Loss weight per pixel of a class, where it is not 1.

A third of all cloth in the training images is satin or leather, so that both are learnt. In reality most clothes are
neither; without the weights the model overestimates both.
"""


def class_weights() -> NDArray[np.float32]:
    """Returns the loss weight per pixel of each class, [classes] float32."""
    return np.array([CLASS_WEIGHTS.get(name, 1.0) for name in CLASSES], np.float32)


def draw_class(rng: np.random.Generator) -> str:
    """Draws the name of a class from the prior."""
    weights = np.array(list(PRIOR.values()))
    return str(rng.choice(list(PRIOR), p=weights / weights.sum()))


def paint(rng: np.random.Generator, name: str, style: MaterialStyle = DEFAULT_STYLE) -> NDArray[np.void]:
    """Draws a material of a class.

    Args:
        rng: source of every choice.
        name: key of `CLASSES`.
        style: colour and print statistics.

    Returns:
        A `MATERIAL` record.
    """
    kind = CLASSES[name]
    material = np.zeros((), MATERIAL)
    mean, std, low, high = kind.roughness
    borrowed = style.borrowed_colour > 0 and name in RECOLOURABLE and rng.random() < style.borrowed_colour
    base = _colour(rng, CLASSES[str(rng.choice(_COLOUR_DONORS))] if borrowed else kind)
    tile = str(rng.choice(kind.tiles))
    chance = style.cloth_print if name in _CLOTH else style.solid_print if name in _SOLID else 0
    large_print = chance > 0 and rng.random() < chance
    if large_print:
        tile = str(rng.choice(_LARGE_PRINTS))
    # A print is two paints on one cloth: strong contrast, no other roughness.
    printed = large_print or tile in _PRINTS
    finest, widest = (3.5, 40) if large_print else (6, 60) if printed else (1.6, 14)
    period = np.exp(rng.uniform(np.log(finest), np.log(widest)))
    material["kind"] = list(CLASSES).index(name)
    material["base"] = base
    ends = _colour(rng, CLASSES["woven"] if large_print else kind) if printed else base * rng.uniform(0.3, 0.9)
    material["second"] = ends
    material["pattern"] = tile_index(tile)
    material["frequency"] = SIZE / CYCLES / period
    material["turn"] = rng.uniform(-0.2, 0.2) + (np.pi / 2) * rng.integers(2)
    material["contrast"] = rng.uniform(0.3, 1) if printed else rng.uniform(0, kind.contrast)
    material["mottle"] = rng.uniform(0, 0.35) * rng.random()
    material["slow"] = np.exp(rng.uniform(np.log(0.3), np.log(3)))
    material["roughness"] = np.clip(rng.normal(mean, std), low, high)
    material["roughness_pattern"] = 0 if printed else rng.uniform(-0.5, 1) * kind.variation
    material["roughness_slow"] = rng.uniform(-1, 1) * kind.variation
    material["metallic"] = kind.metallic
    material["patina"] = rng.uniform(0, 0.4) if name == "worn metal" and rng.random() < 0.5 else 0
    material["bump"] = rng.uniform(0, kind.bump)
    material["fold"] = rng.uniform(0, kind.fold) * (rng.random() < 0.7)
    material["fold_frequency"] = np.exp(rng.uniform(np.log(0.25), np.log(1.2)))
    return material


def _colour(rng: np.random.Generator, kind: MaterialClass) -> NDArray[np.float64]:
    """Linear Rec.709 colour from the palette with jitter, or any colour."""
    if kind.colours and rng.random() > kind.off_palette:
        i = int(rng.integers(len(kind.colours)))
        j = min(i + 1, len(kind.colours) - 1)
        mix = rng.random() if kind.colours is _SKIN else 0.0
        colour = (1 - mix) * np.array(kind.colours[i]) + mix * np.array(kind.colours[j])
        return np.clip(colour * np.exp(rng.normal(0, 0.2)) * np.exp(rng.normal(0, 0.07, 3)), 0.004, 0.98)
    value = np.exp(rng.uniform(np.log(0.02), np.log(0.85)))
    saturation = rng.beta(1.0, 1.6)
    hue = rng.random(3)
    hue = (hue - hue.min()) / max(1e-6, float(hue.max() - hue.min()))
    return np.clip(value * (1 - saturation + saturation * hue), 0.004, 0.95)
