"""Costumes of the humans: skin and garments as material layers, the outermost last."""

from __future__ import annotations

from yesnt.capture_stage.material_layers import Between, Color, Layer, Layers

FRONT = 10.0  # metres: "anything in front of"
_TRUNK = Between("arms", high=0.5)
_NOT_HEAD = (Between("head", high=0.35), Between("neck", high=0.5))


def _skin(tone: Color, deep: Color) -> tuple[Layer, ...]:
    red: Color = (min(1.0, tone[0] * 0.85), tone[1] * 0.55, tone[2] * 0.5)
    return (
        Layer("skin", (), "noise", (tone, deep), 14, (0.38, 0.55)),
        Layer("lips", (Between("head", 0.5), Between("z", 1.588, 1.612), Between("y", -FRONT, -0.135), Between("x",
              -0.024, 0.024)), "plain", (red, red), 10, (0.28, 0.34)),
        Layer("eyes", (Between("eyes", 0.5),), "plain", ((0.55, 0.53, 0.5), (0.5, 0.48, 0.46)), 10, (0.06, 0.1)),
    )  # fmt: skip


def explorer() -> Layers:
    """The embedded shot: checked shirt, ribbed trousers, boots, plates of metal, a rubber band."""
    return (
        *_skin((0.50, 0.29, 0.20), (0.38, 0.19, 0.12)),
        Layer("hair", (Between("head", 0.5), Between("scalp", 0.0)), "noise", ((0.035, 0.02, 0.012), (0.10, 0.055,
              0.03)), 42, (0.45, 0.65), thickness=0.016, softness=0.02),
        Layer("shirt", (_TRUNK, Between("z", 1.0, 1.49), *_NOT_HEAD), "plaid", ((0.55, 0.09, 0.06), (0.72, 0.62,
              0.44)), 11, (0.72, 0.95), thickness=0.010),
        Layer("sleeves", (Between("arms", 0.5), Between("sleeve", -1, 1.45), Between("hands", high=0.5)), "plaid",
              ((0.55, 0.09, 0.06), (0.72, 0.62, 0.44)), 11, (0.72, 0.95), thickness=0.011),
        Layer("trousers", (_TRUNK, Between("z", 0.15, 1.03)), "stripes", ((0.06, 0.09, 0.17), (0.15, 0.21, 0.32)),
              26, (0.48, 0.74), thickness=0.012),
        Layer("boots", (Between("z", high=0.19),), "noise", ((0.16, 0.075, 0.03), (0.07, 0.03, 0.014)), 18, (0.28,
              0.5), thickness=0.012),
        Layer("soles", (Between("z", high=0.02),), "plain", ((0.02, 0.02, 0.022), (0.03, 0.03, 0.03)), 10, (0.85,
              0.95)),
        Layer("belt", (_TRUNK, Between("z", 1.0, 1.05)), "noise", ((0.12, 0.055, 0.02), (0.06, 0.03, 0.012)), 24,
              (0.30, 0.42), thickness=0.018),
        Layer("buckle", (_TRUNK, Between("z", 0.992, 1.058), Between("x", -0.045, 0.045), Between("y", -FRONT,
              0.0)), "brushed", ((0.92, 0.72, 0.36), (0.80, 0.58, 0.26)), 60, (0.12, 0.22), 1.0, 0.026),
        Layer("plates", (Between("shoulder", high=0.105), *_NOT_HEAD), "brushed", ((0.78, 0.79, 0.80), (0.60, 0.61,
              0.63)), 40, (0.14, 0.28), 1.0, 0.026),
        Layer("collar", (_TRUNK, Between("neck", 0.30), Between("head", high=0.2)), "brushed", ((0.90, 0.60, 0.42),
              (0.75, 0.45, 0.30)), 50, (0.20, 0.34), 1.0, 0.010),
        Layer("bracer", (Between("sleeve", 1.52, 1.90), Between("x", high=0)), "brushed", ((0.83, 0.83, 0.86),
              (0.66, 0.67, 0.70)), 45, (0.10, 0.22), 1.0, 0.012),
        Layer("band", (Between("sleeve", 1.62, 1.88), Between("x", low=0)), "plain", ((0.02, 0.28, 0.26), (0.02,
              0.22, 0.22)), 10, (0.42, 0.5), thickness=0.012),
    )  # fmt: skip


def athlete() -> Layers:
    """The boxer: much bare skin, satin shorts, leather gloves and boots, a steel belt plate."""
    return (
        *_skin((0.30, 0.15, 0.09), (0.20, 0.09, 0.055)),
        Layer("hair", (Between("head", 0.5), Between("scalp", 0.012)), "noise", ((0.012, 0.009, 0.008), (0.03,
              0.022, 0.018)), 60, (0.6, 0.8), thickness=0.006, softness=0.02),
        Layer("shorts", (_TRUNK, Between("z", 0.58, 1.06)), "stripes", ((0.62, 0.50, 0.10), (0.50, 0.38, 0.06)), 6,
              (0.22, 0.40), thickness=0.018, softness=0.03),
        Layer("belt", (_TRUNK, Between("z", 1.0, 1.075)), "plain", ((0.03, 0.03, 0.035), (0.05, 0.05, 0.055)), 14,
              (0.35, 0.55), thickness=0.024),
        Layer("belt plate", (_TRUNK, Between("z", 0.99, 1.085), Between("x", -0.08, 0.08), Between("y", -FRONT,
              0.0)), "brushed", ((0.72, 0.73, 0.75), (0.55, 0.56, 0.58)), 50, (0.10, 0.2), 1.0, 0.032),
        Layer("gloves", (Between("sleeve", 1.68),), "noise", ((0.42, 0.03, 0.025), (0.26, 0.02, 0.02)), 22, (0.18,
              0.36), thickness=0.022, softness=0.05),
        Layer("cuffs", (Between("sleeve", 1.66, 1.80),), "plain", ((0.75, 0.74, 0.70), (0.6, 0.59, 0.56)), 10, (0.7,
              0.9), thickness=0.014, softness=0.05),
        Layer("boots", (Between("z", high=0.26),), "checks", ((0.80, 0.80, 0.78), (0.12, 0.12, 0.14)), 8, (0.4,
              0.62), thickness=0.012),
        Layer("soles", (Between("z", high=0.02),), "plain", ((0.3, 0.16, 0.06), (0.2, 0.1, 0.04)), 10, (0.85, 0.95)),
    )  # fmt: skip


def performer() -> Layers:
    """The dancer: a sequinned bodice, metallic leggings, one long glove, soft shoes."""
    return (
        *_skin((0.62, 0.40, 0.30), (0.50, 0.28, 0.20)),
        Layer("hair", (Between("head", 0.5), Between("scalp", -0.02)), "stripes", ((0.40, 0.16, 0.05), (0.22, 0.08,
              0.025)), 70, (0.3, 0.5), thickness=0.022, softness=0.03),
        Layer("leggings", (_TRUNK, Between("z", 0.12, 1.0)), "noise", ((0.10, 0.24, 0.30), (0.05, 0.13, 0.2)), 10,
              (0.3, 0.5), thickness=0.005),
        Layer("bodice", (_TRUNK, Between("z", 0.92, 1.40), *_NOT_HEAD), "checks", ((0.85, 0.82, 0.88), (0.55, 0.42,
              0.66)), 22, (0.12, 0.3), 1.0, 0.007),
        Layer("sash", (_TRUNK, Between("z", 1.02, 1.12)), "plain", ((0.55, 0.30, 0.05), (0.46, 0.22, 0.03)), 14,
              (0.75, 0.95), thickness=0.018),
        Layer("skirt", (_TRUNK, Between("z", 0.72, 0.98)), "spots", ((0.50, 0.06, 0.14), (0.72, 0.45, 0.30)), 22,
              (0.65, 0.9), thickness=0.03, softness=0.12),
        Layer("glove", (Between("sleeve", 0.62), Between("x", low=0)), "plain", ((0.06, 0.05, 0.08), (0.10, 0.08,
              0.12)), 16, (0.34, 0.46), thickness=0.004),
        Layer("bangles", (Between("sleeve", 1.5, 1.86), Between("x", high=0)), "stripes", ((0.94, 0.74, 0.40), (0.6,
              0.4, 0.2)), 60, (0.08, 0.2), 1.0, 0.008),
        Layer("shoes", (Between("z", high=0.13),), "plain", ((0.5, 0.05, 0.06), (0.4, 0.04, 0.05)), 12, (0.2, 0.34),
              thickness=0.008),
    )  # fmt: skip


def courtier() -> Layers:
    """The elder: a quilted coat, leather trousers, a chain over the shoulders, boots with metal caps."""
    return (
        *_skin((0.55, 0.34, 0.25), (0.44, 0.23, 0.16)),
        Layer("hair", (Between("head", 0.5), Between("scalp", 0.005)), "noise", ((0.55, 0.54, 0.52), (0.36, 0.35,
              0.34)), 40, (0.5, 0.7), thickness=0.012, softness=0.02),
        Layer("trousers", (_TRUNK, Between("z", 0.15, 1.0)), "noise", ((0.10, 0.06, 0.04), (0.05, 0.03, 0.022)), 12,
              (0.3, 0.55), thickness=0.012),
        Layer("coat", (_TRUNK, Between("z", 0.70, 1.49), *_NOT_HEAD), "checks", ((0.12, 0.05, 0.20), (0.24, 0.12,
              0.34)), 14, (0.6, 0.9), thickness=0.028, softness=0.04),
        Layer("sleeves", (Between("arms", 0.5), Between("sleeve", -1, 1.85)), "checks", ((0.12, 0.05, 0.20), (0.24,
              0.12, 0.34)), 14, (0.6, 0.9), thickness=0.018),
        Layer("front", (_TRUNK, Between("z", 0.70, 1.44), Between("x", -0.03, 0.03), Between("y", -FRONT, 0.0),
              *_NOT_HEAD), "brushed", ((0.90, 0.70, 0.36), (0.76, 0.52, 0.24)), 30, (0.2, 0.36), 1.0, 0.032),
        Layer("chain", (Between("shoulder", 0.10, 0.15), *_NOT_HEAD), "spots", ((0.80, 0.81, 0.82), (0.4, 0.41,
              0.43)), 50, (0.1, 0.25), 1.0, 0.036),
        Layer("boots", (Between("z", high=0.40),), "noise", ((0.045, 0.03, 0.02), (0.03, 0.02, 0.015)), 14, (0.16,
              0.36), thickness=0.014),
        Layer("caps", (Between("z", high=0.075), Between("y", -FRONT, -0.10)), "brushed", ((0.7, 0.7, 0.72), (0.5,
              0.5, 0.52)), 40, (0.15, 0.3), 1.0, 0.016),
    )  # fmt: skip
