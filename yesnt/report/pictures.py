"""Pictures of the report: stages side by side, slices through time, network evaluations per pixel."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import srgb_encode
from yesnt.core.errors import YesntError
from yesnt.io.color_config import convert
from yesnt.io.pictures.image import read_image
from yesnt.io.pictures.png import png_bytes
from yesnt.io.shot_inputs import read_plate
from yesnt.io.store import FrameStore
from yesnt.report.fits import fit_picture
from yesnt.runtime.session import Session

STRIP_FRAMES = 3

HEAT_FRAMES = 4

Float32 = NDArray[np.float32]


def draw(session: Session) -> dict[str, bytes]:
    """PNG bytes by name; a picture whose stage is not done is left out."""
    pictures: dict[str, bytes] = {}
    sheet = session.output.run / "contact_sheet.png"
    if sheet.exists():
        pictures["sheet"] = sheet.read_bytes()
    delivered = [f for f in session.job.frames if session.output.exr_path(session.job.shot.name, f).exists()]
    chosen = delivered[:: max(1, len(delivered) // STRIP_FRAMES)][:STRIP_FRAMES]
    if chosen:
        pictures["strip"] = png_bytes(np.concatenate([stages_of(session, frame) for frame in chosen], axis=0))
    fits = fit_picture(session)
    if fits is not None:
        pictures["fits"] = fits
    heat = _nfe(session)
    if heat is not None:
        pictures["nfe"] = png_bytes(heat)
    measured = _measured(session)
    if measured is not None:
        pictures["measured"] = png_bytes(measured)
    slices = _slices(session)
    if slices is not None:
        pictures["slices"] = png_bytes(slices)
    return pictures


def stages_of(session: Session, frame: int) -> Float32:
    """Plate, roughness, metallic, spread, relit, composite of one frame side by side."""
    plate = read_plate(session.job, frame)
    image = read_image(session.output.exr_path(session.job.shot.name, frame))
    show = partial(convert, conversion=session.job.colors.display)
    panels = [
        srgb_encode(plate.color * plate.matte[..., None]),
        *(_grey(image.channels[name]) for name in ("roughness.Y", "metallic.Y")),
        _grey(2 * image.channels["roughness_std.Y"]),
        show(image.stack([f"relit.{c}" for c in "RGB"])),
        show(image.stack("RGB")),
    ]
    return np.concatenate(panels, axis=1).astype(np.float32)


def _nfe(session: Session) -> Float32 | None:
    """Where network evaluations went: up to four frames side by side, black: none, bright: the most."""
    import cv2

    store, book = FrameStore(session.output.store), session.book
    records = [book.find("decompose", frame) for frame in session.job.frames]
    drawn = [r for r in records if r is not None and "nfe" in r.arrays]
    chosen = drawn[:: max(1, len(drawn) // HEAT_FRAMES)][:HEAT_FRAMES]
    try:
        maps = [store.read("nfe", session.job.position(r.frame), r.arrays["nfe"])[0] for r in chosen]
    except (YesntError, KeyError, OSError):
        return None
    if not maps:
        return None
    scaled = np.concatenate(maps, axis=1) / max(float(np.max(maps)), 1.0)
    colors = cv2.applyColorMap((255 * scaled + 0.5).astype(np.uint8), cv2.COLORMAP_INFERNO)
    return (colors[..., ::-1] / 255).astype(np.float32)


def _measured(session: Session) -> Float32 | None:
    """What the capture changed in one frame: roughness of the backend, measured, the same of metallic, views.

    The frame is the measured one in the middle of the shot. Views: white where the most cameras saw a pixel.
    """
    store, frames = FrameStore(session.output.store), session.job.frames
    known = [f for f in frames if _has_views(session, f)]
    if not known:
        return None
    frame = known[len(known) // 2]
    arrays = (("decompose", "observed"), ("evidence", "measured"), ("evidence", "views"))
    try:
        observed, measured, views = (
            store.read(name, session.job.position(frame), _digest(session, stage, name, frame))
            for stage, name in arrays
        )
    except (YesntError, KeyError, OSError):
        return None
    inside = read_plate(session.job, frame).matte > 0.5
    panels = [observed[0], measured[0], observed[1], measured[1], views[0] / max(float(views.max()), 1)]
    return np.concatenate([_grey(panel * inside) for panel in panels], axis=1)


def _slices(session: Session) -> Float32 | None:
    """One row of roughness over time, before and after the solver: flicker is vertical stripes' raggedness."""
    store, frames = FrameStore(session.output.store), session.job.frames
    try:
        before = [
            store.read("observed", session.job.position(f), _digest(session, "decompose", "observed", f))
            for f in frames
        ]
        after = [
            store.read("material", session.job.position(f), _digest(session, "solve", "material", f)) for f in frames
        ]
    except (YesntError, KeyError, OSError):
        return None
    row = session.job.height * 2 // 5
    rows = [np.stack([frame[0, row] for frame in series]) for series in (before, after)]
    thick = [np.repeat(picture, max(1, 96 // len(frames)), axis=0) for picture in rows]
    gap = np.ones((4, session.job.width), np.float32)
    return _grey(np.concatenate([thick[0], gap, thick[1]]))


def _has_views(session: Session, frame: int) -> bool:
    record = session.book.find("evidence", frame)
    return record is not None and record.facts.get("views", 0) > 0


def _digest(session: Session, stage: str, array: str, frame: int) -> str:
    record = session.book.find(stage, frame)
    if record is None:
        raise KeyError(stage, frame)
    return record.arrays[array]


def _grey(plane: NDArray[np.floating]) -> Float32:
    return np.repeat(np.clip(plane, 0, 1)[..., None], 3, axis=-1).astype(np.float32)
