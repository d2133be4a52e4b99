"""Rows of the tables: the materials that each uses, and how its relighting differs from the default."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

Source = Literal[
    "plate",
    "own",
    "observed",
    "true",
    "constant",
    "own_constant",
    "blender",
    "true_flow",
    "own_flow",
    "measured",
]
Group = Literal["table", "ablation", "separation", "evidence", "fitted"]

FULL: Mapping[str, Any] = MappingProxyType({})
PAPER = MappingProxyType(
    {"base_color": "plate", "brdf": "paper", "bounce": 0, "edges": False, "pixel_filter": 0.0, "extend": False}
)
UNSHADOWED = MappingProxyType({"shadows": False, "bounce": 0})


@dataclass(frozen=True)
class Row:
    """One way to make a relit picture.

    Attributes:
        name: key in JSON.
        title: label in tables.
        group: the table that it belongs to; `separation` rows only serve to separate the stages' errors.
        source: origin of roughness and metallic, or of a picture that is used unchanged.
        definition: what is computed, in one sentence.
        knobs: relighting settings that replace those of the shot.
        proxy: whether visibility and bounces use the proxy mesh.
        true_base: whether the true base colour is used instead of the one recovered from the plate.
    """

    name: str
    title: str
    group: Group
    source: Source
    definition: str
    knobs: Mapping[str, Any] = field(default_factory=dict)
    proxy: bool = True
    true_base: bool = False

    @property
    def needs_own(self) -> bool:
        """Whether it needs the decomposition."""
        return self.source in ("own", "observed")

    @property
    def thorough(self) -> bool:
        """Whether every metric is computed; term-by-term rows and constants per shot get the quick ones only."""
        return self.group == "table" and self.source != "own_constant"

    @property
    def independent(self) -> bool:
        """Whether the row does not depend on the decomposition, so that new weights leave it unchanged."""
        return self.source in ("plate", "true", "blender")


def _ablation() -> tuple[Row, ...]:
    """The terms of method.md section 5 added one by one, with true and with own materials; the last row equals Full."""
    steps: tuple[tuple[str, str, str, Mapping[str, Any], bool], ...] = (
        ("paper", "The paper's scheme", "base colour = plate, plain BRDF, one shadow factor marched through z",
         {**PAPER, "shadows": "single"}, False),
        ("paper_open", "The paper's scheme without shadow", "base colour = plate, plain BRDF, no shadow",
         {**PAPER, "shadows": False}, False),
        ("capture", "+ capture light removed", "base colour recovered from the plate, BRDF of Cycles, no shadow",
         UNSHADOWED, False),
        ("depth", "+ visibility from z alone", "and one visibility per light cluster, marched through z",
         {"bounce": 0}, False),
        ("visibility", "+ visibility from the proxy instead", "and one visibility per light cluster, cast at the proxy",
         {"bounce": 0}, True),
        ("bounce", "+ bounces off the proxy (Full)", "and light bounced off the proxy: the product's own setting",
         FULL, True),
    )  # fmt: skip
    sources: tuple[tuple[Source, str], ...] = (("true", "true materials"), ("own", "own materials"))
    return tuple(
        Row(f"{name}_{source}", f"{title}, {what}", "ablation", source, f"{text}; {what}", knobs, proxy)
        for name, title, text, knobs, proxy in steps
        for source, what in sources
    )


TABLE = (
    Row("no_relighting", "No Relighting", "table", "plate", "the plate as it was captured"),
    Row("no_decomposition", "No Decomposition", "table", "constant",
        "Full with one roughness and one metallic everywhere: the best pair for the whole set, chosen with the truth"),
    Row("no_decomposition_each", "No Decomposition, constant per shot", "table", "own_constant",
        "as No Decomposition, with the best pair for each shot: no method may know it"),
    Row("unregularised", "Full without temporal regularisation", "table", "observed",
        "Full with the ensemble's mean of each frame as it is"),
    Row("full", "Full", "table", "own",
        "the product: ensemble, temporal solve, capture light removed, visibility, bounce"),
    Row("full_true", "Full with true materials", "table", "true",
        "Full with the truth's roughness and metallic: the ceiling of decomposition"),
    Row("blender_proxy", "Proxy mesh relit in Blender", "table", "blender",
        "Cycles relights the proxy mesh with the captured colours (truth/proxy_MAP.####.exr)"),
)  # fmt: skip

SEPARATION = (
    Row("true_base", "", "separation", "true", "Full with true materials and true base colour", true_base=True),
    Row("solved_true", "", "separation", "true_flow", "Full with the true materials after a solve along the true flow"),
    Row("solved_own_flow", "", "separation", "own_flow", "Full with the true materials after a solve along our flow"),
)

ROWS = MappingProxyType({row.name: row for row in (*TABLE, *_ablation(), *SEPARATION)})
"""Every row by name."""


TRUE_SOLVES = MappingProxyType({"true_flow": "solved_true_flow_material", "own_flow": "solved_own_flow_material"})
"""Arrays that hold the temporal solves of the true materials, by the source that reads them."""


@dataclass(frozen=True)
class Separation:
    """The error of one stage: two pictures that differ in that stage only.

    Attributes:
        stage: name of the stage.
        candidate: the row with the stage's own result.
        reference: the row with the truth in its place, or "truth" for the reference picture.
        text: what is compared, in one sentence.
    """

    stage: str
    candidate: str
    reference: str
    text: str


SEPARATIONS = (
    Separation("light transport", "true_base", "truth",
               "our relighting of true base colour, roughness, metallic against Cycles"),
    Separation("base colour", "full_true", "true_base",
               "base colour recovered from the plate against the true one, true materials in both"),
    Separation("decomposition", "unregularised", "full_true",
               "the ensemble's mean of each frame against the true materials, all else alike"),
    Separation("temporal solve", "solved_true", "full_true",
               "true materials after a solve along the true flow against the true materials"),
    Separation("flow", "solved_own_flow", "solved_true",
               "true materials after a solve along our flow against the same along the true flow"),
)  # fmt: skip
"""Every stage that has an error of its own; G-buffers and proxies of rendered shots are exact."""
