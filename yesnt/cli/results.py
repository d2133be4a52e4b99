"""What a run left and where, for the last lines that it prints."""

from __future__ import annotations

from yesnt.core.gaussian_input import FOLDER
from yesnt.io.output import OutputFolder

_OF_FIELDS = ("field", "view", "proxy")


def result_lines(output: OutputFolder) -> list[str]:
    """Where the results of a run are; a run that stopped early has no EXR sequence, so none is named."""
    lines, fields = [], output.root / FOLDER
    made = [kind for kind in _OF_FIELDS if any(fields.glob(f"{kind}.*"))]
    if made:
        lines.append(f"Gaussians:    {fields} ({', '.join(made)})")
    if output.exr.is_dir():
        lines.append(f"EXR sequence: {output.exr}")
    preview = output.run / "preview.mp4"
    if preview.exists():
        lines.append(f"Preview:      {preview} and contact_sheet.png")
    return lines
