"""Weights file of the embedded model: safetensors with 8- and 16-bit values; its header holds the network's sizes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import save_file

from yesnt.core.errors import CorruptError, JobError
from yesnt.decompose.network import Network, NetworkShape

FORMAT = "2"
"""Version of the file: 2 since the tensors are named `estimator`, `denoiser` and `auxiliary`."""

SMOOTH_SIGMAS = (4.0, 16.0, 64.0)
"""Blur in pixels of the smooth noise planes, from the width of a seam to that of a garment."""

PATCH = 128
"""Side in pixels of the patches that the network is trained on."""

_SCALE = ".scale"
"""Suffix of the name of the scales of an 8-bit tensor."""

_LEVELS = 127
"""Quantisation steps on either side of 0."""

Tensors = dict[str, torch.Tensor]


def save_weights(network: Network, path: Path, patch: int = PATCH) -> None:
    """Writes the weights of a network atomically, by renaming a finished file.

    Args:
        network: network to store; its values are quantised (`packed`).
        path: file to write.
        patch: side of the patches in pixels.
    """
    tensors = packed(network.state_dict())
    part = path.with_suffix(".part")
    save_file(tensors, part, {"format": FORMAT, "shape": network.shape.header(), "patch": str(patch)})
    part.chmod(0o644)  # safetensors creates it for the owner only
    part.replace(path)


def load_weights(path: Path) -> tuple[Network, int]:
    """Reads a network.

    Returns:
        The network in float32 and evaluation mode, without gradients, and its patch side in pixels.

    Raises:
        JobError: there is no such file, or it has another format.
        CorruptError: the file is not one that `save_weights` wrote.
    """
    if not path.is_file():
        raise JobError(
            "the weights of the embedded model are missing",
            str(path),
            "a safetensors file",
            "reinstall the package, or make it with `python -m yesnt.training`",
        )
    try:
        with safe_open(path, "pt") as file:
            header = file.metadata() or {}
            _refuse_other_formats(header, path)
            tensors = unpacked({name: file.get_tensor(name) for name in file.keys()})
        network = Network(NetworkShape.from_header(header["shape"]))
        network.load_state_dict(tensors)
        patch = int(header["patch"])
    except JobError:
        raise
    except Exception as error:
        raise CorruptError(
            f"the weights cannot be read ({error})",
            str(path),
            "a file written by `python -m yesnt.training`",
            "restore the file",
        ) from error
    return channels_last(network.eval().requires_grad_(False)), patch


def _refuse_other_formats(header: Mapping[str, str], path: Path) -> None:
    """Raises JobError for weights of another format, whose tensors have other names."""
    found = header.get("format", "1 or unknown")  # format 1 did not state itself
    if found != FORMAT:
        raise JobError(
            f"the weights have format {found}",
            str(path),
            f"format {FORMAT}",
            "use the weights of the installed package, or make them anew with `python -m yesnt.training`",
        )


def packed(state: Tensors) -> Tensors:
    """Quantises a state dict: filters to 8 bits with a scale per output channel, everything else to 16 bits.

    The error is at most 1/254 of the largest weight of the channel. Packing unpacked values changes nothing.
    """
    tensors = {}
    for name, value in state.items():
        if value.dim() < 2:
            tensors[name] = value.half().contiguous()
            continue
        largest = value.flatten(1).abs().amax(1).clamp_min(1e-12)
        scale = (largest / _LEVELS).view(-1, *[1] * (value.dim() - 1))
        tensors[name] = torch.round(value / scale).to(torch.int8).contiguous()
        tensors[name + _SCALE] = scale.flatten().contiguous()
    return tensors


def unpacked(tensors: Tensors) -> Tensors:
    """Returns float32 tensors of what `packed` returned; 16-bit tensors without scales are converted."""
    state = {}
    for name, value in tensors.items():
        if name.endswith(_SCALE):
            continue
        state[name] = value.float()
        if value.dtype == torch.int8:
            state[name] *= tensors[name + _SCALE].view(-1, *[1] * (value.dim() - 1))
    return state


def channels_last(network: Network) -> Network:
    """Stores the convolution weights channels last, the fastest layout on CPUs, and returns the network."""
    for parameter in network.parameters():
        if parameter.dim() == 4:
            parameter.data = parameter.data.contiguous(memory_format=torch.channels_last)
    return network
