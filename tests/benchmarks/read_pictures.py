"""Reading four channels of plain and of many-layered EXRs, against decoding all channels of the file.

    python tests/benchmarks/read_pictures.py

Prints, for a 960x540 plate of half floats, ZIP, of 4, 24 and 200 channels: milliseconds to read R, G, B, A as the
product does, to decode every channel with the OpenEXR package, and the ratio of both. Each figure is the least of five.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from yesnt.io.exr import read_planes, write_exr
from yesnt.io.pictures.image import read_channels, read_headers

SIZE, REPEATS = (540, 960), 5


def least(call: Callable[[], object]) -> float:
    """Seconds of the fastest of some calls."""
    seconds = []
    for _ in range(REPEATS):
        started = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - started)
    return min(seconds)


def picture(channels: int) -> dict[str, np.ndarray]:
    """R, G, B, A and layers, smooth with noise as renders are."""
    random = np.random.default_rng(0)
    smooth = np.add.outer(np.linspace(0, 1, SIZE[0]), np.linspace(0, 1, SIZE[1]))
    names = [*"RGBA", *(f"aov{i:03d}.V" for i in range(channels - 4))]
    return {name: (smooth + 0.01 * random.random(SIZE)).astype(np.float16) for name in names}


def main() -> None:
    """Prints a line for each number of channels."""
    with tempfile.TemporaryDirectory() as folder:
        for channels in (4, 24, 200):
            path = Path(folder) / f"{channels}.exr"
            write_exr(path, picture(channels))
            few = least(lambda path=path: read_channels(read_headers(path)[0], list("RGBA")))
            every = least(lambda path=path: read_planes(path))
            print(f"{channels} channels: {1e3 * few:.1f} ms; all of them {1e3 * every:.1f} ms; ratio {few / every:.2f}")


if __name__ == "__main__":
    main()
