"""Pictures that any program wrote: headers and planes as stored, in every format that OpenImageIO knows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.errors import JobError
from yesnt.core.windows import Window
from yesnt.io.exr import read_planes

MAX_SIDE = 32768
"""Largest width or height that is read: above any camera's, and a header that claims more is a trap."""

MAX_CHANNELS = 4096
"""Most channels of one part; renderers write hundreds, and only those that are asked for are decoded."""

MAX_PARTS = 1024
"""Most parts of one file."""

WHOLE = 64
"""Bytes of a pixel up to which a plain EXR is decoded whole, in less time than OpenImageIO takes for four of its
channels (tests/benchmarks/read_pictures.py); of larger ones, such as 200 layers, only what is needed is kept."""

_PLAIN = MappingProxyType({"half": 2, "float": 4})
"""Bytes of the pixel types of plain EXRs."""

F32 = NDArray[np.float32]
Planes = Mapping[str, F32]


@dataclass(frozen=True)
class ImageHeader:
    """What a file says of a picture, read without its pixels: of one part, where it has several.

    Attributes:
        path: of the file.
        width: columns that are stored.
        height: rows that are stored.
        channels: names as stored.
        attributes: the others by name, as OpenImageIO gives them.
        kinds: pixel type of each channel (half, float, uint, uint8, ...).
        format: OpenImageIO's name of the file's format, such as `openexr` or `png`.
        part: number of the part.
        parts: how many the file has.
        data: window of the stored pixels.
        display: window of the picture that is meant.
        deep: a pixel holds any number of samples.
        tiled: stored in tiles.
    """

    path: str
    width: int
    height: int
    channels: tuple[str, ...]
    attributes: Mapping[str, Any]
    kinds: tuple[str, ...]
    format: str
    part: int
    parts: int
    data: Window
    display: Window
    deep: bool
    tiled: bool

    @property
    def name(self) -> str:
        """Name of the part; "" in a file of a single part."""
        return str(self.attributes.get("oiio:subimagename", "")) if self.parts > 1 else ""

    @property
    def plain(self) -> bool:
        """Whether it is what nearly every renderer writes: one part of half or float scan lines."""
        flat = not (self.deep or self.tiled) and self.parts == 1
        return self.format == "openexr" and flat and set(self.kinds) <= set(_PLAIN)

    @property
    def pixel_bytes(self) -> int:
        """Bytes of a pixel of a plain EXR."""
        return sum(_PLAIN[kind] for kind in self.kinds)


@dataclass(frozen=True)
class ExrImage:
    """A picture: planes `[H, W]` float32 by channel name, and the header."""

    channels: Planes
    header: ImageHeader

    def stack(self, names: Sequence[str]) -> F32:
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
    """The header of the first part.

    Raises:
        JobError: as `read_headers`.
    """
    return read_headers(path)[0]


def read_headers(path: str | Path) -> tuple[ImageHeader, ...]:
    """The headers of all parts; refuses pictures whose claimed size is absurd before any memory is taken.

    Raises:
        JobError: the file is missing, is not an image, or claims more than `MAX_SIDE` or `MAX_CHANNELS`.
    """
    with _opened(path) as source:
        return tuple(_headers(source, path))


def read_image(path: str | Path) -> ExrImage:
    """Every channel of the first part as float32, values as stored (no colour conversion).

    Raises:
        JobError: as `read_headers` and `read_channels`.
    """
    header = read_header(path)
    return ExrImage(read_channels(header, header.channels), header)


def read_channels(header: ImageHeader, names: Sequence[str]) -> dict[str, F32]:
    """Some channels of a part, each `[H, W]` float32 with the values as stored; integers of EXR are not scaled.

    Raises:
        JobError: the part is deep, or its pixels are missing, truncated or damaged.
    """
    if header.deep:
        raise JobError(
            f"The picture{_of_part(header)} is deep: a pixel holds many samples", header.path, "a flat picture",
            "flatten it, in Nuke with DeepToImage, or render it flat",
        )  # fmt: skip
    planes = None
    if header.plain and header.pixel_bytes <= WHOLE:
        planes = _scanlines(header, names)
    return _any_pixels(header, names) if planes is None else planes


def _scanlines(header: ImageHeader, names: Sequence[str]) -> dict[str, F32] | None:
    """Channels of a plain EXR by the OpenEXR package; None if it cannot: then OpenImageIO says why."""
    try:
        planes = read_planes(header.path)
    except (RuntimeError, ValueError):
        return None
    if any(name not in planes or planes[name].shape != (header.height, header.width) for name in names):
        return None
    return {name: np.asarray(planes[name], np.float32) for name in names}


def _any_pixels(header: ImageHeader, names: Sequence[str]) -> dict[str, F32]:
    """Channels of any picture by OpenImageIO, neighbours of one type together."""
    planes: dict[str, F32] = {}
    with _opened(header.path) as source:
        for first, last in _runs(header, sorted({header.channels.index(name) for name in names})):
            pixels = _range(source, header, first, last)
            for index in range(first, last):
                planes[header.channels[index]] = np.ascontiguousarray(pixels[..., index - first])
    return {name: planes[name] for name in names}


def _runs(header: ImageHeader, indices: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Channels as ranges of neighbours that have one pixel type."""
    first = indices[0]
    for now, following in zip(indices, [*indices[1:], None], strict=True):
        if following != now + 1 or header.kinds[following] != header.kinds[now]:
            yield first, now + 1
            first = following if following is not None else first


def _range(source: Any, header: ImageHeader, first: int, last: int) -> F32:
    """Neighbouring channels [H, W, C]; refused unless every pixel was read.

    Raises:
        JobError: OpenImageIO reports missing or damaged pixels. What it would return then is uninitialised.
    """
    import OpenImageIO as oiio

    integers = header.format == "openexr" and header.kinds[first] == "uint"  # else scaled by 2^-32
    pixels = source.read_image(header.part, 0, first, last, oiio.UINT if integers else oiio.FLOAT)
    problem: str = source.geterror().strip()
    if pixels is None or problem:
        raise JobError(
            f"The image is damaged or cut short ({problem.splitlines()[0] if problem else 'no pixels'})",
            header.path,
            f"{header.width}x{header.height} pixels, {len(header.channels)} channels",
            "copy or export this file again",
        )
    return np.asarray(pixels, dtype=np.float32).reshape(header.height, header.width, last - first)


@contextmanager
def _opened(path: str | Path) -> Iterator[Any]:
    """An OpenImageIO reader that leaves alpha as it is stored.

    Raises:
        JobError: the file is missing or cannot be opened.
    """
    import OpenImageIO as oiio

    if not Path(path).is_file():
        raise JobError("The image is missing", str(path), "a readable file", "check the path and the frame range")
    straight = oiio.ImageSpec()
    straight.attribute("oiio:UnassociatedAlpha", 1)  # PNG keeps the alpha it was written with
    source = oiio.ImageInput.open(str(path), straight)
    if source is None:
        raise _cannot_open(str(path), oiio.geterror())
    try:
        yield source
    finally:
        source.close()


def _cannot_open(path: str, problem: str) -> JobError:
    first = (problem or "unknown format").strip().splitlines()[0]
    if "Subsampled" in first:
        return JobError(
            f"The image has channels of lower resolution, as luminance-chroma EXRs have ({first.rstrip('.')})", path,
            "channels of full resolution", "export it as RGB",
        )  # fmt: skip
    return JobError(f"The image cannot be opened ({first})", path, "an EXR, PNG, TIFF, JPEG or DPX", "export it again")


def _headers(source: Any, path: str | Path) -> Iterator[ImageHeader]:
    parts = max(1, source.spec().get_int_attribute("oiio:subimages", 1))
    if parts > MAX_PARTS:
        raise _absurd(path, f"{parts} parts", f"at most {MAX_PARTS}")
    for part in range(parts):
        if not source.seek_subimage(part, 0):
            raise _cannot_open(str(path), source.geterror())
        yield _header(source, path, part, parts)


def _header(source: Any, path: str | Path, part: int, parts: int) -> ImageHeader:
    spec = source.spec()
    if not (0 < spec.width <= MAX_SIDE and 0 < spec.height <= MAX_SIDE and 0 < spec.nchannels <= MAX_CHANNELS):
        claimed = f"{spec.width}x{spec.height} pixels and {spec.nchannels} channels"
        raise _absurd(path, claimed, f"at most {MAX_SIDE}x{MAX_SIDE} and {MAX_CHANNELS} channels")
    names = tuple(spec.channelnames)
    kinds = tuple(str(kind) for kind in spec.channelformats) or (str(spec.format),) * len(names)
    return ImageHeader(
        str(path), spec.width, spec.height, names, {a.name: a.value for a in spec.extra_attribs}, kinds,
        source.format_name(), part, parts, Window(spec.x, spec.y, spec.width, spec.height),
        Window(spec.full_x, spec.full_y, spec.full_width, spec.full_height), bool(spec.deep), spec.tile_width > 0,
    )  # fmt: skip


def _absurd(path: str | Path, claimed: str, most: str) -> JobError:
    return JobError(f"The header claims {claimed}", str(path), most, "this file is damaged or hostile: export it again")


def _of_part(header: ImageHeader) -> str:
    """How a message names a part."""
    return f" in part {header.name or header.part + 1}" if header.parts > 1 else ""
