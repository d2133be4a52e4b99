"""Optical flow between two frames of the plate and where to trust it (method.md section 4).

Flow is a choice: OpenCV's DIS in four presets and DeepFlow here; a learned or a precomputed flow only has to deliver
forward and backward arrays to `consistency`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from yesnt.color import luminance, srgb_encode
from yesnt.temporal.geometry import build_geometry

Single = NDArray[np.float32]
Mask = NDArray[np.bool_]
FlowMethod = Literal["dis-fast", "dis-medium", "dis-quality", "deepflow"]


@dataclass(frozen=True)
class FlowSettings:
    """How flow is found and trusted.

    Attributes:
        method: cheapest first: dis-fast, dis-medium, dis-quality (finest scale 0, 25 gradient steps, 10 variational
            iterations), deepflow. Figures in docs/temporal.md.
        relative: how much of |f|^2 + |b|^2 the squared forward-backward error may be, as in method.md.
        absolute: plus this much, pixels^2.
        soft: False gives V in {0, 1}; True lets V fall linearly in error / allowed from 1 at 0.5 to 0 at 2.
    """

    method: FlowMethod = "dis-quality"
    relative: float = 0.01
    absolute: float = 0.5
    soft: bool = False


def flow_and_validity(
    rgb_t: Single, rgb_t1: Single, matte_t: NDArray[Any], matte_t1: NDArray[Any], settings: FlowSettings
) -> tuple[Single, Single]:
    """Flow from frame t to t+1 and its validity.

    Args:
        rgb_t: [H, W, 3] straight (un-premultiplied) linear Rec.709.
        rgb_t1: [H, W, 3] of the next frame.
        matte_t: [H, W] bool or coverage (matte where > 0.5).
        matte_t1: [H, W] of the next frame.
        settings: method and thresholds.

    Returns:
        flow [H, W, 2] float32 pixels (dx, dy), and validity [H, W] float32 in [0, 1], 0 outside the matte.
    """
    mask_t, mask_t1 = np.asarray(matte_t) > 0.5, np.asarray(matte_t1) > 0.5
    grey_t, grey_t1 = encode_grey(rgb_t, mask_t), encode_grey(rgb_t1, mask_t1)
    forward = dense_flow(grey_t, grey_t1, settings.method)
    backward = dense_flow(grey_t1, grey_t, settings.method)
    return forward, consistency(forward, backward, mask_t, mask_t1, settings)


def encode_grey(rgb: Single, mask: Mask) -> NDArray[np.uint8]:
    """8-bit sRGB grey `[H, W]` for matching; outside the matte a constant mid grey, so that no background pulls."""
    grey = 255.0 * srgb_encode(luminance(rgb.astype(np.float32, copy=False)))
    return np.where(mask, np.rint(grey), 128).astype(np.uint8)


def dense_flow(grey_t: NDArray[np.uint8], grey_t1: NDArray[np.uint8], method: FlowMethod) -> Single:
    """Flow `[H, W, 2]` pixels from one 8-bit picture to the next. Frames too small for the method get zero flow."""
    import cv2

    height, width = grey_t.shape
    if min(height, width) < 16:  # DIS and DeepFlow match patches on a pyramid and refuse less
        return np.zeros((height, width, 2), np.float32)
    if method == "deepflow":
        return cv2.optflow.createOptFlow_DeepFlow().calc(grey_t, grey_t1, None).astype(np.float32)
    preset = cv2.DISOPTICAL_FLOW_PRESET_FAST if method == "dis-fast" else cv2.DISOPTICAL_FLOW_PRESET_MEDIUM
    dis = cv2.DISOpticalFlow.create(preset)
    if method == "dis-quality":
        dis.setFinestScale(0)
        dis.setGradientDescentIterations(25)
        dis.setVariationalRefinementIterations(10)
    return dis.calc(grey_t, grey_t1, None).astype(np.float32)


def consistency(forward: Single, backward: Single, mask_t: Mask, mask_t1: Mask, settings: FlowSettings) -> Single:
    """Validity [H, W] from forward-backward consistency.

    A point is consistent where |f + b(p + f)|^2 <= relative (|f|^2 + |b|^2) + absolute (method.md section 4; after
    Sundaram et al. 2010), sampled over matte pixels as the warp of the energy does.
    """
    sampled, valid = sample_next(backward, forward, mask_t, mask_t1)
    error = np.sum((forward + sampled) ** 2, axis=-1)
    allowed = settings.relative * np.sum(forward**2 + sampled**2, axis=-1) + settings.absolute
    if not settings.soft:
        return (valid & (error <= allowed)).astype(np.float32)
    return np.where(valid, np.clip((2.0 - error / allowed) / 1.5, 0.0, 1.0), 0.0).astype(np.float32)


def sample_next(image: Single, flow: Single, mask_t: Mask, mask_t1: Mask) -> tuple[Single, Mask]:
    """The energy's warp of a frame: `image` [H, W, C] of t+1 sampled at p + flow(p).

    Returns:
        [H, W, C] float32 (0 where invalid) and [H, W] where the sample is valid.
    """
    matte = np.stack([mask_t, mask_t1])
    geometry = build_geometry(matte, flow[None], np.ones((1, *mask_t.shape), np.float32))
    here = slice(0, int(geometry.frames[1]))
    values = np.concatenate([np.zeros((here.stop, image.shape[-1]), image.dtype), image[mask_t1]])
    corners = (geometry.top, geometry.top + 1, geometry.bottom, geometry.bottom + 1)
    total = sum(geometry.weights[here, k, None] * values[index[here]] for k, index in enumerate(corners))
    sampled, valid = np.zeros((*mask_t.shape, image.shape[-1]), np.float32), np.zeros(mask_t.shape, bool)
    sampled[mask_t], valid[mask_t] = total, geometry.link[here] > 0
    return sampled, valid
