"""Task that finds the ground under the subject, once for a shot, and the way other tasks read it."""

from __future__ import annotations

import dataclasses
import json
from typing import TYPE_CHECKING, Any

from yesnt.core.errors import CorruptError
from yesnt.io.durable import write_json
from yesnt.io.file_digests import file_digest
from yesnt.io.mesh import read_proxy
from yesnt.planning.stages import GROUND
from yesnt.planning.task_records import GroundTask
from yesnt.tasks.workspace import Workspace

if TYPE_CHECKING:
    from yesnt.scene.ground import Ground


def find_ground(space: Workspace[GroundTask]) -> None:
    """Commits `run/ground.json`: height, middle, reach and radius of the ground."""
    from yesnt.scene.ground import fit_ground, stance

    given = space.job.shot.set
    assert given is not None
    stances = []
    for frame in space.task.frames:
        mesh = read_proxy(space.job, frame)
        space.inputs.prove("proxy", frame)
        with space.kernel():
            stances.append(stance(mesh.vertices, mesh.faces))
    height = given.ground if isinstance(given.ground, float) else None
    ground = fit_ground(stances, height, given.radius)
    path = space.output.ground
    write_json(path, dataclasses.asdict(ground))
    facts = {"ground": ground.height, "contact": fit_ground(stances, None, given.radius).height}
    space.commit(space.frame, {}, {str(path.relative_to(space.output.root)): file_digest(path)}, facts)


def read_ground(space: Workspace[Any]) -> Ground:
    """The ground that the shot's task found.

    Raises:
        CorruptError: its file is not what was committed.
    """
    from yesnt.scene.ground import Ground

    path, record = space.output.ground, space.book.find(GROUND, space.job.frames[0])
    name = str(path.relative_to(space.output.root))
    if record is None or not path.is_file() or record.files.get(name) != file_digest(path):
        raise CorruptError(
            "The ground under the subject is not what was committed", str(path), "the file that its record names",
            "run again: it will be made",
        )  # fmt: skip
    held = json.loads(path.read_text())
    return Ground(held["height"], (held["centre"][0], held["centre"][1]), held["reach"], held["radius"])
