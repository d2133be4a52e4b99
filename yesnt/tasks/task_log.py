"""The log file of one task."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def open_log(path: Path) -> Iterator[logging.Logger]:
    """A logger that appends to a file; an exception is written with its traceback and raised again."""
    path.parent.mkdir(parents=True, exist_ok=True)
    logger = logging.getLogger("yesnt.task")  # one name for all: the registry of loggers never shrinks
    handler = _LogFile(path, mode="a", encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    logger.propagate = False
    try:
        yield logger
    except Exception:
        logger.exception("failed")
        raise
    finally:
        logger.removeHandler(handler)
        handler.close()


class _LogFile(logging.FileHandler):
    def handleError(self, record: logging.LogRecord) -> None:
        """Ignores that the disk is full: the task itself reports it."""
