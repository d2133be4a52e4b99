"""The verbs (contract.md). Each reads its options, calls one function of the layers below, prints what came back."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from yesnt.cli import control, text
from yesnt.cli.camera import camera
from yesnt.cli.capture import capture
from yesnt.cli.evaluate import evaluate
from yesnt.cli.file_progress import FileProgress
from yesnt.cli.gof import GofAction
from yesnt.cli.share import drive_shared, refuse_with_share
from yesnt.cli.trade import trade

app = typer.Typer(
    help="Relights volumetric video: decompose, stabilise, relight, composite.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

ShotArgument = Annotated[Path, typer.Argument(metavar="SHOT", help="shot.yaml or its folder")]
JsonOption = Annotated[bool, typer.Option("--json", help="one JSON document on stdout")]
FramesOption = Annotated[str | None, typer.Option(help="frames, as 1001-1010x2,1020")]
OrderedFramesOption = Annotated[
    str | None, typer.Option(help="frames, as 1001-1010x2,1020; 1-100:10 does every tenth first")
]
ForceOption = Annotated[
    list[str] | None, typer.Option(metavar="STAGE[:F]", help="make these frames again, and what uses them")
]
PriorityOption = Annotated[int, typer.Option(help="among the runs of one scheduler; higher goes first")]
WorkersOption = Annotated[int, typer.Option(min=1, max=1024, help="worker processes, one thread each")]
ClusterWorkersOption = Annotated[
    int | None, typer.Option(min=1, max=10_000, help="CPU workers, one thread each [2, or the profile's]")
]
ClusterOption = Annotated[str, typer.Option(help="local, slurm, a profile (farm.yaml), or a scheduler's address")]
InsecureOption = Annotated[bool, typer.Option("--insecure", help="allow plain TCP to a scheduler elsewhere")]


@app.command()
def run(
    shot: ShotArgument,
    workers: ClusterWorkersOption = None,
    cluster: ClusterOption = "local",
    insecure: InsecureOption = False,
    frames: OrderedFramesOption = None,
    until: Annotated[str | None, typer.Option(metavar="STAGE", help="stop after this stage")] = None,
    force: ForceOption = None,
    priority: PriorityOption = 0,
    share: Annotated[
        bool, typer.Option("--share", help="tasks run in this process, beside others that do the same")
    ] = False,
    accept_license: Annotated[list[str] | None, typer.Option(metavar="NAME", help="a non-commercial licence")] = None,
    json: JsonOption = False,
) -> int:
    """Run a shot; what is done already is not done again."""
    from yesnt.runtime.driver.driver import DriverSettings
    from yesnt.runtime.launchers.spec import read_cluster
    from yesnt.runtime.run_options import RunOptions
    from yesnt.runtime.session import Session

    if share:
        refuse_with_share({"--cluster": cluster != "local", "--workers": workers, "--force": force})
    where = read_cluster(cluster, workers, insecure)
    session = Session(shot, tuple(accept_license or ()), FileProgress())
    if share:
        return drive_shared(session, RunOptions(frames, until, where), json)
    settings = DriverSettings(priority=priority)
    return _drive(session, RunOptions(frames, until, where, settings, tuple(force or ())), json)


@app.command()
def demo(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="where the shot is put")] = Path("demo"),
    workers: WorkersOption = 2,
    json: JsonOption = False,
) -> int:
    """Run the main job on the embedded shot with two local workers."""
    from yesnt.io.embedded_shot import copy_embedded_shot
    from yesnt.runtime.launchers.spec import ClusterSpec
    from yesnt.runtime.run_options import RunOptions
    from yesnt.runtime.session import Session

    return _drive(Session(copy_embedded_shot(folder)), RunOptions(cluster=ClusterSpec("local", workers)), json)


@app.command()
def init(folder: Annotated[Path, typer.Argument(metavar="DIR")]) -> None:
    """Write a commented shot.yaml and the folders it expects."""
    from yesnt.io.embedded_shot import write_template

    print(f"Wrote {write_template(folder)}: put your files where it says, then `yesnt plan {folder}`.")


@app.command()
def plan(shot: ShotArgument, cluster: ClusterOption = "local", json: JsonOption = False) -> None:
    """Print what a run would do, why, and what it would cost; no stage runs."""
    from yesnt.cli.plan import print_plan
    from yesnt.inspect.forecast import forecast
    from yesnt.runtime.launchers.spec import read_cluster
    from yesnt.runtime.session import Session

    where = read_cluster(cluster, insecure=True)  # nothing is connected
    session = Session(shot, progress=FileProgress())
    session.check_cluster(where)
    found = forecast(session)
    if json:
        text.print_json(found.as_json())
    else:
        print_plan(found)


@app.command()
def status(
    shot: ShotArgument,
    watch: Annotated[bool, typer.Option("--watch", help="follow a run until it is done")] = False,
    json: JsonOption = False,
) -> None:
    """Print the state of every stage, and why frames are stale."""
    if watch:
        from yesnt.cli.watch import watch as follow
        from yesnt.core.errors import UsageError

        if json:
            raise UsageError(
                "A view that is drawn again is no JSON document",
                "--watch --json",
                "one of them",
                "ask for `status --json` as often as you like",
            )
        follow(shot)
        return
    from yesnt.inspect.run_view import look_at_run
    from yesnt.inspect.status import status as find

    run = look_at_run(shot)
    report = find(shot, FileProgress())
    if json:
        text.print_json({**report.as_json(), "run": dict(vars(run))})
        return
    for line in text.run_lines(run):
        print(line)
    text.print_status(report)


@app.command()
def explain(shot: ShotArgument, frame: int, json: JsonOption = False) -> None:
    """Print for one frame what each stage would compute again, and why."""
    from yesnt.inspect.explain import explain as find
    from yesnt.runtime.session import Session

    found = find(Session(shot, progress=FileProgress(), as_run=True), frame)
    if json:
        rows = [{"stage": s.stage, "state": s.state, "causes": s.causes, "follows": s.follows} for s in found]
        text.print_json({"frame": frame, "stages": rows})
    else:
        text.print_table(
            ("stage", "state", "why"), ((s.stage, s.state, s.why or "everything is as it was") for s in found)
        )


@app.command()
def retry(
    shot: ShotArgument,
    frames: FramesOption = None,
    stage: Annotated[list[str] | None, typer.Option(help="stage to do again; may be given more than once")] = None,
    workers: ClusterWorkersOption = None,
    cluster: ClusterOption = "local",
    insecure: InsecureOption = False,
    json: JsonOption = False,
) -> int:
    """Compute frames again: remove their records and marks of death, then run."""
    from yesnt.inspect.forget import forget
    from yesnt.planning.stages import STAGES
    from yesnt.runtime.launchers.spec import read_cluster
    from yesnt.runtime.run_options import RunOptions
    from yesnt.runtime.session import Session

    where = read_cluster(cluster, workers, insecure)
    forget(Session(shot, as_run=True), stage or list(STAGES), frames)
    return _drive(Session(shot), RunOptions(cluster=where), json)


@app.command()
def verify(
    shot: ShotArgument,
    repair: Annotated[bool, typer.Option("--repair", help="make the damaged frames again, and only these")] = False,
    workers: WorkersOption = 2,
    json: JsonOption = False,
) -> int:
    """Compare everything that is committed with the digests in its records."""
    from dataclasses import asdict

    from yesnt.inspect.verify import verify as find
    from yesnt.runtime.launchers.spec import ClusterSpec
    from yesnt.runtime.run_options import RunOptions
    from yesnt.runtime.session import Session

    session = Session(shot, as_run=True)
    damage = find(session)
    if json and not repair:
        text.print_json({"damaged": [asdict(found) for found in damage]})
    elif not json:
        for found in damage:
            print(f"{found.stage} {found.frame}: {found.what}")
        print(f"{len(damage)} damaged" if damage else "Everything is as it was committed.")
    if not (damage and repair):
        return 1 if damage else 0
    with session.output.lock():
        for found in damage:
            session.book.forget(found.stage, found.frame)
    return _drive(session, RunOptions(cluster=ClusterSpec("local", workers)), json)


@app.command()
def report(shot: ShotArgument) -> None:
    """Write a self-contained page about the run: strips, slices through time, times, timeline."""
    from yesnt.report import write_report
    from yesnt.runtime.session import Session

    print(f"Report: {write_report(Session(shot, as_run=True))}")


@app.command()
def stage(
    sets: Annotated[list[str], typer.Argument(metavar="SET...", help="objects, sequences, reference, multiview, ...")],
    out: Annotated[Path, typer.Option(help="root of the sets")] = Path("stage"),
    cache: Annotated[Path, typer.Option(help="folder of fetched assets")] = Path("stage/cache"),
    small: Annotated[bool, typer.Option("--small", help="2 subjects, 2 maps, 64x64")] = False,
    fits: Annotated[
        Path | None, typer.Option(help="reference: meshes that `yesnt eval --fit-steps` fitted in this folder")
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Blenders side by side [2, or the profile's]")] = None,
    cluster: ClusterOption = "local",
) -> int:
    """Render sets of the virtual capture stage, with truth (needs `make blender`); resumes."""
    from yesnt.cli.staging import drive_stage

    return drive_stage(sets, out, cache, small, fits, workers, cluster)


@app.command()
def gof(
    action: Annotated[GofAction, typer.Argument(metavar="fit|render|mesh", help="fields, pictures or proxy meshes")],
    shot: ShotArgument,
    path: Annotated[
        str | None, typer.Option(metavar="orbit|A,B,...", help="another camera: around, or by cameras of the capture")
    ] = None,
    views: Annotated[int, typer.Option(min=2, max=10_000, help="pictures along the path")] = 24,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="folder of the pictures along the path")] = None,
    frames: FramesOption = None,
    workers: ClusterWorkersOption = None,
    cluster: ClusterOption = "local",
    insecure: InsecureOption = False,
    json: JsonOption = False,
) -> int:
    """Fit Gaussian fields to a capture, render them as plates and G-buffers, or extract their proxy meshes."""
    from yesnt.cli.gof import path_of, render_path
    from yesnt.runtime.launchers.spec import read_cluster
    from yesnt.runtime.run_options import RunOptions
    from yesnt.runtime.session import Session

    along = path_of(action, path, views, out)
    where = read_cluster(cluster, workers, insecure)
    session = Session(shot, progress=FileProgress())
    if along is not None:
        return render_path(session, along, frames, json)
    return _drive(session, RunOptions(frames, action.stage, where), json)


@app.command()
def doctor(json: JsonOption = False) -> int:
    """Show versions, threads, security floors, scratch speed, and optional parts."""
    from yesnt.inspect.doctor import examine

    findings = examine()
    if json:
        text.print_json([finding.__dict__ for finding in findings])
    else:
        text.print_table(("", "part", "found", "do"), ((f.mark, f.part, f.found, f.do) for f in findings))
    return 1 if any(finding.mark == "bad" for finding in findings) else 0


def _drive(session: object, options: object, json: bool) -> int:
    """Runs with progress and prints where the results are; 3 if frames are missing."""
    from yesnt.cli.progress import BarProgress, line_progress
    from yesnt.runtime.run_options import RunOptions
    from yesnt.runtime.session import Session

    assert isinstance(session, Session)
    assert isinstance(options, RunOptions)
    if json:
        result = session.run(options)
    else:
        progress = (BarProgress if sys.stdout.isatty() else line_progress)(session.job.width * session.job.height / 1e6)
        with progress:
            result = session.run(options, progress)
    missing = [{"stage": s, "frame": f, "why": why} for (s, f), why in sorted(result.missing.items())]
    if json:
        text.print_json(
            {
                "done": len(result.outcome.done),
                "reused": len(result.outcome.reused),
                "missing": missing,
                "warnings": result.warnings,
                "notes": list(result.notes),
                "exr": str(session.output.exr),
                "preview": str(session.output.run / "preview.mp4"),
                "dashboard": result.dashboard,
                "busy_seconds": result.outcome.busy_seconds,
                "kernel_seconds": result.outcome.kernel_seconds,
            }
        )
    else:
        text.print_findings(result.notes, result.warnings)
        _print_result(session, missing)
    return 3 if missing else 0


def _print_result(session: object, missing: list[dict[str, object]]) -> None:
    from yesnt.cli.results import result_lines
    from yesnt.core.frame_ranges import frame_ranges
    from yesnt.io.dead_marks import SKIPPED
    from yesnt.runtime.session import Session

    assert isinstance(session, Session)
    for row in missing:
        print(f"Missing: frame {row['frame']} of {row['stage']}: {row['why']}")
    from yesnt.report import write_report

    for line in result_lines(session.output):
        print(line)
    print(f"Report:       {write_report(session)}")
    skipped = [row for row in missing if str(row["why"]).startswith(SKIPPED)]
    if len(missing) > len(skipped):
        print("Some frames are missing; `yesnt retry SHOT` tries them again.")
    if skipped:
        frames = frame_ranges(int(str(row["frame"])) for row in skipped)
        print(f"Frames that you skipped are left out; `yesnt retry SHOT --frames {frames}` takes them in again.")


app.command("eval")(evaluate)
app.command("trade")(trade)
app.command("camera")(camera)
app.command("capture")(capture)
for verb in (
    control.submit,
    control.export_openjd,
    control.logs,
    control.pause,
    control.resume,
    control.cancel,
    control.skip,
):
    app.command()(verb)
