"""Records of the evidence. P points of a frame, V views, R roughness and M metallic candidates, H x W pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera

F32 = NDArray[np.float32]
Bool = NDArray[np.bool_]


@dataclass(frozen=True)
class View:
    """The picture of one camera.

    Attributes:
        name: of the camera, for messages.
        camera: the camera.
        pose: what `Camera.pose` takes: the frame, or None of a camera at rest.
        radiance: [H, W, 3] straight scene-linear Rec.709; NaN where a pixel is damaged.
        matte: [H, W] coverage in [0, 1].
    """

    name: str
    camera: Camera
    pose: int | None
    radiance: F32
    matte: F32


class Observations(NamedTuple):
    """What V cameras saw of P points.

    Attributes:
        radiance: [P, V, 3] scene-linear; 0 where not valid.
        sigma: [P, V, 3] standard deviation of that radiance.
        valid: [P, V] whether the camera sees the point.
    """

    radiance: F32
    sigma: F32
    valid: Bool


class Responses(NamedTuple):
    """Radiance towards V cameras as a function of base colour b, metallic m and roughness (R candidates).

    L = b A + D with A = (1 - m) diffuse + m F(b) metal_f0 and D = (1 - m) dielectric + m F(b) metal_f90, where
    F(b) = 1 + Fms(b, average) missing is the compensation for multiple scattering (relight/combine.py).

    Attributes:
        diffuse: [P, V, R, 3] E_d times the share that passes the dielectric layer.
        dielectric: [P, V, R, 3] specular of a dielectric, compensated.
        metal_f0: [P, V, R, 3] part of the metallic lobe that F0 multiplies.
        metal_f90: [P, V, R, 3] the rest of that lobe.
        missing: [P, V, R] (1 - E) / E of the lobe; 0 for `brdf="paper"`.
        average: [R] Eavg of the lobe; 1 for `brdf="paper"`.
    """

    diffuse: F32
    dielectric: F32
    metal_f0: F32
    metal_f90: F32
    missing: F32
    average: F32


@dataclass(frozen=True)
class FrameEvidence:
    """Materials of one frame.

    Attributes:
        mean: [2, H, W] roughness and metallic in [0, 1].
        std: [2, H, W] their posterior standard deviation, at most 0.5.
        views: [H, W] how many cameras measured a pixel; 0 where the model's estimate stands.
        left_out: camera -> why it was not used.
        gains: camera -> its radiance over that of the others.
        light: harmonics of bands 1 and 2 of the factor of the capture light minus 1; empty if none was fitted.
        moved: pixels whose point was taken from the proxy, since z contradicts it.
        base_views: [H, W, 4] base colour by all views and its weight against the plate's; None: the plate's stands.
    """

    mean: F32
    std: F32
    views: F32
    left_out: dict[str, str]
    gains: dict[str, float]
    light: tuple[float, ...] = ()
    moved: int = 0
    base_views: F32 | None = None
