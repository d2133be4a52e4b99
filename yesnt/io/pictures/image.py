"""Pictures that any program wrote: headers and planes as stored, in every format that OpenImageIO knows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError
from yesnt.io.exr import read_planes

MAX_SIDE = 32768
"""Largest width or height that is read: above any camera's, and a header that claims more is a trap."""

MAX_CHANNELS = 128
"""Most channels that one image may have."""

_PLAIN = {"half", "float"}

Planes = Mapping[str, NDArray[np.float32]]


@dataclass(frozen=True)
class ImageHeader:
    """What a file says of its picture, read without its pixels."""

    path: str
    width: int
    height: int
    channels: tuple[str, ...]
    attributes: Mapping[str, Any]


@dataclass(frozen=True)
class ExrImage:
    """A picture: planes `[H, W]` float32 by channel name, and the header's attributes."""

    channels: Mapping[str, NDArray[np.float32]]
    header: ImageHeader

    def stack(self, names: Sequence[str]) -> NDArray[np.float32]:
        """The named channels as `[H, W, C]`.

        Raises:
            JobError: a channel is absent.
        """
        absent = [name for name in names if name not in self.channels]
        if absent:
            raise JobError(
                f"The image has no channel {', '.join(absent)}",
                self.header.path,
                f"channels {', '.join(names)}; it has {', '.join(self.channels)}",
                "export it with these channels, or name the right ones in the job file",
            )
        return np.stack([self.channels[name] for name in names], axis=-1)


def read_header(path: str | Path) -> ImageHeader:
    """Reads a header; refuses pictures whose claimed size is absurd before any memory is taken.

    Raises:
        JobError: the file is missing, is not an image, or claims more than `MAX_SIDE` or `MAX_CHANNELS`.
    """
    source = _open(path)
    try:
        return _header(source, path)
    finally:
        source.close()


def read_image(path: str | Path) -> ExrImage:
    """Reads every channel of the first part as float32, values as stored (no colour conversion).

    Raises:
        JobError: as `read_header`, or the pixels are truncated or damaged.
    """
    source = _open(path)
    try:
        header = _header(source, path)
        plain = _is_plain_exr(source)
        planes, problem = (_scanlines(path, header), "") if plain else (None, "")
        if planes is None:
            planes, problem = _any_pixels(source, header)
    finally:
        source.close()
    if planes is None or problem:
        raise JobError(
            f"The image is damaged or cut short ({problem.splitlines()[0] if problem else 'no pixels'})",
            str(path),
            f"{header.width}x{header.height} pixels, {len(header.channels)} channels",
            "copy or export this file again",
        )
    return ExrImage(planes, header)


def _open(path: str | Path) -> Any:
    import OpenImageIO as oiio

    if not Path(path).is_file():
        raise JobError("The image is missing", str(path), "a readable file", "check the path and the frame range")
    straight = oiio.ImageSpec()
    straight.attribute("oiio:UnassociatedAlpha", 1)  # PNG keeps the alpha it was written with
    source = oiio.ImageInput.open(str(path), straight)
    if source is None:
        problem = (oiio.geterror() or "unknown format").splitlines()[0]
        raise JobError(f"The image cannot be opened ({problem})", str(path), "an EXR, PNG or JPEG", "export it again")
    return source


def _is_plain_exr(source: Any) -> bool:
    """Whether it is what nearly every renderer writes: one part of half or float channels, neither deep nor tiled."""
    spec = source.spec()
    kinds = {str(kind) for kind in (spec.channelformats or (spec.format,))}
    single = spec.get_int_attribute("oiio:subimages", 1) == 1
    return source.format_name() == "openexr" and single and not spec.deep and not spec.tile_width and kinds <= _PLAIN


def _scanlines(path: str | Path, header: ImageHeader) -> Planes | None:
    """The planes of a plain EXR by the OpenEXR package; None if it cannot: then the slow way says why."""
    try:
        planes = read_planes(path)
    except (RuntimeError, ValueError):  # damaged: OpenImageIO says where
        return None
    shape = header.height, header.width
    if any(name not in planes or planes[name].shape != shape for name in header.channels):
        return None  # subsampled chroma
    return {name: np.asarray(planes[name], np.float32) for name in header.channels}


def _any_pixels(source: Any, header: ImageHeader) -> tuple[Planes | None, str]:
    """The planes of any image, and OpenImageIO's error message."""
    import OpenImageIO as oiio

    pixels = source.read_image(oiio.FLOAT)
    problem: str = source.geterror()
    if pixels is None:
        return None, problem
    whole = np.asarray(pixels, dtype=np.float32).reshape(header.height, header.width, len(header.channels))
    return {n: np.ascontiguousarray(whole[..., i]) for i, n in enumerate(header.channels)}, problem


def _header(source: Any, path: str | Path) -> ImageHeader:
    spec = source.spec()
    if not (0 < spec.width <= MAX_SIDE and 0 < spec.height <= MAX_SIDE and 0 < spec.nchannels <= MAX_CHANNELS):
        raise JobError(
            f"The header claims {spec.width}x{spec.height} pixels and {spec.nchannels} channels",
            str(path),
            f"at most {MAX_SIDE}x{MAX_SIDE} and {MAX_CHANNELS} channels",
            "this file is damaged or hostile: export it again",
        )
    attributes = {attribute.name: attribute.value for attribute in spec.extra_attribs}
    return ImageHeader(str(path), spec.width, spec.height, tuple(spec.channelnames), attributes)
