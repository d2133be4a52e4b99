"""Weights of the embedded model as float16 safetensors with the network's shape in the header."""

from __future__ import annotations

import hashlib
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import save_file

from yesnt.decompose.network import Network, NetworkShape
from yesnt.errors import CorruptError, JobError

SMOOTH_SIGMAS = (4.0, 16.0, 64.0)
"""Blur in pixels of the noise planes that steer a draw: from a seam to a whole garment."""

PATCH = 128
"""Side of the patches that weights are made for."""

SHIPPED = Path(__file__).parent.parent / "data" / "weights" / "embedded.safetensors"
"""The weights in the package."""


def save_weights(network: Network, path: Path, patch: int = PATCH) -> None:
    """Writes float16 weights whole or not at all."""
    tensors = {name: value.half().contiguous() for name, value in network.state_dict().items()}
    part = path.with_suffix(".part")
    save_file(tensors, part, {"shape": network.shape.header(), "patch": str(patch)})
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
            header = file.metadata()
            tensors = {name: file.get_tensor(name).float() for name in file.keys()}
        network = Network(NetworkShape.from_header(header["shape"]))
        network.load_state_dict(tensors)
        patch = int(header["patch"])
    except Exception as error:
        raise CorruptError(
            f"the weights cannot be read ({error})",
            str(path),
            "a file written by `python -m yesnt.training`",
            "restore the file",
        ) from error
    return channels_last(network.eval().requires_grad_(False)), patch


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
