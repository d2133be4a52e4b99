"""Costumes of the humans: fields that locate places on a body, and the displacement of cloth over it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.capture_stage.material_layers import Layers, displacement, vertex_normals
from yesnt.capture_stage.pose import Body

_FACE_BONES = ("head", "jaw", "special", "oris", "levator", "temporalis", "oculi", "orbicularis", "risorius", "tongue")


@dataclass(frozen=True)
class Dressed:
    """A body displaced by its clothes, and the fields that locate each material.

    Attributes:
        vertices: rest vertices, [V, 3] metres.
        fields: per vertex, [V] each.
    """

    vertices: NDArray[np.float64]
    fields: dict[str, NDArray[np.float64]]


def body_fields(body: Body) -> dict[str, NDArray[np.float64]]:
    """Places on a body: x, y, z in metres of a body 1.78 m tall; shares of weights; `sleeve` 0 shoulder .. 2 wrist."""
    scale = 1.78 / body.vertices[:, 2].max()
    x, y, z = (body.vertices * scale).T
    near = [np.linalg.norm(body.vertices - _pad(body, side), axis=1) * scale for side in "LR"]
    return {
        "x": x, "y": y, "z": z,
        "arms": body.share("upperarm", "lowerarm", "wrist", "finger", "metacarpal"),
        "hands": body.share("wrist", "finger", "metacarpal"),
        "head": body.share(*_FACE_BONES),
        "neck": body.share("neck"),
        "eyes": body.share("eye."),
        "sleeve": _sleeve(body),
        "shoulder": np.minimum(*near),
        "scalp": _scalp(body) * scale,
    }  # fmt: skip


def dress(body: Body, layers: Layers, folds: float = 0.004) -> Dressed:
    """Displaces the rest surface along its normals by the thickness of the clothes and by folds.

    Args:
        body: the bare body.
        layers: skin and garments, the outermost last.
        folds: amplitude of folds in metres where clothes are thick.
    """
    fields = body_fields(body)
    height = displacement(layers, fields)
    x, y, z = fields["x"], fields["y"], fields["z"]
    wave = np.sin(43 * z + 9 * np.sin(17 * x) + 5 * y) + 0.7 * np.sin(61 * x + 21 * np.sin(13 * z))
    height = height + folds * wave * np.clip(height / 0.008, 0, 1)
    normals = vertex_normals(body.vertices, body.faces)
    shod = np.clip(height / 0.010, 0, 1) * np.clip((0.14 - z) / 0.03, 0, 1)
    return Dressed(_rounded(body.vertices + height[:, None] * normals, body.faces, shod), fields)


def _rounded(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], share: NDArray[np.float64], steps: int = 60
) -> NDArray[np.float64]:
    """Averages vertices with their neighbours where `share` [V] says, so that a shoe shows no toes."""
    starts, ends = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    count = np.bincount(starts, minlength=len(vertices)) + np.bincount(ends, minlength=len(vertices))
    out = vertices.copy()
    for _ in range(steps):
        total = np.zeros_like(out)
        np.add.at(total, starts, out[ends])
        np.add.at(total, ends, out[starts])
        out += share[:, None] * (total / np.maximum(count, 1)[:, None] - out) * 0.7
    return out


def _pad(body: Body, side: str) -> NDArray[np.float64]:
    """Middle of a shoulder plate: above and outside the shoulder joint, [3]."""
    outward = 0.02 if side == "L" else -0.02
    return body.joint(f"upperarm01.{side}") + np.array([outward, 0.0, 0.045])


def _sleeve(body: Body) -> NDArray[np.float64]:
    """Where along an arm: 0 shoulder, 1 elbow, 2 wrist, up to 3 at the finger tips, blended by the bones' weights."""
    out = np.zeros(len(body.vertices))
    for side in "LR":
        chain = [body.joint(f"{bone}.{side}") for bone in ("upperarm01", "lowerarm01", "wrist", "finger3-3")]
        bones = (f"upperarm01.{side} upperarm02.{side}", f"lowerarm01.{side} lowerarm02.{side}")
        shares = [body.share(*names.split()) for names in bones]
        shares.append(
            body.share(*(b for b in body.bones if b.endswith(side) and b.startswith(("wrist", "finger", "metacarpal"))))
        )
        for index, share in enumerate(shares):
            along = chain[index + 1] - chain[index]
            t = (body.vertices - chain[index]) @ along / (along @ along)
            out += share * (index + np.clip(t, 0, 1))
    return out


def _scalp(body: Body) -> NDArray[np.float64]:
    """Height above the hair line: a plane that is high at the forehead and low at the nape, metres."""
    eye = body.joint("eye.L")
    behind = body.vertices[:, 1] - eye[1]
    return body.vertices[:, 2] - eye[2] - 0.075 + 1.15 * np.clip(behind - 0.035, 0, 0.125)
