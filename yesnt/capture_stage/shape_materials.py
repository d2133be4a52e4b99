"""Materials of the painted shapes as layers, the outermost last."""

from __future__ import annotations

from yesnt.capture_stage.material_layers import Between, Layer, Layers


def worn_metal() -> Layers:
    """Brushed steel with gilded stretches, and rust, which is not metallic."""
    return (
        Layer("steel", (), "brushed", ((0.66, 0.67, 0.69), (0.50, 0.51, 0.53)), 40, (0.08, 0.42), 1.0),
        Layer("gold", (Between("gilt", 0.73),), "noise", ((0.95, 0.70, 0.30), (0.85, 0.56, 0.20)), 14, (0.05, 0.20),
              1.0),
        Layer("rust", (Between("rust", 0.84),), "noise", ((0.30, 0.10, 0.035), (0.14, 0.05, 0.025)), 20, (0.75, 1.0)),
    )  # fmt: skip


def glaze() -> Layers:
    """Glazed bands over a bare clay foot, with a gilded lip."""
    return (
        Layer("glaze", (), "noise", ((0.10, 0.30, 0.34), (0.05, 0.17, 0.24)), 9, (0.05, 0.16)),
        Layer("band", (Between("z", 0.50, 0.66),), "checks", ((0.72, 0.66, 0.52), (0.45, 0.10, 0.06)), 12, (0.12,
              0.28)),
        Layer("matt band", (Between("z", 0.70, 0.80),), "spots", ((0.62, 0.56, 0.44), (0.10, 0.12, 0.20)), 26, (0.5,
              0.7)),
        Layer("clay", (Between("z", high=0.13),), "noise", ((0.42, 0.21, 0.12), (0.30, 0.14, 0.08)), 26, (0.8, 1.0)),
        Layer("inside", (Between("inside", 0.5),), "plain", ((0.36, 0.20, 0.12), (0.28, 0.15, 0.09)), 10, (0.6, 0.8)),
        Layer("lip", (Between("z", 0.975),), "brushed", ((0.93, 0.72, 0.38), (0.82, 0.58, 0.26)), 40, (0.15, 0.3),
              1.0),
    )  # fmt: skip


def brocade() -> Layers:
    """Wool with a satin border and a woven metal hem."""
    return (
        Layer("wool", (), "plaid", ((0.10, 0.16, 0.09), (0.42, 0.36, 0.22)), 7, (0.8, 1.0)),
        Layer("satin", (Between("hem", 0.07, 0.20),), "stripes", ((0.40, 0.05, 0.10), (0.28, 0.03, 0.08)), 30,
              (0.24, 0.40)),
        Layer("thread", (Between("hem", 0.03, 0.07),), "spots", ((0.88, 0.68, 0.36), (0.70, 0.48, 0.22)), 60, (0.3,
              0.5), 1.0),
    )  # fmt: skip
