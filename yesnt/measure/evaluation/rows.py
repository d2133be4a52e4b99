"""The rows of the tables: what each is fed, and how its relighting differs from the product's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

Source = Literal["plate", "own", "observed", "true", "constant", "own_constant", "blender", "true_flow", "own_flow"]
Group = Literal["table", "ladder", "separation"]

FULL: Mapping[str, Any] = MappingProxyType({})
PAPER = MappingProxyType({"base_color": "plate", "brdf": "paper", "bounce": 0, "edges": False, "pixel_filter": 0.0})
UNSHADOWED = MappingProxyType({"shadows": False, "bounce": 0})


@dataclass(frozen=True)
class Row:
    """One way to make a relit picture.

    Attributes:
        name: the word in JSON.
        title: the words in tables.
        group: the table it stands in; `separation` rows are only inputs of the errors' separation.
        source: where roughness and metallic come from, or a picture that is taken as it is.
        definition: what is done, in a sentence.
        knobs: of the relighting, over those of the shot.
        proxy: whether shadows and bounces have the proxy mesh.
        true_base: whether the base colour is the truth's instead of recovered from the plate.
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
        """Whether every number is measured; the ladder and what no method may know get the quick ones."""
        return self.group == "table" and self.source != "own_constant"

    @property
    def given(self) -> bool:
        """Whether it is the same whatever the decomposition says, so that new weights leave it as it is."""
        return self.source in ("plate", "true", "blender")


def _ladder() -> tuple[Row, ...]:
    """The terms of method.md section 5 one by one, with true and with own materials; the last step is Full itself."""
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
        Row(f"{name}_{source}", f"{title}, {what}", "ladder", source, f"{text}; {what}", knobs, proxy)
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

ROWS = MappingProxyType({row.name: row for row in (*TABLE, *_ladder(), *SEPARATION)})
"""Every row by name."""


EXACT_ARRAYS = MappingProxyType({"true_flow": "exact_true_flow", "own_flow": "exact_own_flow"})
"""Where the solves of true materials are stored, by the source that reads them."""


@dataclass(frozen=True)
class Separation:
    """One stage's own error: two pictures that differ in that stage alone.

    Attributes:
        stage: its name.
        candidate: the row with the stage's own result.
        reference: the row with the truth in its place, or "truth" for Blender's picture.
        text: what is compared.
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
"""Stages of the product in the order of light; the G-buffer and the proxy of a rendered stage are true."""
