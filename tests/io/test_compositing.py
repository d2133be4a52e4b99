"""The scripts beside the EXR sequence put its layers together to the composite."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.nuke_script import Nuke
from yesnt.capture_stage.tools import find_tools, run_script
from yesnt.core.errors import MissingPartError
from yesnt.io.compositing.blender import blender_script
from yesnt.io.compositing.nuke import nuke_script
from yesnt.io.compositing.sequence import LayerSequence
from yesnt.io.exr import read_planes, write_exr
from yesnt.scene.composite import Behind, into_set

F32 = NDArray[np.float32]
SIZE = (12, 8)


def sequence(front: bool = True, **parts: bool) -> LayerSequence:
    """Two frames of a sequence of SIZE."""
    return LayerSequence("walk", (1001, 1002), SIZE, 1.0, front, **parts)


def groups(seed: int, composite: F32) -> dict[str, F32]:
    """The composite [H, W, 4] and the light groups that it is the sum of, as channels of a delivered EXR."""
    sun = composite[..., :3] * np.random.default_rng(seed + 9).uniform(0, 1, composite.shape[:2])[..., None]
    planes = {"light_sun": sun, "light_rest": composite[..., :3] - sun, "": composite}
    return {
        f"{name}.{c}".lstrip("."): np.ascontiguousarray(plane[..., i], np.float32)
        for name, plane in planes.items()
        for i, c in enumerate("RGBA"[: plane.shape[-1]])
    }


def layers(seed: int = 0, before: bool = True) -> tuple[dict[str, F32], F32]:
    """Channels of a delivered EXR by name, and the composite [H, W, 4] that the product makes of them."""
    draw = np.random.default_rng(seed)
    shape = SIZE[::-1]
    alpha, holdout, shadow = (draw.uniform(0, 1, shape).astype(np.float32) for _ in range(3))
    relit = np.concatenate([draw.uniform(0, 4, (*shape, 3)) * alpha[..., None], alpha[..., None]], axis=-1)
    env, front = draw.uniform(0, 9, (*shape, 3)), draw.uniform(0, 2, (*shape, 3)) * holdout[..., None]
    reflection = draw.uniform(-1, 1, (*shape, 3))
    one = np.ones(shape, np.float32)[..., None]
    behind = Behind(
        np.concatenate([env, one], -1).astype(np.float32), np.repeat(shadow[..., None], 3, -1),
        reflection.astype(np.float32), holdout, front.astype(np.float32) if before else None,
    )  # fmt: skip
    found = {f"relit.{c}": relit[..., i] for i, c in enumerate("RGBA")}
    found |= {f"{name}.{c}": plane[..., i] for name, plane in (("env", env), ("reflection_set", reflection),
              ("front", front)) for i, c in enumerate("RGB")}  # fmt: skip
    found |= {"shadow_set.Y": shadow, "holdout.Y": holdout, **{c: 0 * shadow for c in "RGBA"}}
    return {n: np.ascontiguousarray(p, np.float32) for n, p in found.items()}, into_set(
        relit.astype(np.float32), behind
    )


@pytest.mark.parametrize("front", [True, False])
def test_nuke_makes_the_same_composite(front: bool) -> None:
    channels, composite = layers(before=front)
    nuke = Nuke(channels)
    found = nuke.run(nuke_script(sequence(front)))
    np.testing.assert_allclose(found, composite, rtol=1e-5, atol=1e-5)
    assert nuke.reads == ['"\\[file dirname \\[value root.name]]/walk.####.exr"']


@pytest.mark.parametrize("of_set", [True, False])
def test_nuke_rebalances_light_groups(of_set: bool) -> None:
    channels, composite = layers(before=False)
    held = groups(0, composite)
    script = nuke_script(sequence(front=False, set=of_set, groups=True))
    found = Nuke(channels | held).run(script)
    np.testing.assert_allclose(found, composite, rtol=1e-5, atol=1e-5)
    more = Nuke(channels | held, {"sun": 3.0, "rest": 0.5}).run(script)
    for i, c in enumerate("RGB"):
        expected = 3 * held[f"light_sun.{c}"] + 0.5 * held[f"light_rest.{c}"]
        np.testing.assert_allclose(more[..., i], expected, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(more[..., 3], composite[..., 3], rtol=1e-5)


def test_nukes_script_names_frames_and_size() -> None:
    text = nuke_script(LayerSequence("walk", (1001, 1016), (1920, 1080), 2.0, True))
    assert 'format "1920 1080 0 0 1920 1080 2"' in text
    assert " first 1001\n last 1016\n" in text
    assert text.count("{") == text.count("}")


def test_blenders_script_is_python_of_its_own() -> None:
    text = blender_script(LayerSequence("it's", (1, 2), (4, 3), 1.5, False))
    compile(text, "layers.py", "exec")
    assert (
        'NAME = "it\'s"\nFRAMES = (1, 2)\nSIZE = (4, 3)\nASPECT = 1.5\nFRONT = False\nSET = True\nGROUPS = False\n'
        in text
    )


@pytest.mark.blender
@pytest.mark.parametrize("front", [True, False])
def test_blender_makes_the_same_composite(tmp_path: Path, front: bool) -> None:
    """Each frame has its own pixels, so that a compositor that shows another frame is noticed."""
    expected = {}
    for frame in (1001, 1002):
        channels, expected[frame] = layers(frame, front)
        write_exr(tmp_path / f"walk.{frame}.exr", channels)
    for frame, found in blender_composites(tmp_path, sequence(front)).items():
        np.testing.assert_allclose(found, expected[frame], rtol=1e-4, atol=1e-4)


@pytest.mark.blender
@pytest.mark.parametrize("of_set", [True, False])
@pytest.mark.parametrize("factors", [(1.0, 1.0), (3.0, 0.5)])
def test_blender_rebalances_light_groups(tmp_path: Path, of_set: bool, factors: tuple[float, float]) -> None:
    expected = {}
    for frame in (1001, 1002):
        channels, composite = layers(frame, before=False)
        held = groups(frame, composite)
        sun, rest = (np.stack([held[f"{n}.{c}"] for c in "RGB"], -1) for n in ("light_sun", "light_rest"))
        expected[frame] = np.concatenate([factors[0] * sun + factors[1] * rest, composite[..., 3:]], -1)
        write_exr(tmp_path / f"walk.{frame}.exr", channels | held)
    script = sequence(front=False, set=of_set, groups=True)
    for frame, found in blender_composites(tmp_path, script, factors).items():
        np.testing.assert_allclose(found, expected[frame], rtol=1e-4, atol=1e-4)


def blender_composites(
    folder: Path, of: LayerSequence, factors: tuple[float, float] = (1.0, 1.0)
) -> dict[int, NDArray[np.float32]]:
    """What the compositor of the product's script shows in each frame, with factors of sun and rest."""
    try:
        tools = find_tools(folder)
    except MissingPartError as error:
        pytest.skip(str(error))
    script = folder / "walk_layers.py"
    script.write_text(blender_script(of))
    arguments = [*map(str, factors), str(script)]
    run_script(tools, Path(__file__).with_name("composite_in_blender.py"), arguments, 300.0)
    found = {}
    for frame in (1001, 1002):
        planes = read_planes(folder / f"composited.{frame}.exr")
        found[frame] = np.stack([planes[c] for c in "RGBA"], axis=-1)
    return found
