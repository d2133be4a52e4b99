"""Scenes whose pictures are known by formula, rendered once a session."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from yesnt.capture_stage import passes
from yesnt.capture_stage.cameras import look_at
from yesnt.capture_stage.material_layers import Between, Layer, fields_of, layers_to_json
from yesnt.capture_stage.pose import turn
from yesnt.capture_stage.procedural_maps import directions, write_map
from yesnt.capture_stage.tools import Tools, find_tools, run_blender
from yesnt.core.camera import Camera
from yesnt.core.errors import MissingPartError

SIZE = 96
FOCAL = 150.0
PLAIN = ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5))


@pytest.fixture(scope="session")
def tools(tmp_path_factory) -> Tools:
    try:
        return find_tools(tmp_path_factory.mktemp("cache"))
    except MissingPartError as error:
        pytest.skip(str(error))


@dataclass(frozen=True)
class Scene:
    """A painted mesh, one shape and one camera pose a frame, under one map."""

    shapes: np.ndarray
    faces: np.ndarray
    layers: tuple[Layer, ...]
    poses: tuple[np.ndarray, ...]
    light: np.ndarray
    subdivision: int = 0
    samples: int = 16

    def camera(self) -> Camera:
        frames = {str(i): {"world_from_camera": pose.ravel().tolist()} for i, pose in enumerate(self.poses)}
        size = {"width": SIZE, "height": SIZE, "fx": FOCAL, "fy": FOCAL, "cx": SIZE / 2, "cy": SIZE / 2}
        return Camera.from_dict({**size, "frames": frames})

    def render(self, tools: Tools, work: Path, frame: int) -> tuple[dict, dict]:
        """The one-sample passes through pixel centres and the antialiased ones."""
        rest = self.shapes[0]
        known = dict(zip("xyz", rest.T, strict=True))
        fields = {f"field_{name}": known[name].astype(np.float32) for name in fields_of(self.layers)}
        np.savez(work / "subject.npz", vertices=self.shapes, faces=self.faces, rest=rest.astype(np.float32), **fields)
        write_map(work / "light.exr", self.light)
        subject = {
            "kind": "mesh", "archive": str(work / "subject.npz"), "layers": layers_to_json(self.layers),
            "subdivision": self.subdivision,
        }  # fmt: skip
        request = {
            "subject": subject, "width": SIZE, "height": SIZE, "fx": FOCAL, "samples": self.samples, "threads": 1,
            "proxy_triangles": 500, "truth": True,
            "frames": [
                {"frame": i, "shape": min(i, len(self.shapes) - 1), "world_from_camera": p.tolist()}
                for i, p in enumerate(self.poses)
            ],
            "renders": [
                {"what": "geometry", "frame": frame, "out": str(work / "points.exr")},
                {"what": "light", "frame": frame, "env": str(work / "light.exr"), "out": str(work / "lit.exr")},
            ],
        }  # fmt: skip
        run_blender(tools, request, work)
        return passes.read_passes(work / "points.exr"), passes.read_passes(work / "lit.exr")


def octant_layers() -> tuple[Layer, ...]:
    """Red, green and blue say on which side of x, y and z = 0 a point lies."""
    layers = []
    for x in (0, 1):
        for y in (0, 1):
            for z in (0, 1):
                where = tuple(
                    Between(name, 0.0 if side else -5.0, 5.0 if side else 0.0)
                    for name, side in zip("xyz", (x, y, z), strict=True)
                )
                layers.append(Layer("octant", where, "plain", ((x, y, z), (x, y, z)), 1, (0.5, 0.5)))
    return tuple(layers)


def cube(half: float) -> tuple[np.ndarray, np.ndarray]:
    """A cube about the origin with 8x8 squares a side."""
    steps = np.linspace(-half, half, 9)
    a, b = (g.ravel() for g in np.meshgrid(steps, steps, indexing="ij"))
    corners = np.arange(81).reshape(9, 9)
    quads = np.stack([corners[:-1, :-1], corners[1:, :-1], corners[1:, 1:], corners[:-1, 1:]], -1).reshape(-1, 4)
    vertices, faces = [], []
    for axis in range(3):
        for sign in (-1, 1):
            side = np.empty((81, 3))
            side[:, axis], side[:, (axis + 1) % 3], side[:, (axis + 2) % 3] = sign * half, a, b
            faces.append((quads if sign > 0 else quads[:, ::-1]) + 81 * len(vertices))
            vertices.append(side)
    return np.concatenate(vertices), np.concatenate(faces).astype(np.int32)


def cube_motion(frame: int) -> tuple[np.ndarray, np.ndarray]:
    """The rotation [3, 3] and the shift [3] that take the cube from rest to a frame."""
    return turn("z", 4 * frame) @ turn("x", 2 * frame), np.array([0.02, -0.03, 0.04]) * frame


def sphere(radius: float, rings: int = 96, sectors: int = 192) -> tuple[np.ndarray, np.ndarray]:
    """A ball about the origin, poles on z, fine enough that its facets do not show."""
    d = directions(rings, sectors)
    d = np.concatenate([np.tile([[[0, 0, 1.0]]], (1, sectors, 1)), d, np.tile([[[0, 0, -1.0]]], (1, sectors, 1))])
    r, c = np.meshgrid(np.arange(rings + 1), np.arange(sectors), indexing="ij")
    right = (c + 1) % sectors
    faces = np.stack([r * sectors + c, (r + 1) * sectors + c, (r + 1) * sectors + right, r * sectors + right], -1)
    return radius * d.reshape(-1, 3), faces[:, :, ::-1].reshape(-1, 4).astype(np.int32)


@pytest.fixture
def chrome_scene() -> Scene:
    vertices, faces = sphere(0.5)
    layers = (Layer("chrome", (), "plain", ((1, 1, 1), (1, 1, 1)), 1, (0.0, 0.0), 1.0),)
    pose = look_at([1.1, -2.0, 0.7], [0.05, 0.0, 0.02])
    light = (2 + directions(256, 512)).astype(np.float32)  # radiance says where it comes from
    return Scene(vertices[None].astype(np.float32), faces, layers, (pose, pose, pose), light, samples=64)


@pytest.fixture
def cube_scene() -> Scene:
    """A cube that turns, rises and comes nearer while the camera moves; at frame 0 it is at rest."""
    vertices, faces = cube(0.3)
    motions = [cube_motion(frame) for frame in range(4)]
    shapes = [vertices @ rotation.T + shift for rotation, shift in motions]
    poses = tuple(look_at([-0.9 + 0.05 * t, -1.7, 0.8], [0.0, 0.0, 0.02]) for t in range(4))
    light = np.ones((16, 32, 3), dtype=np.float32)
    return Scene(np.stack(shapes).astype(np.float32), faces, octant_layers(), poses, light, samples=64)
