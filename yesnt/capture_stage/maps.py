"""Environment maps of the capture stage by name: procedural ones, Blender's own, fetched ones; 512x256."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yesnt.capture_stage.assets import MANIFEST, fetch
from yesnt.capture_stage.procedural_maps import OWN_MAPS, reduce_by_two, write_map
from yesnt.capture_stage.tools import Tools, blender_maps
from yesnt.core.errors import UsageError
from yesnt.io.durable import durable_path
from yesnt.io.pictures.image import read_image

_RENAMED = {"photo_studio": "studio"}
"""Blender calls its own `studio`; that name is taken by the project's map."""

_WIDTH = 512


def map_path(name: str, tools: Tools) -> Path:
    """The EXR of a light, made once in the cache.

    Raises:
        UsageError: no such map.
    """
    path = Path(tools.cache) / "maps" / f"{name}.exr"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_map(path, _radiance(name, tools))
    return path


def _radiance(name: str, tools: Tools) -> NDArray[np.float32]:
    if name in OWN_MAPS:
        return OWN_MAPS[name]()
    if f"hdri-{name}" in MANIFEST:
        return _clean(_read_embedded(fetch(f"hdri-{name}", Path(tools.cache)), Path(tools.cache)))
    source = blender_maps(tools) / f"{_RENAMED.get(name, name)}.exr"
    if not source.exists():
        raise UsageError(
            f"There is no map {name!r}", str(source), "a map of the stage", "name one of yesnt.capture_stage.jobs"
        )
    return _clean(read_image(source).stack("RGB"))


def _clean(radiance: NDArray[np.float32]) -> NDArray[np.float32]:
    """Takes out what a codec left (negative lobes, NaN) and halves a map to 512 columns; no clamp above."""
    out = np.maximum(np.nan_to_num(radiance, nan=0.0, posinf=0.0, neginf=0.0), 0.0).astype(np.float32)
    while out.shape[1] > _WIDTH:
        out = reduce_by_two(out)
    return out


def _read_embedded(script: Path, cache: Path) -> NDArray[np.float32]:
    """Reads an EXR out of a JavaScript module that holds it as a base64 data address."""
    text = script.read_text()
    start = text.index("base64,") + len("base64,")
    end = min(at for at in (text.find(quote, start) for quote in "'\"`") if at > 0)
    with durable_path(cache / f"{script.stem}") as temporary:
        temporary.write_bytes(base64.b64decode(text[start:end]))
        return read_image(temporary).stack("RGB")
