"""A tiny shot through every stage on two workers: resume, staleness, damage, repair, subsets, order."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.tiny_shot import write_tiny_shot
from yesnt.core.errors import UsageError
from yesnt.inspect.explain import explain
from yesnt.inspect.forget import forget
from yesnt.inspect.frame_states import states
from yesnt.inspect.verify import verify
from yesnt.io.pictures.image import read_image
from yesnt.io.store import FrameStore
from yesnt.planning.stages import COMPOSITE, DECOMPOSE, FLOW, RELIGHT
from yesnt.runtime.cluster.open_cluster import open_cluster
from yesnt.runtime.launchers.spec import ClusterSpec
from yesnt.runtime.run_options import RunOptions, RunResult
from yesnt.runtime.session import Session

FRAMES = 4


@pytest.fixture(scope="module")
def cluster():
    with open_cluster(ClusterSpec("local", 2)) as client:
        yield ClusterSpec(client.scheduler.address)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory, cluster: ClusterSpec) -> Path:
    path = write_tiny_shot(tmp_path_factory.mktemp("finished") / "shot", FRAMES)
    assert not run(path, cluster).missing
    return path


@pytest.fixture
def copied(finished: Path, tmp_path: Path) -> Path:
    shutil.copytree(finished.parent, tmp_path / "shot")
    return tmp_path / "shot" / "shot.yaml"


def run(path: Path, cluster: ClusterSpec, **options) -> RunResult:
    return Session(path).run(RunOptions(cluster=cluster, **options))


def exr_digests(path: Path) -> dict[str, str]:
    return {
        p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted((path.parent / "out" / "exr").glob("*.exr"))
    }


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def stages_of(result: RunResult) -> set[str]:
    return {stage.name for stage, _ in result.outcome.done}


def test_what_comes_out_is_the_contract(finished: Path) -> None:
    out = finished.parent / "out"
    assert sorted(p.name for p in (out / "exr").iterdir()) == [f"tiny.{n}.exr" for n in range(1001, 1005)]
    image = read_image(out / "exr" / "tiny.1001.exr")
    expected = {
        *"RGBA", *(f"relit.{c}" for c in "RGBA"), *(f"{n}.{c}" for n in ("diffuse", "specular") for c in "RGB"),
        "shadow.Y", "roughness.Y", "metallic.Y", "roughness_std.Y", "metallic_std.Y", "N.X", "N.Y", "N.Z", "depth.Z",
    }  # fmt: skip
    assert set(image.channels) == expected
    assert all(np.isfinite(plane).all() for plane in image.channels.values())
    assert len(image.header.attributes["yesnt:job"]) == 32
    assert image.header.attributes["compression"] == "zip"
    for name in ("preview.mp4", "contact_sheet.png", "events.jsonl", "record_index.json"):
        assert (out / "run" / name).stat().st_size > 0
    assert all(json.loads(line) for line in (out / "run" / "events.jsonl").read_text().splitlines())
    assert (out / "run" / "logs" / "relight" / "1001.log").read_text().count("done") == 1


def test_layers_add_up(finished: Path) -> None:
    image = read_image(finished.parent / "out" / "exr" / "tiny.1002.exr")
    relit, alpha = image.stack([f"relit.{c}" for c in "RGB"]), image.channels["relit.A"][..., None]
    total = image.stack([f"diffuse.{c}" for c in "RGB"]) + image.stack([f"specular.{c}" for c in "RGB"])
    np.testing.assert_allclose(total, relit, rtol=2e-3, atol=1e-4)
    over = image.stack("RGB") - relit
    assert (over[alpha[..., 0] == 1] == 0).all(), "an opaque figure hides the background"
    assert (over[alpha[..., 0] == 0] > 0).all(), "the light's map is seen around it"


def test_a_second_run_does_nothing(copied: Path, cluster: ClusterSpec) -> None:
    before = exr_digests(copied)
    result = run(copied, cluster)
    assert not result.outcome.done
    assert result.dashboard == "", "no cluster is started for nothing"
    assert exr_digests(copied) == before


def test_a_fresh_run_gives_the_same_bytes(finished: Path, tmp_path: Path) -> None:
    path = write_tiny_shot(tmp_path / "again", FRAMES)
    run(path, ClusterSpec("local", 1))
    assert exr_digests(path) == exr_digests(finished)


@pytest.mark.parametrize(
    ("old", "new", "redone"),
    [
        ("version: 1", "version: 1\nexr: {compression: piz}", {"composite", "preview"}),
        ("path: light.exr", "path: light.exr\n  exposure: 1.0", {"relight", "composite", "preview"}),
        ("version: 1", "version: 1\ntemporal: {knobs: {lambda2: 2.5}}", {"solve", "relight", "composite", "preview"}),
    ],
)
def test_a_change_redoes_what_depends_on_it_and_no_more(
    copied: Path, cluster: ClusterSpec, old: str, new: str, redone: set[str]
) -> None:
    change(copied, old, new)
    assert {s.stage for s in states(Session(copied)) if s.state == "stale"} == redone
    assert stages_of(run(copied, cluster)) == redone
    assert {s.state for s in states(Session(copied))} == {"done"}


def test_one_changed_plate_redoes_its_frame_and_what_it_reaches(copied: Path, cluster: ClusterSpec) -> None:
    folder = copied.parent
    shutil.copy(folder / "plate.1003.exr", folder / "plate.1004.exr")
    assert set(run(copied, cluster).outcome.done) >= {(DECOMPOSE, 3), (FLOW, 2)}
    assert not {("decompose", 0), ("flow", 0)} & {
        (s.stage, s.frame - 1001) for s in states(Session(copied)) if s.state != "done"
    }


def test_explain_names_the_field(copied: Path) -> None:
    change(copied, "texels: 8", "texels: 9")
    why = {s.stage: s.why for s in explain(Session(copied), 1002)}
    assert why["relight"] == "relight.texels was 8, is 9"
    assert why["solve"] == ""
    with pytest.raises(UsageError, match="no frame 7"):
        explain(Session(copied), 7)


def test_subset_first_then_all_gives_the_same_bytes(finished: Path, tmp_path: Path, cluster: ClusterSpec) -> None:
    path = write_tiny_shot(tmp_path / "s", FRAMES)
    result = run(path, cluster, frames="1003")
    assert {i for s, i in result.outcome.done if s == COMPOSITE} == {2}
    assert "preview" not in stages_of(result)
    run(path, cluster, until="flow")
    run(path, cluster)
    assert exr_digests(path) == exr_digests(finished)


def test_wrong_options_are_refused_before_anything_is_written(tmp_path: Path, cluster: ClusterSpec) -> None:
    path = write_tiny_shot(tmp_path / "s", FRAMES)
    with pytest.raises(UsageError, match="No stage 'polish'"):
        run(path, cluster, until="polish")
    with pytest.raises(UsageError, match="no frame 2000"):
        run(path, cluster, frames="2000")
    assert not (path.parent / "out").exists()


def shard(path: Path, name: str, position: int) -> Path:
    return Session(path).output.store / name / "c" / str(position) / "0" / "0" / "0"


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(data)


def swap(one: Path, two: Path) -> None:
    data = one.read_bytes()
    one.write_bytes(two.read_bytes())
    two.write_bytes(data)


FAULTS = {
    "deleted shard": (lambda p: shard(p, "material", 1).unlink(), {("solve", 1002)}),
    "empty shard": (lambda p: shard(p, "observed", 0).write_bytes(b""), {("decompose", 1001)}),
    "flipped bit in a shard": (lambda p: flip(shard(p, "diffuse", 2)), {("relight", 1003)}),
    "truncated EXR": (lambda p: (e := exr(p, 1002)).write_bytes(e.read_bytes()[:500]), {("composite", 1002)}),
    "flipped bit in an EXR": (lambda p: flip(exr(p, 1004)), {("composite", 1004)}),
    "swapped shards": (lambda p: swap(shard(p, "flow", 0), shard(p, "flow", 1)), {("flow", 1001), ("flow", 1002)}),
    "swapped EXRs": (lambda p: swap(exr(p, 1001), exr(p, 1002)), {("composite", 1001), ("composite", 1002)}),
    "damaged record": (lambda p: Session(p).book.path("relight", 1001).write_text("{"), {("relight", 1001)}),
    "deleted video": (lambda p: (p.parent / "out/run/preview.mp4").unlink(), {("preview", 1001)}),
}


def exr(path: Path, frame: int) -> Path:
    return path.parent / "out" / "exr" / f"tiny.{frame}.exr"


@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_is_found_and_repaired_exactly(
    copied: Path, finished: Path, cluster: ClusterSpec, name: str
) -> None:
    spoil, expected = FAULTS[name]
    assert verify(Session(copied)) == []
    spoil(copied)
    session = Session(copied)
    damage = verify(session)
    assert {(d.stage, d.frame) for d in damage} == expected
    for found in damage:
        session.book.forget(found.stage, found.frame)
    redone = run(copied, cluster).outcome.done
    assert {s.name for s, _ in redone} == {s for s, _ in expected}
    assert verify(Session(copied)) == []
    assert exr_digests(copied) == exr_digests(finished)


def test_retry_forgets_what_it_is_told(copied: Path, cluster: ClusterSpec, finished: Path) -> None:
    assert forget(Session(copied), ["relight", "composite"], "1002-1003") == 4
    assert {i for _, i in run(copied, cluster).outcome.done if _ == RELIGHT} == {1, 2}
    assert exr_digests(copied) == exr_digests(finished)


def test_frames_that_cannot_be_had_are_left_out_and_all_others_finish(
    tmp_path: Path, cluster: ClusterSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_tiny_shot(tmp_path / "s", FRAMES)
    session = Session(path)
    node = session.graph().nodes[DECOMPOSE, 1]
    session.dead_marks.set(node.stage, node.frames, "it killed two workers")
    result = run(path, cluster)
    assert set(result.missing) == {(DECOMPOSE, 1002)}
    assert sorted(exr_digests(path)) == ["tiny.1001.exr", "tiny.1003.exr", "tiny.1004.exr"]
    assert forget(Session(path), ["decompose"], None) >= 1
    assert not run(path, cluster).missing
    assert len(exr_digests(path)) == FRAMES


def test_chunks_with_exchange_give_what_one_chunk_gives(tmp_path: Path, cluster: ClusterSpec) -> None:
    def material(chunk: int) -> np.ndarray:
        path = write_tiny_shot(tmp_path / f"c{chunk}", 8, temporal={"chunk": chunk})
        run(path, cluster, until="solve")
        session = Session(path)
        assert sorted(p.name for p in session.output.store.glob("solve.*")) == [], "sweeps are swept away"
        assert not run(path, cluster, until="solve").outcome.done, "and are not made again"
        return np.stack([FrameStore(session.output.store).read("material", i) for i in range(8)])

    np.testing.assert_allclose(material(4), material(16), atol=1e-4)


def test_a_cluster_that_is_too_busy_to_close_takes_nothing_back(monkeypatch: pytest.MonkeyPatch) -> None:
    from distributed import LocalCluster

    close = LocalCluster.close

    def late(self: LocalCluster, timeout: float | None = None) -> None:
        close(self, timeout)
        raise TimeoutError(f"timed out after {timeout} s.")

    monkeypatch.setattr(LocalCluster, "close", late)
    with open_cluster(ClusterSpec("local", 1)) as client:
        assert client.submit(sum, (1, 2)).result(timeout=30) == 3


def test_a_run_on_workers_makes_views_of_fields_and_goes_on(tmp_path: Path, cluster: ClusterSpec) -> None:
    from tests.runtime.test_gaussian_job import write_field_shot

    path = write_field_shot(tmp_path / "shot", 1)
    result = run(path, cluster)
    assert {stage.name for stage, _ in result.outcome.done} >= {"mesh", "view", "relight", "composite"}
    assert not result.missing
    assert len(exr_digests(path)) == 1
    assert not run(path, cluster).outcome.done
