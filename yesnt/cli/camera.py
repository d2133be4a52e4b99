"""`yesnt camera`: checks a camera file, converts those of other programs, prints the script for Blender."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from yesnt.cli import text
from yesnt.core.errors import UsageError

if TYPE_CHECKING:
    from yesnt.inspect.camera_facts import CameraFacts


def camera(
    file: Annotated[
        Path | None, typer.Argument(metavar="[FILE]", help="camera.json, cameras.json, .chan, .abc or .usd")
    ] = None,
    write: Annotated[Path | None, typer.Option(metavar="camera.json", help="write the camera in our form")] = None,
    blender_script: Annotated[bool, typer.Option("--blender-script", help="print a script that exports it")] = False,
    size: Annotated[str | None, typer.Option(metavar="WxH", help="size of the pictures, pixels")] = None,
    aperture: Annotated[str | None, typer.Option(metavar="W[xH]", help="sensor, mm (.chan)")] = None,
    focal: Annotated[float | None, typer.Option(metavar="MM", help="focal length, mm (.chan without angle)")] = None,
    pixel_aspect: Annotated[float, typer.Option(help="width of a pixel over its height")] = 1.0,
    rotation_order: Annotated[str, typer.Option(help="of the angles of a .chan, first turned first")] = "ZXY",
    up: Annotated[str, typer.Option(metavar="y|z", help="axis of a .chan's world that points up")] = "y",
    name: Annotated[str | None, typer.Option("--camera", metavar="NAME", help="which of several cameras")] = None,
    frames: Annotated[str | None, typer.Option(help="frames, as 1001-1010x2,1020; default: the file's")] = None,
    fps: Annotated[float, typer.Option(help="frames a second of an .abc, which counts seconds")] = 24.0,
    json: Annotated[bool, typer.Option("--json", help="one JSON document on stdout")] = False,
) -> None:
    """Check a camera and print what it means; convert .chan, Alembic and USD; print an export script for Blender."""
    if blender_script:
        from yesnt.io.camera_files.files import blender_script as script

        print(script(), end="")
        return
    if file is None:
        raise UsageError("No camera is named", "yesnt camera", "a file, or `--blender-script`", "name one")
    from yesnt.inspect.camera_facts import describe
    from yesnt.io.camera_files.files import read_cameras_of, write_camera
    from yesnt.io.camera_files.options import ImportOptions
    from yesnt.io.jobfile import parse_frames

    options = ImportOptions(
        _pair(size, "--size", int), _pair(aperture, "--aperture", float), focal, pixel_aspect, rotation_order, up, name,
        parse_frames(frames, "--frames") if frames else None, fps,
    )  # fmt: skip
    cameras = read_cameras_of(file, options)
    found = {name: describe(one, file.name) for name, one in cameras.items()}
    if write is not None:
        if len(cameras) > 1:
            raise UsageError(
                f"The file has {len(cameras)} cameras", str(file), "`--camera NAME` with --write", "name one"
            )
        write_camera(write, next(iter(cameras.values())), file.name)
    if json:
        text.print_json({name: facts.document | {"warnings": facts.warnings} for name, facts in found.items()})
        return
    for name, facts in found.items():
        _print(name, facts)
    if write is not None:
        print(f"Wrote {write}")


def _pair(value: str | None, option: str, kind: type) -> Any:
    """`1920x1080` as two numbers, `24.576` as a number and None; None without a value.

    Raises:
        UsageError: other text, or numbers that are not positive.
    """
    if value is None:
        return None
    try:
        numbers = [kind(part) for part in value.lower().split("x")]
    except ValueError:
        numbers = []
    if not 1 <= len(numbers) <= 2 or min(numbers) <= 0 or (kind is int and len(numbers) != 2):
        raise UsageError(
            f"{option} {value!r} cannot be used", "yesnt camera", "two positive numbers, as 1920x1080", "mend it"
        )
    return (numbers[0], numbers[1] if len(numbers) > 1 else None)


def _print(name: str, facts: CameraFacts) -> None:
    text.print_table((name, ""), facts.rows)
    for warning in facts.warnings:
        print(f"Warning: {warning}")
