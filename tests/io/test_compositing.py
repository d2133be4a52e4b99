"""The scripts beside the EXR sequence put its layers together to the composite."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from yesnt.capture_stage.tools import find_tools, run_script
from yesnt.core.errors import MissingPartError
from yesnt.io.compositing.blender import blender_script
from yesnt.io.compositing.nuke import nuke_script
from yesnt.io.compositing.sequence import LayerSequence
from yesnt.io.exr import read_planes, write_exr
from yesnt.scene.composite import Behind, into_set

F32 = NDArray[np.float32]
SIZE = (12, 8)
LONG = {"R": "red", "G": "green", "B": "blue", "A": "alpha"}


def sequence(front: bool = True) -> LayerSequence:
    """Two frames of a sequence of SIZE."""
    return LayerSequence("walk", (1001, 1002), SIZE, 1.0, front)


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


class Nuke:
    """Evaluates the few nodes that the script uses, as Nuke's reference guide describes them."""

    def __init__(self, channels: Mapping[str, F32]) -> None:
        self._file = {re.sub(r"\.([RGBA])$", lambda m: f".{LONG[m[1]]}", name): p for name, p in channels.items()}
        self._file |= {LONG[name]: plane for name, plane in channels.items() if name in LONG}
        self._stack: list[dict[str, F32]] = []
        self._named: dict[str, dict[str, F32]] = {}
        self.reads: list[str] = []

    def run(self, script: str) -> F32:
        for kind, body, name, pushed in re.findall(
            r"^(\w+) \{\n(.*?)^\}$|^set (\w+) \[stack 0\]$|^push \$(\w+)$", script, re.M | re.S
        ):
            if name:
                self._named[name] = self._stack[-1]
            elif pushed:
                self._stack.append(self._named[pushed])
            elif kind != "Root":
                knobs = dict(re.findall(r"^ (\w+) (.*)$", body, re.M))
                self._stack.append(getattr(self, f"_{kind.lower()}")(knobs))
        result = self._stack.pop()
        return np.stack([result[c] for c in LONG.values()], axis=-1)

    def _read(self, knobs: Mapping[str, str]) -> dict[str, F32]:
        self.reads.append(knobs["file"])
        assert knobs["raw"] == "true"  # the layers are scene-linear: no conversion
        return self._file

    def _expression(self, knobs: Mapping[str, str]) -> dict[str, F32]:
        given = self._stack.pop()
        out = dict(given)
        for i, channel in enumerate(LONG.values()):
            text = knobs[f"expr{i}"].strip('"')
            names = sorted(set(re.findall(r"[a-z_]+(?:\.\w+)?", text)) - {"max"}, key=len, reverse=True)
            for k, name in enumerate(names):
                text = re.sub(rf"(?<![\w.]){re.escape(name)}(?![\w.])", f"v[{k}]", text)
            values = [given[name] for name in names]
            out[channel] = np.broadcast_to(eval(text, {"max": np.maximum, "v": values}), SIZE[::-1])
        return out

    def _merge2(self, knobs: Mapping[str, str]) -> dict[str, F32]:
        """Input 0, B, is the last that was pushed; merges act on red, green, blue and alpha."""
        b, a = self._stack.pop(), self._stack.pop()
        cover = a["alpha"]
        operation: dict[str, Callable[[F32, F32], F32]] = {
            "multiply": lambda a, b: a * b,
            "plus": lambda a, b: a + b,
            "over": lambda a, b: a + b * (1 - cover),
            "stencil": lambda a, b: b * (1 - cover),
        }
        return {**b, **{c: operation[knobs["operation"]](a[c], b[c]) for c in LONG.values()}}


@pytest.mark.parametrize("front", [True, False])
def test_nuke_makes_the_same_composite(front: bool) -> None:
    channels, composite = layers(before=front)
    nuke = Nuke(channels)
    found = nuke.run(nuke_script(sequence(front)))
    np.testing.assert_allclose(found, composite, rtol=1e-5, atol=1e-5)
    assert nuke.reads == ['"\\[file dirname \\[value root.name]]/walk.####.exr"']


def test_nukes_script_names_frames_and_size() -> None:
    text = nuke_script(LayerSequence("walk", (1001, 1016), (1920, 1080), 2.0, True))
    assert 'format "1920 1080 0 0 1920 1080 2"' in text
    assert " first 1001\n last 1016\n" in text
    assert text.count("{") == text.count("}")


def test_blenders_script_is_python_of_its_own() -> None:
    text = blender_script(LayerSequence("it's", (1, 2), (4, 3), 1.5, False))
    compile(text, "layers.py", "exec")
    assert 'NAME = "it\'s"\nFRAMES = (1, 2)\nSIZE = (4, 3)\nASPECT = 1.5\nFRONT = False\n' in text


@pytest.mark.blender
@pytest.mark.parametrize("front", [True, False])
def test_blender_makes_the_same_composite(tmp_path: Path, front: bool) -> None:
    """Each frame has its own pixels, so that a compositor that shows another frame is noticed."""
    try:
        tools = find_tools(tmp_path)
    except MissingPartError as error:
        pytest.skip(str(error))
    expected = {}
    for frame in (1001, 1002):
        channels, expected[frame] = layers(frame, front)
        write_exr(tmp_path / f"walk.{frame}.exr", channels)
    script = tmp_path / "walk_layers.py"
    script.write_text(blender_script(sequence(front)))
    run_script(tools, Path(__file__).with_name("composite_in_blender.py"), [str(script)], 300.0)
    for frame, composite in expected.items():
        planes = read_planes(tmp_path / f"composited.{frame}.exr")
        found = np.stack([planes[c] for c in "RGBA"], axis=-1)
        np.testing.assert_allclose(found, composite, rtol=1e-4, atol=1e-4)
