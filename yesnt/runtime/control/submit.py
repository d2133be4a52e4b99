"""Hands a run over: to a driver process on this machine, or to a job of a batch system that holds everything."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from yesnt.core.errors import UsageError
from yesnt.core.shot import Shot
from yesnt.io.jobfile import parse_frames
from yesnt.io.output import OutputFolder
from yesnt.runtime.control.commands import open_output
from yesnt.runtime.control.submission import (
    Submission,
    driver_command,
    keep,
    made_now,
    new_submission_id,
    start_detached,
)
from yesnt.runtime.launchers.allocation import submission_script
from yesnt.runtime.launchers.slurm_commands import require_command, submit
from yesnt.runtime.launchers.spec import ClusterSpec, read_cluster
from yesnt.runtime.launchers.table import check_cluster
from yesnt.runtime.run_options import check_stage

SLURM = "slurm"
"""Kind of cluster whose drivers are jobs of its own; those of all others are processes of this machine."""


@dataclass(frozen=True)
class SubmitOptions:
    """Options of `yesnt run` that a submission passes on, as the user gave them."""

    cluster: str
    workers: int | None = None
    insecure: bool = False
    frames: str | None = None
    until: str | None = None
    force: tuple[str, ...] = ()
    priority: int = 0
    accept_license: tuple[str, ...] = ()

    def arguments(self, cluster: str) -> list[str]:
        """The options as arguments of `yesnt run`."""
        found = ["--cluster", cluster]
        found += ["--workers", str(self.workers)] if self.workers else []
        found += ["--insecure"] if self.insecure else []
        found += ["--frames", self.frames] if self.frames else []
        found += ["--until", self.until] if self.until else []
        found += [word for force in self.force for word in ("--force", force)]
        found += ["--priority", str(self.priority)] if self.priority else []
        return found + [word for name in self.accept_license for word in ("--accept-license", name)]


def submit_run(path: Path, options: SubmitOptions) -> Submission:
    """Starts a driver that goes on without this process; what a quick look can refuse is refused first.

    Raises:
        JobError: the job file is wrong, or the job is being run.
        UsageError: wrong options, or a cluster that cannot run the job.
    """
    shot, output = open_output(path)
    check_stage(options.until, "--until")
    for force in options.force:
        check_stage(force.partition(":")[0], f"--force {force}")
    _check_frames(shot, options.frames)
    spec = read_cluster(options.cluster, options.workers, options.insecure)
    if spec.kind == SLURM:
        require_command("sbatch")  # whether the job's own cluster can be had shows inside of the job
    else:
        check_cluster(spec)
    output.check(0)
    output.refuse_if_running()
    output.run.mkdir(parents=True, exist_ok=True)
    identifier, file = new_submission_id(shot.name), str(path.absolute())
    cluster = str(Path(options.cluster).absolute()) if Path(options.cluster).is_file() else options.cluster
    job, command = _start(output, identifier, [file, *options.arguments(cluster)], spec)
    made = made_now(identifier, options.cluster, job, command)
    keep(output, made)
    return made


def _start(output: OutputFolder, identifier: str, arguments: list[str], spec: ClusterSpec) -> tuple[str, list[str]]:
    """Starts the driver; returns where it is, and its arguments."""
    if spec.kind != SLURM:
        return start_detached(output, identifier, arguments), arguments
    script = submission_script(spec, driver_command(identifier, arguments), output.driver_log)
    return f"slurm job {submit(script, output.run)}", arguments


def _check_frames(shot: Shot, text: str | None) -> None:
    if text is None:
        return
    unknown = sorted(set(parse_frames(text, "--frames")) - set(parse_frames(shot.frames, "key frames")))
    if unknown:
        raise UsageError(f"The shot has no frame {unknown[0]}", "--frames", shot.frames, "choose among these")
