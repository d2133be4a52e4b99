"""Task that writes the scripts for Nuke and Blender beside the EXR sequence."""

from __future__ import annotations

from yesnt.io.compositing.blender import blender_script
from yesnt.io.compositing.nuke import nuke_script
from yesnt.io.compositing.sequence import LayerSequence
from yesnt.io.durable import write_bytes
from yesnt.io.file_digests import file_digest
from yesnt.planning.task_records import CompositingTask
from yesnt.tasks.workspace import Workspace


def write_scripts(space: Workspace[CompositingTask]) -> None:
    """Commits NAME.nk and NAME_layers.py."""
    job, folder = space.job, space.output.exr
    aspect = 1.0 if job.raster is None else float(job.raster.aspect)
    shot, name, frames = job.shot, job.shot.name, (job.frames[0], job.frames[-1])
    sequence = LayerSequence(
        name, frames, job.display_size, aspect, front=shot.scene is not None, set=shot.set is not None,
        groups=len(shot.light_groups) == 2,
    )  # fmt: skip
    texts = {folder / f"{name}.nk": nuke_script(sequence), folder / f"{name}_layers.py": blender_script(sequence)}
    folder.mkdir(parents=True, exist_ok=True)
    for path, text in texts.items():
        write_bytes(path, text.encode())
    space.commit(space.frame, {}, {str(path.relative_to(space.output.root)): file_digest(path) for path in texts})
