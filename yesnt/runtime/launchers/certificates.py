"""TLS certificates of one run: made by the driver, readable by its user only, removed when the run ends."""

from __future__ import annotations

import datetime
import os
import shutil
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

VALID_BEFORE = datetime.timedelta(days=2)
"""A worker whose clock is a day late accepts the certificate too."""

VALID_FOR = datetime.timedelta(days=60)
"""Longer than any walltime; the files are gone when the run ends."""

PREFIX = "tls-"


@dataclass(frozen=True)
class Certificate:
    """A self-signed certificate that every process of a run shows and accepts, and no other.

    Attributes:
        certificate: PEM.
        key: its private key, PEM.
    """

    certificate: str
    key: str

    def security(self) -> Any:
        """Dask's settings with this certificate in memory, for scheduler and client."""
        from distributed.security import Security

        roles = {f"tls_{role}_{part}": value for role in ("client", "scheduler", "worker")
                 for part, value in (("cert", self.certificate), ("key", self.key))}  # fmt: skip
        return Security(require_encryption=True, tls_ca_file=self.certificate, **roles)


@dataclass(frozen=True)
class CertificateFiles:
    """A certificate in files that workers of the same user read.

    Attributes:
        certificate: path of the certificate, which is also the authority.
        key: path of the private key.
    """

    certificate: Path
    key: Path


def make_certificate() -> Certificate:
    """Makes a key on the curve P-256 and a certificate for it."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import NameOID

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "yesnt run")])
    now = datetime.datetime.now(tz=datetime.UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - VALID_BEFORE)
        .not_valid_after(now + VALID_FOR)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(key, hashes.SHA256())
    )
    pem = serialization.Encoding.PEM
    plain = key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    return Certificate(certificate.public_bytes(pem).decode(), plain.decode())


@contextmanager
def certificate_files(certificate: Certificate, parent: Path | None) -> Iterator[CertificateFiles]:
    """Writes a certificate below a folder that the workers see too (mode 0600, in a folder of mode 0700).

    Args:
        certificate: what to write.
        parent: the shared folder; None: this machine's folder for temporary files.
    """
    if parent is not None:
        parent.mkdir(parents=True, exist_ok=True)
        _sweep(parent)
    owner = f"{PREFIX}{socket.gethostname()}-{os.getpid()}-"
    folder = Path(tempfile.mkdtemp(prefix=owner, dir=parent)).absolute()  # mkdtemp gives mode 0700
    try:
        files = CertificateFiles(folder / "certificate.pem", folder / "key.pem")
        write_private(files.certificate, certificate.certificate)
        write_private(files.key, certificate.key)
        yield files
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def write_private(path: Path, text: str) -> None:
    """Writes a file that never had another mode than 0600."""
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as stream:
        stream.write(text)


def _sweep(parent: Path) -> None:
    """Removes certificates of drivers of this host that were killed."""
    import psutil

    here = f"{PREFIX}{socket.gethostname()}-"
    for folder in parent.glob(f"{here}*"):
        number = folder.name.removeprefix(here).partition("-")[0]
        if number.isdigit() and not psutil.pid_exists(int(number)):
            shutil.rmtree(folder, ignore_errors=True)
