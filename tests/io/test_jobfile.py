import time
from pathlib import Path

import pytest
import yaml
from fileseq import FileSequence
from fileseq.constants import PAD_STYLE_HASH1

from yesnt.core.errors import JobError, UsageError
from yesnt.io.jobfile import frame_path, frames_on_disk, load_shot, parse_frames

GOOD = {
    "version": 1, "name": "walk", "frames": "1-4", "plate": {"path": "p.####.exr"}, "gbuffer": {"path": "g.####.exr"},
    "camera": "camera.json", "light": {"path": "l.exr"},
}  # fmt: skip


def job(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "shot.yaml"
    path.write_text(text)
    return path


def test_defaults_are_the_contract(tmp_path: Path) -> None:
    shot = load_shot(job(tmp_path, yaml.safe_dump(GOOD)))
    assert (shot.decompose.backend, shot.quality, shot.seed) == ("embedded", "standard", 0)
    assert shot.decompose.samples is None, "the backend says"
    assert (shot.gbuffer.z, shot.gbuffer.normal, shot.gbuffer.normal_space) == ("depth.Z", "N", "world")
    assert (shot.light.convention, shot.light.rotation, shot.output) == ("blender", (0, 0, 0), "out")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("camra: x", r"Unknown key 'camra'.*line 9"),
        ("seed: hello", r"'seed' cannot be used.*line 9"),
        ("seed: 1.5", "'seed' cannot be used"),
        ("seed: -1", "'seed' cannot be used"),
        ("output: !!python/object/apply:os.system ['true']", r"not plain YAML.*python.*line 9"),
        ("decompose: {samples: 0}", r"'decompose.samples' cannot be used.*line 9"),
        ("decompose: {sample: 4}", r"Unknown key 'decompose.sample'.*line 9"),
        ("quality: best", "'quality' cannot be used"),
        ("output: [", "not plain YAML"),
        ("light: {path: l.exr, rotation: [0, 0]}", "'light.rotation"),
        ("light: {path: l.exr, rotation: {1001: [0, 0]}}", r"'light\.rotation\.1001\.2' is absent.*line 9"),
        ("light: {path: l.exr, rotation: 90}", "'light.rotation' cannot be used: Input should be a valid list"),
        ("capture_light: estimated", "'capture_light' cannot be used: .*the word `estimate`"),
        ("materials: {mask: m.exr, roughness: 1}", "'materials' cannot be used: Input should be a valid list"),
        ("materials: [{mask: m.exr}]", r"'materials\.0' cannot be used: .*it needs `roughness` or `metallic`"),
        ("light: {path: l.exr, rotation: {}}", "'light.rotation' cannot be used: .*at least 1 item"),
        ("light: {path: l.exr, exposure: {a: 1}}", r"'light\.exposure\.a\.\[key\]' cannot be used"),
        ("light: {path: l.exr, exposure: 1, exposure: 2}", r"The key 'exposure' stands twice.*line 9"),
        ("light: {path: l.exr, rotation: {1001: [0, 0, 0], 1001: [9, 0, 0]}}", "The key '1001' stands twice"),
        ("light: {path: l.exr, exposure: .nan}", "'light.exposure'"),
    ],
)
def test_bad_lines_are_named(tmp_path: Path, line: str, message: str) -> None:
    key = line.partition(":")[0]
    text = yaml.safe_dump({k: v for k, v in GOOD.items() if k != key}, default_flow_style=None)
    padding = "#\n" * (8 - text.count("\n"))
    with pytest.raises(JobError, match=message):
        load_shot(job(tmp_path, f"{text}{padding}{line}\n"))


def test_a_single_frame_and_an_empty_list_are_what_they_mean(tmp_path: Path) -> None:
    shot = load_shot(job(tmp_path, yaml.safe_dump({**GOOD, "frames": 1001}) + "materials:\n"))
    assert (shot.frames, shot.materials) == ("1001", ())


@pytest.mark.parametrize("name", ["a/b", "..", "a\\b", " a", ""])
def test_names_with_separators_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(JobError, match="'name' cannot be used"):
        load_shot(job(tmp_path, yaml.safe_dump({**GOOD, "name": name})))


@pytest.mark.parametrize("text", ["", "- 1\n", "hello", "version: 2\n"])
def test_what_is_no_job_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(JobError):
        load_shot(job(tmp_path, text))


def test_absent_job_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(JobError, match="yesnt init"):
        load_shot(tmp_path / "shot.yaml")


@pytest.mark.parametrize(
    ("text", "frames"),
    [
        ("1001-1004", (1001, 1002, 1003, 1004)),
        ("1-9x4", (1, 5, 9)),
        ("3,1", (1, 3)),
        ("-2-0", (-2, -1, 0)),
        ("7", (7,)),
        ("5-7,6-9,1", (1, 5, 6, 7, 8, 9)),
        (" 1 - 3 ,,9,", (1, 2, 3, 9)),
        ("1-10y3", (2, 3, 5, 6, 8, 9)),
    ],
)
def test_ranges(text: str, frames: tuple[int, ...]) -> None:
    assert parse_frames(text, "here") == frames


@pytest.mark.parametrize("text", ["", "a-b", "1-", "1-10:", "1-99999999", "1.5"])
def test_bad_ranges_are_refused_in_one_paragraph(text: str) -> None:
    with pytest.raises(UsageError, match=r"^The frame range .* cannot be used .*Where: here\.") as caught:
        parse_frames(text, "here")
    assert "\n" not in str(caught.value)


def test_a_sparse_list_is_parsed_in_linear_time() -> None:
    def seconds(count: int) -> float:
        text = ",".join(str(frame) for frame in range(1001, 1001 + 5 * count, 5))
        began = time.process_time()
        assert len(parse_frames(text, "here")) == count
        return time.process_time() - began

    assert seconds(6000) < 2  # 3,000 numbers took 32 s


@pytest.mark.parametrize("pattern", ["/a/b.####.exr", "~/p.%04d.exr", "p.@.exr", "still.exr", "p.#.tar.gz"])
@pytest.mark.parametrize("frame", [-12345, -5, 0, 7, 123456])
def test_paths_are_those_of_fileseq(pattern: str, frame: int) -> None:
    sequence = FileSequence(pattern, pad_style=PAD_STYLE_HASH1)
    name = sequence.frame(frame) if sequence.padding() else pattern
    assert frame_path("/root", pattern, frame) == Path("/root") / Path(name).expanduser()


@pytest.mark.parametrize("pattern", ["cam.01.json", "still.1001.exr", "50%d/still.exr", "a#b/c@d/$F4/p.exr"])
def test_only_the_name_of_a_file_has_a_frame_number(tmp_path: Path, pattern: str) -> None:
    assert frame_path(tmp_path, pattern, 7) == tmp_path / pattern
    assert frames_on_disk(tmp_path, pattern) == set()


def test_folders_keep_signs_of_a_frame_number(tmp_path: Path) -> None:
    (tmp_path / "50%d#").mkdir()
    for name in ("p.0007.exr", "p.12345.exr", "p.00012.exr", "p.7.exr", "q.0008.exr", "p.0009.exr.tmp"):
        (tmp_path / "50%d#" / name).touch()
    assert frame_path(tmp_path, "50%d#/p.####.exr", 7) == tmp_path / "50%d#" / "p.0007.exr"
    assert frames_on_disk(tmp_path, "50%d#/p.####.exr") == {7, 12345}


def test_a_name_of_two_frame_numbers_is_refused() -> None:
    with pytest.raises(JobError, match=r"name of a sequence cannot be understood.*a#b\.%d\.exr"):
        frame_path("/root", "a#b.%d.exr", 7)


@pytest.mark.parametrize(
    "value", [r"C:\\shots\\p.####.exr", "C:/shots/p.####.exr", r"\\\\server\\p.exr", r"plate\\p.exr"]
)
def test_windows_paths_are_named_as_that(tmp_path: Path, value: str) -> None:
    text = yaml.safe_dump({k: v for k, v in GOOD.items() if k != "plate"})
    with pytest.raises(JobError, match=r"'plate.path' is a Windows path.*line 9"):
        load_shot(job(tmp_path, text + f'plate: {{path: "{value}"}}\n'))


@pytest.mark.parametrize("pattern", ["p.####.exr", "p.%04d.exr", "p.@@@@.exr", "p.$F4.exr"])
def test_every_field_notation_of_frames_works(tmp_path: Path, pattern: str) -> None:
    assert frame_path(tmp_path, pattern, 12) == tmp_path / "p.0012.exr"
    for number in (7, 12, 12345):
        (tmp_path / f"p.{number:04d}.exr").touch()
    assert frames_on_disk(tmp_path, pattern) == {7, 12, 12345}


def test_absolute_paths_and_still_pictures_stay(tmp_path: Path) -> None:
    assert frame_path("/a", "/b/p.exr", 3) == Path("/b/p.exr")
    assert frames_on_disk(tmp_path, "still.exr") == set()
