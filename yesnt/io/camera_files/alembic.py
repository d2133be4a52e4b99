"""Alembic cameras (.abc), read by Blender: Python's bindings of Alembic are not published as a package."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

from yesnt.capture_stage.tools import find_tools, run_script
from yesnt.core.errors import JobError, YesntError
from yesnt.io.camera_files.options import ImportOptions

_SCRIPT = Path(__file__).parent / "inside_blender" / "import_alembic.py"


def read_alembic(path: Path, options: ImportOptions) -> dict[str, Any]:
    """An Alembic camera as the document of `camera.json`.

    Alembic's world is Y-up. Blender reads the lens of the first frame only: a zoom needs another format.

    Raises:
        JobError: the file cannot be read, or has no camera, or several and none is named.
        UsageError: the size of the pictures is unknown.
        MissingPartError: there is no Blender.
    """
    if not path.is_file():
        raise JobError("The camera file is missing", str(path), "an Alembic file", "check the path")
    width, height = options.pixels
    tools = find_tools(Path(tempfile.gettempdir()))
    with tempfile.TemporaryDirectory(prefix="yesnt-camera-") as folder:
        request = {
            "abc": str(path.absolute()), "out": folder, "camera": options.camera, "width": width, "height": height,
            "pixel_aspect": options.pixel_aspect, "frames": list(options.frames or ()), "fps": options.fps,
        }  # fmt: skip
        asked = Path(folder) / "request.json"
        asked.write_text(json.dumps(request))
        try:
            run_script(tools, _SCRIPT, [str(asked)], 600.0)
        except YesntError as error:
            raise JobError(
                f"The Alembic file cannot be read ({error.what})", str(path), "a camera", error.do
            ) from error
        document: dict[str, Any] = json.loads((Path(folder) / "camera.json").read_text())
    return document | {"source": path.name}
