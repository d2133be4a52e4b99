"""Fits of Gaussian fields in the report: figures of the last look, and what a held-out camera sees; also mid-way."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.gaussian_input import PROXY
from yesnt.gaussians.records import View
from yesnt.io.jobfile import frame_path
from yesnt.io.mesh import Mesh, read_mesh
from yesnt.io.pictures.png import png_bytes
from yesnt.relight.proxy import ProxyScene
from yesnt.runtime.session import Session
from yesnt.tasks.fit_progress import normal_colors, picture_path, progress_path

SHOWN = 3
"""Frames of which the page shows pictures."""


def fit_facts(session: Session) -> list[dict[str, Any]]:
    """Frame, steps done and asked, Gaussians and held-out PSNR of every fit that has begun."""
    return [{"frame": one["frame"], **one["looks"][-1]} for one in _told(session)]


def fit_picture(session: Session) -> bytes | None:
    """PNG of up to three frames, one above the other; None if no fit has begun.

    From the left: a held-out camera's picture, the field, their difference times 4, normals of the field, and of the
    proxy mesh (black until it is there).
    """
    told = [one for one in _told(session) if picture_path(session.output.run, one["frame"]).is_file()]
    rows = [_row(session, one) for one in told[:: max(1, len(told) // SHOWN)][:SHOWN]]
    if not rows:
        return None
    width = max(row.shape[1] for row in rows)
    return png_bytes(np.concatenate([np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0))) for row in rows]))


def _told(session: Session) -> list[dict[str, Any]]:
    paths = (progress_path(session.output.run, frame) for frame in session.job.frames)
    return [json.loads(path.read_text()) for path in paths if path.is_file()]


def _row(session: Session, told: dict[str, Any]) -> NDArray[np.float32]:
    import cv2

    drawn = cv2.imread(str(picture_path(session.output.run, told["frame"])))
    assert drawn is not None, "written in one piece"
    kept: dict[str, Any] = told["view"]
    turn, place = np.array(kept.pop("rotation")), np.array(kept.pop("position"))
    view = View(turn, place, **kept)
    mesh = frame_path(session.output.root, PROXY, told["frame"])
    proxy = _proxy_normals(read_mesh(mesh), view) if mesh.is_file() else np.zeros((view.height, view.width, 3))
    return np.concatenate([drawn[..., ::-1] / 255, proxy], axis=1).astype(np.float32)


def _proxy_normals(mesh: Mesh, view: View) -> NDArray[np.float32]:
    """[H, W, 3] colours of the normals of the first triangles that a camera sees; black beside the mesh."""
    proxy = ProxyScene.from_arrays(mesh.vertices, mesh.faces)
    along = (view.rays() @ view.rotation).reshape(-1, 3).astype(np.float32)
    face = proxy.first_hits(np.broadcast_to(view.position.astype(np.float32), along.shape), along)
    colors = normal_colors(proxy.normals[face], view.rotation)
    return np.where(face[:, None] >= 0, colors, 0).reshape(view.height, view.width, 3)
