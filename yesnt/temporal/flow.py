"""Optical flow between two frames of the plate, and its validity (docs/method.md section 4).

Methods: OpenCV's DIS in three presets, DeepFlow, and a learned flow whose network the caller loads. A flow from another
source only needs its validity: `flow_validity`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import luminance, srgb_encode
from yesnt.core.errors import JobError
from yesnt.temporal.geometry import build_geometry

Single = NDArray[np.float32]
Mask = NDArray[np.bool_]
Matcher = Callable[[NDArray[np.uint8], NDArray[np.uint8]], Single]
FlowMethod = Literal["dis-fast", "dis-medium", "dis-quality", "deepflow", "spynet"]

LEARNED: tuple[FlowMethod, ...] = ("spynet",)
"""Methods that need a file of weights."""


@dataclass(frozen=True)
class FlowSettings:
    """Flow method and thresholds of its validity; the defaults were chosen on data, see docs/temporal.md.

    Attributes:
        method: cheapest first: dis-fast, dis-medium, dis-quality (finest scale 0, 25 gradient steps, 10 variational
            iterations), deepflow; spynet, a learned flow whose weights the caller loads and passes as `match`.
        relative: largest squared forward-backward error, as a share of |f|^2 + |b|^2.
        absolute: added to it, pixels^2. The pair of Sundaram et al., (0.01, 0.5), rejects much good flow.
        photometric: sRGB difference at which validity falls to 1/e; infinite: colours are not compared and validity is
            0 or 1.
        cut: threshold that makes validity binary; 0: validity stays continuous.
    """

    method: FlowMethod = "dis-quality"
    relative: float = 0.05
    absolute: float = 2.0
    photometric: float = 0.03
    cut: float = 0.0


def flow_and_validity(
    rgb_t: Single,
    rgb_t1: Single,
    matte_t: NDArray[Any],
    matte_t1: NDArray[Any],
    settings: FlowSettings,
    match: Matcher | None = None,
) -> tuple[Single, Single]:
    """Flow from frame t to t+1 and its validity.

    Args:
        rgb_t: [H, W, 3] straight (un-premultiplied) linear Rec.709.
        rgb_t1: [H, W, 3] of the next frame.
        matte_t: [H, W] bool or coverage (matte where > 0.5).
        matte_t1: [H, W] of the next frame.
        settings: method and thresholds.
        match: function from two 8-bit sRGB images [H, W, 3] to a flow [H, W, 2], used instead of the method, for
            instance `spynet.SpyNet`.

    Returns:
        Flow [H, W, 2] float32 in pixels (dx, dy); and validity [H, W] float32 in [0, 1], 0 outside the matte.

    Raises:
        JobError: the method needs weights and `match` is None.
    """
    mask_t, mask_t1 = np.asarray(matte_t) > 0.5, np.asarray(matte_t1) > 0.5
    if match is None and settings.method in LEARNED:
        raise JobError(
            f"The flow {settings.method} needs weights",
            "flow.weights",
            "a file of weights",
            "name one, or another method",
        )
    if match is None:
        now, following = encode_grey(rgb_t, mask_t), encode_grey(rgb_t1, mask_t1)
        forward = dense_flow(now, following, settings.method)
        backward = dense_flow(following, now, settings.method)
    else:
        now, following = encode_colour(rgb_t, mask_t), encode_colour(rgb_t1, mask_t1)
        forward, backward = match(now, following), match(following, now)
    return forward, flow_validity(forward, backward, rgb_t, rgb_t1, mask_t, mask_t1, settings)


def flow_validity(
    forward: Single,
    backward: Single | None,
    rgb_t: Single,
    rgb_t1: Single,
    mask_t: Mask,
    mask_t1: Mask,
    settings: FlowSettings,
) -> Single:
    """Validity [H, W] in [0, 1] of a flow from any source, for instance a renderer.

    Args:
        forward: [H, W, 2] pixels, frame t to t+1, x right and y down.
        backward: [H, W, 2] pixels, frame t+1 to t; None if unknown: then validity depends on colour alone.
        rgb_t: [H, W, 3] straight linear Rec.709.
        rgb_t1: [H, W, 3] of the next frame.
        mask_t: [H, W] bool matte.
        mask_t1: [H, W] bool matte of the next frame.
        settings: thresholds.
    """
    weight = photometric_weight(forward, rgb_t, rgb_t1, mask_t, mask_t1, settings.photometric)
    if backward is not None:
        weight = weight * consistency(forward, backward, mask_t, mask_t1, settings)
    return weight if settings.cut == 0 else (weight >= settings.cut).astype(np.float32)


def encode_grey(rgb: Single, mask: Mask) -> NDArray[np.uint8]:
    """8-bit sRGB grey `[H, W]` for matching; constant outside the matte, so that the background is not matched."""
    grey = 255.0 * srgb_encode(luminance(rgb.astype(np.float32, copy=False)))
    return np.where(mask, np.rint(grey), 128).astype(np.uint8)


def encode_colour(rgb: Single, mask: Mask) -> NDArray[np.uint8]:
    """8-bit sRGB `[H, W, 3]` for a learned flow; mid grey outside the matte."""
    colour = np.rint(255.0 * srgb_encode(rgb.astype(np.float32, copy=False)))
    return np.where(mask[..., None], colour, 128).astype(np.uint8)


def dense_flow(grey_t: NDArray[np.uint8], grey_t1: NDArray[np.uint8], method: FlowMethod) -> Single:
    """Flow `[H, W, 2]` in pixels from one 8-bit image [H, W] to the next; 0 for frames too small for the method."""
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
    """Validity [H, W] in {0, 1} from forward-backward consistency; `backward` is the flow of frame t+1 to t.

    A point is consistent where |f + b(p + f)|^2 <= relative (|f|^2 + |b|^2) + absolute (method.md section 4; after
    Sundaram et al. 2010), sampled over matte pixels as the warp of the energy does.
    """
    sampled, valid = sample_next(backward, forward, mask_t, mask_t1)
    error = np.sum((forward + sampled) ** 2, axis=-1)
    allowed = settings.relative * np.sum(forward**2 + sampled**2, axis=-1) + settings.absolute
    return (valid & (error <= allowed)).astype(np.float32)


def photometric_weight(
    forward: Single, rgb_t: Single, rgb_t1: Single, mask_t: Mask, mask_t1: Mask, scale: float
) -> Single:
    """Weight exp(-(d / scale)^2) [H, W] in [0, 1] from the colour difference d along the flow.

    d is the largest sRGB difference of the three channels between p in frame t and p + f in t+1, averaged over 3 x 3
    pixels. Occlusions change the colour far more often than they break forward-backward consistency.
    """
    if np.isinf(scale):
        return mask_t.astype(np.float32)
    here, following = (srgb_encode(rgb).astype(np.float32) for rgb in (rgb_t, rgb_t1))
    sampled, valid = sample_next(following, forward, mask_t, mask_t1)
    difference = np.where(valid, np.abs(sampled - here).max(axis=-1), 0.0)
    return np.exp(-((box_mean(difference, valid, 3) / scale) ** 2)).astype(np.float32) * valid


def box_mean(image: NDArray[Any], mask: Mask, size: int) -> Single:
    """Mean of the masked pixels of `image` [H, W] in a box of `size` pixels; 0 where the box holds none."""
    import cv2

    total = cv2.boxFilter((image * mask).astype(np.float32), -1, (size, size), normalize=False)
    count = cv2.boxFilter(mask.astype(np.float32), -1, (size, size), normalize=False)
    return np.where(count > 0, total / np.maximum(count, 1.0), 0.0).astype(np.float32)


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
