"""Weights of the embedded model as safetensors of 8 and 16 bits with the network's shape in the header."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import save_file

from yesnt.core.errors import CorruptError, JobError
from yesnt.decompose.network import Network, NetworkShape

FORMAT = "2"
"""Version of the file: 2 since the tensors carry the names `estimator`, `denoiser` and `auxiliary`."""

SMOOTH_SIGMAS = (4.0, 16.0, 64.0)
"""Blur in pixels of the noise planes that steer a draw: from a seam to a whole garment."""

PATCH = 128
"""Side of the patches that weights are made for."""

SHIPPED = Path(__file__).parent.parent / "data" / "weights" / "embedded.safetensors"
"""The weights in the package."""

_SCALE = ".scale"
"""Ends the name of the scales that belong to a tensor of 8 bits."""

_LEVELS = 127
"""Steps on either side of 0."""

Tensors = dict[str, torch.Tensor]


def save_weights(network: Network, path: Path, patch: int = PATCH) -> None:
    """Writes weights whole or not at all."""
    tensors = packed(network.state_dict())
    part = path.with_suffix(".part")
    save_file(tensors, part, {"format": FORMAT, "shape": network.shape.header(), "patch": str(patch)})
    part.chmod(0o644)  # safetensors creates it for the owner only
    part.replace(path)


def load_weights(path: Path) -> tuple[Network, int]:
    """Reads a network.

    Returns:
        The network in float32, in evaluation mode, and its patch side.

    Raises:
        JobError: there is no such file.
        CorruptError: the file is not what `save_weights` writes.
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
    """Refuses weights whose tensors carry the names of another version; files of version 1 state none."""
    found = header.get("format", "1")
    if found != FORMAT:
        raise JobError(
            f"the weights have format {found}",
            str(path),
            f"format {FORMAT}",
            "use the weights of the installed package, or make them anew with `python -m yesnt.training`",
        )


def packed(state: Tensors) -> Tensors:
    """Filters as 8 bits with a scale for every output channel, all else as 16 bits.

    A quarter of the numbers' size is a two-hundredth of their channel's largest in error; to pack what was unpacked
    changes nothing.
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
    """What `packed` wrote as float32; a file of 16 bits throughout, as older ones are, is read as well."""
    state = {}
    for name, value in tensors.items():
        if name.endswith(_SCALE):
            continue
        state[name] = value.float()
        if value.dtype == torch.int8:
            state[name] *= tensors[name + _SCALE].view(-1, *[1] * (value.dim() - 1))
    return state


def channels_last(network: Network) -> Network:
    """Lays the weights out as the CPU's convolutions like them."""
    for parameter in network.parameters():
        if parameter.dim() == 4:
            parameter.data = parameter.data.contiguous(memory_format=torch.channels_last)
    return network


def file_digest(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
