"""USD cameras (.usd, .usda, .usdc, .usdz), with the package usd-core.

USD's camera looks along -z with +y up. Focal length and apertures are in one unit; the horizontal aperture is fitted to
the width of the picture, as Hydra's delegates and Nuke do.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from yesnt.core.errors import JobError, MissingPartError, UsageError
from yesnt.io.camera_files.options import ImportOptions, without_scale, z_up


def read_usd(path: Path, options: ImportOptions) -> dict[str, Any]:
    """A USD camera as the document of `camera.json`; the stage says which axis is up and the unit of its lengths.

    Raises:
        JobError: the stage cannot be opened, or has no camera, or several and none is named.
        UsageError: the size of the pictures is unknown.
        MissingPartError: usd-core is not installed.
    """
    try:
        from pxr import Tf, Usd, UsdGeom
    except ImportError as error:
        raise MissingPartError(
            "USD files need the package usd-core", str(path), "pip install 'yesnt[usd]'",
            "install it, or export a .chan or a camera.json",
        ) from error  # fmt: skip
    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        raise JobError("The USD file cannot be opened", str(path), "a USD stage", "export it again") from error
    camera = _choose(path, [p for p in stage.Traverse() if p.IsA(UsdGeom.Camera)], options.camera)
    frames = options.frames or _frames(stage)
    up, metres = UsdGeom.GetStageUpAxis(stage).lower(), UsdGeom.GetStageMetersPerUnit(stage)
    poses, lenses = {}, {}
    for frame in frames:
        seen = UsdGeom.Camera(camera).GetCamera(Usd.TimeCode(frame))
        if seen.projection != seen.Perspective:
            raise JobError(
                "The camera is orthographic", f"{path}: {camera.GetPath()}", "a perspective camera", "change it"
            )
        pose = without_scale(np.array(seen.transform).T)  # USD's matrices act on rows
        pose[:3, 3] *= metres
        poses[frame], lenses[frame] = z_up(pose, up), _lens(seen, options)
    return _document(path, str(camera.GetPath()), options, poses, lenses)


def _choose(path: Path, cameras: list[Any], wanted: str | None) -> Any:
    """The only camera, or the one that is named."""
    named = [c for c in cameras if wanted in (str(c.GetPath()), c.GetName())] if wanted else cameras
    if len(named) != 1:
        there = ", ".join(str(c.GetPath()) for c in cameras) or "none"
        raise JobError(
            f"The file has {len(cameras)} cameras" if not wanted else f"{len(named)} cameras are called {wanted}",
            f"{path}: {there}", "one camera", "name one with `--camera PATH`",
        )  # fmt: skip
    return named[0]


def _frames(stage: Any) -> tuple[int, ...]:
    first, last = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    if not stage.HasAuthoredTimeCodeRange():
        raise UsageError(
            "The USD file does not say its frames", stage.GetRootLayer().identifier, "`--frames 1001-1024`", "name them"
        )
    return tuple(range(int(np.ceil(first)), int(np.floor(last)) + 1))


def _lens(seen: Any, options: ImportOptions) -> dict[str, float]:
    """Intrinsics in pixels of a `Gf.Camera`."""
    width, height = options.pixels
    across = seen.horizontalAperture
    fx = seen.focalLength / across * width
    fy = fx * options.pixel_aspect
    offset_x, offset_y = (
        offset / across * width for offset in (seen.horizontalApertureOffset, seen.verticalApertureOffset)
    )
    return {"fx": fx, "fy": fy, "cx": width / 2 - offset_x, "cy": height / 2 + offset_y * options.pixel_aspect}


def _document(
    path: Path, name: str, options: ImportOptions, poses: dict[int, Any], lenses: dict[int, dict[str, float]]
) -> dict[str, Any]:
    (width, height), first = options.pixels, next(iter(lenses.values()))
    frames = {
        str(frame): {"world_from_camera": pose.ravel().tolist(), **({} if lenses[frame] == first else lenses[frame])}
        for frame, pose in poses.items()
    }
    return {
        "axes": "opengl",
        "source": path.name,
        "name": name,
        "width": width,
        "height": height,
        **first,
        "frames": frames,
    }
