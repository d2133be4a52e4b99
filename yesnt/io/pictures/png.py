"""Pictures for people as PNG: display values, 8 bits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def png_bytes(picture: NDArray[np.float32]) -> bytes:
    """A display-referred picture [H, W, 3] as PNG; values outside [0, 1] are clipped."""
    import cv2

    done, data = cv2.imencode(".png", (np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8)[..., ::-1])
    assert done
    return bytes(data.tobytes())


def grey_png_bytes(picture: NDArray[np.float32]) -> bytes:
    """Values [H, W] in [0, 1], such as coverage, as a grey PNG of 8 bits."""
    import cv2

    done, data = cv2.imencode(".png", (np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8))
    assert done
    return bytes(data.tobytes())
