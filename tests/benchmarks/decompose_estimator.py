"""Validation loss of the estimator, whole and with single levels zeroed: does every part of it contribute?

python tests/benchmarks/decompose_estimator.py CHECKPOINT [--pictures 100]

The loss of a healthy estimator rises when coarse levels are zeroed, and the standard deviation of every level is below
a few tens. A learning rate of 4e-3 once raised that of the coarse levels to several hundred; zeroing them then changed
nothing.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from torch.nn import functional as F

from yesnt.decompose.global_context import ContextBatch
from yesnt.decompose.network import Network, NetworkShape
from yesnt.decompose.weights import PATCH
from yesnt.training.checkpoint import read_state
from yesnt.training.losses import estimator_loss
from yesnt.training.synthetic.dataset import Patches, draw_patches
from yesnt.training.synthetic.materials import CLASSES

SEED = 1_000_007
"""Of the pictures; training's own seed is 0."""

ZEROED = (
    "skips.0.coarse",
    "skips.1.coarse",
    "skips.2.coarse",
    "statistics",
    "context_projection",
    "global_pooling.mix.2",
)


def figures(estimator, classes, patches):
    losses, hits, squares, variances = [], [], [], []
    for rows in np.array_split(np.arange(len(patches.rgb)), max(1, len(patches.rgb) // 20)):
        rgb, matte, truth, kind, whole, place = (
            torch.from_numpy(np.ascontiguousarray(p[rows])) for p in patches.planes()[:6]
        )
        with torch.no_grad():
            read = estimator(rgb, matte, ContextBatch(whole, place))
            scores = classes(read)
        losses.append(float(estimator_loss(read, scores, 2 * truth - 1, kind, matte)))
        inside = F.avg_pool2d(matte, 2)[:, 0] > 0.99
        hits.append(float((scores.argmax(1) == kind[:, ::2, ::2])[inside].float().mean()))
        clean = F.avg_pool2d(truth[:, :1], 2)[:, 0][inside]
        squares.append(float(((read[:, 0] + 1) / 2)[inside].sub(clean).square().mean()))
        variances.append(clean)
    return np.mean(losses), np.mean(hits), np.mean(squares) ** 0.5, float(torch.cat(variances).std())


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("--pictures", type=int, default=100)
    options = parser.parse_args()
    torch.set_num_threads(1)
    state, shape = read_state(options.checkpoint), NetworkShape()
    network, classes = Network(shape), torch.nn.Conv2d(shape.condition, len(CLASSES), 1)
    network.load_state_dict(state["network"])
    classes.load_state_dict(state["classes"])
    patches = Patches.join([draw_patches(SEED, i, 2, PATCH) for i in range(options.pictures)])
    estimator = network.eval().estimator
    loss, accuracy, error, constant = figures(estimator, classes, patches)
    print(f"step {state['step']}: loss {loss:.3f}, class accuracy {accuracy:.3f}")
    print(f"roughness: RMSE of the regression {error:.4f}, of the best constant {constant:.4f}")
    modules = dict(estimator.named_modules())
    for name in ZEROED:
        layer = modules[name]
        kept = layer.weight.detach().clone()
        layer.weight.data.zero_()
        print(f"without {name:14s} {figures(estimator, classes, patches)[0] / loss:.3f} of the loss")
        layer.weight.data.copy_(kept)
    deviations = {}
    for name in ("levels.0", "levels.1", "levels.2", "levels.3"):
        modules[name].register_forward_hook(lambda _, __, out, name=name: deviations.update({name: float(out.std())}))
    figures(estimator, classes, Patches(*(p[:8] for p in patches.planes())))
    print("standard deviation of the levels:", ", ".join(f"{name} {value:.1f}" for name, value in deviations.items()))


if __name__ == "__main__":
    main()
