"""Files that correct materials: masks, Cryptomattes as renderers write them, passes of one quantity."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from tests.cases.shots import FRAME, HEIGHT, WIDTH, check, material, sphere, write, write_shot
from yesnt.decompose.cryptomatte import identifier
from yesnt.io.corrections import read_overrides
from yesnt.io.pictures.describe import describe_reads
from yesnt.io.pictures.material_pass import read_quantity
from yesnt.runtime.session import Session

SEEN = sphere()
LEFT = np.zeros((HEIGHT, WIDTH), np.float32)
LEFT[:, : WIDTH // 2] = 1
PARTS = {"boots": LEFT * SEEN.matte, "belt": (1 - LEFT) * SEEN.matte}
"""Coverage of two things that make up the sphere."""


def ranks(parts: dict[str, np.ndarray], kind: type = np.float32) -> dict[str, np.ndarray]:
    """Planes R, G, B, A of one layer whose two ranks hold two things in turn."""
    (first, one), (second, two) = parts.items()
    numbers = [np.full(one.shape, identifier(name), np.uint32).view(np.float32) for name in (first, second)]
    planes = dict(zip("RGBA", (numbers[0], one, numbers[1], two), strict=True))
    return {role: plane.astype(kind) for role, plane in planes.items()}


def metadata(name: str, names: Any = ("boots", "belt", "hat"), key: str = "1a2b3c4", **changes: Any) -> dict[str, Any]:
    """Header attributes of a Cryptomatte; `names` None leaves the manifest out."""
    fields = {"name": name, "hash": "MurmurHash3_32", "conversion": "uint32_to_float32"} | changes
    if names is not None:
        fields["manifest"] = json.dumps({one: f"{identifier(one):08x}" for one in names})
    return {f"cryptomatte/{key}/{field}": value for field, value in fields.items()}


def layer(name: str, planes: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {f"{name}.{role}": plane for role, plane in planes.items()}


def shot(folder: Path, **entry: Any) -> Path:
    """A shot with one override by the Cryptomatte `id.exr`."""
    return write_shot(folder, materials=[{"cryptomatte": "id.exr", "metallic": 1.0, **entry}])


def weight_of(folder: Path) -> np.ndarray:
    """The weight [H, W] of the first override in the first frame."""
    return read_overrides(Session(folder).job, FRAME, SEEN.matte)[0][0].weight


def test_a_cryptomatte_that_went_through_nuke(tmp_path: Path) -> None:
    spelt = dict(zip("RGBA", ("red", "green", "blue", "alpha"), strict=True))
    planes = {f"crypto_object00.{spelt[role]}": plane for role, plane in ranks(PARTS).items()}
    known = {f"nuke/exr/{name}": value for name, value in metadata("crypto_object").items()}
    write(shot(tmp_path / "s", names=["boots"]) / "id.exr", {**planes, "R": LEFT}, **known)
    np.testing.assert_array_equal(weight_of(tmp_path / "s"), PARTS["boots"])
    write(shot(tmp_path / "t", names=["boot"]) / "id.exr", {**planes, "R": LEFT}, **known)
    assert "did you mean boots" in check(tmp_path / "t").refusal


@pytest.mark.parametrize("name", ["CryptoObject", "ViewLayer.CryptoObject"])
@pytest.mark.parametrize("names", [("boots", "belt", "hat"), None])
def test_a_cryptomatte_in_layers_of_one_part(tmp_path: Path, name: str, names: Any) -> None:
    write(shot(tmp_path / "s", names=["boots"]) / "id.exr", layer(f"{name}00", ranks(PARTS)), **metadata(name, names))
    np.testing.assert_array_equal(weight_of(tmp_path / "s"), PARTS["boots"])
    assert not check(tmp_path / "s").refusal


def test_a_cryptomatte_as_blender_5_writes_it_in_parts_with_metadata_in_the_first(tmp_path: Path) -> None:
    folder = shot(tmp_path / "s", names=["belt"])
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    name = "ViewLayer.CryptoObject"
    small = {role.lower(): plane for role, plane in ranks(PARTS).items()}
    empty = {role: np.zeros_like(plane) for role, plane in small.items()}
    beauty = OpenEXR.Part({"name": "ViewLayer.Combined", **header, **metadata(name)}, {"ViewLayer.Combined.R": LEFT})
    matte = [
        OpenEXR.Part({"name": f"{name}{number}", **header}, layer(f"{name}{number}", planes))
        for number, planes in (("01", empty), ("00", small))
    ]
    with OpenEXR.File([beauty, *matte]) as target:
        target.write(str(folder / "id.exr"))
    np.testing.assert_array_equal(weight_of(folder), PARTS["belt"])


def test_plan_says_what_corrects_what(tmp_path: Path) -> None:
    rough = {"backend": "embedded", "roughness": {"path": "material.####.exr"}}
    entries = [
        {"cryptomatte": "id.exr", "names": ["belt"], "metallic": 1.0},
        {"mask": "mask.exr", "channel": "cap", "roughness": 0.2},
    ]
    folder = write_shot(tmp_path / "s", decompose=rough, materials=entries)
    write(folder / "id.exr", layer("CryptoObject00", ranks(PARTS)), **metadata("CryptoObject"))
    write(folder / "mask.exr", {"cap": LEFT, "belt": LEFT})
    reads = describe_reads(Session(folder).job, FRAME)
    named = {role: reads[role] for role in ("roughness", "materials.0", "materials.1")}
    assert named == {"roughness": "roughness.Y", "materials.0": "belt of CryptoObject", "materials.1": "cap"}


def test_several_names_are_taken_together(tmp_path: Path) -> None:
    folder = shot(tmp_path / "s", names=["belt", "boots"])
    write(folder / "id.exr", layer("CryptoObject00", ranks(PARTS)), **metadata("CryptoObject"))
    np.testing.assert_array_equal(weight_of(folder), SEEN.matte)


def test_the_manifest_may_lie_beside_the_picture(tmp_path: Path) -> None:
    folder = shot(tmp_path / "s", names=["bootz"])
    beside = metadata("CryptoObject", None, manif_file="names.json")
    write(folder / "id.exr", layer("CryptoObject00", ranks(PARTS)), **beside)
    (folder / "names.json").write_text(json.dumps({"boots": f"{identifier('boots'):08x}"}))
    assert "did you mean boots?" in check(folder).refusal


@pytest.mark.parametrize("names", [("boots", "belt", "hat"), None])
def test_an_unknown_name_is_refused_with_near_names(tmp_path: Path, names: Any) -> None:
    folder = shot(tmp_path / "s", names=["boot"])
    write(folder / "id.exr", layer("CryptoObject00", ranks(PARTS)), **metadata("CryptoObject", names))
    refusal = check(folder).refusal
    assert "The Cryptomatte has no 'boot' in any frame" in refusal
    assert "materials.0" in refusal
    assert ("did you mean boots or belt?" in refusal) == (names is not None)


def test_a_name_that_one_frame_lacks_is_used_in_the_others(tmp_path: Path) -> None:
    job = {"materials": [{"cryptomatte": "id.####.exr", "names": ["boots"], "metallic": 1.0}]}
    folder = write_shot(tmp_path / "s", (FRAME, FRAME + 1), **job)
    for frame, parts in ((FRAME, {"belt": SEEN.matte, "cap": 0 * LEFT}), (FRAME + 1, PARTS)):
        known = metadata("CryptoObject", tuple(parts))
        write(folder / f"id.{frame}.exr", layer("CryptoObject00", ranks(parts)), **known)
    assert not check(folder).refusal


def test_of_several_cryptomattes_the_one_that_knows_the_name_is_taken(tmp_path: Path) -> None:
    folder = shot(tmp_path / "s", names=["leather"])
    planes = layer("CryptoObject00", ranks(PARTS))
    planes |= layer("CryptoMaterial00", ranks({"leather": PARTS["belt"], "wool": PARTS["boots"]}))
    known = metadata("CryptoObject") | metadata("CryptoMaterial", ("leather", "wool"), "5d6e7f8")
    write(folder / "id.exr", planes, **known)
    np.testing.assert_array_equal(weight_of(folder), PARTS["belt"])


def test_a_name_in_two_cryptomattes_needs_a_layer(tmp_path: Path) -> None:
    planes = layer("CryptoObject00", ranks(PARTS))
    planes |= layer("CryptoMaterial00", ranks({"boots": PARTS["belt"], "wool": PARTS["boots"]}))
    known = metadata("CryptoObject") | metadata("CryptoMaterial", ("boots", "wool"), "5d6e7f8")
    write(shot(tmp_path / "s", names=["boots"]) / "id.exr", planes, **known)
    assert "Several Cryptomattes may be meant: CryptoObject, CryptoMaterial" in check(tmp_path / "s").refusal
    write(shot(tmp_path / "t", names=["boots"], layer="CryptoMaterial") / "id.exr", planes, **known)
    np.testing.assert_array_equal(weight_of(tmp_path / "t"), PARTS["belt"])
    write(shot(tmp_path / "u", names=["boots"], layer="CryptoAsset") / "id.exr", planes, **known)
    assert "No Cryptomatte is called 'CryptoAsset'" in check(tmp_path / "u").refusal


@pytest.mark.parametrize(
    ("kind", "changes", "refusal"),
    [
        (np.float16, {}, "is half: its identifiers are rounded"),
        (np.float32, {"hash": "CRC32"}, "The Cryptomatte's hash is 'CRC32'"),
        (np.float32, {"conversion": "none"}, "The Cryptomatte's conversion is 'none'"),
    ],
)
def test_identifiers_that_are_not_those_of_the_specification_are_refused(
    tmp_path: Path, kind: type, changes: dict[str, str], refusal: str
) -> None:
    folder = shot(tmp_path / "s", names=["boots"])
    with np.errstate(over="ignore"):
        planes = layer("CryptoObject00", ranks(PARTS, kind))
    write(folder / "id.exr", planes, **metadata("CryptoObject", **changes))
    assert refusal in check(folder).refusal


def test_identifiers_that_were_filtered_are_refused(tmp_path: Path) -> None:
    folder = shot(tmp_path / "s", names=["boots"])
    planes = ranks(PARTS)
    planes["R"] = planes["R"] * np.float32(0.99)  # as a resize mixes them
    write(folder / "id.exr", layer("CryptoObject00", planes), **metadata("CryptoObject"))
    refusal = check(folder).refusal
    assert "100% of the identifiers of the Cryptomatte CryptoObject are not in its manifest" in refusal
    assert "without resizing, filtering or lossy compression" in refusal


def test_a_picture_without_a_cryptomatte_is_refused(tmp_path: Path) -> None:
    write(shot(tmp_path / "s", names=["boots"]) / "id.exr", {"R": LEFT})
    assert "The picture has no Cryptomatte" in check(tmp_path / "s").refusal


def masked(folder: Path, planes: dict[str, np.ndarray], **entry: Any) -> Path:
    """A shot with one override by a mask of these planes."""
    made = write_shot(folder, materials=[{"mask": "belt.exr", "roughness": 0.2, **entry}])
    write(made / "belt.exr", planes)
    return made


@pytest.mark.parametrize("planes", [{"Y": LEFT}, {"R": LEFT, "G": LEFT, "B": LEFT}, {"A": LEFT, "R": LEFT * 0}])
def test_the_channel_of_a_mask_is_found_where_it_is_obvious(tmp_path: Path, planes: dict[str, np.ndarray]) -> None:
    np.testing.assert_array_equal(weight_of(masked(tmp_path / "s", planes)), LEFT * SEEN.matte)


@pytest.mark.parametrize(
    ("planes", "entry", "refusal"),
    [
        ({"belt": LEFT, "cap": LEFT}, {}, "The matte's file has several channels"),
        (
            {"R": LEFT, "G": LEFT, "B": LEFT, "A": LEFT * 0 + 1},
            {},
            "The alpha of the mask is 1 everywhere, and its colour",
        ),
        ({"R": LEFT, "G": LEFT, "B": LEFT * 0}, {}, "The red, green and blue of the mask differ"),
        ({"belt": LEFT, "cap": LEFT}, {"channel": "bel"}, "did you mean belt"),
        ({"Y": LEFT * 255}, {}, "The mask goes up to 255"),
        ({"Y": np.where(SEEN.hit, np.nan, 0).astype(np.float32)}, {}, "inside the matte are NaN or Inf in Y"),
    ],
)
def test_a_mask_that_is_not_clear_is_refused(
    tmp_path: Path, planes: dict[str, np.ndarray], entry: dict[str, str], refusal: str
) -> None:
    assert refusal in check(masked(tmp_path / "s", planes, **entry)).refusal


def test_a_mask_that_meets_nothing_and_one_with_overshoot_are_reported(tmp_path: Path) -> None:
    outside = np.where(SEEN.hit, 0, 1).astype(np.float32)
    (warning,) = (w for w in check(masked(tmp_path / "s", {"Y": outside})).warnings if "materials" in w)
    assert warning.startswith("materials.0: ")
    assert warning.endswith("belt.exr covers no pixel of the matte in any frame")
    warnings = check(masked(tmp_path / "t", {"Y": LEFT * np.float32(1.05)})).warnings
    beyond = int((LEFT * SEEN.matte > 0).sum())
    assert f"corrections: values outside [0, 1] that are set to its ends: {beyond} in the shot" in warnings


def test_a_pass_of_one_quantity_is_straight_unless_the_job_says_otherwise(tmp_path: Path) -> None:
    matte = SEEN.matte * 0.5
    for alpha, stored in (("straight", 0.3), ("premultiplied", 0.15)):
        spec = {"path": "rough.exr", "channel": "rough.V", "alpha": alpha}
        folder = write_shot(tmp_path / alpha, decompose={"backend": "embedded", "roughness": spec})
        write(folder / "rough.exr", {"rough.V": np.full_like(matte, stored), "other": matte})
        job = Session(folder).job
        given = job.shot.decompose.quantities["roughness"]
        plane, clamped = read_quantity(job, "roughness", given, FRAME, matte)
        np.testing.assert_allclose(plane, 0.3 * SEEN.matte, rtol=1e-6)
        assert clamped == 0


@pytest.mark.parametrize(
    ("decompose", "refusal"),
    [
        ({"path": "material.####.exr", "roughness": {"path": "r.exr"}}, "path holds both quantities, and roughness"),
        ({"roughness": {"path": "r.exr", "alpha": "maybe"}}, "'decompose.roughness.alpha' cannot be used"),
    ],
)
def test_passes_that_contradict_each_other_are_refused(tmp_path: Path, decompose: Any, refusal: str) -> None:
    assert refusal in check(write_shot(tmp_path / "s", decompose=decompose)).refusal


def test_a_missing_mask_is_named(tmp_path: Path) -> None:
    folder = write_shot(tmp_path / "s", materials=[{"mask": "belt.####.exr", "roughness": 0.2}])
    assert "belt.1001.exr" in check(folder).refusal


def test_both_quantities_from_passes_of_their_own_need_no_backend(tmp_path: Path) -> None:
    given = {"roughness": {"path": "r.exr", "channel": "roughness.Y"}, "metallic": {"path": "m.exr"}}
    folder = write_shot(tmp_path / "s", decompose=given)
    for name in ("r.exr", "m.exr"):
        write(folder / name, material(0.3, 0.6))
    session = Session(folder)
    assert session.resolved.backend is None
    assert not session.job.shot.corrected
