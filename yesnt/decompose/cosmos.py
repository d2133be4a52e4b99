"""Backend for DiffusionRenderer-Cosmos (7B): runs a checkout of the model in a process of its own.

The checkout is not a diffusers model, and its packages conflict with ours. Its files are pickles and TorchScript,
which execute code when they are loaded. A job therefore has to name the Python interpreter and to set
`allow_pickle: true`.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import srgb_encode
from yesnt.core.errors import JobError, YesntError
from yesnt.decompose.backend import Clip, Footprint
from yesnt.decompose.published import COSMOS
from yesnt.decompose.settings import EnsembleSettings

Float32 = NDArray[np.float32]

_RUNNER = Path(__file__).parent / "inside_cosmos" / "run.py"
_PASSES = ("roughness", "metallic")
_SIZE = (704, 1280)
"""Rows and columns that the model was trained at. Frames are resized to it and back, as the model's own script does."""

_STDERR_CHARACTERS = 2000
"""Number of last characters of a failed process's stderr that go into the error message."""


class CosmosBackend:
    """Video backend that draws clips of roughness and metallic with the user's checkout.

    The model draws its own noise from one integer seed. The seed of each member, quantity and window is derived from
    the seed of the job, so a member is reproducible on the same machine. Antithetic pairs are not possible.

    Args:
        folder: the checkout, with `checkpoints/` below it.
        steps: denoising steps per quantity.
        window: frames of a clip: 57, or 1.
        window_overlap: least number of frames that consecutive windows share.
        python: interpreter of the checkout's environment.
        allow_pickle: must be true, because the checkout loads pickles.
        offload: move network and tokenizer to the GPU in turn, which takes less memory and more time.

    Raises:
        JobError: a file is missing, no interpreter is given, or pickles are not allowed.
    """

    def __init__(
        self,
        folder: Path,
        steps: int = 15,
        window: int = 57,
        window_overlap: int = 8,
        python: str = "",
        allow_pickle: bool = False,
        offload: bool = True,
    ) -> None:
        COSMOS.check(folder)
        if not python or not allow_pickle:
            raise JobError(
                "diffusion-renderer-cosmos runs the code and opens the pickles of a checkout",
                "key decompose.knobs",
                "python: the interpreter of the checkout's environment, and allow_pickle: true",
                "set both if you trust that checkout",
            )
        self._folder, self._python, self._offload, self._steps = folder, python, offload, steps
        self.footprint = Footprint(None, 1, steps * len(_PASSES), window, window_overlap)

    def draw(self, clip: Clip, seed: int, members: Sequence[int], settings: EnsembleSettings) -> Iterator[Float32]:
        """Draws members of a clip, [F, 2, H, W] each, in one process, because loading the model takes a minute.

        Raises:
            YesntError: the process failed or wrote arrays of another shape.
        """
        with tempfile.TemporaryDirectory(prefix="yesnt-cosmos-") as name:
            home = Path(name)
            _write_frames(home / "clips" / "clip", clip)
            self._run(home, clip, seed, members)
            for member in members:
                yield np.stack([_read(home / f"{member}.{one}.npy", clip) for one in _PASSES], axis=1)

    def _run(self, home: Path, clip: Clip, seed: int, members: Sequence[int]) -> None:
        request = home / "request.json"
        draws = [
            {"pass": one, "seed": draw_seed(seed, clip.frames[0], member, one),
             "output": str(home / f"{member}.{one}.npy")}
            for member in members for one in _PASSES
        ]  # fmt: skip
        document = {
            "folder": str(home / "clips"), "checkpoints": str(self._folder / "checkpoints"), "draws": draws,
            "frames": len(clip.frames), "height": _SIZE[0], "width": _SIZE[1], "steps": self._steps,
            "offload": self._offload,
        }  # fmt: skip
        request.write_text(json.dumps(document))
        done = subprocess.run(
            [self._python, str(_RUNNER), str(request)], cwd=self._folder, capture_output=True, text=True,
            env={**os.environ, "PYTHONPATH": str(self._folder)}, check=False,
        )  # fmt: skip
        if done.returncode:
            raise YesntError(
                f"The checkout's process ended with {done.returncode}: {done.stderr[-_STDERR_CHARACTERS:].strip()}",
                str(self._folder), "the float arrays of every member", "try the checkout's own example first",
            )  # fmt: skip


def draw_seed(seed: int, frame: int, member: int, quantity: str) -> int:
    """Returns a 31-bit seed that is a hash of job seed, frame, member and quantity."""
    text = f"{seed} {frame} {member} {quantity}".encode()
    return int.from_bytes(hashlib.blake2b(text, digest_size=4).digest(), "little") >> 1


def _write_frames(folder: Path, clip: Clip) -> None:
    """Writes display-referred 8-bit PNGs over white at the model's size, which is what its data loader reads."""
    import cv2

    folder.mkdir(parents=True)
    for i, (rgb, matte) in enumerate(zip(clip.rgb, clip.matte, strict=True)):
        shown = srgb_encode(np.clip(rgb, 0, 1)) * matte[..., None] + (1 - matte[..., None])
        sized = cv2.resize(shown.astype(np.float32), _SIZE[::-1], interpolation=cv2.INTER_AREA)
        done, data = cv2.imencode(".png", np.rint(255 * sized[..., ::-1]).astype(np.uint8))
        assert done
        (folder / f"{i:04d}.png").write_bytes(data.tobytes())


def _read(path: Path, clip: Clip) -> Float32:
    """Reads one quantity and returns it at the clip's size, [F, H, W]."""
    import cv2

    height, width = clip.matte.shape[1:]
    values = np.load(path, allow_pickle=False)
    if values.shape != (len(clip.frames), *_SIZE) or not np.isfinite(values).all():
        raise YesntError(
            f"The checkout's process wrote {values.shape}", str(path), f"finite {(len(clip.frames), *_SIZE)}",
            "check its version",
        )  # fmt: skip
    return np.stack([cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA) for frame in values])
