"""`python -m yesnt.capture_stage SET --out DIR --cache DIR`: renders a set in this process, job after job."""

from __future__ import annotations

import argparse
import logging
from pathlib import Path

from yesnt.capture_stage.jobs import SETS, render_jobs
from yesnt.capture_stage.render import render
from yesnt.capture_stage.tools import stage_tools

_LOG = logging.getLogger("yesnt.capture_stage")


def main() -> None:
    """Parses, renders what is missing, logs one line a job."""
    parser = argparse.ArgumentParser(prog="python -m yesnt.capture_stage", description=__doc__)
    parser.add_argument("set_names", nargs="+", choices=sorted(SETS))
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--nice", type=int, default=0)
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    tools = stage_tools(arguments.cache, arguments.threads, arguments.nice)
    for set_name in arguments.set_names:
        jobs = render_jobs(set_name, arguments.small)
        for number, job in enumerate(jobs, 1):
            receipt = render(job, arguments.out, tools)
            _LOG.info(
                "%s %d/%d %s %d-%d: %d pictures, %.0f s", set_name, number, len(jobs), job.subject, job.frames[0],
                job.frames[-1], receipt.rendered, receipt.seconds,
            )  # fmt: skip


if __name__ == "__main__":
    main()
