"""Corrections in a run: what is solved from them, and what a change of theirs makes again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from tests.cases.shots import FRAME, deliver, material, sphere, write, write_shot
from tests.in_process import run_here
from yesnt.inspect.forecast import forecast
from yesnt.io.store import FrameStore
from yesnt.planning.stages import CORRECT, SOLVE
from yesnt.runtime.clamps import clamp_lines
from yesnt.runtime.session import Session
from yesnt.tasks.correct import SCALED_BEYOND

SEEN = sphere()
HALF = np.zeros_like(SEEN.matte)
HALF[:, HALF.shape[1] // 2 :] = 1
INSIDE, OUTSIDE = (HALF * SEEN.matte) > 0, ((1 - HALF) * SEEN.matte) > 0
FRAMES = (FRAME, FRAME + 1)
MATERIALS = [{"mask": "half.exr", "metallic": 1.0, "roughness": {"scale": 0.5}}]


def corrected_shot(folder: Path, **job: Any) -> Path:
    """A grey sphere whose right half is made metal."""
    made = write_shot(folder, FRAMES, **{"materials": MATERIALS, **job})
    write(made / "half.exr", {"Y": HALF})
    return made


def test_an_override_is_what_is_solved_and_delivered(tmp_path: Path) -> None:
    plain = deliver(write_shot(tmp_path / "plain", FRAMES)).planes
    planes = deliver(corrected_shot(tmp_path / "s")).planes
    assert (np.abs(planes["metallic.Y"][INSIDE] - 1) < 0.03).all()
    assert (np.abs(planes["metallic.Y"][OUTSIDE]) < 0.03).all()
    assert (np.abs(planes["roughness.Y"][INSIDE] - 0.25) < 0.03).all()
    assert np.abs(planes["relit.R"] - plain["relit.R"])[INSIDE].mean() < 0.1
    np.testing.assert_array_equal(planes["N.X"], plain["N.X"])


def test_a_job_without_corrections_has_neither_nodes_nor_arrays_of_theirs(tmp_path: Path) -> None:
    session = run_here(write_shot(tmp_path / "s"), "decompose")
    assert CORRECT not in session.graph().stages
    assert not (session.output.store / "corrected").exists()
    assert "correct" not in {row.stage for row in forecast(session).stages}


def test_a_changed_override_samples_nothing_again(tmp_path: Path) -> None:
    folder = corrected_shot(tmp_path / "s")
    run_here(folder, "composite")
    job = yaml.safe_load((folder / "shot.yaml").read_text())
    job["materials"][0]["metallic"] = 0.5
    (folder / "shot.yaml").write_text(yaml.safe_dump(job))
    todo = {row.stage: row.todo for row in forecast(Session(folder)).stages}
    assert (todo["decompose"], todo["flow"], todo["correct"], todo["relight"]) == (0, 0, 2, 2)
    write(folder / "half.exr", {"Y": HALF * 0.5})
    assert {row.stage: row.todo for row in forecast(Session(folder)).stages}["decompose"] == 0


def test_what_a_scale_takes_above_1_is_told_after_the_run(tmp_path: Path) -> None:
    entries = [{"mask": "half.exr", "roughness": {"scale": 3}}]
    session = run_here(corrected_shot(tmp_path / "s", materials=entries), "correct")
    lines = clamp_lines(FRAMES, session.graph(), session.open_index())
    assert lines == [f"{SCALED_BEYOND}: {2 * int(INSIDE.sum()):,} in 2 frames"]


def test_neighbours_do_not_lower_the_confidence_of_what_is_given(tmp_path: Path) -> None:
    """The second frame's pass contradicts the others; what the override gives there keeps its full weight."""
    frames = tuple(range(FRAME, FRAME + 5))
    folder = write_shot(tmp_path / "s", frames, materials=[{"mask": "half.####.exr", "metallic": 1.0}])
    for frame in frames:
        odd = frame == FRAME + 2
        write(folder / f"half.{frame}.exr", {"Y": HALF * odd})
        write(folder / f"material.{frame}.exr", material(0.5, 0.0))
    session = run_here(folder, "confidence")
    confidence = FrameStore(session.output.store).read("confidence", 2)[1]
    assert (confidence[INSIDE] == 1).all()


def test_a_pass_of_roughness_stands_beside_the_backends_metallic(tmp_path: Path) -> None:
    job = {"backend": "embedded", "samples": 1, "roughness": {"path": "rough.exr"}}
    folder = write_shot(tmp_path / "s", decompose=job)
    write(folder / "rough.exr", {"roughness.Y": np.full_like(HALF, 0.15)})
    session = run_here(folder, "solve")
    store = FrameStore(session.output.store)
    observed, solved = store.read("observed", 0), store.read(SOLVE.array("material"), 0)
    inside = SEEN.hit
    assert abs(observed[0][inside] - 0.15).max() > 0.1, "the backend itself says something else"
    np.testing.assert_allclose(solved[0][inside], 0.15, atol=0.01)
    np.testing.assert_allclose(store.read("corrected", 0)[1], observed[1])
