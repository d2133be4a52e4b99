"""OpenColorIO: finds spaces by name or role, and converts colours.

The package `opencolorio` is used, not OpenImageIO's `ColorConfig`: it says what a conversion consists of (tables
included), which a key must hold; it can leave out fast approximations, which are off by 2e-5 on sRGB; and it converts
between a configuration and the built-in one.

Our own names (core/color_spaces.py) mean the same under every configuration. So do interop identifiers as files state
them: a configuration that lacks one takes it from OpenColorIO's built-in ACES configuration.
"""

from __future__ import annotations

import difflib
import hashlib
import os
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yesnt.core.color import srgb_decode, srgb_encode
from yesnt.core.color_spaces import ACESCG, LIN_REC709, NAMED_BY_INTEROP, SRGB, Conversion
from yesnt.core.errors import JobError

Float32 = NDArray[np.float32]

BUILT_IN = "ocio://default"
"""OpenColorIO's own ACES configuration."""

FROM_ENVIRONMENT = "$OCIO"
"""What the job file writes for the configuration of the environment; without one it is the built-in."""

_OWN = {LIN_REC709: "lin_rec709", ACESCG: "ACEScg"}
"""Our own linear spaces in the built-in configuration."""

_NAMES_SHOWN = 12


def locate_config(root: str, stated: str) -> str:
    """Path or `ocio://` name of the configuration that a job means.

    Args:
        root: folder of the job file.
        stated: `$OCIO`, a path (environment variables and `~` are expanded), or a name such as `ocio://default`.
    """
    if stated == FROM_ENVIRONMENT:
        return os.environ.get("OCIO") or BUILT_IN
    expanded = os.path.expanduser(os.path.expandvars(stated))
    return expanded if expanded.startswith("ocio://") else str(Path(root) / expanded)


@lru_cache(maxsize=4)
def open_config(path: str) -> ColorConfig:
    """The configuration at a path or `ocio://` name; kept in the process.

    Raises:
        JobError: OpenColorIO cannot read it; says why.
    """
    return ColorConfig(path)


def fresh_config(path: str) -> ColorConfig:
    """The configuration as it is on disk now: OpenColorIO itself keeps what it once read.

    Raises:
        JobError: OpenColorIO cannot read it; says why.
    """
    import PyOpenColorIO as ocio

    ocio.ClearAllCaches()
    return ColorConfig(path)


class ColorConfig:
    """One OpenColorIO configuration.

    Args:
        path: a file, an archive (`.ocioz`), or an `ocio://` name.

    Raises:
        JobError: OpenColorIO cannot read it.
    """

    def __init__(self, path: str) -> None:
        import PyOpenColorIO as ocio

        self.path = path
        try:
            self._config = ocio.Config.CreateFromFile(path)
        except (ocio.Exception, ocio.ExceptionMissingFile) as error:
            raise JobError(
                f"The OpenColorIO configuration cannot be read ({_first_line(error)})", path,
                "a config.ocio, an .ocioz archive or a name such as ocio://default",
                "correct `color.config` or $OCIO, or remove it: the built-in ACES configuration is then used",
            ) from error  # fmt: skip

    def canonical(self, name: str, where: str) -> str:
        """The name by which a space is kept: one of our own, an interop identifier, or the configuration's own name.

        Args:
            name: name, alias, role or interop identifier; letter case is ignored.
            where: the key of the job file, for the message.

        Raises:
            JobError: the configuration has no such space (the message lists near names), or it holds data, not colour.
        """
        own = name.casefold()
        own = NAMED_BY_INTEROP.get(own, own)
        if own in (*_OWN, SRGB):
            return own
        found: str = self._config.getCanonicalName(name)
        if not found:
            if _built_in_name(name) is None:
                raise self._unknown("colour space", name, where, list(self._names()))
            return name
        if self._config.getColorSpace(found).isData():
            raise JobError(
                f"The space {found!r} is for data, not for colours", where, "the space of the picture's colours",
                "name the space that the picture was rendered or encoded in",
            )  # fmt: skip
        return next((one for one in _OWN if _optimized(self._between(found, one)).isNoOp()), found)

    def conversion(self, source: str, target: str) -> Conversion:
        """A conversion between two canonical names.

        Raises:
            JobError: OpenColorIO cannot make it; says why (an absent table, for example).
        """
        if source == target:
            return Conversion(source, target)
        steps = self._steps(source, target)
        digest = _digest(_optimized(step).getCacheID() for step in steps)
        return Conversion(source, target, self.path if steps else "", digest if steps else "")

    def view(self, source: str, view: str, where: str) -> Conversion:
        """The conversion from a linear space to the default display, through a view of it.

        Raises:
            JobError: the display has no such view; the message lists those that it has.
        """
        display = self._config.getDefaultDisplay()
        views = list(self._config.getViews(display))
        found = next((one for one in views if one.casefold() == view.casefold()), None)
        if found is None:
            raise self._unknown(f"view of the display {display!r}", view, where, views)
        return self.conversion(source, f"{display}/{found}")

    def processors(self, conversion: Conversion) -> list[Any]:
        """What OpenColorIO applies one after another.

        Raises:
            JobError: the configuration or one of its tables is not the one that the digest names.
        """
        found = [_optimized(step) for step in self._steps(conversion.source, conversion.target)]
        if _digest(one.getCacheID() for one in found) != conversion.digest:
            raise JobError(
                "The OpenColorIO configuration is another one than when the run began",
                f"{self.path}, from {conversion.source} to {conversion.target}",
                "the same file and tables, and the same environment variables, on every worker",
                "run again: what depends on it is made anew",
            )  # fmt: skip
        return found

    def _steps(self, source: str, target: str) -> list[Any]:
        import PyOpenColorIO as ocio

        try:
            return list(self._raw_steps(source, target))
        except (ocio.Exception, ocio.ExceptionMissingFile) as error:
            raise JobError(
                f"OpenColorIO cannot convert from {source} to {target} ({_first_line(error)})", self.path,
                "spaces and tables that the configuration defines", "correct the configuration or name another space",
            ) from error  # fmt: skip

    def _raw_steps(self, source: str, target: str) -> Iterator[Any]:
        """Processors of a conversion. Between two configurations they meet in the built-in one; sRGB is our own."""
        display, _, view = target.partition("/")
        if source == SRGB:
            source = LIN_REC709
        if target == SRGB:
            target = LIN_REC709
        if source == target:
            return
        if view and display in set(self._config.getDisplays()):
            yield from self._raw_steps(source, self._scene_linear)
            yield self._view_processor(display, view)
            return
        yield self._between(source, target)

    def _between(self, source: str, target: str) -> Any:
        import PyOpenColorIO as ocio

        start, end = self._foreign(source), self._foreign(target)
        if start is not None and end is not None:
            return open_config(BUILT_IN)._config.getProcessor(start, end)
        if start is not None:
            return ocio.Config.GetProcessorFromBuiltinColorSpace(start, self._config, target)
        if end is not None:
            return ocio.Config.GetProcessorToBuiltinColorSpace(self._config, source, end)
        return self._config.getProcessor(source, target)

    def _foreign(self, name: str) -> str | None:
        """The built-in configuration's name of one of our own spaces or of an interop identifier; None of others."""
        if name in _OWN:
            return _OWN[name]
        return None if self._config.getCanonicalName(name) else _built_in_name(name)

    @property
    def _scene_linear(self) -> str:
        found: str = self._config.getCanonicalName("scene_linear")
        if not found:
            raise JobError(
                "The OpenColorIO configuration has no role scene_linear", self.path, "that role: views start from it",
                "add the role, or remove `color.view`",
            )  # fmt: skip
        return found

    def _view_processor(self, display: str, view: str) -> Any:
        import PyOpenColorIO as ocio

        return self._config.getProcessor(ocio.DisplayViewTransform(src=self._scene_linear, display=display, view=view))

    def _names(self) -> Iterator[str]:
        """Names of all spaces, their aliases, the roles, and our own names."""
        yield from (*_OWN, SRGB)
        for space in self._config.getColorSpaces():
            yield space.getName()
            yield from space.getAliases()
        yield from self._config.getRoleNames()

    def _unknown(self, kind: str, name: str, where: str, known: list[str]) -> JobError:
        folded = {one.casefold(): one for one in known}
        near = [folded[one] for one in difflib.get_close_matches(name.casefold(), folded, 5, 0.6)]
        shown = near or known[:_NAMES_SHOWN]
        return JobError(
            f"There is no {kind} {name!r}", where, f"a name that {self.path} has: {', '.join(shown)}",
            f"{'one of these near names' if near else 'a name of the configuration'}, or another `color.config`",
        )  # fmt: skip


def convert(color: Float32, conversion: Conversion) -> Float32:
    """Colours [..., 3] in another space; the same array where there is nothing to convert. Straight, not associated.

    Raises:
        JobError: the configuration has changed since the conversion was found.
    """
    if not conversion.changes:
        return color
    if conversion.source == SRGB:
        color = srgb_decode(color).astype(np.float32)
    if conversion.digest:
        color = np.array(color, dtype=np.float32, order="C")  # a copy: OpenColorIO works in place
        for processor in _processors(conversion):
            processor.applyRGB(color)
    return srgb_encode(color).astype(np.float32) if conversion.target == SRGB else color


@lru_cache(maxsize=16)
def _processors(conversion: Conversion) -> list[Any]:
    """Processors of a conversion; a configuration that changed under its path is opened again."""
    try:
        return open_config(conversion.config).processors(conversion)
    except JobError:
        return fresh_config(conversion.config).processors(conversion)


def _built_in_name(name: str) -> str | None:
    """Canonical name that the built-in configuration has for an interop identifier; None of other names."""
    if not name.endswith(("_scene", "_display")):
        return None
    return open_config(BUILT_IN)._config.getCanonicalName(name) or None


def _optimized(processor: Any) -> Any:
    """Without approximations: results do not depend on the processor's instructions beyond rounding."""
    import PyOpenColorIO as ocio

    return processor.getOptimizedCPUProcessor(ocio.OPTIMIZATION_LOSSLESS)


def _digest(texts: Iterator[str]) -> str:
    return hashlib.blake2b(" ".join(texts).encode(), digest_size=16).hexdigest()


def _first_line(error: Exception) -> str:
    return next((line.strip() for line in str(error).splitlines() if line.strip()), "no reason given")
