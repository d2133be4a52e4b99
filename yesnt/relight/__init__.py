"""Physically based relighting under an environment map (docs/method.md section 5)."""

from yesnt.core.camera import Camera
from yesnt.relight.envmap import EnvMap
from yesnt.relight.estimate import estimate_capture
from yesnt.relight.frame import FrameInputs, RelitFrame, prepare_capture, prepare_relight, relight_frame
from yesnt.relight.gbuffer import GBuffer, Shading, shade
from yesnt.relight.lights import PreparedLight, prepare_light, uniform_light
from yesnt.relight.points import Surface
from yesnt.relight.proxy import ProxyScene
from yesnt.relight.scope import Requirement, SceneFacts, requirements
from yesnt.relight.settings import RelightSettings

__all__ = [
    "Camera",
    "EnvMap",
    "FrameInputs",
    "GBuffer",
    "PreparedLight",
    "ProxyScene",
    "RelightSettings",
    "RelitFrame",
    "Requirement",
    "SceneFacts",
    "Shading",
    "Surface",
    "estimate_capture",
    "prepare_capture",
    "prepare_light",
    "prepare_relight",
    "relight_frame",
    "requirements",
    "shade",
    "uniform_light",
]
