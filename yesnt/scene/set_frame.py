"""The set in one frame: its pixels are lit and put over what is behind them.

Source: docs/method.md section 6.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.relight.indirect import IndirectLight, ShownPixels, indirect_light
from yesnt.relight.lights import PreparedLight
from yesnt.relight.occlusion import find_occluders
from yesnt.relight.points import Surface, gather_pixels
from yesnt.relight.proxy import ProxyScene
from yesnt.relight.settings import RelightSettings
from yesnt.relight.surroundings import Surroundings
from yesnt.scene.contact import subject_edge
from yesnt.scene.delivered_picture import DeliveredPicture
from yesnt.scene.mesh_edges import EdgeMix
from yesnt.scene.set_light import SetLight, light_set
from yesnt.scene.set_scene import SetScene
from yesnt.scene.set_view import SetImage
from yesnt.scene.subject import Lighting, Subject
from yesnt.scene.subject_materials import SubjectMaterials
from yesnt.scene.vertex_materials import COVERED, MeasuredVertices

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]


@dataclass(frozen=True)
class RelitSubject:
    """The relit subject in one frame.

    Attributes:
        surface: its G-buffer.
        base_color: [H, W, 3] 0..1.
        diffuse: [H, W, 3] straight relit radiance.
        proxy: its mesh.
        measured: base colour, roughness and metallic of vertices that other cameras see; None: there are none.
    """

    surface: Surface
    base_color: F32
    diffuse: F32
    proxy: ProxyScene
    measured: MeasuredVertices | None = None

    def around(self, light: PreparedLight, surroundings: Surroundings, settings: RelightSettings) -> Subject:
        """As the set sees it."""
        pixels = gather_pixels(self.surface)
        occluders = find_occluders(self.surface, pixels, self.proxy, settings)
        base = self.base_color.reshape(-1, 3)[pixels.index]
        joined = surroundings.around(self.proxy)
        shown = inner_pixels(occluders.shown, np.asarray(self.surface.opacity).reshape(-1)[pixels.index])
        source = ShownPixels(pixels, shown, np.ascontiguousarray(base))
        sent = indirect_light(joined, source, light, settings, surroundings)
        if settings.bounce == 0:  # as relighting: what is occluded is black
            sent = IndirectLight(sent.diffuse * 0, sent.metal._replace(tint=sent.metal.tint * 0), sent.light)
        picture = DeliveredPicture(self.proxy, self.surface)
        materials, diffuse = (
            SubjectMaterials(picture, self.base_color, self.measured),
            self.diffuse if settings.bounce else self.diffuse * 0,
        )
        return Subject(picture, sent, diffuse, materials, Lighting(light, settings, surroundings))


def inner_pixels(shown: I32, opacity: F32) -> I32:
    """Triangles [P] that pixels show, without those of edge pixels: they would colour whole sides that no pixel shows.

    Args:
        shown: [P] triangle of each pixel, -1 where none.
        opacity: [P] coverage of the pixels; where none is `COVERED`, all count.
    """
    inner = opacity >= COVERED
    return np.where(inner, shown, np.int32(-1)) if (inner & (shown >= 0)).any() else shown


class SetLayers(NamedTuple):
    """What a frame's composite is made of, beside the subject.

    Attributes:
        ratio: [H, W, 3] what the subject leaves of the light on what is behind it, 0..1.
        added: [H, W, 3] radiance that the subject adds there.
        holdout: [H, W] share of the pixel in which the set is in front of the subject.
        behind: [H, W, 3] the set without the subject over the light's map; None: a plate is behind the subject.
    """

    ratio: F32
    added: F32
    holdout: F32
    behind: F32 | None


def lit_set(
    image: SetImage,
    subject: RelitSubject,
    light: PreparedLight,
    surroundings: Surroundings,
    settings: RelightSettings,
    behind: F32 | None,
) -> SetLayers:
    """Lights the set around a relit subject.

    Args:
        image: where the camera sees the set.
        subject: the subject.
        light: that relit it.
        surroundings: the set.
        settings: of relighting.
        behind: [H, W, 3] radiance behind the set; None: the set only catches shadow and reflection.
    """
    own = surroundings if surroundings.floor is None else None
    scene = SetScene(subject.around(light, surroundings, settings), own, settings.offset)
    lit = light_set(image.view, light, scene, settings)
    opacity = np.nan_to_num(np.asarray(subject.surface.opacity, np.float32))
    lit = _at_edge(lit, subject_edge(image.view, opacity, subject.proxy))
    if image.edges is not None:
        lit = SetLight(*map(image.edges.of, lit))
    pixels, cover = image.view.pixels, image.cover[:, None]
    if behind is None:
        ratio = 1 - cover * (1 - _over(lit.blocked, lit.open))
    else:
        back = behind.reshape(-1, 3)[pixels.index] * (1 - cover)
        whole = back + cover * lit.open
        ratio = _over(back + cover * lit.blocked, whole)
        behind = behind.copy()
        behind.reshape(-1, 3)[pixels.index] = whole
    left = np.ones((*image.holdout.shape, 3), np.float32)
    left.reshape(-1, 3)[pixels.index] = ratio
    return SetLayers(left, pixels.image(cover * lit.added), image.holdout, behind)


def _at_edge(lit: SetLight, edge: EdgeMix) -> SetLight:
    """The light of the set; at the subject's edge, with what the subject does to the pixels beside it."""
    return SetLight(lit.open, lit.open * edge.of(_over(lit.blocked, lit.open)), edge.of(lit.added))


def _over(part: F32, whole: F32) -> F32:
    """Ratio [P, 3] of a part to the whole, in [0, 1]; 1 where both are the same, so also where there is no light."""
    ratio = part / np.where(whole > 0, whole, 1)
    return np.where(part == whole, 1, np.clip(ratio, 0, 1)).astype(np.float32)
