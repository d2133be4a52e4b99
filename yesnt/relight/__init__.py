"""Physically based relighting under an environment map (method.md section 5)."""

from yesnt.camera import Camera
from yesnt.relight.envmap import EnvMap
from yesnt.relight.frame import FrameInputs, RelitFrame, prepare_capture, prepare_relight, relight_frame
from yesnt.relight.lights import PreparedLight, prepare_light, uniform_light
from yesnt.relight.points import Surface
from yesnt.relight.proxy import ProxyScene
from yesnt.relight.settings import RelightSettings
from yesnt.relight.shade import GBuffer, Shading, shade

__all__ = [
    "Camera",
    "EnvMap",
    "FrameInputs",
    "GBuffer",
    "PreparedLight",
    "ProxyScene",
    "RelightSettings",
    "RelitFrame",
    "Shading",
    "Surface",
    "prepare_capture",
    "prepare_light",
    "prepare_relight",
    "relight_frame",
    "shade",
    "uniform_light",
]
