"""Connects to a scheduler that is running: plain TCP on this machine only, else TLS."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from yesnt.core.errors import UsageError
from yesnt.runtime.launchers.spec import LOOPBACK, ClusterSpec, no_such_kind
from yesnt.runtime.launchers.table import Running


class AttachLauncher:
    """A scheduler that somebody else started; its workers offer what they offer."""

    pools: frozenset[str] = frozenset()

    def __init__(self, spec: ClusterSpec) -> None:
        self._spec = spec

    def check(self) -> None:
        """Refuses an address that is not safe.

        Raises:
            UsageError: it is on another machine and has no TLS, or a certificate is missing.
        """
        address = self._spec.kind
        if address.startswith("tcp://") and not address.startswith(LOOPBACK) and not self._spec.insecure:
            raise UsageError(
                "A scheduler on another machine must use TLS: any user who reaches it runs code",
                f"--cluster {address}", "tls://HOST:PORT",
                "start the scheduler with TLS, or tunnel it to 127.0.0.1; --insecure accepts the risk",
            )  # fmt: skip
        if not address.startswith(("tcp://", "tls://")):
            raise no_such_kind(address)
        if address.startswith("tls://") and not any(self._files().values()) and not _configured():
            raise UsageError(
                "There is no certificate for a connection with TLS", f"--cluster {address}",
                "the scheduler's authority, and a certificate and key that it accepts",
                "write a profile with ca_file, cert_file and key_file (deploy/attach.yaml), or configure Dask's "
                "distributed.comm.tls",
            )  # fmt: skip
        for name, path in self._files().items():
            if path is not None and not Path(path).is_file():
                raise UsageError("A certificate of the cluster profile is missing", f"{path} ({name})", "a PEM file")

    def _files(self) -> dict[str, str | None]:
        return {name: getattr(self._spec.profile, name, None) for name in ("ca_file", "cert_file", "key_file")}

    @contextmanager
    def open(self) -> Iterator[Running]:
        """Yields the address; the scheduler stays when the run ends."""
        yield Running(self._spec.kind, self._security())

    def _security(self) -> Any:
        """Dask's own configuration (`distributed.comm.tls`), unless the profile names certificates."""
        files = self._files()
        if not any(files.values()):
            return None
        from distributed.security import Security

        return Security(
            require_encryption=True, tls_ca_file=files["ca_file"],
            tls_client_cert=files["cert_file"], tls_client_key=files["key_file"],
        )  # fmt: skip


def _configured() -> bool:
    """Whether Dask's own configuration names certificates."""
    import dask
    import distributed  # noqa: F401 - it loads the configuration's defaults

    return bool(dask.config.get("distributed.comm.tls.ca-file", None))
