"""One rig of three cameras, and writers of each program's format, from the description of that format alone."""

from __future__ import annotations

import json
import struct

import numpy as np

from yesnt.core.camera import Camera
from yesnt.core.distortion import UNDISTORTED, Distortion

BROWN = Distortion("brown", (-0.05, 0.02, 0.0007, -0.0004))
FISHEYE = Distortion("fisheye", (0.03, -0.01, 0.002, 0.0))
POINTS = np.array([[0.1, -0.2, 1.1], [-0.3, 0.25, 0.6], [0.0, 0.4, 1.7]])


def rig(distortion=UNDISTORTED):
    """Cameras by name, about 3 m around the point (0, 0, 1), Z up."""
    return {f"cam{i + 1}": _camera(i, distortion) for i in range(3)}


def _camera(i, distortion):
    angle = 2.0 * i + 0.3
    place = np.array([3 * np.cos(angle), 3 * np.sin(angle), 1.0 + 0.4 * i])
    forward = np.array([0, 0, 1.0]) - place
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    tilt = 0.2 * i  # about the optical axis: no camera is quite level
    down = np.cross(forward, right)
    axes = np.stack([np.cos(tilt) * right + np.sin(tilt) * down, np.cos(tilt) * down - np.sin(tilt) * right, forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = axes.T, place
    return Camera(640 + 8 * i, 480, 700.0 + i, 702.5, 318.25, 241.75 + i, {0: pose}, distortion)


def projections(cameras):
    """Pixels of the points in each camera."""
    return {name: camera.project(POINTS) for name, camera in cameras.items()}


def world_to_camera(camera):
    """Rotation [3, 3] and translation [3] that take the world to a camera."""
    pose = camera.pose()
    return pose[:3, :3].T, -pose[:3, :3].T @ pose[:3, 3]


def quaternion(matrix):
    """w, x, y, z by the eigenvector of the largest eigenvalue (Bar-Itzhack)."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    system = np.array([
        [a - e - i, d + b, g + c, h - f], [d + b, e - a - i, h + f, c - g],
        [g + c, h + f, i - a - e, d - b], [h - f, c - g, d - b, a + e + i],
    ]) / 3  # fmt: skip
    x, y, z, w = np.linalg.eigh(system)[1][:, -1]
    return np.array([w, x, y, z])


COLMAP_MODELS = {"none": ("PINHOLE", 1), "brown": ("OPENCV", 4), "fisheye": ("OPENCV_FISHEYE", 5)}


def write_colmap_text(folder, cameras):
    lines, images = ["# Camera list"], ["# Image list"]
    for number, (name, camera) in enumerate(cameras.items(), 1):
        parameters = [camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion.k]
        model = COLMAP_MODELS[camera.distortion.model][0]
        lines.append(f"{number} {model} {camera.width} {camera.height} " + " ".join(repr(float(v)) for v in parameters))
        rotation, translation = world_to_camera(camera)
        pose = " ".join(repr(float(v)) for v in (*quaternion(rotation), *translation))
        points = "12.5 30.25 7 100.0 4.5 -1" if number == 2 else ""  # the line of points may be empty
        images += [f"{10 * number} {pose} {number} {name}.png", points]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.txt").write_text("\n".join(lines) + "\n")
    (folder / "images.txt").write_text("\n".join(images) + "\n")


def write_colmap_binary(folder, cameras):
    first, second = [struct.pack("<Q", len(cameras))], [struct.pack("<Q", len(cameras))]
    for number, (name, camera) in enumerate(cameras.items(), 1):
        parameters = [camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion.k]
        model = COLMAP_MODELS[camera.distortion.model][1]
        first.append(struct.pack("<iiQQ", number, model, camera.width, camera.height))
        first.append(struct.pack(f"<{len(parameters)}d", *parameters))
        rotation, translation = world_to_camera(camera)
        second.append(struct.pack("<I7dI", 10 * number, *quaternion(rotation), *translation, number))
        second.append(f"{name}.png".encode() + b"\0" + struct.pack("<Q", 2))
        second.append(struct.pack("<ddqddq", 1.5, 2.5, 3, 4.5, 5.5, -1))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.bin").write_bytes(b"".join(first))
    (folder / "images.bin").write_bytes(b"".join(second))


def write_transforms(path, cameras):
    frames = []
    for name, camera in cameras.items():
        matrix = camera.pose().copy()
        matrix[:3, 1:3] *= -1  # y up, z back
        k = dict(zip(("k1", "k2", "p1", "p2"), camera.distortion.k, strict=False))
        if camera.distortion.model == "fisheye":
            k = dict(zip(("k1", "k2", "k3", "k4"), camera.distortion.k, strict=True))
        lens = {"w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy}
        center = {"cx": camera.cx, "cy": camera.cy}
        frames.append({"file_path": f"./images/{name}.png", "transform_matrix": matrix.tolist(), **lens, **center, **k})
    model = "OPENCV_FISHEYE" if camera.distortion.model == "fisheye" else "OPENCV"
    applied = [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]]
    path.write_text(json.dumps({"camera_model": model, "applied_transform": applied, "frames": frames}))


def write_qualisys(path, cameras):
    parts = []
    for name, camera in cameras.items():
        axes = (camera.pose()[:3, :3] * [1, -1, -1]).T.ravel()  # rows: right, up, back
        turn = " ".join(f'r{i // 3 + 1}{i % 3 + 1}="{v!r}"' for i, v in enumerate(map(float, axes)))
        place = " ".join(f'{a}="{float(v)!r}"' for a, v in zip("xyz", 1000 * camera.pose()[:3, 3], strict=True))
        left, top = 16, 8  # a part of the sensor was recorded
        window = f'left="{left}" top="{top}" right="{left + camera.width - 1}" bottom="{top + camera.height - 1}"'
        k = (*camera.distortion.k, 0, 0, 0, 0)[:4]
        lens = {
            "focalLengthU": 64 * camera.fx, "focalLengthV": 64 * camera.fy, "skew": 0.0,
            "centerPointU": 64 * (camera.cx - 0.5 + left), "centerPointV": 64 * (camera.cy - 0.5 + top),
            "radialDistortion1": k[0], "radialDistortion2": k[1], "radialDistortion3": 0,
            "tangentalDistortion1": k[2], "tangentalDistortion2": k[3],
        }  # fmt: skip
        intrinsic = " ".join(f'{key}="{value!r}"' for key, value in lens.items())
        parts.append(
            f'<camera active="1" model="Miqus Video" serial="{name}" viewrotation="0"><fov_video {window}/>'
            f"<transform {turn} {place}/><intrinsic {intrinsic}/></camera>"
        )
    text = f'<calibration qtm-version="2024.1" type="regular"><cameras>{"".join(parts)}</cameras></calibration>'
    path.write_text(f"<?xml version='1.0' encoding='ASCII'?>\n{text}")


def _matrix(name, values, kind="!!opencv-matrix"):
    values = np.atleast_2d(values)
    data = ", ".join(repr(float(v)) for v in values.ravel())
    rows, cols = values.shape
    return f"{name}: {kind}\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {data} ]\n"


def _intrinsics(camera):
    return np.array([[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1]])


def write_opencv_files(folder, cameras):
    """One file a camera."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, camera in cameras.items():
        rotation, translation = world_to_camera(camera)
        text = f"%YAML:1.0\n---\nimage_width: {camera.width}\nimage_height: {camera.height}\n"
        text += f"fisheye_model: {int(camera.distortion.model == 'fisheye')}\n"
        text += _matrix("camera_matrix", _intrinsics(camera))
        text += _matrix("distortion_coefficients", np.array([camera.distortion.k or (0.0,) * 4]).T)
        text += _matrix("R", rotation) + _matrix("T", translation[:, None])
        (folder / f"{name}.yml").write_text(text)


def write_opencv_pair(folder, cameras):
    """`intri.yml` and `extri.yml`; rotations as vectors."""
    import cv2

    folder.mkdir(parents=True, exist_ok=True)
    names = "names:\n" + "".join(f'   - "{name}"\n' for name in cameras)
    first = second = f"%YAML:1.0\n---\n{names}"
    for name, camera in cameras.items():
        rotation, translation = world_to_camera(camera)
        first += f"W_{name}: {camera.width}\nH_{name}: {camera.height}\n" + _matrix(f"K_{name}", _intrinsics(camera))
        first += _matrix(f"dist_{name}", np.array([(*(camera.distortion.k or (0.0,) * 4), 0.0)]))
        second += _matrix(f"R_{name}", cv2.Rodrigues(rotation)[0]) + _matrix(f"T_{name}", translation[:, None])
    (folder / "intri.yml").write_text(first)
    (folder / "extri.yml").write_text(second)
