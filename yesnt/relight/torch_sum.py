"""The lobe sums of relight/kernels.py on any torch device, equal to rounding; for machines with CUDA."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import LUMINANCE_REC709
from yesnt.relight.brdf import COS_MIN
from yesnt.relight.kernels import COLUMNS, WIDEN, cluster_rows
from yesnt.relight.lights import PreparedLight
from yesnt.relight.microfacet import FRESNEL
from yesnt.relight.records import ShadingPoints
from yesnt.relight.texel_lod import LEAST_COSINE, TAIL

if TYPE_CHECKING:
    import torch

F32 = NDArray[np.float32]

_PAIRS = 1 << 22  # pixel-texel pairs per chunk: about twenty temporaries of 16 MB each


def sum_lobes_torch(
    points: ShadingPoints,
    light: PreparedLight,
    hidden: NDArray[np.bool_] | None,
    indirect: F32 | None,
    filtered: bool = True,
    device: str | None = None,
) -> F32:
    """As `kernels.sum_lobes`, to rounding.

    Args:
        points: P pixels.
        light: the light, with C clusters.
        hidden: [P, C] clusters that are occluded; None: none.
        indirect: [3, P, C] radiance that comes from an occluded cluster's direction; None: 0.
        filtered: as for `kernels.sum_lobes`.
        device: name of a torch device; None: CUDA if there is one, else the CPU.

    Returns:
        [P, 20] float32 lobe sums.
    """
    import torch

    where = device or ("cuda" if torch.cuda.is_available() else "cpu")
    out = np.zeros((len(points.alpha), COLUMNS), dtype=np.float32)
    sums = _Sums(light, filtered, where)
    order = np.argsort(points.alpha, kind="stable")  # pixels of a chunk then want the same levels
    step = max(1, _PAIRS // max(rows.shape[1] for rows in sums.levels))
    for first in range(0, len(order), step):
        index = order[first : first + step]
        part = ShadingPoints(
            points.normal[:, index],
            points.viewer[:, index],
            points.alpha[index],
            points.dielectric[index],
            points.metal[index],
            points.disney,
        )
        shut = None if hidden is None else hidden[index]
        out[index] = sums(part, shut, None if indirect is None else indirect[:, index])
    return out


class _Sums:
    """A light on a device; a call with pixels returns their lobe sums."""

    def __init__(self, light: PreparedLight, filtered: bool, device: str) -> None:
        self.device, texels = device, light.texels
        self.detail, self.widen = (light.detail, WIDEN) if filtered else (math.inf, 0.0)
        self.levels = [self._put(texels.level(k)) for k in range(len(texels.start))]
        self.owners = [self._put(texels.owner(k)) for k in range(len(texels.start))]
        self.coarsest = texels.coarsest if filtered else 0
        self.size, self.cone = self._put(texels.size), self._put(light.cone)
        self.moment, self.edge = self._put(light.moment.reshape(4, 3, -1)), self._put(light.edge)
        self.clusters = self._put(cluster_rows(light.clusters))
        self.luminance = self._put(np.asarray(LUMINANCE_REC709, dtype=np.float32))

    def _put(self, array: NDArray[np.generic]) -> torch.Tensor:
        import torch

        return torch.from_numpy(np.array(array, order="C")).to(self.device)

    def __call__(self, points: ShadingPoints, hidden: NDArray[np.bool_] | None, indirect: F32 | None) -> F32:
        import torch

        normal, view, alpha = self._put(points.normal.T), self._put(points.viewer.T), self._put(points.alpha)
        wanted = torch.stack([self._put(a).float() for a in (points.dielectric, points.metal, points.metal)])
        frame = _Frame(normal, view, alpha, wanted, self.widen, points.disney)
        shut = torch.zeros((len(alpha), self.cone.shape[1]), device=self.device)
        if hidden is not None:
            shut = self._put(hidden).float()
        up = (normal @ self.cone[:3] > -self.cone[3]).float() * (1 - shut)
        level = self._level(frame, normal)
        sums = torch.zeros((len(alpha), COLUMNS), device=self.device)
        if self.coarsest < 0 and self.edge.shape[1] and not points.disney:
            self._clamped_cosine(sums, normal, 1 - shut)
        else:
            _add_irradiance(sums, frame, self.levels[0], up[:, self.owners[0]])
        for k, (rows, owner) in enumerate(zip(self.levels, self.owners, strict=True)):
            chosen = up * (level == k)
            if chosen.any():
                _add_lobes(sums, frame, rows, chosen[:, owner])
        _add_lobes(sums, frame, self.clusters, up * (level < 0))
        for k in range(4):
            sums[:, 12 + k] = sums[:, 3 * k : 3 * k + 3] @ self.luminance
        if hidden is not None:
            self._add_occluded(sums, frame, shut, indirect)
        return sums.cpu().numpy()

    def _clamped_cosine(self, sums: torch.Tensor, normal: torch.Tensor, seen: torch.Tensor) -> None:
        """Irradiance of clusters; see irradiance.add_clamped_clusters."""
        import torch

        mean = torch.einsum("pa,kac->pkc", normal, self.moment)
        half, over = self.edge[:4], self.edge[4:]
        part = torch.minimum((mean + half).clamp(min=0), 2 * half) * over
        found = ((part.square() + (mean - half).clamp(min=0)) * seen[:, None]).sum(2)
        sums[:, :3] += found[:, :3]
        sums[:, 16] += found[:, 3]

    def _level(self, frame: _Frame, normal: torch.Tensor) -> torch.Tensor:
        """Level [P, C] that each cluster is read at; see texel_lod.choose_levels."""
        core = 2 * frame.alpha * frame.nv.clamp(min=LEAST_COSINE)
        away = (2 - 2 * frame.mirror @ self.cone[:3]).clamp(min=0).sqrt() - self.cone[3]
        away = away.clamp(min=0)
        bearable = self.detail * (core + away) * (1 + TAIL * away / core)
        level = (self.size[:-1, None] > bearable[None]).sum(0)
        cut = (normal @ self.cone[:3]).abs() <= self.cone[3]
        whole = (self.clusters[6] <= bearable * bearable) & ~cut
        return level + self.coarsest * whole

    def _add_occluded(self, sums: torch.Tensor, frame: _Frame, shut: torch.Tensor, indirect: F32 | None) -> None:
        """Adds occluded clusters: their own light to the open sums, indirect radiance to the others."""
        open_ = sums.new_zeros(sums.shape)
        _add_irradiance(open_, frame, self.clusters, shut)
        _add_lobes(open_, frame, self.clusters, shut)
        for k in range(4):
            sums[:, 12 + k] += open_[:, 3 * k : 3 * k + 3] @ self.luminance
        lit = self.clusters[None].repeat(len(shut), 1, 1)
        solid = self.clusters[6]
        lit[:, 3:6] = 0 if indirect is None else self._put(indirect).permute(1, 0, 2) * solid
        _add_irradiance(sums, frame, lit, shut)
        _add_lobes(sums, frame, lit, shut)


class _Frame:
    """ShadingFrame of P pixels, [P, 3] and [P, 1]; relight/microfacet.py has the form of D."""

    def __init__(
        self,
        normal: torch.Tensor,
        view: torch.Tensor,
        alpha: torch.Tensor,
        wanted: torch.Tensor,
        widen: float,
        disney: bool,
    ) -> None:
        import torch

        cosine = (normal * view).sum(1, keepdim=True)
        self.normal, self.alpha, self.wanted, self.widen = normal, alpha[:, None], wanted, widen
        self.disney = disney
        self.nv = cosine.clamp(COS_MIN, 1.0)
        across = torch.nn.functional.normalize(view - cosine * normal, dim=1)
        self.tangent = across * (1 - self.nv * self.nv).clamp(min=0).sqrt()
        self.mirror = self.nv * normal - self.tangent

    def diffuse(self, rows: torch.Tensor) -> torch.Tensor:
        """n.l [P, T] of texels [8, T] or [P, 8, T], at least 0; weighted as Burley's diffuse if that is wanted."""
        cos_i = (self.normal[:, None] @ rows[..., :3, :])[:, 0].clamp(min=0)
        if not self.disney:
            return cos_i
        view = self.nv * self.normal + self.tangent
        cos_d = 0.5 * (1 + (view[:, None] @ rows[..., :3, :])[:, 0])  # its square
        grazing = 2 * self.alpha.sqrt() * cos_d - 0.5
        return cos_i * (1 + grazing * (1 - cos_i) ** 5) * (1 + grazing * (1 - self.nv) ** 5)

    def lobes(self, rows: torch.Tensor) -> list[torch.Tensor]:
        """The three specular lobes times the cosine, [P, T] each."""
        import torch

        direction = rows[..., :3, :].expand(len(self.normal), -1, -1)
        facing = (self.normal[:, None] @ direction)[:, 0]
        flat = direction - facing[:, None] * self.normal[:, :, None] + self.tangent[:, :, None]
        cos_i = facing.clamp(min=0)
        across, s, a2 = flat.square().sum(1), cos_i + self.nv, self.alpha.square()
        q, disc = across + s * s, self.widen / self.nv.clamp(min=LEAST_COSINE) * rows[..., 7, :]
        x = across + (a2 - disc) * s * s
        half = 2 * a2 * disc * s**4
        root = (x * x + 2 * half).sqrt()
        square = torch.maximum(root * (root + x), half)
        smith = self.nv * (cos_i.square() * (1 - a2) + a2).sqrt() + cos_i * (self.nv.square() * (1 - a2) + a2).sqrt()
        shape = cos_i * a2 * q * q / (0.5 * square * smith) * (0.5 / np.pi)
        m = 1 - 0.5 * q.sqrt()
        fresnel = sum(c * m**k for c, k in zip(map(float, FRESNEL), (0, 2, 4, 8, 16), strict=True))
        high = shape * m.clamp(min=0) ** 5
        return [shape * fresnel, shape - high, high]


def _add_irradiance(sums: torch.Tensor, frame: _Frame, rows: torch.Tensor, mask: torch.Tensor) -> None:
    _add(sums, 0, frame.diffuse(rows) * mask, rows)


def _add_lobes(sums: torch.Tensor, frame: _Frame, rows: torch.Tensor, mask: torch.Tensor) -> None:
    for i, lobe in enumerate(frame.lobes(rows)):
        _add(sums, i + 1, lobe * mask * frame.wanted[i][:, None], rows)


def _add(sums: torch.Tensor, lobe: int, weight: torch.Tensor, rows: torch.Tensor) -> None:
    """Adds weighted energy (RGB) and solid angle to a lobe's columns."""
    found = (weight[:, None] @ rows[..., 3:7, :].mT)[:, 0]
    sums[:, 3 * lobe : 3 * lobe + 3] += found[:, :3]
    sums[:, 16 + lobe] += found[:, 3]
