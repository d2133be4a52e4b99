"""PLY files of Gaussian fields: round trips, layouts of other programs, refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from yesnt.core.errors import JobError
from yesnt.gaussians.field import GaussianField
from yesnt.io.gaussian_ply import field_bytes, read_field, write_field


def random_field(count: int = 7, degree: int = 2, filtered: bool = False, space: str = "srgb") -> GaussianField:
    rng = np.random.default_rng(degree)
    quaternions = rng.normal(size=(count, 4))
    return GaussianField(
        rng.normal(size=(count, 3)), rng.normal(-4, 0.3, (count, 3)),
        quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True), rng.normal(size=count),
        rng.normal(size=(count, (degree + 1) ** 2, 3)), rng.random(count) * 0.01 if filtered else None,
        space,  # type: ignore[arg-type]
    )  # fmt: skip


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("filtered", [False, True])
def test_a_field_comes_back_bit_for_bit(tmp_path: Path, degree: int, filtered: bool) -> None:
    field = random_field(degree=degree, filtered=filtered, space="linear" if filtered else "srgb")
    write_field(tmp_path / "a.ply", field)
    found = read_field(tmp_path / "a.ply")
    assert found.digest == field.digest
    assert field_bytes(found) == field_bytes(field)


def by_hand(properties: dict[str, np.ndarray], form: str = "binary_little_endian", extra: str = "") -> bytes:
    """A PLY file written from the format's description alone."""
    count = len(next(iter(properties.values())))
    lines = "".join(f"property float {name}\n" for name in properties)
    header = f"ply\nformat {form} 1.0\n{extra}element vertex {count}\n{lines}end_header\n".encode()
    table = np.stack(list(properties.values()), axis=1)
    if form == "ascii":
        return header + "".join(" ".join(f"{v:.9g}" for v in row) + "\n" for row in table).encode()
    return header + table.astype("<f4" if "little" in form else ">f4").tobytes()


def inria(count: int = 3, rest: int = 9) -> dict[str, np.ndarray]:
    """Properties in another order than ours, without normals; f_rest of red, then green, then blue."""
    found = {name: np.full(count, 0.1 * i, np.float32) for i, name in enumerate("xyz")}
    found |= {f"f_rest_{i}": np.full(count, float(i), np.float32) for i in range(rest)}
    found |= {f"f_dc_{i}": np.full(count, 10.0 + i, np.float32) for i in range(3)}
    found |= {f"rot_{i}": np.full(count, 2.0 * (i == 0), np.float32) for i in range(4)}
    found |= {f"scale_{i}": np.full(count, -3.0 - i, np.float32) for i in range(3)}
    return found | {"opacity": np.full(count, 1.5, np.float32)}


@pytest.mark.parametrize("form", ["binary_little_endian", "binary_big_endian", "ascii"])
def test_harmonics_are_channel_major_and_quaternions_are_normalised(tmp_path: Path, form: str) -> None:
    (tmp_path / "a.ply").write_bytes(by_hand(inria(), form, "comment made elsewhere\n"))
    field = read_field(tmp_path / "a.ply")
    assert field.harmonics[0, 1:].T.ravel().tolist() == list(range(9))  # red's three coefficients first
    assert field.harmonics[0, 0].tolist() == [10, 11, 12]
    assert field.rotations[0].tolist() == [1, 0, 0, 0]
    assert field.log_scales[0].tolist() == [-3, -4, -5]
    assert (field.degree, field.filter_3d, field.color_space) == (1, None, "srgb")


def test_the_filter_of_gaussian_opacity_fields_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(by_hand(inria() | {"filter_3D": np.full(3, 0.25, np.float32)}))
    field = read_field(tmp_path / "a.ply")
    assert field.filter_3d is not None
    assert field.filter_3d.tolist() == [0.25] * 3


def without(name: str) -> dict[str, np.ndarray]:
    return {key: value for key, value in inria().items() if key != name}


CHUNK = "element chunk 1\nproperty float min_x\n"


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (by_hand(without("opacity")), "The Gaussian field has no opacity"),
        (by_hand(without("scale_2")), "field of flat discs (2DGS)"),
        (by_hand(inria(rest=10)), "10 properties f_rest_*"),
        (by_hand(inria() | {"packed_position": np.zeros(3)}), "PlayCanvas' compressed PLY, which is compressed"),
        (by_hand(inria(), extra=CHUNK), "PlayCanvas' compressed PLY"),
        (by_hand(inria()).replace(b"float opacity", b"uchar opacity"), "a quantised PLY (opacity is an integer)"),
        (by_hand(inria())[:-8], "It ends after 2 of 3 Gaussians"),
        (b"solid stl\n", "no header of a PLY file"),
        (by_hand(inria() | {"x": np.full(3, np.nan, np.float32)}), "3 of 3 Gaussians with a wrong value"),
    ],
)
def test_what_is_no_plain_field_is_refused_by_name(tmp_path: Path, data: bytes, text: str) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(data)
    with pytest.raises(JobError) as error:
        read_field(path)
    assert text in str(error.value)
    assert str(path) in str(error.value)


def test_other_formats_and_missing_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(JobError, match=r"Niantic's \.spz"):
        read_field(tmp_path / "a.spz")
    with pytest.raises(JobError, match="The Gaussian field is missing"):
        read_field(tmp_path / "a.ply")
