"""The rasteriser in torch with autograd: one tile at a time, vectorised over its Gaussians and pixels.

Reads like method.md section 2. Runs on any device of torch, in float32 or float64; tests compare the compiled kernels
and their gradients with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from yesnt.gaussians.harmonics import C0, C1, C2_XX, C2_XY, C2_ZZ, C3_XYZ, C3_YXX, C3_YZZ, C3_ZXX, C3_ZZZ
from yesnt.gaussians.project import TILE
from yesnt.gaussians.reference import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN
from yesnt.gaussians.tiles import TileLists

if TYPE_CHECKING:
    import torch

    from yesnt.gaussians.project import GaussianArrays, Pinhole

IMAGES = 10
"""Images that are returned: colour (3), normal (3), sum of weights, weighted depth and its square, median depth."""


@dataclass(frozen=True)
class TorchField:
    """The arrays of a field as tensors (field.py); `added` [N] is the smoothing filter's variance."""

    positions: torch.Tensor
    log_scales: torch.Tensor
    rotations: torch.Tensor
    opacity_logits: torch.Tensor
    harmonics: torch.Tensor
    added: torch.Tensor

    @classmethod
    def of(cls, arrays: GaussianArrays, dtype: str = "float32", device: str = "cpu") -> TorchField:
        """Tensors with gradients (but for `added`) of arrays of a field."""
        import torch

        kind = getattr(torch, dtype)
        tensors = [torch.tensor(np.array(a), dtype=kind, device=device).requires_grad_() for a in arrays]
        a, b, c, d, e, added = tensors
        return cls(a, b, c, d, e, added.detach())


@dataclass(frozen=True)
class TorchSplats:
    """Gaussians in camera axes: centre [N, 3], covariance and adjugate [N, 3, 3], opacity [N], colour and normal."""

    center: torch.Tensor
    covariance: torch.Tensor
    adjugate: torch.Tensor
    opacity: torch.Tensor
    color: torch.Tensor
    normal: torch.Tensor


def matrices(quaternions: torch.Tensor) -> torch.Tensor:
    """Rotation matrices [N, 3, 3] of quaternions [N, 4], which are normalised first."""
    import torch

    w, x, y, z = (quaternions / quaternions.norm(dim=1, keepdim=True)).unbind(1)
    entries = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(entries, 1).reshape(-1, 3, 3)


def basis(d: torch.Tensor, count: int) -> torch.Tensor:
    """The first `count` harmonics along unit directions [N, 3]: [N, count]."""
    import torch

    x, y, z = d.unbind(1)
    xx, yy, zz = x * x, y * y, z * z
    values = [
        torch.full_like(x, C0), -C1 * y, C1 * z, -C1 * x, C2_XY * x * y, -C2_XY * y * z, C2_ZZ * (2 * zz - xx - yy),
        -C2_XY * x * z, C2_XX * (xx - yy), -C3_YXX * y * (3 * xx - yy), C3_XYZ * x * y * z,
        -C3_YZZ * y * (4 * zz - xx - yy), C3_ZZZ * z * (2 * zz - 3 * xx - 3 * yy), -C3_YZZ * x * (4 * zz - xx - yy),
        C3_ZXX * z * (xx - yy), -C3_YXX * x * (xx - 3 * yy),
    ]  # fmt: skip
    return torch.stack(values[:count], 1)


def splats(field: TorchField, pinhole: Pinhole) -> TorchSplats:
    """The Gaussians as a camera sees them."""
    import torch

    rotation, position = (
        torch.as_tensor(a, dtype=field.positions.dtype, device=field.positions.device)
        for a in (pinhole.rotation, pinhole.position)
    )
    offset = field.positions - position
    center = offset @ rotation.T
    axes = rotation @ matrices(field.rotations)
    own = torch.exp(2 * field.log_scales)
    d = own + field.added[:, None]
    cofactors = torch.stack([d[:, 1] * d[:, 2], d[:, 0] * d[:, 2], d[:, 0] * d[:, 1]], 1)
    covariance = torch.einsum("nij,nj,nkj->nik", axes, d, axes)
    adjugate = torch.einsum("nij,nj,nkj->nik", axes, cofactors, axes)
    opacity = torch.sigmoid(field.opacity_logits) * (own / d).prod(1).sqrt()
    directions = offset / offset.norm(dim=1, keepdim=True)
    values = torch.einsum("nk,nkc->nc", basis(directions, field.harmonics.shape[1]), field.harmonics)
    across = -torch.einsum("nij,nj->ni", adjugate, center)
    normal = across / across.norm(dim=1, keepdim=True)
    return TorchSplats(center, covariance, adjugate, opacity, (0.5 + values).clamp(min=0), normal)


def responses(s: TorchSplats, members: torch.Tensor, rays: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Response and depth t* of K Gaussians on P rays [P, 3]: [K, P] each (project.py has the formulas)."""
    import torch

    center, g = s.center[members], s.adjugate[members]
    across = torch.linalg.cross(center[:, None, :], rays[None, :, :].expand(len(members), -1, -1))
    den = torch.einsum("pi,kij,pj->kp", rays, g, rays)
    q = torch.einsum("kpi,kij,kpj->kp", across, s.covariance[members], across) / den
    return torch.exp(-0.5 * q), torch.einsum("pi,kij,kj->kp", rays, g, center) / den


def composite_tile(
    s: TorchSplats, members: torch.Tensor, rays: torch.Tensor, near: float, reference_z: float
) -> torch.Tensor:
    """The ten images of P pixels, [10, P], from K Gaussians, nearest first."""
    import torch

    response, t = responses(s, members, rays)
    alpha = (s.opacity[members, None] * response).clamp(max=ALPHA_MAX)
    alpha = torch.where((alpha < ALPHA_MIN) | (t < near), torch.zeros_like(alpha), alpha)
    passed = torch.cumprod(torch.cat([torch.ones_like(alpha[:1]), 1 - alpha]), 0)
    alpha = torch.where(passed[:-1] > TRANSMITTANCE_MIN, alpha, torch.zeros_like(alpha))
    weight = alpha * passed[:-1]
    depth = t - reference_z
    crosses = (passed[:-1] > 0.5) & (passed[:-1] - weight <= 0.5)
    rows = [
        torch.einsum("kp,kc->cp", weight, s.color[members]), torch.einsum("kp,kc->cp", weight, s.normal[members]),
        weight.sum(0)[None], (weight * depth).sum(0)[None], (weight * depth * depth).sum(0)[None],
        torch.where(crosses, t, torch.zeros_like(t)).sum(0)[None],
    ]  # fmt: skip
    return torch.cat(rows)


def render_tiles(field: TorchField, pinhole: Pinhole, lists: TileLists) -> torch.Tensor:
    """The ten images of a view over whole tiles, [10, rows, columns], with the Gaussians of each tile's list."""
    import torch

    kind: dict[str, Any] = {"dtype": field.positions.dtype, "device": field.positions.device}
    s = splats(field, pinhole)
    columns, rows = -(-pinhole.width // TILE), -(-pinhole.height // TILE)
    x = (torch.arange(columns * TILE, **kind) + 0.5 - pinhole.cx) / pinhole.fx
    y = (torch.arange(rows * TILE, **kind) + 0.5 - pinhole.cy) / pinhole.fy
    out = torch.zeros((IMAGES, rows, columns, TILE, TILE), **kind)
    tiles = []
    for tile in range(rows * columns):
        members = torch.as_tensor(lists.members[lists.starts[tile] : lists.starts[tile + 1]], device=kind["device"])
        if not len(members):
            tiles.append(out[:, 0, 0])
            continue
        row, column = divmod(tile, columns)
        grid = torch.meshgrid(y[row * TILE : row * TILE + TILE], x[column * TILE : column * TILE + TILE], indexing="ij")
        rays = torch.stack([grid[1], grid[0], torch.ones_like(grid[0])], -1).reshape(-1, 3)
        images = composite_tile(s, members.long(), rays, pinhole.near, pinhole.reference_z)
        tiles.append(images.reshape(IMAGES, TILE, TILE))
    whole = torch.stack(tiles, 1).reshape(IMAGES, rows, columns, TILE, TILE)
    return whole.permute(0, 1, 3, 2, 4).reshape(IMAGES, rows * TILE, columns * TILE)
