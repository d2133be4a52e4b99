"""One way to relight a frame of a shot: the relight task, evaluation and trade all call `relight` of this module."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera
from yesnt.core.shot import Job
from yesnt.io import shot_inputs
from yesnt.io.mesh import read_proxy as read_mesh_of
from yesnt.relight import FrameInputs, PreparedLight, ProxyScene, RelightSettings, RelitFrame, Surface, relight_frame

if TYPE_CHECKING:
    from yesnt.io.mesh import Mesh
    from yesnt.relight.extend import CapturedLight
    from yesnt.relight.surroundings import Surroundings

F32 = NDArray[np.float32]
P = TypeVar("P", bound=ProxyScene)


@dataclass(frozen=True)
class RelightInputs:
    """The inputs of one frame that do not depend on its materials or on the new light.

    Attributes:
        plate: straight scene-linear colour [H, W, 3] and matte [H, W]; pixels outside the matte are not shaded.
        gbuffer: world-space normals [H, W, 3] and planar z [H, W] in metres.
        camera: the shot's camera.
        frame: frame number; selects the camera pose.
        proxy: mesh that casts shadows and bounces light; None: no such mesh.
        surroundings: the set that the subject is relit in; None: there is none.
    """

    plate: shot_inputs.Plate
    gbuffer: shot_inputs.Surface
    camera: Camera
    frame: int
    proxy: ProxyScene | None
    surroundings: Surroundings | None = None

    def surface(self, material: F32) -> Surface:
        """The surface to shade, for roughness and metallic as [2, H, W]."""
        roughness, metallic = material
        seen, matte = self.gbuffer, self.plate.matte
        return Surface(seen.normal, seen.z, matte, roughness, metallic, self.camera, self.frame)


def relight(
    inputs: RelightInputs,
    material: F32,
    lights: tuple[PreparedLight, PreparedLight | None],
    settings: RelightSettings,
    base_color: F32 | None = None,
    captured: CapturedLight | None = None,
    base_views: F32 | None = None,
) -> RelitFrame:
    """Relights one frame.

    Args:
        inputs: plate, G-buffer, camera and proxy of the frame.
        material: roughness and metallic, [2, H, W] in [0, 1].
        lights: the new light and the light that the plate was captured under (None if `base_color` is given).
        settings: quality of relighting.
        base_color: known base colour [H, W, 3]; None: the capture light is divided out of the plate.
        captured: with a known base colour, what it sends out under the light of the plate; None: not known.
        base_views: [H, W, 4] base colour by other views and its weight against the plate's; None: the plate's stands.
    """
    light, capture = lights
    frame_inputs = FrameInputs(inputs.plate.color, inputs.surface(material), base_color, captured, base_views)
    return relight_frame(frame_inputs, light, capture, inputs.proxy, settings, inputs.surroundings)


def read_proxy(job: Job, frame: int) -> Mesh | None:
    """The proxy mesh of a frame, vertices in world metres; None if the job names none."""
    return None if job.shot.proxy is None else read_mesh_of(job, frame)


def proxy_scene(mesh: Mesh | None, kind: type[P]) -> P | None:
    """A ray-casting scene of class `kind` over the mesh; None without a mesh."""
    return None if mesh is None else kind.from_arrays(mesh.vertices, mesh.faces)
