"""A worker that outlives a run uses the new file where an input was replaced under the same path, whatever its kind.

Each file is overwritten in place with one of equal size and equal time of change: only its content tells it apart.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.in_process import run_here
from tests.tiny_shot import write_tiny_shot
from yesnt.core.errors import JobError
from yesnt.decompose.registry import find_weights
from yesnt.io.exr import write_exr
from yesnt.io.pictures.image import read_image
from yesnt.io.store import FrameStore
from yesnt.runtime.session import Session
from yesnt.tasks import decoded, decompose, flow, inputs, light
from yesnt.tasks.run import run_node

SIZE = (24, 20)


def forget_all() -> None:
    """What a worker holds, dropped: as if it had been started anew."""
    decoded.FRAMES.clear()
    decoded.MATTES.clear()
    for cached in (inputs._camera, light._map, light._prepared, decompose._backend, flow._spynet):
        cached.cache_clear()


def overwrite(path: Path, data: bytes) -> None:
    """Other bytes in the same file, of the same size and time of change."""
    before = path.stat()
    assert path.read_bytes() != data
    path.write_bytes(data)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert (path.stat().st_ino, path.stat().st_size) == (before.st_ino, before.st_size)


def planes(path: Path) -> dict[str, np.ndarray]:
    return {name: plane.copy() for name, plane in read_image(path).channels.items()}


def scaled(name: str, channels: str, factor: float) -> Callable[[Path], None]:
    """Multiplies some channels of a picture."""

    def change(folder: Path) -> None:
        image = planes(folder / name)
        for channel in channels.split():
            image[channel] *= np.float32(factor)
        write_exr(folder / "new.exr", image, compression="none")
        overwrite(folder / name, (folder / "new.exr").read_bytes())
        (folder / "new.exr").unlink()

    return change


def turn_camera(folder: Path) -> None:
    text = (folder / "camera.json").read_text()
    assert '"fx": 38.' in text
    overwrite(folder / "camera.json", text.replace('"fx": 38.', '"fx": 30.').encode())


def grow_proxy(folder: Path) -> None:
    text = (folder / "proxy.1001.ply").read_text()
    assert " 0.0" in text
    overwrite(folder / "proxy.1001.ply", text.replace(" 0.0", " 0.2").encode())


def retrain(folder: Path) -> None:
    """Changes every quantized weight by 8 of 127 steps."""
    data = bytearray((folder / "weights.safetensors").read_bytes())
    start = 8 + int.from_bytes(data[:8], "little")
    header = json.loads(data[8:start])
    for tensor in (tensor for tensor in header.values() if tensor.get("dtype") == "I8"):
        first, stop = (start + offset for offset in tensor["data_offsets"])
        data[first:stop] = (np.frombuffer(data[first:stop], np.uint8) ^ 0x08).tobytes()
    overwrite(folder / "weights.safetensors", bytes(data))


KINDS: dict[str, tuple[Callable[[Path], None], dict]] = {
    "camera": (turn_camera, {}),
    "camera of an estimated light": (turn_camera, {"capture_light": "estimate"}),
    "light": (scaled("light.exr", "R G", 2), {}),
    "capture light": (scaled("capture.exr", "R", 0.5), {"capture_light": {"path": "capture.exr"}}),
    "plate": (scaled("plate.1001.exr", "G", 0.5), {}),
    "gbuffer": (scaled("gbuffer.1001.exr", "N.X N.Z", 0.5), {}),
    "passes": (scaled("material.1001.exr", "roughness.Y", 0.5), {}),
    "background": (scaled("background.exr", "B", 0.5), {"background": {"path": "background.exr"}}),
    "flow": (scaled("flow.1001.exr", "forward.u", 3), {"flow": {"path": "flow.####.exr"}}),
    "proxy": (grow_proxy, {}),
    "weights": (retrain, {"decompose": {"backend": "embedded", "samples": 2, "weights": "weights.safetensors"}}),
}


def prepare(folder: Path, changes: dict) -> Path:
    """The shot, its pictures uncompressed: equal sizes whatever they show."""
    path = write_tiny_shot(folder, 2, SIZE, **changes)
    shutil.copy(folder / "light.exr", folder / "capture.exr")
    shutil.copy(folder / "plate.1001.exr", folder / "background.exr")
    if "weights" in changes.get("decompose", {}):
        shutil.copy(find_weights("embedded", None), folder / "weights.safetensors")
    flow = np.random.default_rng(0).random((2, SIZE[1], SIZE[0]), dtype=np.float32)
    write_exr(folder / "flow.1001.exr", {"forward.u": flow[0], "forward.v": flow[1]})
    for picture in folder.glob("*.exr"):
        write_exr(picture, planes(picture), compression="none")
    return path


def delivered(path: Path) -> dict[str, bytes]:
    return {exr.name: exr.read_bytes() for exr in sorted((path.parent / "out" / "exr").glob("*.exr"))}


@pytest.mark.parametrize("kind", KINDS)
def test_a_living_worker_sees_the_new_file(tmp_path: Path, kind: str) -> None:
    change, changes = KINDS[kind]
    path = prepare(tmp_path / "shot", changes)
    run_here(path, "composite")
    before = delivered(path)
    change(path.parent)
    run_here(path, "composite")
    shutil.copytree(path.parent, tmp_path / "fresh", ignore=shutil.ignore_patterns("out"))
    forget_all()
    run_here(tmp_path / "fresh", "composite")
    fresh = delivered(tmp_path / "fresh" / "shot.yaml")
    assert before != fresh, "the change shows in what is delivered"
    assert delivered(path) == fresh


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "camera of an estimated light"])
def test_an_input_that_changes_during_a_run_is_not_committed_under_the_old_key(tmp_path: Path, kind: str) -> None:
    change, changes = KINDS[kind]
    path = prepare(tmp_path / "shot", changes)
    session = Session(path)
    graph = session.graph()
    FrameStore.create(session.output.store, session.plan().arrays(), range(2), SIZE[1], SIZE[0])
    session.output.exr.mkdir(parents=True)
    forget_all()
    change(path.parent)
    with pytest.raises(JobError, match=r"An input has changed while the job runs.*the run began with.*run again"):  # noqa: PT012
        for node in graph:
            run_node(session.job, node)


def test_settings_of_the_picture_count_as_content_where_the_capture_light_is_estimated(tmp_path: Path) -> None:
    path = prepare(tmp_path / "shot", {"capture_light": "estimate"})
    run_here(path, "composite")
    text = path.read_text()
    assert "path: gbuffer.####.exr" in text
    path.write_text(text.replace("path: gbuffer.####.exr", "path: gbuffer.####.exr\n  normal_space: camera"))
    run_here(path, "composite")
    shutil.copytree(path.parent, tmp_path / "fresh", ignore=shutil.ignore_patterns("out"))
    forget_all()
    run_here(tmp_path / "fresh", "composite")
    assert delivered(path) == delivered(tmp_path / "fresh" / "shot.yaml")


def test_the_camera_file_is_read_once_a_worker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = prepare(tmp_path / "shot", {})
    forget_all()
    opened: list[Path] = []
    whole = inputs.Camera.open
    monkeypatch.setattr(inputs.Camera, "open", lambda file: opened.append(file) or whole(file))
    run_here(path, "composite")
    assert len([file for file in opened if json.loads(Path(file).read_text())]) == 2, "the preflight's and the tasks'"
