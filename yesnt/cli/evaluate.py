"""`yesnt eval`: reads options, runs the evaluation, prints its tables and where the rest lies."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Annotated, Any

import typer

from yesnt.cli import text

FolderArgument = Annotated[Path | None, typer.Argument(metavar="FOLDER", help="a shot with truth, or a folder of such")]
SetOption = Annotated[str | None, typer.Option("--set", help="a set of the capture stage, as objects; or embedded")]
OutputOption = Annotated[Path | None, typer.Option(help="where results go (default: eval/SET)")]
ShotsOption = Annotated[str | None, typer.Option(help="shots to evaluate, as vase,knot (default: all)")]
MapsOption = Annotated[str | None, typer.Option(help="maps to evaluate, as city,studio (default: all)")]
CaptureRowsOption = Annotated[
    str | None, typer.Option(help="rows of shots with a capture, as cameras_8,cameras_8_all, or none (default: all)")
]
FramesOption = Annotated[int, typer.Option(min=1, help="most frames per shot on which every row is scored")]
AtOption = Annotated[
    str | None,
    typer.Option("--at", metavar="FRAMES", help="score every row on these frames, as 1003,1012"),
]
ProbesOption = Annotated[
    int, typer.Option(min=1, help="maps per shot for the term-by-term rows and the search of constants")
]
SamplesOption = Annotated[int | None, typer.Option(min=1, help="members of the ensemble (default: as the shot says)")]
WeightsOption = Annotated[Path | None, typer.Option(help="weights of the decomposition")]
QualityOption = Annotated[
    str | None, typer.Option(help="draft, standard, final, reference (default: as the shot says)")
]
LpipsOption = Annotated[Path | None, typer.Option(help="state_dict of LPIPS with AlexNet, for the LPIPS columns")]
FitOption = Annotated[
    int | None,
    typer.Option(min=1, help="also fit a Gaussian field to each shot's capture, with so many steps (minutes a shot)"),
]
WorkersOption = Annotated[
    int | None, typer.Option(min=0, max=1024, help="worker processes; 0: in this process [2, or the profile's]")
]
ClusterOption = Annotated[str, typer.Option(help="local, slurm, a profile (farm.yaml), or a scheduler's address")]
JsonOption = Annotated[bool, typer.Option("--json", help="one JSON document on stdout")]


def evaluate(
    folder: FolderArgument = None,
    set_name: SetOption = None,
    output: OutputOption = None,
    shots: ShotsOption = None,
    maps: MapsOption = None,
    capture_rows: CaptureRowsOption = None,
    frames: FramesOption = 3,
    at: AtOption = None,
    probes: ProbesOption = 3,
    samples: SamplesOption = None,
    weights: WeightsOption = None,
    quality: QualityOption = None,
    lpips: LpipsOption = None,
    fit_steps: FitOption = None,
    workers: WorkersOption = None,
    cluster: ClusterOption = "local",
    json: JsonOption = False,
) -> int:
    """Measure shots that have ground truth: accuracy, ablations, videos, error of each stage; finished work is kept."""
    from yesnt.measure.evaluation.run import EvalOptions, run_evaluation
    from yesnt.measure.evaluation.table import as_markdown

    options = EvalOptions(
        shots=_names(shots), maps=_names(maps), thorough=frames, chosen=at, probes=probes, samples=samples,
        weights=weights, quality=quality, lpips=lpips,
        capture_rows=() if capture_rows == "none" else _names(capture_rows),
        fit_knobs=None if fit_steps is None else {"steps": fit_steps}, workers=workers, cluster=cluster,
    )  # fmt: skip
    source = _source(folder, set_name)
    target = output or Path("eval") / (set_name or source.absolute().name)
    with _progress(json) as listen:
        result = run_evaluation(source, target, options, listen)
    if json:
        text.print_json(result.document | {"failed": result.failed})
    else:
        print(as_markdown(result.document))
        for node, reason in sorted(result.failed.items()):
            print(f"Failed: {node}: {reason}")
        print(f"JSON:     {result.json}\nMarkdown: {result.markdown}\nPage:     {result.page}")
    return 3 if result.failed else 0


def _names(text: str | None) -> tuple[str, ...] | None:
    return None if text is None else tuple(name.strip() for name in text.split(",") if name.strip())


def _source(folder: Path | None, set_name: str | None) -> Path:
    """The folder of the shots: the embedded one, a set of the capture stage, or the one that the user named."""
    if folder is None and set_name == "embedded":
        from yesnt.io.embedded_shot import SHOT

        return SHOT
    home = folder or Path("stage")
    return home if set_name is None else home / set_name


class _Silent:
    def __enter__(self) -> Callable[[Mapping[str, Any]], None]:
        return lambda event: None

    def __exit__(self, *error: object) -> None:
        return None


def _progress(json: bool) -> AbstractContextManager[Callable[[Mapping[str, Any]], None]]:
    from yesnt.cli.progress import BarProgress, LineProgress

    if json:
        return _Silent()
    return BarProgress() if sys.stdout.isatty() else LineProgress()
