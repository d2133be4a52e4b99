"""Settings of the proxy mesh of a Gaussian opacity field."""

from __future__ import annotations

from dataclasses import dataclass

from yesnt.gaussians.records import SURFACE


@dataclass(frozen=True)
class MeshSettings:
    """How a proxy mesh is made.

    Attributes:
        level: opacity at the surface.
        box: half the side of a Gaussian's box, in standard deviations; its corners and centre are the points.
        bisections: of each edge that the surface cuts.
        least_opacity: Gaussians below it give no points.
        least_part: components with a smaller share of the largest one's area are dropped.
        smoothing: passes of Taubin's smoothing before the decimation.
        triangles: at most.
    """

    level: float = SURFACE
    box: float = 3.0
    bisections: int = 8
    least_opacity: float = 0.05
    least_part: float = 0.02
    smoothing: int = 0
    triangles: int = 20_000

    def __post_init__(self) -> None:
        shares = {"level": self.level, "least_opacity": self.least_opacity, "least_part": self.least_part}
        for name, value in shares.items():
            if not 0 < value < 1:
                raise ValueError(f"{name}={value} must lie between 0 and 1")
        if self.box <= 0 or not 0 <= self.bisections <= 32 or not 0 <= self.smoothing <= 100 or self.triangles < 4:
            raise ValueError("box > 0, 0 <= bisections <= 32, 0 <= smoothing <= 100 and triangles >= 4 are needed")
