"""`python -m yesnt.runtime.cluster.scheduler`: `dask scheduler` with the product's settings, as pods run it."""

from __future__ import annotations

import sys

from yesnt.runtime.cluster.worker_settings import dask_settings


def main(arguments: list[str]) -> None:
    """Runs a scheduler until a signal ends it; it waits for its first worker as long as that takes to be scheduled."""
    import dask

    dask.config.set({**dask_settings(), "distributed.scheduler.no-workers-timeout": None})
    from distributed.cli.dask_scheduler import main as dask_scheduler

    dask_scheduler.main(args=arguments, prog_name="yesnt-scheduler", standalone_mode=False)


if __name__ == "__main__":
    main(sys.argv[1:])
