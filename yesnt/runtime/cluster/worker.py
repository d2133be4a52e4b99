"""`python -m yesnt.runtime.cluster.worker`: `dask worker` with the product's settings.

Launchers start it so on other machines. With `--certificates-from-stdin` as its first argument, it reads a certificate
and key from its standard input, and ends when that is closed: over SSH, workers end with the connection.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
import threading
from contextlib import ExitStack
from pathlib import Path

from yesnt.runtime.cluster.worker_settings import WORKER_ENVIRONMENT, dask_settings

FROM_STDIN = "--certificates-from-stdin"


def main(arguments: list[str]) -> None:
    """Runs nannies and workers until the scheduler, a signal or their lifetime ends them."""
    import dask

    os.environ.update({name: os.environ.get(name, value) for name, value in WORKER_ENVIRONMENT.items()})
    dask.config.set(dask_settings())
    from distributed.cli.dask_worker import main as dask_worker

    with ExitStack() as stack:
        if arguments[:1] == [FROM_STDIN]:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="yesnt-tls-")))
            arguments = [*arguments[1:], *_certificates_from_stdin(folder)]
        dask_worker.main(args=arguments, prog_name="yesnt-worker", standalone_mode=False)


def _certificates_from_stdin(folder: Path) -> list[str]:
    """Options for the certificate that the first line of the standard input holds as JSON."""
    from yesnt.runtime.launchers.certificates import write_private

    given = json.loads(sys.stdin.readline())
    files = {name: folder / f"{name}.pem" for name in ("certificate", "key")}
    for name, path in files.items():
        write_private(path, given[name])
    threading.Thread(target=_end_with_stdin, daemon=True).start()
    certificate = str(files["certificate"])
    return ["--tls-ca-file", certificate, "--tls-cert", certificate, "--tls-key", str(files["key"])]


def _end_with_stdin() -> None:
    """Ends this process, in order, when the process that started it is gone."""
    while sys.stdin.readline():
        pass
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    main(sys.argv[1:])
