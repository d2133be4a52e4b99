"""Channels are found under the names that programs give them; what is ambiguous is refused by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.io.exr_bytes import Raw, string_vector, write_raw
from yesnt.core.errors import JobError
from yesnt.core.shot import GBufferInput, PlateInput
from yesnt.io.pictures.image import ImageHeader, read_headers
from yesnt.io.pictures.passes import find_color, find_matte, find_normals, find_scalar, find_z

PLANE = np.zeros((1, 1), np.float16)


def headers(folder: Path, *parts: str | tuple[str, str], view: tuple[str, ...] = ()) -> tuple[ImageHeader, ...]:
    """Headers of a file: each part as its channels, or as (name, channels), separated by blanks."""
    raws = []
    for part in parts:
        name, channels = part if isinstance(part, tuple) else ("", part)
        attributes = {"multiView": string_vector(*view)} if view else {}
        raws.append(Raw({c.replace("_", " "): PLANE for c in channels.split()}, name=name, attributes=attributes))
    write_raw(folder / "x.exr", *raws)
    return read_headers(folder / "x.exr")


def plate(**keys: object) -> PlateInput:
    return PlateInput.model_validate({"path": "x.exr", **keys})


COLORS = {
    "plain": (["A B G R Z"], {}, "R G B A"),
    "lower case": (["r g b a"], {}, "r g b a"),
    "Nuke": (["rgba.red rgba.green rgba.blue rgba.alpha depth.Z"], {}, "rgba.red rgba.green rgba.blue rgba.alpha"),
    "without alpha": (["R G B"], {}, "R G B"),
    "unnamed before layers": (["R G B A diffuse.R diffuse.G diffuse.B"], {}, "R G B A"),
    "Blender 4": (
        ["V.Combined.R V.Combined.G V.Combined.B V.Combined.A V.Normal.X V.Normal.Y V.Normal.Z V.Depth.Z"],
        {}, "V.Combined.R V.Combined.G V.Combined.B V.Combined.A",
    ),
    "Blender 5": (
        [("V.Combined", "V.Combined.R V.Combined.G V.Combined.B"), ("V.Noisy Image", "V.N.R V.N.G V.N.B")],
        {}, "V.Combined.R V.Combined.G V.Combined.B",
    ),
    "part's name": ([("depth", "Z"), ("beauty", "R G B A")], {}, "beauty.R beauty.G beauty.B beauty.A"),
    "one of several parts": ([("albedo", "R G B"), ("rgba", "R G B A")], {}, "rgba.R rgba.G rgba.B rgba.A"),
    "only colour layer": (["key.R key.G key.B N.R N.G N.B"], {}, "key.R key.G key.B"),
    "cryptomatte is no colour": (["key.R key.G key.B crypto00.r crypto00.g crypto00.b"], {}, "key.R key.G key.B"),
    "layer": (["a.R a.G a.B a.A b.R b.G b.B"], {"layer": "b"}, "b.R b.G b.B"),
    "layer is a part": ([("a", "R G B"), ("b", "R G B")], {"layer": "b"}, "b.R b.G b.B"),
    "nested layer": (["x.y.z.R x.y.z.G x.y.z.B"], {"layer": "x.y.z"}, "x.y.z.R x.y.z.G x.y.z.B"),
    "channels": (["a b c"], {"channels": {"R": "c", "G": "b", "B": "a"}}, "c b a"),
    "grey": (["Y"], {}, "Y"),
    "grey with alpha": (["Y A"], {}, "Y A"),
}  # fmt: skip


@pytest.mark.parametrize("name", COLORS)
def test_colour_is_found(tmp_path: Path, name: str) -> None:
    parts, keys, expected = COLORS[name]
    assert find_color(headers(tmp_path, *parts), plate(**keys), "plate").label == ", ".join(expected.split())


NO_COLORS = {
    "two layers": (["a.R a.G a.B b.R b.G b.B"], {}, r"Several layers may be plate's colour: a, b.*`layer:`"),
    "two beauties": (["rgba.R rgba.G rgba.B beauty.R beauty.G beauty.B"], {}, "beauty, rgba"),
    "two view layers": (
        [(f"{v}.Combined", f"{v}.Combined.R {v}.Combined.G {v}.Combined.B") for v in "AB"],
        {}, r"A\.Combined, B\.Combined",
    ),
    "only alpha": (["A"], {}, "No channels of the picture are the plate's red, green and blue.*it has A"),
    "only depth": (["Z"], {}, "No channels.*it has Z"),
    "no such layer": (["rgba.R rgba.G rgba.B"], {"layer": "rbga"}, "no layer rbga.*did you mean rgba"),
    "no such channel": (["red green blue"], {"channels": {"R": "rde", "G": "green", "B": "blue"}},
                        "no channel rde.*did you mean red"),
}  # fmt: skip


@pytest.mark.parametrize("name", NO_COLORS)
def test_colour_that_is_not_clear_is_refused(tmp_path: Path, name: str) -> None:
    parts, keys, message = NO_COLORS[name]
    with pytest.raises(JobError, match=message):
        find_color(headers(tmp_path, *parts), plate(**keys), "plate")


@pytest.mark.parametrize(
    ("channels", "z", "normals"),
    [
        ("depth.Z N.X N.Y N.Z", "depth.Z", "N.X N.Y N.Z"),
        ("Z N.red N.green N.blue", "Z", "N.red N.green N.blue"),
        ("z nx ny nz", "z", "nx ny nz"),
        ("depth Nx Ny Nz", "depth", "Nx Ny Nz"),
        ("Depth.V Normal.X Normal.Y Normal.Z", "Depth.V", "Normal.X Normal.Y Normal.Z"),
        ("V.Depth.Z V.Normal.X V.Normal.Y V.Normal.Z", "V.Depth.Z", "V.Normal.X V.Normal.Y V.Normal.Z"),
        ("depth.Z Z N.X N.Y N.Z normal.X normal.Y normal.Z", "depth.Z", "N.X N.Y N.Z"),
        ("depth.r normals.r normals.g normals.b", "depth.r", "normals.r normals.g normals.b"),
    ],
)
def test_z_and_normals_are_found(tmp_path: Path, channels: str, z: str, normals: str) -> None:
    found = headers(tmp_path, channels)
    spec = GBufferInput(path="x.exr")
    assert find_z(found, spec).label == z
    assert [channel.label for channel in find_normals(found, spec)] == normals.split()


def test_z_and_normals_of_parts_are_found(tmp_path: Path) -> None:
    found = headers(tmp_path, ("rgba", "R G B A"), ("depth", "Z"), ("N", "X Y Z"))
    spec = GBufferInput(path="x.exr")
    assert find_z(found, spec).label == "depth.Z"
    assert [channel.label for channel in find_normals(found, spec)] == ["N.X", "N.Y", "N.Z"]


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        ("Z a.Depth.Z N.X N.Y N.Z", r"Several channels may be the depth: Z, a\.Depth\.Z.*`z:`"),
        ("depth.Z a.N.X a.N.Y a.N.Z b.N.X b.N.Y b.N.Z", r"Several layers may be the normals: a\.N, b\.N.*`normal:`"),
        ("N.X N.Y N.Z", r"no channel depth\.Z"),
        ("depth.Z", "no normals N"),
    ],
)
def test_a_gbuffer_that_is_not_clear_is_refused(tmp_path: Path, channels: str, message: str) -> None:
    found, spec = headers(tmp_path, channels), GBufferInput(path="x.exr")
    with pytest.raises(JobError, match=message):
        (find_z(found, spec), find_normals(found, spec))


def test_a_name_in_the_job_is_not_replaced_by_another(tmp_path: Path) -> None:
    found = headers(tmp_path, "depth.Z N.X N.Y N.Z")
    with pytest.raises(JobError, match=r"no channel dist\.Z"):
        find_z(found, GBufferInput(path="x.exr", z="dist.Z"))
    with pytest.raises(JobError, match="no normals Ng"):
        find_normals(found, GBufferInput(path="x.exr", normal="Ng"))


STEREO = "R G B left.R left.G left.B depth.Z depth.left.Z"


@pytest.mark.parametrize(("view", "color", "z"), [("right", ["R", "G", "B"], "depth.Z"), ("left", ["left.R"], "depth")])
def test_a_view_is_chosen_by_name(tmp_path: Path, view: str, color: list[str], z: str) -> None:
    found = headers(tmp_path, STEREO.replace("depth.Z", "depth.right.Z"), view=("right", "left"))
    chosen = find_color(found, plate(view=view), "plate").color
    assert [c.name for c in chosen][: len(color)] == color
    assert find_z(found, GBufferInput(path="x.exr", view=view)).name == f"depth.{view}.Z"


def test_views_are_named_where_none_is_chosen_and_where_it_is_wrong(tmp_path: Path) -> None:
    found = headers(tmp_path, STEREO, view=("right", "left"))
    with pytest.raises(JobError, match=r"has the views left, right.*`view:` under key plate"):
        find_color(found, plate(), "plate")
    with pytest.raises(JobError, match=r"no view 'middle'.*left, right"):
        find_color(found, plate(view="middle"), "plate")


def test_a_matte_of_a_stereo_file_is_named_in_full(tmp_path: Path) -> None:
    found = headers(tmp_path, "A left.A", view=("right", "left"))
    assert [c.name for c in find_matte(found, "left.A")] == ["left.A"]
    with pytest.raises(JobError, match=r"has the views left, right.*export one view alone"):
        find_matte(found, None)


def test_parts_with_views_are_chosen(tmp_path: Path) -> None:
    planes = {c: PLANE for c in "RGB"}
    parts = [Raw(planes, name=f"rgba.{v}", attributes={"view": ("string", v.encode())}) for v in ("left", "right")]
    write_raw(tmp_path / "x.exr", *parts)
    chosen = find_color(read_headers(tmp_path / "x.exr"), plate(view="right"), "plate").color[0]
    assert (chosen.header.part, chosen.label) == (1, "rgba.R")


@pytest.mark.parametrize(
    ("channels", "expected"),
    [("A", "A"), ("R G B A", "A"), ("m", "m"), ("R G B", "R, G, B"), ("matte.A Z", None), ("a.A b.A", None)],
)
def test_the_matte_is_found_where_it_is_obvious(tmp_path: Path, channels: str, expected: str | None) -> None:
    found = headers(tmp_path, channels)
    if expected is None:
        with pytest.raises(JobError, match=r"several channels.*`channel:`"):
            find_matte(found, None)
    else:
        assert ", ".join(c.label for c in find_matte(found, None)) == expected


@pytest.mark.parametrize(
    ("channels", "expected"),
    [
        ("roughness.Y metallic.Y", "roughness.Y"),
        ("roughness metallic", "roughness"),
        ("V.Roughness.X", "V.Roughness.X"),
        ("Roughness.R Roughness.G Roughness.B", "Roughness.R"),
    ],
)
def test_a_material_is_found(tmp_path: Path, channels: str, expected: str) -> None:
    assert find_scalar(headers(tmp_path, channels), "roughness", "decompose").label == expected
