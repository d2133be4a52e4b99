"""The full sum on any torch device, with the results of kernels.py to rounding; for machines with CUDA."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from yesnt.color import LUMINANCE_REC709
from yesnt.relight.brdf import COS_MIN
from yesnt.relight.kernels import COLUMNS, FRESNEL, ShadingPoints, sharp_below
from yesnt.relight.lights import PreparedLight

if TYPE_CHECKING:
    import torch

F32 = NDArray[np.float32]

_PAIRS = 1 << 22  # pixel-texel pairs a chunk: some twenty temporaries of 16 MB each


def sum_lobes_torch(
    points: ShadingPoints,
    light: PreparedLight,
    visible: F32 | None,
    bounce: F32 | None,
    filtered: bool = True,
    device: str | None = None,
) -> F32:
    """As `kernels.sum_lobes`; `device` None takes CUDA where there is one."""
    import torch

    where = device or ("cuda" if torch.cuda.is_available() else "cpu")
    out = np.zeros((len(points.alpha), COLUMNS), dtype=np.float32)
    sharp = points.alpha < sharp_below(light, filtered)
    texels = int(light.coarse_start[-1])
    for chosen, used in ((np.flatnonzero(~sharp), texels), (np.flatnonzero(sharp), light.direction.shape[1])):
        sums = _Sums(light, used, filtered, where)
        step = max(1, _PAIRS // used)
        for first in range(0, len(chosen), step):
            index = chosen[first : first + step]
            part = ShadingPoints(
                points.normal[:, index],
                points.view[:, index],
                points.alpha[index],
                points.dielectric[index],
                points.metal[index],
            )
            shares = None if visible is None else visible[index]
            out[index] = sums(part, shares, None if bounce is None else bounce[:, index])
    return out


class _Sums:
    """A light on a device, its first `used` texels; called with pixels, gives their sums."""

    def __init__(self, light: PreparedLight, used: int, filtered: bool, device: str) -> None:
        import torch

        self.device, self.light, self.used = device, light, used
        self.direction, self.energy = (self._put(a[:, :used]) for a in (light.direction, light.energy))
        self.solid, self.owner = self._put(light.solid_angle[:used]), self._put(light.cluster_of[:used]).long()
        self.luminance = self._put(LUMINANCE_REC709) @ self.energy
        spread = self._put(light.spread[:used])
        self.widen = spread if filtered else torch.zeros_like(spread)

    def _put(self, array: object) -> torch.Tensor:
        import torch

        values = np.ascontiguousarray(array)
        return torch.from_numpy(values if values.dtype == np.int32 else values.astype(np.float32)).to(self.device)

    def __call__(self, points: ShadingPoints, visible: F32 | None, bounce: F32 | None) -> F32:
        import torch

        normal, view, alpha = self._put(points.normal.T), self._put(points.view.T), self._put(points.alpha)
        cos_i, lobes = self._lobes(normal, view, alpha)
        energy = self.energy[None].expand(len(alpha), -1, -1)
        if visible is not None:
            energy = energy * self._put(visible)[:, None, self.owner]
        if bounce is not None:
            energy = energy + self._put(bounce).permute(1, 0, 2)[:, :, self.owner] * self.solid
        wanted = torch.stack([self._put(a) for a in (points.dielectric, points.metal, points.metal)])
        sums = torch.zeros((len(alpha), COLUMNS), device=self.device)
        for i, weight in enumerate([cos_i, *(lobe * on[:, None] for lobe, on in zip(lobes, wanted, strict=True))]):
            sums[:, 3 * i : 3 * i + 3] = torch.einsum("pt,pct->pc", weight, energy)
            sums[:, 12 + i], sums[:, 16 + i] = weight @ self.luminance, weight @ self.solid
        return sums.cpu().numpy()

    def _lobes(self, normal: torch.Tensor, view: torch.Tensor, alpha: torch.Tensor) -> tuple[torch.Tensor, list]:  # type: ignore[type-arg]
        """Cosine and the three specular lobes times the cosine, [P, T] each; see kernels.py for the form of D."""
        import torch

        cosine = (normal * view).sum(1, keepdim=True)
        nv = cosine.clamp(COS_MIN, 1.0)
        tangent = torch.nn.functional.normalize(view - cosine * normal, dim=1) * (1 - nv * nv).clamp(min=0).sqrt()
        kept = self._kept(normal, normal * nv * 2 - (normal * nv + tangent), alpha)
        cos_i = (normal @ self.direction).clamp(min=0) * kept
        flat = self.direction[None] - (normal @ self.direction)[:, None] * normal[:, :, None] + tangent[:, :, None]
        across, s = flat.square().sum(1), cos_i + nv
        q, a2 = across + s * s, (alpha * alpha)[:, None]
        b2 = a2 + self.widen
        smith = nv * (cos_i * cos_i * (1 - a2) + a2).sqrt() + cos_i * (nv * nv * (1 - a2) + a2).sqrt()
        shape = cos_i * b2 * q * q / ((across + b2 * s * s).square() * smith) * (0.5 / np.pi)
        cos_d = 0.5 * q.sqrt()
        fresnel = torch.zeros_like(cos_d)
        for coefficient in reversed(FRESNEL.tolist()):
            fresnel = fresnel * cos_d + coefficient
        high = shape * (1 - cos_d).clamp(min=0) ** 5
        return cos_i, [shape * fresnel, shape - high, high]

    def _kept(self, normal: torch.Tensor, mirror: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
        """1 for the texels that a pixel sums, [P, T] or [1, 1]: a cluster's cells near the lobe, else its texels."""
        import torch

        texels = int(self.light.coarse_start[-1])
        if self.used == texels:
            return torch.ones((1, 1), device=self.device)
        cone = self._put(self.light.cluster_cone)
        margin = (0.08 + 3.0 * alpha).clamp(max=1.5)[:, None]
        bound = margin.cos() * (1 - cone[3] ** 2).clamp(min=0).sqrt() - margin.sin() * cone[3]
        near = (mirror @ cone[:3] > bound) | (cone[3] > 1)
        fine = torch.arange(self.used, device=self.device) >= texels
        return (near[:, self.owner] == fine).float()
