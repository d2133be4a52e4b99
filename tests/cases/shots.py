"""Tiny shots as EXR files: a grey sphere in front of a camera at rest, each file replaceable by a test's own.

Every case writes its own input with these functions, runs the product in the test's process and asserts the right
value. A product that refuses the input in one paragraph, or warns about it, gives an `Outcome` that says so.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import trimesh
import yaml
from numpy.typing import NDArray

from tests.in_process import run_here
from yesnt.core.errors import YesntError
from yesnt.io.pictures.image import read_image
from yesnt.runtime.checks.inputs import inspect
from yesnt.runtime.clamps import clamp_lines
from yesnt.runtime.session import Session

Array = NDArray[Any]
Planes = Mapping[str, Array]

WIDTH, HEIGHT = 64, 48
FRAME = 1001
RADIUS, DISTANCE = 0.5, 3.0
POSE = (1, 0, 0, 0, 0, 0, 1, -DISTANCE, 0, -1, 0, 0, 0, 0, 0, 1)
"""Camera at -Y that looks along +Y with +Z up, OpenCV axes, row-major."""

POSE_OPENGL = (1, 0, 0, 0, 0, 0, -1, -DISTANCE, 0, 1, 0, 0, 0, 0, 0, 1)
"""The same camera with OpenGL axes: y up, looking along -z."""

ACES_AP1 = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
"""Chromaticities of ACEScg: red, green, blue, white."""

ACESCG_COLOR, REC709_COLOR = (0.5, 0.05, 0.05), (0.8170, -0.0086, 0.0390)
"""One colour in ACEScg and in linear Rec.709 (Bradford adaptation, D60 to D65)."""


@dataclass(frozen=True)
class Sphere:
    """What the camera sees of the sphere: hit [H, W] bool, z [H, W] planar metres, normal [H, W, 3] world."""

    hit: NDArray[np.bool_]
    z: Array
    normal: Array

    @property
    def matte(self) -> NDArray[np.float32]:
        """Coverage, [H, W] 0 or 1."""
        return self.hit.astype(np.float32)


@dataclass(frozen=True)
class Outcome:
    """What became of a shot.

    Attributes:
        refusal: the text of the error that stopped it; empty if nothing did.
        warnings: what was reported before any work, and at the end of the run.
        planes: channels of the delivered EXR of the first frame by name; empty if not delivered.
        header: attributes of that EXR, with `dataWindow` and `displayWindow` as ((x, y), (x, y)).
    """

    refusal: str = ""
    warnings: tuple[str, ...] = ()
    planes: Mapping[str, Array] = field(default_factory=dict)
    header: Mapping[str, Any] = field(default_factory=dict)

    @property
    def reported(self) -> bool:
        """Whether the user was told of something odd."""
        return bool(self.refusal or self.warnings)

    def centre(self, layer: str = "relit") -> list[float]:
        """R, G, B of a layer at the middle of the picture, where the sphere is; empty if nothing was delivered."""
        return self.at(HEIGHT // 2, WIDTH // 2, layer)

    def at(self, y: int, x: int, layer: str = "relit") -> list[float]:
        """R, G, B of a layer at a pixel; `layer` "" is the composite; empty if nothing was delivered."""
        names = [f"{layer}.{c}" if layer else c for c in "RGB"]
        return [float(self.planes[name][y, x]) for name in names] if self.planes else []


def sphere(width: int = WIDTH, height: int = HEIGHT) -> Sphere:
    """The sphere as the camera of `POSE` sees it."""
    focal = 1.6 * width
    x, y = np.meshgrid((np.arange(width) + 0.5 - width / 2) / focal, (np.arange(height) + 0.5 - height / 2) / focal)
    rays = np.stack([x, np.ones_like(x), -y], -1)
    origin = np.array([0.0, -DISTANCE, 0.0])
    a, b, c = (rays**2).sum(-1), rays @ origin, origin @ origin - RADIUS**2
    root = b * b - a * c
    hit = root > 0
    z = np.where(hit, (-b - np.sqrt(np.maximum(root, 0))) / a, 0)
    normal = np.where(hit[..., None], (origin + z[..., None] * rays) / RADIUS, 0)
    return Sphere(hit, z, normal)


def write(path: Path, planes: Planes, **attributes: Any) -> None:
    """Writes one part of scan lines, pixel types as given; `attributes` may hold the windows (see `window`)."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **attributes}
    path.parent.mkdir(parents=True, exist_ok=True)
    with OpenEXR.File(header, {name: np.ascontiguousarray(plane) for name, plane in planes.items()}) as target:
        target.write(str(path))


def write_parts(path: Path, parts: Mapping[str, Planes]) -> None:
    """Writes a multi-part file, parts by name in order."""
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    made = [OpenEXR.Part({"name": name, **header}, dict(planes)) for name, planes in parts.items()]
    with OpenEXR.File(made) as target:
        target.write(str(path))


def window(left: int, top: int, width: int, height: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """A data or display window as the OpenEXR package takes it."""
    return np.array([left, top], np.int32), np.array([left + width - 1, top + height - 1], np.int32)


def display_window() -> dict[str, Any]:
    """The display window that the camera means: `WIDTH` x `HEIGHT` at the origin."""
    return {"displayWindow": window(0, 0, WIDTH, HEIGHT)}


def rgba(color: float | Array, matte: Array, kind: type = np.float32) -> dict[str, Array]:
    """R, G, B, A planes of one straight grey or [3] or [H, W, 3] colour over a matte, alpha associated."""
    image = np.broadcast_to(np.asarray(color, np.float64), (*matte.shape, 3)) * matte[..., None]
    return {**{c: image[..., i].astype(kind) for i, c in enumerate("RGB")}, "A": matte.astype(kind)}


def gbuffer(seen: Sphere, normal: Array | None = None, z: Array | None = None) -> dict[str, Array]:
    """`N.X`, `N.Y`, `N.Z` and `depth.Z`; a miss lies at 1e10, as Blender writes it."""
    normal = seen.normal if normal is None else normal
    z = np.where(seen.hit, seen.z, 1e10) if z is None else z
    return {
        **{f"N.{c}": normal[..., i].astype(np.float32) for i, c in enumerate("XYZ")},
        "depth.Z": z.astype(np.float32),
    }


def material(
    roughness: float = 0.5, metallic: float = 0.0, shape: tuple[int, int] = (HEIGHT, WIDTH)
) -> dict[str, Array]:
    """Constant material passes."""
    return {f"{n}.Y": np.full(shape, v, np.float32) for n, v in (("roughness", roughness), ("metallic", metallic))}


def sky(value: float | Array = 1.0) -> dict[str, Array]:
    """A lat-long map [16, 32] of one radiance or from an array [16, 32, 3]."""
    image = np.broadcast_to(np.asarray(value, np.float32), (16, 32, 3))
    return {c: image[..., i] for i, c in enumerate("RGB")}


def sky_with_sun() -> Array:
    """A dim sky with a bright patch, [16, 32, 3]."""
    image = np.full((16, 32, 3), 0.2, np.float32)
    image[3:6, 20:26] = 8
    return image


def camera(
    frames: tuple[int, ...] = (FRAME,),
    pose: tuple[float, ...] = POSE,
    size: tuple[int, int] | None = None,
    **changes: Any,
) -> dict[str, Any]:
    """`camera.json` as a document."""
    width, height = size or (WIDTH, HEIGHT)
    poses = {str(frame): {"world_from_camera": list(pose)} for frame in frames}
    return {
        "width": width, "height": height, "fx": 1.6 * width, "fy": 1.6 * width, "cx": width / 2, "cy": height / 2,
        "frames": poses, **changes,
    }  # fmt: skip


def write_shot(
    folder: Path,
    frames: tuple[int, ...] = (FRAME,),
    size: tuple[int, int] = (WIDTH, HEIGHT),
    numbers: str | None = None,
    **job: Any,
) -> Path:
    """Writes a whole shot: grey .5 sphere, roughness .5, light of radiance 1, passes instead of a network.

    Args:
        folder: a new folder.
        frames: consecutive frame numbers.
        size: columns and rows.
        numbers: what the job file says of its frames; None: the range of `frames`.
        job: top-level keys of `shot.yaml` to replace; None removes one.

    Returns:
        The folder; a test then replaces the files that its case is about.
    """
    seen = sphere(*size)
    for frame in frames:
        write(folder / f"plate.{frame:04d}.exr", rgba(0.5, seen.matte))
        write(folder / f"gbuffer.{frame:04d}.exr", gbuffer(seen))
        write(folder / f"material.{frame:04d}.exr", material(shape=(size[1], size[0])))
    write(folder / "light.exr", sky())
    write_json(folder / "camera.json", camera(frames, size=size))
    document = {
        "version": 1, "name": "t", "frames": numbers or f"{frames[0]}-{frames[-1]}",
        "plate": {"path": "plate.####.exr"}, "gbuffer": {"path": "gbuffer.####.exr"},
        "camera": "camera.json", "light": {"path": "light.exr"},
        "decompose": {"path": "material.####.exr"}, "flow": {"knobs": {"method": "dis-fast"}}, "quality": "draft",
    } | job  # fmt: skip
    text = yaml.safe_dump({key: value for key, value in document.items() if value is not None}, allow_unicode=True)
    (folder / "shot.yaml").write_text(text)
    return folder


def write_json(path: Path, document: Any) -> None:
    """Writes a document."""
    path.write_text(json.dumps(document))


def write_proxy(path: Path, scale: float = 1.0, centre: tuple[float, float, float] = (0, 0, 0)) -> None:
    """The sphere as a mesh, scaled and moved."""
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=RADIUS)
    write_mesh(path, mesh.vertices * scale + centre, mesh.faces)


def write_mesh(path: Path, vertices: Array, faces: Array) -> None:
    """An ASCII PLY."""
    lines = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(f"{x:.6f}" for x in vertex) for vertex in vertices]
    lines += [" ".join(map(str, (len(face), *face))) for face in faces]
    path.write_text("\n".join(lines) + "\n")


def check(folder: Path) -> Outcome:
    """What a run reports before any work: refusal or warnings."""
    try:
        return Outcome(warnings=tuple(inspect(Session(folder).resolved)))
    except YesntError as error:
        return Outcome(refusal=str(error))


def deliver(folder: Path) -> Outcome:
    """Checks a shot and delivers its EXRs; the preview video is left out."""
    checked = check(folder)
    if checked.refusal:
        return checked
    try:
        session = run_here(folder, "composite")
    except YesntError as error:
        return Outcome(str(error), checked.warnings)
    clamps = clamp_lines(session.job.frames, session.graph(), session.open_index())
    planes, header = read_delivered(session.output.exr_path(session.job.shot.name, session.job.frames[0]))
    return Outcome("", (*checked.warnings, *clamps), planes, header)


def read_delivered(path: Path) -> tuple[dict[str, Array], dict[str, Any]]:
    """Channels as float32 and header of a delivered EXR."""
    with OpenEXR.File(str(path), separate_channels=True) as source:
        header = dict(source.header())
        planes = {name: channel.pixels.astype(np.float32) for name, channel in source.channels().items()}
    for name in ("dataWindow", "displayWindow"):
        header[name] = tuple(tuple(int(v) for v in corner) for corner in header[name])
    return planes, header


def stored(path: Path) -> dict[str, Array]:
    """Channels of a file that `write` wrote, to write them again with a change."""
    return {name: plane.copy() for name, plane in read_image(path).channels.items()}
