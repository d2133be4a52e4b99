"""A Gaussian opacity field: N anisotropic Gaussians with opacity and colour by direction (docs/method.md section 2)."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
ColorSpace = Literal["srgb", "linear"]

COUNTS = {1: 0, 4: 1, 9: 2, 16: 3}
"""Harmonics of a Gaussian -> their degree."""

_UNIT = 1e-3  # how far the length of a quaternion may be from 1
_LARGEST_LOG = 30.0  # exp(2 * 30) is still finite in float32


@dataclass(frozen=True)
class GaussianField:
    """N Gaussians in the world, in the conventions of 3D Gaussian Splatting's files.

    Attributes:
        positions: [N, 3] centres, world metres.
        log_scales: [N, 3] natural logarithms of the standard deviations along the Gaussian's own axes, metres.
        rotations: [N, 4] unit quaternions w, x, y, z: the Gaussian's axes to the world's.
        opacity_logits: [N]; the opacity is 1 / (1 + exp(-logit)).
        harmonics: [N, (degree + 1)^2, 3] real spherical harmonics of the colour, degree 0 to 3. The colour seen along a
            unit direction d from the camera is max(0, 0.5 + sum of harmonics x basis(d)) (harmonics.py).
        filter_3d: [N] standard deviation of the 3D smoothing filter, metres, or None: it widens each axis to
            sqrt(scale^2 + filter^2) and lowers the opacity by the ratio of the two volumes, as Gaussian Opacity Fields.
        color_space: in which colours are stored and composited: "srgb" (code values, as files of others) or "linear".

    Raises:
        JobError: a shape or a value that no field has; the message names the array and the first Gaussian.
    """

    positions: F32
    log_scales: F32
    rotations: F32
    opacity_logits: F32
    harmonics: F32
    filter_3d: F32 | None = None
    color_space: ColorSpace = "srgb"

    def __post_init__(self) -> None:
        for name in ARRAYS:
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, _frozen(value))
        self._check_shapes()
        for name in ARRAYS:
            if getattr(self, name) is not None:
                self._refuse(name, ~_per_gaussian(np.isfinite(getattr(self, name))), "a finite number")
        self._refuse("log_scales", _per_gaussian(np.abs(self.log_scales) > _LARGEST_LOG, np.any), "between -30 and 30")
        lengths = np.linalg.norm(self.rotations.astype(np.float64), axis=1)
        self._refuse("rotations", np.abs(lengths - 1) > _UNIT, "a quaternion of length 1")
        if self.filter_3d is not None:
            self._refuse("filter_3d", self.filter_3d < 0, "0 or more")
        if self.color_space not in ("srgb", "linear"):
            raise JobError(
                f"A Gaussian field has no colour space {self.color_space!r}", "color_space", "srgb or linear"
            )

    def _check_shapes(self) -> None:
        n = len(self.positions)
        shapes: dict[str, tuple[int, ...]] = {
            "positions": (n, 3), "log_scales": (n, 3), "rotations": (n, 4), "opacity_logits": (n,), "filter_3d": (n,),
        }  # fmt: skip
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is not None and value.shape != shape:
                raise _wrong_shape(name, value.shape, str(list(shape)))
        shape = self.harmonics.shape
        if len(shape) != 3 or shape[0] != n or shape[2] != 3 or shape[1] not in COUNTS:
            raise _wrong_shape("harmonics", shape, f"[{n}, 1, 4, 9 or 16, 3]")

    def _refuse(self, name: str, wrong: NDArray[np.bool_], expected: str) -> None:
        if wrong.any():
            first = int(np.argmax(wrong))
            raise JobError(
                f"The Gaussian field has {int(wrong.sum())} of {len(wrong)} Gaussians with a wrong value",
                f"{name}, first Gaussian {first}: {np.array2string(getattr(self, name)[first], precision=4)}",
                expected,
                "export the field again, or fit it again",
            )

    @property
    def count(self) -> int:
        """N."""
        return len(self.positions)

    @property
    def degree(self) -> int:
        """Degree of the harmonics, 0 to 3."""
        return COUNTS[self.harmonics.shape[1]]

    @property
    def opacities(self) -> F64:
        """[N] opacities in (0, 1), lowered by the smoothing filter if there is one."""
        return 1 / (1 + np.exp(-self.opacity_logits.astype(np.float64))) * self._shrinkage()

    @property
    def variances(self) -> F64:
        """[N, 3] variances along the Gaussian's own axes, m^2, smoothing filter included."""
        own = np.exp(2 * self.log_scales.astype(np.float64))
        return own if self.filter_3d is None else own + self.filter_3d.astype(np.float64)[:, None] ** 2

    def _shrinkage(self) -> F64:
        """[N] by what the smoothing filter multiplies opacities: the ratio of the volumes."""
        own = np.exp(2 * self.log_scales.astype(np.float64))
        return np.sqrt(np.prod(own / self.variances, axis=1))

    @property
    def axes(self) -> F64:
        """[N, 3, 3] rotation matrices; columns are the Gaussian's own axes in the world."""
        return rotation_matrices(self.rotations)

    @property
    def covariances(self) -> F64:
        """[N, 3, 3] covariance matrices in the world, m^2, smoothing filter included."""
        axes = self.axes
        return np.einsum("nij,nj,nkj->nik", axes, self.variances, axes)

    @property
    def digest(self) -> str:
        """32 hexadecimal digits of everything that the field holds."""
        state = hashlib.blake2b(self.color_space.encode(), digest_size=16)
        for name in ARRAYS:
            value = getattr(self, name)
            state.update(f"|{name} {None if value is None else value.shape}|".encode())
            state.update(b"" if value is None else np.ascontiguousarray(value, "<f4").tobytes())
        return state.hexdigest()

    def select(self, index: NDArray[np.integer] | NDArray[np.bool_]) -> GaussianField:
        """The Gaussians of an index or a mask, in its order."""
        chosen = {name: value[index] for name in ARRAYS if (value := getattr(self, name)) is not None}
        return GaussianField(**chosen, color_space=self.color_space)


ARRAYS = tuple(f.name for f in fields(GaussianField) if f.name != "color_space")
"""Names of the arrays of a field."""


def rotation_matrices(quaternions: NDArray[np.floating]) -> F64:
    """Rotation matrices [..., 3, 3] of quaternions [..., 4] (w, x, y, z), which are normalised first."""
    q = np.asarray(quaternions, np.float64)
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def _frozen(value: NDArray[np.floating]) -> F32:
    """A contiguous read-only float32 array with the same values."""
    array = np.ascontiguousarray(value, np.float32)
    view = array.view()
    view.setflags(write=False)
    return view


def _per_gaussian(values: NDArray[np.bool_], over: object = np.all) -> NDArray[np.bool_]:
    """[N]: all (or any) of each Gaussian's values."""
    flat = values.reshape(len(values), int(np.prod(values.shape[1:])))
    return np.asarray(flat.any(axis=1) if over is np.any else flat.all(axis=1))


def _wrong_shape(name: str, shape: tuple[int, ...], expected: str) -> JobError:
    return JobError(f"An array of the Gaussian field has the shape {list(shape)}", name, expected)
