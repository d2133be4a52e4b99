"""DiffusionRenderer-Cosmos (7B) through a user's checkout, run by the checkout's own Python as a process of its own.

It is not a diffusers model and needs packages that would fight ours; its files are pickles and TorchScript, which run
code when they are opened. So the job must name the Python and say `allow_pickle: true`.
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
from yesnt.decompose.backend import Clip, Footprint, Licence
from yesnt.decompose.published import COSMOS
from yesnt.decompose.settings import EnsembleSettings

Float32 = NDArray[np.float32]

_RUNNER = Path(__file__).parent / "inside_cosmos" / "run.py"
_PASSES = ("roughness", "metallic")
_SIZE = (704, 1280)
"""Rows and columns that the model was trained at; frames are stretched to it and back, as its own script does."""

_STDERR_CHARACTERS = 2000
"""Last characters of what a failed process said that go into the error."""


class CosmosBackend:
    """SamplePairs clips of roughness and metallic in a process of the user's checkout.

    The model draws its noise itself, from one seed; we give each member, quantity and window a seed made from the
    job's, so a member is the same whenever it is drawn on the same machine. Members cannot be paired.

    Args:
        folder: the checkout, with `checkpoints/` below it.
        steps: denoising steps of each quantity.
        window: frames of a clip: 57, or 1.
        window_overlap: frames that neighbouring windows share at least.
        python: the interpreter of the checkout's environment.
        allow_pickle: must be true: the checkout opens pickles.
        offload: network and tokenizer leave the GPU in turn (less memory, more time).

    Raises:
        JobError: a file is absent, or the job does not name the Python or does not allow pickles.
    """

    name = "diffusion-renderer-cosmos"
    licence = Licence("NVIDIA-Open-Model", commercial=True)

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
                f"{self.name} runs the code and opens the pickles of a checkout",
                "key decompose.knobs",
                "python: the interpreter of the checkout's environment, and allow_pickle: true",
                "set both if you trust that checkout",
            )
        self._folder, self._python, self._offload, self._steps = folder, python, offload, steps
        self.footprint = Footprint(None, 1, steps * len(_PASSES), window, window_overlap)
        self.weights_digest = COSMOS.digest(folder)

    def draw(self, clip: Clip, seed: int, members: Sequence[int], settings: EnsembleSettings) -> Iterator[Float32]:
        """Members of a clip, [F, 2, H, W] each; all of them in one process, since loading takes a minute."""
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
    """A 31-bit seed from the key of a draw."""
    text = f"{seed} {frame} {member} {quantity}".encode()
    return int.from_bytes(hashlib.blake2b(text, digest_size=4).digest(), "little") >> 1


def _write_frames(folder: Path, clip: Clip) -> None:
    """Display-referred 8-bit PNGs over white, stretched to the model's size: what its own estimator takes."""
    import cv2

    folder.mkdir(parents=True)
    for i, (rgb, matte) in enumerate(zip(clip.rgb, clip.matte, strict=True)):
        shown = srgb_encode(np.clip(rgb, 0, 1)) * matte[..., None] + (1 - matte[..., None])
        sized = cv2.resize(shown.astype(np.float32), _SIZE[::-1], interpolation=cv2.INTER_AREA)
        done, data = cv2.imencode(".png", np.rint(255 * sized[..., ::-1]).astype(np.uint8))
        assert done
        (folder / f"{i:04d}.png").write_bytes(data.tobytes())


def _read(path: Path, clip: Clip) -> Float32:
    """A quantity [F, H, W] at the clip's size."""
    import cv2

    height, width = clip.matte.shape[1:]
    values = np.load(path, allow_pickle=False)
    if values.shape != (len(clip.frames), *_SIZE) or not np.isfinite(values).all():
        raise YesntError(
            f"The checkout's process wrote {values.shape}", str(path), f"finite {(len(clip.frames), *_SIZE)}",
            "check its version",
        )  # fmt: skip
    return np.stack([cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA) for frame in values])
