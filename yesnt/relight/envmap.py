"""Lat-long environment maps: named conventions, rotation, exact solid angles, downsampling that keeps energy.

Internally every map has Blender's layout (docs/method.md section 1): Z up, row 0 up, the centre column looks along +X
and u = 0.25 along +Y. Other conventions are converted once, when the map is read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_matrix

from yesnt.core.color import luminance
from yesnt.core.errors import JobError

Float = NDArray[np.floating]

CONVENTIONS = MappingProxyType({"blender": 0.0, "opengl": 0.25, "mitsuba": -0.25})
"""Convention -> u of that map minus u of Blender's map, in turns, for the same world direction.

`opengl` (nvdiffrec, glTF viewers) is Y-up with its centre along -Z; `mitsuba` is Y-up with its centre along +Z. Y-up
worlds become Z-up as in glTF importers: (x, y, z) -> (x, -z, y). All maps are seen from inside: none is mirrored.
"""


@dataclass(frozen=True, eq=False)  # compared by identity: a comparison of megabytes is never meant
class EnvMap:
    """Radiance from infinitely far away, as a lat-long map.

    Attributes:
        radiance: [h, w, 3] float32, scene-linear Rec.709, finite and >= 0, Blender's layout.
        rotation: yaw about +Z, then pitch about +Y, then roll about +X, degrees; turns the map in the world.
        exposure: stops; multiplies the radiance by 2**exposure.
    """

    radiance: NDArray[np.float32]
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    exposure: float = 0.0

    @classmethod
    def from_array(cls, radiance: ArrayLike, convention: str = "blender") -> EnvMap:
        """Makes a map from an array.

        Args:
            radiance: [h, w, 3] scene-linear Rec.709; NaN and negative values become 0, infinite ones the largest
                finite value.
            convention: a key of CONVENTIONS.

        Raises:
            JobError: the shape is not [h, w, 3] or the convention is unknown.
        """
        array = np.asarray(radiance, dtype=np.float32)
        if array.ndim != 3 or array.shape[-1] != 3 or array.size == 0:
            raise JobError("The env map is not a colour image", f"shape {array.shape}", "[h, w, 3]", "pass RGB")
        if convention not in CONVENTIONS:
            known = ", ".join(CONVENTIONS)
            raise JobError(f"The env map convention '{convention}' is unknown", "convention", known, "choose one")
        clean = roll_turns(sanitise(array), -CONVENTIONS[convention])
        clean.setflags(write=False)
        return cls(clean)

    @classmethod
    def open(cls, path: str | Path, convention: str = "blender") -> EnvMap:
        """Reads a lat-long picture, as its file states its colours: without a statement floats are linear Rec.709.

        Args:
            path: the file.
            convention: a key of CONVENTIONS.

        Raises:
            JobError: a colour channel is absent, the file's colour space is not known, or as `from_array`.
        """
        from yesnt.io.env_maps import read_map  # the one upward import: a map is usually a file

        return cls.from_array(read_map(Path(path)), convention)

    def turned(self, rotation: Sequence[float], exposure: float = 0.0) -> EnvMap:
        """The same map with this rotation (degrees: yaw, pitch, roll) and exposure (stops)."""
        yaw, pitch, roll = (float(angle) for angle in rotation)
        return replace(self, rotation=(yaw, pitch, roll), exposure=float(exposure))

    def clamped(self, most: float) -> EnvMap:
        """The same map with no channel above `most`, in the map's own units; texels keep their hue."""
        top = self.radiance.max(axis=-1, keepdims=True)
        return replace(self, radiance=self.radiance * np.minimum(1, most / np.maximum(top, 1e-30)).astype(np.float32))

    def seen_from(self, offset: Sequence[float], distance: float) -> EnvMap:
        """The map as seen from another place, if everything it shows lies on a sphere around its own place.

        Parallax correction after Lagarde & Zanuttini 2012: a lamp grows as one moves towards it.

        Args:
            offset: [3] the other place minus that of the map, world metres.
            distance: radius of the sphere, metres.

        Raises:
            JobError: the offset leads out of the sphere.
        """
        place = np.asarray(offset, dtype=np.float64)
        if not np.linalg.norm(place) < distance:
            far = float(np.linalg.norm(place))
            raise JobError(
                "The actor or the camera lies outside the sphere of the env map", f"{far:.2f} m from `captured_at`",
                f"less than `distance`, {distance:g} m", "mend `captured_at` or `distance`",
            )  # fmt: skip
        height, width = self.radiance.shape[:2]
        ray = uv_to_direction((np.arange(width) + 0.5) / width, (np.arange(height)[:, None] + 0.5) / height)
        along = ray @ place
        reach = np.sqrt(along**2 - place @ place + distance**2) - along
        return EnvMap(self.lookup(place + reach[..., None] * ray))

    @property
    def world_from_map(self) -> NDArray[np.float64]:
        """Rotation matrix [3, 3]: a direction in the map's axes to the world."""
        return rotation_matrix(self.rotation)

    @property
    def gain(self) -> float:
        """Linear factor of the exposure."""
        return float(2.0**self.exposure)

    def lookup(self, directions: Float) -> NDArray[np.float32]:
        """Bilinear radiance along world directions [..., 3], any length: [..., 3]."""
        local = np.asarray(directions, dtype=np.float64) @ self.world_from_map
        u, v = direction_to_uv(local)
        return (bilinear_wrapped(self.radiance, u, v) * self.gain).astype(np.float32)


def sanitise(radiance: NDArray[np.float32]) -> NDArray[np.float32]:
    """Finite, non-negative copy [h, w, 3]: one NaN or negative texel of a merged HDR would spread to every pixel."""
    finite = radiance[np.isfinite(radiance)]
    top = float(max(finite.max(initial=0.0), 0.0))
    return np.clip(np.nan_to_num(radiance, nan=0.0, posinf=top, neginf=0.0), 0.0, None).astype(np.float32)


def roll_turns(radiance: NDArray[np.float32], turns: float) -> NDArray[np.float32]:
    """Shifts a map [h, w, 3] to the right by `turns` of its width; fractions of a texel are interpolated."""
    width = radiance.shape[1]
    shift = turns * width
    whole = int(np.floor(shift))
    part = np.float32(shift - whole)
    near = np.roll(radiance, whole, axis=1)
    if part == 0:
        return near
    return near * (1 - part) + np.roll(radiance, whole + 1, axis=1) * part


def rotation_matrix(angles: Sequence[float]) -> NDArray[np.float64]:
    """Matrix [3, 3] Rx(roll) Ry(pitch) Rz(yaw) of angles (yaw, pitch, roll), degrees: yaw about +Z is applied first."""
    (cz, cy, cx), (sz, sy, sx) = np.cos(np.radians(angles)), np.sin(np.radians(angles))
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    return about_x @ about_y @ about_z


def direction_to_uv(direction: Float) -> tuple[Float, Float]:
    """Blender's mapping u = 0.5 - atan2(y, x) / (2 pi), v = acos(z) / pi of directions [..., 3] of any length."""
    x, y, z = np.moveaxis(np.asarray(direction, dtype=np.float64), -1, 0)
    return (0.5 - np.arctan2(y, x) / (2 * np.pi)) % 1.0, np.arctan2(np.hypot(x, y), z) / np.pi


def uv_to_direction(u: ArrayLike, v: ArrayLike) -> NDArray[np.float64]:
    """Inverse of `direction_to_uv`: unit directions [..., 3]."""
    azimuth, polar = np.pi - 2 * np.pi * np.asarray(u, dtype=np.float64), np.pi * np.asarray(v, dtype=np.float64)
    around = np.sin(polar)
    return np.stack(np.broadcast_arrays(around * np.cos(azimuth), around * np.sin(azimuth), np.cos(polar)), axis=-1)


def bilinear_wrapped(image: NDArray[np.float32], u: Float, v: Float) -> Float:
    """Bilinear samples [..., 3] of an image [h, w, 3] at u, v [...] in [0, 1]; u wraps, v is clamped at the poles."""
    height, width = image.shape[:2]
    x, y = u * width - 0.5, np.clip(v * height - 0.5, 0, height - 1)
    x0, y0 = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    fx, fy = (x - x0)[..., None], (y - y0)[..., None]
    left, right, below = x0 % width, (x0 + 1) % width, np.minimum(y0 + 1, height - 1)
    upper = image[y0, left] * (1 - fx) + image[y0, right] * fx
    lower = image[below, left] * (1 - fx) + image[below, right] * fx
    return upper * (1 - fy) + lower * fy


def row_solid_angles(height: int, width: int) -> NDArray[np.float64]:
    """Exact solid angle [h], sr, of one texel of each row: (2 pi / w) (cos v_top - cos v_bottom)."""
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    return 2 * np.pi / width * (edges[:-1] - edges[1:])


def cell_moments(env: EnvMap, size: tuple[int, int]) -> NDArray[np.float64]:
    """Integrals of a map over the cells of a lat-long grid of `size` (rows, columns), in the axes of the map.

    Energy is kept exactly. Within its texels the map is constant. Cells are made a row at a time, so that an 8K map
    needs no more memory than the map itself.

    Returns:
        [rows, columns, 10]: energy (radiance times solid angle, with exposure) R, G, B; luminance times solid angle
        times direction x, y, z; solid angle, sr; solid angle times direction x, y, z.
    """
    radiance = env.radiance
    repeat = [max(1, -(-size // have)) for size, have in zip(size, radiance.shape[:2], strict=True)]
    height, width = radiance.shape[0] * repeat[0], radiance.shape[1] * repeat[1]
    shares = _row_shares(height, size[0])
    columns = csr_matrix(overlap(np.linspace(0, 1, width + 1), np.linspace(0, 1, size[1] + 1)))
    solid = row_solid_angles(height, width)
    cells = np.empty((*size, 10))
    for i, (fine, share) in enumerate(shares):
        colour = np.repeat(radiance[fine // repeat[0]], repeat[1], axis=1).astype(np.float64) * env.gain
        angle = np.broadcast_to((solid[fine] * share)[:, None, None], (*colour.shape[:2], 1))
        direction = uv_to_direction((np.arange(width) + 0.5) / width, (fine[:, None] + 0.5) / height)
        light = luminance(colour)[..., None] * angle
        amounts = np.concatenate([colour * angle, light * direction, angle, angle * direction], axis=-1)
        cells[i] = columns @ amounts.sum(axis=0)
    return cells


def _row_shares(height: int, rows: int) -> list[tuple[NDArray[np.int64], NDArray[np.float64]]]:
    """Per coarse row: the fine rows that touch it, and the shares of their solid angle that lie in it."""
    fine = -np.cos(np.pi * np.arange(height + 1) / height)
    coarse = -np.cos(np.pi * np.arange(rows + 1) / rows)
    result = []
    for i in range(rows):
        touched = np.arange(height * i // rows, min(height, -(-height * (i + 1) // rows)))
        share = overlap(fine[touched[0] : touched[-1] + 2], coarse[i : i + 2])[0]
        result.append((touched, share))
    return result


def overlap(fine: NDArray[np.float64], coarse: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share [coarse, fine] of each fine cell that lies in each coarse cell; `fine` and `coarse` are ascending edges."""
    low = np.maximum(coarse[:-1, None], fine[None, :-1])
    high = np.minimum(coarse[1:, None], fine[None, 1:])
    return np.clip(high - low, 0, None) / (fine[1:] - fine[:-1])[None, :]
