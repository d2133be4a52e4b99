"""Every metric by name, with the definition that is printed with it."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

Better = Literal["higher", "lower", "zero", "neither"]


@dataclass(frozen=True)
class Metric:
    """One measured number.

    Attributes:
        name: key in JSON.
        definition: what was computed, in one sentence.
        value: the number; infinite where the definition says so.
    """

    name: str
    definition: str
    value: float


@dataclass(frozen=True)
class Definition:
    """How a number is defined and read.

    Attributes:
        name: key in JSON.
        title: label in tables.
        unit: "dB", "px", "1".
        better: which direction is good.
        text: the definition.
        digits: decimals in tables.
    """

    name: str
    title: str
    unit: str
    better: Better
    text: str
    digits: int = 3

    def of(self, value: float) -> Metric:
        """A value under this definition."""
        return Metric(self.name, self.text, float(value))


_DISPLAY = "display pictures are sRGB-encoded after a clip to [0, 1], no exposure or tone curve"
_MATTE = "pixels whose coverage is above 0.99 in plate and truth"
_WHOLE = "the whole frame, associated colour over black"
_FLIP = "FLIP (Andersson et al. 2020) at 67 pixels per degree"

_ALL = (
    Definition("psnr", "PSNR", "dB", "higher", f"10 log10(1 / MSE) over {_MATTE}; {_DISPLAY}", 2),
    Definition("psnr_aligned", "PSNR al.", "dB", "higher",
               f"as PSNR, after each linear channel is scaled by sum(truth x) / sum(x x) over {_MATTE}", 2),
    Definition("psnr_whole", "PSNR whole", "dB", "higher", f"as PSNR over {_WHOLE}", 2),
    Definition("psnr_linear", "PSNR lin.", "dB", "higher",
               "10 log10(p^2 / MSE) of scene-linear values, not clipped, p = the 99th percentile of the truth, over "
               f"{_MATTE}", 2),
    Definition("psnr_linear_aligned", "PSNR lin. al.", "dB", "higher",
               "as PSNR lin., after the scaling of PSNR al.", 2),
    Definition("ssim", "SSIM", "1", "higher",
               "SSIM (Wang et al. 2004: Gaussian window of 1.5 px, K = 0.01, 0.03) of display pictures over black, "
               f"mean over channels and {_MATTE}", 4),
    Definition("ssim_aligned", "SSIM al.", "1", "higher", "as SSIM, after the scaling of PSNR al.", 4),
    Definition("ssim_whole", "SSIM whole", "1", "higher", f"as SSIM, mean over {_WHOLE}", 4),
    Definition("flip", "FLIP", "1", "lower", f"mean of {_FLIP} over {_MATTE}; {_DISPLAY}", 4),
    Definition("flip_aligned", "FLIP al.", "1", "lower", "as FLIP, after the scaling of PSNR al.", 4),
    Definition("flip_whole", "FLIP whole", "1", "lower", f"mean of {_FLIP} over {_WHOLE}", 4),
    Definition("hdr_flip", "HDR-FLIP", "1", "lower",
               "HDR-FLIP (Andersson et al. 2021, ACES curve, exposures from the truth's matte) at 67 pixels per "
               f"degree, mean over {_MATTE}", 4),
    Definition("stlpips", "ST-LPIPS", "1", "lower",
               f"ST-LPIPS (Ghildyal and Liu 2022; AlexNet, vST0.0) of display pictures over {_WHOLE}; not LPIPS", 4),
    Definition("stlpips_matte", "ST-LPIPS m.", "1", "lower",
               "as ST-LPIPS, on the bounding box of the matte, black outside it", 4),
    Definition("stlpips_aligned", "ST-LPIPS al.", "1", "lower", "as ST-LPIPS, after the scaling of PSNR al.", 4),
    Definition("lpips", "LPIPS", "1", "lower",
               f"LPIPS (Zhang et al. 2018; AlexNet, weights given by the user) of display pictures over {_WHOLE}", 4),
    Definition("lpips_matte", "LPIPS m.", "1", "lower",
               "as LPIPS, on the bounding box of the matte, black outside it", 4),
    Definition("lpips_aligned", "LPIPS al.", "1", "lower", "as LPIPS, after the scaling of PSNR al.", 4),
    Definition("rmse", "RMSE", "1", "lower", f"root mean squared error over {_MATTE}"),
    Definition("bias", "bias", "1", "zero", f"mean of estimate - truth over {_MATTE}"),
    Definition("constant_rmse", "RMSE of a constant", "1", "neither",
               "RMSE of the truth's own mean over the shot, which no method may know"),
    Definition("auc", "AUC", "1", "higher",
               "probability that a metal pixel (truth above 0.5) is rated above another (Mann-Whitney); absent if "
               "the shot has only one kind"),
    Definition("spearman", "Spearman", "1", "higher",
               "rank correlation of the ensemble's standard deviation and |error|"),
    Definition("ause", "AUSE", "1", "lower",
               "area between the RMSE curves when the pixels of largest standard deviation, and those of largest "
               "error, are left out first (0 .. 95 % in 20 steps), over the RMSE of all"),
    Definition("tpsnr_diff", "tPSNR-diff", "dB", "higher",
               "10 log10(1 / MSE) between x[t+1] - x[t] and g[t+1] - g[t] of display pictures, pooled over all pairs"
               " and pixels inside both mattes", 2),
    Definition("tpsnr_warp", "tPSNR-warp", "dB", "higher",
               "10 log10(1 / MSE) between x[t+1] sampled at p + true flow and x[t], display pictures, pooled over "
               "pairs and pixels that are seen in both", 2),
    Definition("ppl", "PPL", "1", "lower",
               "mean ST-LPIPS (AlexNet) of consecutive frames over black; a frozen video scores 0, so read it beside "
               "PSNR", 4),
    Definition("tlp", "tLP", "1", "lower",
               "100 x mean |ST-LPIPS(x[t], x[t+1]) - ST-LPIPS(g[t], g[t+1])|", 3),
    Definition("psnr_frames", "PSNR", "dB", "higher",
               "mean over the video's frames of PSNR inside the matte (display)", 2),
    Definition("epe", "EPE", "px", "lower",
               "mean length of (flow - true flow) over pixels that are seen in both frames", 3),
    Definition("occlusion_precision", "occl. precision", "1", "higher",
               "of the matte pixels called not valid, the share that the next frame truly hides or drops"),
    Definition("occlusion_recall", "occl. recall", "1", "higher",
               "of the matte pixels that the next frame truly hides or drops, the share called not valid"),
)  # fmt: skip

DEFINITIONS = MappingProxyType({definition.name: definition for definition in _ALL})
"""Every definition by name."""


def named(name: str, value: float) -> Metric:
    """A value under the definition of this name."""
    return DEFINITIONS[name].of(value)
