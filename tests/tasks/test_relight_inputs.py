"""One way to relight: known base colours, lights cached by content, and no second assembly of a frame's inputs."""

import ast
import dataclasses
from pathlib import Path

import numpy as np
import pytest

from tests.tiny_shot import write_tiny_shot
from yesnt.core.camera import Camera
from yesnt.io import shot_inputs
from yesnt.io.exr import write_exr
from yesnt.io.jobfile import frame_path
from yesnt.planning import settings as of
from yesnt.relight import ProxyScene
from yesnt.runtime.session import Session
from yesnt.tasks.light import LightFiles, captured_light, prepared_lights
from yesnt.tasks.relight_inputs import RelightInputs, proxy_scene, read_proxy, relight

PACKAGE = Path(__file__).parents[2] / "yesnt"


@pytest.fixture
def frame(tmp_path):
    """The job and the inputs of a tiny shot's first frame."""
    job = Session(write_tiny_shot(tmp_path, 2, (20, 16))).job
    camera = Camera.open(frame_path(job.root, job.shot.camera, 0))
    first = job.frames[0]
    gbuffer = shot_inputs.read_surface(job, first, camera)
    proxy = proxy_scene(read_proxy(job, first), ProxyScene)
    return job, RelightInputs(shot_inputs.read_plate(job, first), gbuffer, camera, first, proxy)


def test_a_known_base_colour_replaces_the_capture_light(frame):
    job, inputs = frame
    material = np.full((2, job.height, job.width), 0.4, np.float32)
    settings = of.relight_settings(job.shot)
    lights = prepared_lights(LightFiles.read(job, inputs.frame), inputs.surface(material), settings)
    found = relight(inputs, material, lights, settings)
    again = relight(inputs, material, (lights[0], None), settings, found.base_color)
    np.testing.assert_array_equal(again.radiance, found.radiance)
    darker = relight(inputs, material, (lights[0], None), settings, 0.5 * found.base_color)
    inside = inputs.plate.matte > 0
    assert darker.diffuse[inside].sum() == pytest.approx(0.5 * found.diffuse[inside].sum(), rel=0.1)
    with pytest.raises(ValueError, match="needs the capture light or the base colour"):
        relight(inputs, material, (lights[0], None), settings)


def test_pixels_outside_the_matte_are_not_shaded(frame):
    job, inputs = frame
    material = np.full((2, job.height, job.width), 0.4, np.float32)
    settings = of.relight_settings(job.shot)
    matte = inputs.plate.matte.copy()
    matte[:, ::2] = 0
    sparse = dataclasses.replace(inputs, plate=dataclasses.replace(inputs.plate, matte=matte))
    lights = prepared_lights(LightFiles.read(job, inputs.frame), inputs.surface(material), settings)
    found = relight(sparse, material, lights, settings)
    assert not found.radiance[matte == 0].any()
    assert found.radiance[matte > 0].any()


def test_a_changed_capture_map_is_read_again_in_the_same_process(tmp_path):
    write_exr(tmp_path / "capture.exr", _map(1.0))
    path = write_tiny_shot(tmp_path, 2, (20, 16), capture_light={"path": "capture.exr"})
    job = Session(path).job
    camera = Camera.open(frame_path(job.root, job.shot.camera, 0))
    inputs = RelightInputs(
        shot_inputs.read_plate(job, 1001), shot_inputs.read_surface(job, 1001, camera), camera, 1001, None
    )
    surface, settings = inputs.surface(np.zeros((2, 16, 20), np.float32)), of.relight_settings(job.shot)
    before = captured_light(LightFiles.read(job, 1001), surface, settings)
    assert captured_light(LightFiles.read(job, 1001), surface, settings) is before
    write_exr(tmp_path / "capture.exr", _map(3.0))
    after = captured_light(LightFiles.read(job, 1001), surface, settings)
    assert after.coarse.energy.sum() == pytest.approx(3 * before.coarse.energy.sum(), rel=1e-5)


def test_only_one_module_assembles_a_frame_for_the_relighting_kernel():
    """Evaluation and trade measure what `yesnt run` does; a second assembly would drift from it."""
    kernels = {"relight_frame", "shade_pixels", "base_color", "finish"}
    callers = set()
    for path in PACKAGE.rglob("*.py"):
        names = {
            getattr(node.func, "id", getattr(node.func, "attr", ""))
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.Call)
        }
        if kernels & names:
            callers.add(path.relative_to(PACKAGE))
    # These light no frame of a shot: synthetic pixels, and vertices of the proxy as the capture's cameras see them.
    apart = {Path("training/subject_render.py"), Path("decompose/evidence/sides.py")}
    others = {path for path in callers if path.parts[0] != "relight"} - apart
    assert others == {Path("tasks/relight_inputs.py")}


def _map(radiance):
    return {channel: np.full((8, 16), radiance, np.float32) for channel in "RGB"}
