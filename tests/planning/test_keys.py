"""Keys hold what a result depends on and nothing else: a new optional setting changes no key and no delivered byte."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import shutil
from pathlib import Path

import pytest

from tests.in_process import run_here
from tests.planning.long_shot import long_plan
from tests.tiny_shot import write_tiny_shot
from yesnt.core.material_input import DecomposeInput
from yesnt.core.shot import LightInput, Shot, TemporalInput
from yesnt.inspect.frame_states import states
from yesnt.io import jobfile
from yesnt.io.records import SharedSettings, digest_of, frame_key, key_of
from yesnt.planning.keyed_settings import changed_fields, changed_keys, shared
from yesnt.planning.settings import ensemble_settings
from yesnt.planning.stages import DECOMPOSE, STAGES
from yesnt.runtime.session import Session
from yesnt.temporal import EnergyParams
from yesnt.workflows.shot import shot_graph


class LaterTemporal(TemporalInput):
    """The section as a later version might have it."""

    steadiness: float = 1.0


class LaterLight(LightInput):
    """The section as a later version might have it."""

    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)


class LaterShot(Shot):
    """The job file as a later version might have it: new optional keys at the top and in sections."""

    temporal: LaterTemporal = LaterTemporal()
    light: LaterLight
    grain: bool = False


@dataclasses.dataclass(frozen=True)
class LaterParams(EnergyParams):
    """The kernel's settings as a later version might have them."""

    order: int = 2


def keys(path: Path) -> dict[str, str]:
    return {f"{node.stage} {frame}": node.frame_key(frame) for node in Session(path).graph() for frame in node.frames}


def delivered(path: Path) -> dict[str, str]:
    files = sorted((path.parent / "out" / "exr").glob("*.exr"))
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def test_a_new_optional_setting_changes_no_key_and_no_delivered_byte(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_tiny_shot(tmp_path / "shot", 2, temporal={"tolerance": 1e-3})
    run_here(path, "composite")
    before, files = keys(path), delivered(path)
    assert len(files) == 2
    monkeypatch.setattr(jobfile, "Shot", LaterShot)
    monkeypatch.setattr("yesnt.planning.builders.solve.of.energy_params", lambda shot: LaterParams())
    assert isinstance(Session(path).job.shot, LaterShot)
    assert keys(path) == before
    shutil.rmtree(path.parent / "out")
    run_here(path, "composite")
    assert delivered(path) == files
    path.write_text(path.read_text() + "grain: true\n")
    changed = {name for name, key in keys(path).items() if key != before[name]}
    assert {name.split()[0] for name in changed} == {"composite", "preview.segment", "preview"}, "the EXR names its job"


def test_a_setting_at_its_default_is_as_if_it_were_not_written(tmp_path: Path) -> None:
    path = write_tiny_shot(tmp_path / "shot", 2)
    before = keys(path)
    text = "seed: 0\nquality: standard\nexr: {compression: zip}\ntemporal: {robust: true, tolerance: 0.0001}\n"
    path.write_text(path.read_text() + text)
    assert keys(path) == before
    path.write_text(path.read_text().replace("robust: true", "robust: false"))
    assert {s.state for s in states(Session(path)) if s.stage in ("decompose", "flow")} == {"waiting"}
    changed = {name.split()[0] for name, key in keys(path).items() if key != before[name]}
    assert changed == {"confidence", "solve", "relight", "composite", "preview.segment", "preview"}


def test_a_records_key_is_the_hash_of_its_fields_after_a_way_through_json() -> None:
    plan = long_plan(12, chunk=4)
    graph = shot_graph(plan)
    keys = {}
    for node in graph:
        for frame in node.frames:
            fields = json.loads(json.dumps(node.frame_fields(frame)))
            assert key_of(fields) == node.frame_key(frame)
            keys[node.stage, frame] = node.frame_key(frame)
    solved = {key for (stage, _), key in keys.items() if stage.name == "solve"}
    assert len(solved) == sum(len(node.frames) for node in graph if node.stage.name == "solve"), "one for each frame"


def test_a_frames_size_and_a_stages_version_are_in_every_key(monkeypatch: pytest.MonkeyPatch) -> None:
    def found(size: tuple[int, int] = (64, 48)) -> set[str]:
        return {node.key for node in shot_graph(long_plan(2, size))}

    before = found()
    assert not before & found((32, 48))
    monkeypatch.setitem(STAGES, "decompose", dataclasses.replace(STAGES["decompose"], version=99))
    assert len(before & found()) == 1, "only flow does not follow from the decomposition"


def test_shared_settings_are_hashed_as_any_others() -> None:
    settings = {"energy": {"lambda1": 0.5}}
    fields = {"stage": "solve", "settings": settings, "inputs": {}}
    assert key_of({**fields, "settings": SharedSettings(settings)}) == key_of(fields)
    assert key_of({**fields, "frame": 7}) == frame_key(key_of(fields), 7) != frame_key(key_of(fields), 8)
    assert key_of({"job": "a"}) == digest_of({"job": "a"})
    with pytest.raises(ValueError, match="not JSON compliant"):
        key_of({"settings": {"a": float("nan")}})


def test_only_what_differs_from_its_default_is_kept() -> None:
    assert changed_fields(EnergyParams()) == {}
    assert changed_fields(EnergyParams(delta=0.5)) == {"delta": 0.5}
    assert changed_keys(DecomposeInput(backend="embedded", path="p"), {"path"}) == {}
    assert changed_keys(DecomposeInput(samples=9)) == {"samples": 9}
    assert shared(a={}, b=None, c=0, d=False, e=[1]) == {"c": 0, "d": False, "e": [1]}


def sampling(tmp_path: Path, **decompose: object) -> tuple[dict[str, str], str, int]:
    """Keys of a job, the digest that its EXRs carry, and the members that it draws."""
    path = write_tiny_shot(tmp_path / "shot", 2, decompose=decompose)
    session = Session(path)
    return keys(path), session.plan().job_digest, ensemble_settings(session.job.shot).samples


def test_the_embedded_model_draws_two_members_where_the_job_does_not_say(tmp_path: Path) -> None:
    default, two, eight = (sampling(tmp_path, **stated) for stated in ({}, {"samples": 2}, {"samples": 8}))
    assert (default[2], two[2], eight[2]) == (2, 2, 8)
    assert default[0]["decompose 1001"] == two[0]["decompose 1001"] != eight[0]["decompose 1001"]
    assert sampling(tmp_path, knobs={"tolerance": 0.02})[2] == 8, "the most that a patch may get"
    assert sampling(tmp_path, samples=4, knobs={"tolerance": 0.02})[2] == 4


def test_a_job_that_states_eight_members_keeps_its_keys_and_its_header(tmp_path: Path) -> None:
    session = Session(write_tiny_shot(tmp_path / "shot", 2, decompose={"samples": 8}))
    fields = session.graph().nodes[DECOMPOSE, 0].fields
    assert "ensemble" not in fields["settings"], "it was the default of all backends, and keys hold no defaults"
    assert session.plan().job_digest == sampling(tmp_path)[1]
