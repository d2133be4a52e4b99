"""What other programs leave out of a camera file, and sensors in millimetres as focal lengths in pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import UsageError

F64 = NDArray[np.float64]

ORDERS = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")
"""Orders of rotation; the first axis is turned first."""


@dataclass(frozen=True)
class ImportOptions:
    """What the user says of a camera file that the file does not.

    Attributes:
        size: width and height of the pictures, pixels.
        aperture: width, and height if it is not that of square pixels, of the sensor, millimetres; None: unknown.
        focal: focal length, millimetres; None: as the file says.
        pixel_aspect: width of a pixel over its height.
        rotation_order: of the angles of a .chan file.
        up: "y" or "z": the axis of the file's world that points up.
        camera: path or name of the camera, where a file has several.
        frames: frame numbers; None: those of the file.
        fps: frames a second, of files that count seconds.
    """

    size: tuple[int, int] | None = None
    aperture: tuple[float, float | None] | None = None
    focal: float | None = None
    pixel_aspect: float = 1.0
    rotation_order: str = "ZXY"
    up: str = "y"
    camera: str | None = None
    frames: tuple[int, ...] | None = None
    fps: float = 24.0

    def __post_init__(self) -> None:
        known = {"rotation_order": ORDERS, "up": ("y", "z")}
        for key, values in known.items():
            if getattr(self, key) not in values:
                option = key.replace("_", "-")
                raise UsageError(
                    f"--{option} {getattr(self, key)!r} is unknown", "yesnt camera", f"one of {', '.join(values)}",
                    "choose one",
                )  # fmt: skip
        numbers = {"focal": self.focal, "pixel-aspect": self.pixel_aspect, "fps": self.fps}
        wrong = [option for option, value in numbers.items() if value is not None and not 0 < value < float("inf")]
        if wrong:
            raise UsageError(
                f"--{wrong[0]} {numbers[wrong[0]]} cannot be used", "yesnt camera", "a positive number", "mend it"
            )

    @property
    def pixels(self) -> tuple[int, int]:
        """The size of the pictures.

        Raises:
            UsageError: the user named none, and such files have none.
        """
        if self.size is None:
            raise UsageError(
                "The size of the pictures is not in this file", "yesnt camera", "`--size 1920x1080`", "name it"
            )
        return self.size


def z_up(pose: F64, up: str) -> F64:
    """A pose [4, 4] of a Y-up world in a Z-up one, (x, y, z) to (x, -z, y) as in glTF and Alembic importers."""
    turn = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    return turn @ pose if up == "y" else pose


def euler(angles: F64, order: str) -> F64:
    """Rotation [3, 3] of angles about x, y, z, degrees; the first axis of `order` is turned first."""
    result = np.eye(3)
    for axis in order:
        result = _about(axis, angles["XYZ".index(axis)]) @ result
    return result


def _about(axis: str, degrees: float) -> F64:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = {"X": (1, 2), "Y": (2, 0), "Z": (0, 1)}[axis]
    matrix = np.eye(3)
    matrix[i, i], matrix[j, j], matrix[i, j], matrix[j, i] = c, c, -s, s
    return matrix


def without_scale(matrix: F64) -> F64:
    """A pose [4, 4] whose axes have unit length: programs let a camera inherit a scale and look through it unscaled."""
    pose = matrix.copy()
    pose[:3, :3] /= np.linalg.norm(pose[:3, :3], axis=0)
    return pose
