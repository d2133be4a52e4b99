"""Bodies and their motion: forward kinematics in world axes and linear blend skinning, in plain NumPy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Pose = Mapping[str, Array]
"""Bone name -> rotation [3, 3] about the bone's joint, in the axes of the rest pose."""


@dataclass(frozen=True)
class Body:
    """A rest body that faces -Y and stands on z = 0.

    Attributes:
        vertices: [V, 3] metres.
        faces: [F, 4] vertex indices.
        joints: [J, 3] where each bone turns, metres.
        weights: [V, J], rows sum to 1.
        bones: J names; `.L` lies at +X.
        parents: J indices, -1 for the root; a parent comes before its children.
    """

    vertices: Array
    faces: NDArray[np.int32]
    joints: Array
    weights: NDArray[np.float32]
    bones: tuple[str, ...]
    parents: tuple[int, ...]

    @classmethod
    def open(cls, path: Path) -> Body:
        """Reads what `inside_anny/dump_body.py` wrote and puts its soles on the ground."""
        with np.load(path) as data:
            vertices = data["vertices"].astype(np.float64)
            lift = np.array([0.0, 0.0, -vertices[:, 2].min()])
            return cls(
                vertices + lift,
                data["faces"],
                data["joints"].astype(np.float64) + lift,
                data["weights"],
                tuple(str(b) for b in data["bones"]),
                tuple(int(p) for p in data["parents"]),
            )

    def joint(self, bone: str) -> Array:
        """Where a bone turns in the rest pose, [3] metres."""
        return self.joints[self.bones.index(bone)]

    def share(self, *prefixes: str) -> Array:
        """Per vertex, the summed weight of bones whose names start so: [V], 0..1."""
        columns = [i for i, bone in enumerate(self.bones) if bone.startswith(prefixes)]
        return self.weights[:, columns].sum(axis=1, dtype=np.float64)


def turn(axis: str | Array, degrees: float) -> Array:
    """A rotation [3, 3] about "x", "y", "z" or a vector, right-handed."""
    if isinstance(axis, str):
        return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis)).as_matrix()


def skin(body: Body, pose: Pose, vertices: Array | None = None) -> Array:
    """Poses a body: v' = sum_b w_b (A_b v + t_b) (linear blend skinning).

    Args:
        body: the rest body.
        pose: rotations of the bones that turn.
        vertices: rest vertices to be moved instead of the body's own (dressed ones), [V, 3].

    Returns:
        [V, 3] metres, lowered or lifted so that the lowest point is at z = 0.
    """
    linear, shift = forward_kinematics(body, pose)
    rest = body.vertices if vertices is None else vertices
    moved = np.einsum("jab,vb->vja", linear, rest) + shift
    out: Array = np.einsum("vj,vja->va", body.weights, moved)
    out[:, 2] -= out[:, 2].min()
    return out


def forward_kinematics(body: Body, pose: Pose) -> tuple[Array, Array]:
    """Per bone, the affine map from rest to posed space: linear [J, 3, 3] and shift [J, 3]."""
    unknown = set(pose) - set(body.bones)
    if unknown:
        raise ValueError(f"no such bones: {sorted(unknown)}")
    linear, shift = np.empty((len(body.bones), 3, 3)), np.empty((len(body.bones), 3))
    for index, (bone, parent, joint) in enumerate(zip(body.bones, body.parents, body.joints, strict=True)):
        local = pose.get(bone, np.eye(3))
        offset = joint - local @ joint
        above = (np.eye(3), np.zeros(3)) if parent < 0 else (linear[parent], shift[parent])
        linear[index] = above[0] @ local
        shift[index] = above[0] @ offset + above[1]
    return linear, shift


def arm(body: Body, side: str, lower: float, forward: float, across: float, elbow: float) -> dict[str, Array]:
    """Rotations of shoulder and elbow, from anatomical angles in degrees.

    Args:
        body: the rest body, whose arms hang about 45 degrees out.
        side: "L" or "R".
        lower: towards the hip.
        forward: swing to the front (then up).
        across: swing of the raised arm towards the other side.
        elbow: flexion.
    """
    sign = 1.0 if side == "L" else -1.0
    upper = body.joint(f"lowerarm01.{side}") - body.joint(f"upperarm01.{side}")
    hinge = np.cross(upper, (0.0, -1.0, 0.0))
    shoulder = turn("z", -sign * across) @ turn("x", -forward) @ turn("y", sign * lower)
    return {f"upperarm01.{side}": shoulder, f"lowerarm01.{side}": turn(hinge, elbow)}


def leg(side: str, thigh: float, knee: float, ankle: float = 0.0) -> dict[str, Array]:
    """Thigh swing to the front, knee flexion and toes up, in degrees."""
    return {
        f"upperleg01.{side}": turn("x", -thigh),
        f"lowerleg01.{side}": turn("x", knee),
        f"foot.{side}": turn("x", -ankle),
    }


def fist(side: str, curl: float) -> dict[str, Array]:
    """Bends the fingers by `curl` degrees a joint, about the axis that closes an arm hanging 45 degrees out."""
    sign = 1.0 if side == "L" else -1.0
    axis = np.array([0.72, 0.35 * sign, 0.60 * sign])
    return {f"finger{f}-{j}.{side}": turn(axis, -curl) for f in range(2, 6) for j in range(1, 4)}
