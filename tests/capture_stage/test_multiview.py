"""Cameras of a rig see one and the same thing: a point of one view lies in the other where it must."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from yesnt.capture_stage.jobs import render_jobs
from yesnt.capture_stage.render import render
from yesnt.core.camera import Camera
from yesnt.io.cameras import read_cameras
from yesnt.io.mesh import read_mesh
from yesnt.io.pictures.image import read_image
from yesnt.relight import ProxyScene

pytestmark = pytest.mark.blender


def agreement(folder, frame, held_out):
    """Of the points of the delivered view that a camera of the rig shows: how many, and how far it is off."""
    camera = Camera.open(folder / "camera.json")
    other = read_cameras(folder / "heldout.json")[held_out].camera
    z = read_image(folder / f"gbuffer.{frame}.exr").stack(["depth.Z"])[..., 0]
    home = folder / "heldout" / held_out
    z_other = read_image(home / f"gbuffer.{frame}.exr").stack(["depth.Z"])[..., 0]
    plate, plate_other = (read_image(f / f"plate.{frame}.exr").stack("RGBA") for f in (folder, home))
    solid = plate[..., 3] > 0.99
    world = camera.position(frame) + z[solid][:, None] * camera.rays(frame)[solid]
    x, y, depth = other.project(world, None).T
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    within = (column >= 0) & (column < other.width) & (row >= 0) & (row < other.height)
    there = row[within], column[within]
    off = np.abs(z_other[there] / depth[within] - 1)
    seen = off < 0.01
    return seen.mean(), np.abs(plate_other[there] - plate[solid][within])[seen][:, :3], off[seen]


def test_a_point_of_the_delivered_view_lies_where_a_camera_of_the_rig_says(tools, tmp_path):
    sets = [
        replace(render_jobs(name)[i], width=64, height=64) for name, i in (("multiview", 1), ("multiview_capture", 4))
    ]
    receipts = [render(job, tmp_path, tools) for job in sets]  # the vase: nothing is fetched
    assert receipts[0].folder == receipts[1].folder
    shared, color, depth = agreement(Path(receipts[0].folder), 1001, "h00")
    assert shared > 0.6  # 4 degrees of azimuth and 6 of elevation apart
    assert np.median(color) < 0.05
    assert np.median(depth) < 0.003


def test_the_true_surface_is_what_the_cameras_see(tools, tmp_path):
    job = replace(render_jobs("multiview_capture")[4], width=64, height=64)
    folder = Path(render(job, tmp_path, tools).folder)
    mesh = read_mesh(folder / "truth" / "mesh.1001.ply")
    camera = read_cameras(folder / "heldout.json")["h02"].camera
    z = read_image(folder / "heldout/h02/gbuffer.1001.exr").stack(["depth.Z"])[..., 0]
    solid = read_image(folder / "heldout/h02/plate.1001.exr").stack("RGBA")[..., 3] > 0.99
    rays = camera.rays(None)[solid]
    length = np.linalg.norm(rays, axis=1)
    origin = np.broadcast_to(camera.position(None).astype(np.float32), rays.shape)
    hit = ProxyScene.from_arrays(mesh.vertices, mesh.faces).trace(origin, (rays / length[:, None]).astype(np.float32))
    off = np.abs(hit["tfar"] / length - z[solid])
    assert np.median(off) < 1e-5  # metres
