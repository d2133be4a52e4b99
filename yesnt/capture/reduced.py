"""Pictures and cameras at a whole fraction of their size: mattes are found and compared on fewer pixels than stored."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from yesnt.core.camera import Camera

F32 = NDArray[np.float32]


def reduced_image(image: F32, times: int) -> F32:
    """Means of squares of `times` pixels of an image [H, W] or [H, W, C]; rows and columns left over are cut off."""
    import cv2

    if times == 1:
        return image
    height, width = (side // times for side in image.shape[:2])
    whole = np.ascontiguousarray(image[: height * times, : width * times])
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))


def reduced_camera(camera: Camera, pose: int | None, times: int) -> Camera:
    """The camera of the reduced picture of one frame; its lens distorts as before."""
    if times == 1:
        return camera
    lens = camera.lens(pose)
    return replace(
        camera, width=camera.width // times, height=camera.height // times, fx=lens.fx / times, fy=lens.fy / times,
        cx=lens.cx / times, cy=lens.cy / times, distortion=lens.distortion, lenses=MappingProxyType({}),
    )  # fmt: skip


def enlarged_image(image: F32, times: int, size: tuple[int, int]) -> F32:
    """A reduced image [h, w] at its former size (width, height), bilinear; what was cut off repeats the border."""
    import cv2

    if times == 1:
        return image
    height, width = image.shape
    large = cv2.resize(image, (width * times, height * times), interpolation=cv2.INTER_LINEAR)
    rest = (0, size[1] - large.shape[0], 0, size[0] - large.shape[1])
    return np.asarray(cv2.copyMakeBorder(large, *rest, cv2.BORDER_REPLICATE))
