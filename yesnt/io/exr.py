"""Images on disk: reads every format that OpenImageIO knows, writes EXR with the OpenEXR package.

OpenEXR writes the same bytes for the same picture (OpenImageIO stamps a date) and raises on a full disk (OpenImageIO
says so only in a return value).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import CorruptError, JobError
from yesnt.io.durable import durable_path

MAX_SIDE = 32768
"""Largest width or height that is read: above any camera's, and a header that claims more is a trap."""

MAX_CHANNELS = 128
"""Most channels that one image may have."""

EXR_COMPRESSIONS = ("none", "rle", "zips", "zip", "piz")
"""Lossless compressions that every EXR reader of the field opens."""


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


read_exr = read_image


def read_planes(path: str | Path) -> dict[str, NDArray[np.floating]]:
    """Reads every channel of an EXR of our own, pixel types as stored: four times as fast as OpenImageIO."""
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as source:
        return {name: channel.pixels for name, channel in source.channels().items()}


def write_exr(
    path: Path,
    channels: Mapping[str, NDArray[np.floating]],
    attributes: Mapping[str, Any] | None = None,
    compression: str = "zip",
) -> None:
    """Writes one part, atomically, and reads it back before it gets its name.

    Args:
        path: final name.
        channels: `[H, W]` planes, float16 (half) or float32 (float).
        attributes: extra header attributes; equal attributes and pixels give equal bytes.
        compression: one of `EXR_COMPRESSIONS`.

    Raises:
        ValueError: an unknown compression.
        CorruptError: what was read back is not what was written.
        OSError, RuntimeError: the disk refused.
    """
    import OpenEXR

    if compression not in EXR_COMPRESSIONS:
        raise ValueError(f"compression={compression!r} must be one of {EXR_COMPRESSIONS}")
    header = {
        "compression": getattr(OpenEXR, f"{compression.upper().replace('NONE', 'NO')}_COMPRESSION"),
        "type": OpenEXR.scanlineimage,
        **(attributes or {}),
    }
    planes = {name: np.ascontiguousarray(plane) for name, plane in channels.items()}

    def prove(written: Path) -> None:
        back = read_planes(written)
        for name, plane in planes.items():
            if name not in back or not np.array_equal(back[name].view(np.uint8), plane.view(np.uint8)):
                raise CorruptError(
                    f"Channel {name} did not read back as written", str(path), "equal bits", "check the disk"
                )

    with (
        durable_path(path, prove) as temporary,
        OpenEXR.File(header, dict(planes)) as target,  # it replaces the values of its argument
    ):
        target.write(str(temporary))


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
