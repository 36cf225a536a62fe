"""Images that come with packages of the package index: fetched once into build/, and checked by their digest."""

from __future__ import annotations

import hashlib
import io
import re
import tarfile
import urllib.request
import zipfile
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urljoin

INDEX = "https://pypi.org/simple/"


@dataclass(frozen=True)
class Images:
    """Image files in a file of the package index."""

    project: str
    file: str
    digest: str
    """SHA-256 of the file"""
    source: str
    """Their folder in it"""

    @property
    def folder(self) -> Path:
        """Where they are kept."""
        return Path(__file__).parents[1] / "build" / self.project / Path(self.source).name

    def fetch(self) -> None:
        """Fetch them, unless they are at hand. Raises OSError if they cannot be, or are others."""
        if self.folder.exists():
            return
        page_address = f"{INDEX}{self.project}/"
        with urllib.request.urlopen(page_address, timeout=60) as answer:
            page = answer.read().decode()
        address = next((word for word in re.findall('href="([^"#]+)', page) if word.endswith(self.file)), "")
        with urllib.request.urlopen(urljoin(page_address, address), timeout=300) as answer:
            content = answer.read()
        if hashlib.sha256(content).hexdigest() != self.digest:
            raise OSError(f"{address}: not the file of {self.digest}")
        chosen = {name: data for name, data in _members(content) if self.source in name and name.endswith(".jpg")}
        self.folder.mkdir(parents=True)
        for name, data in chosen.items():
            (self.folder / Path(name).name).write_bytes(data)


def _members(content: bytes) -> list[tuple[str, bytes]]:
    if zipfile.is_zipfile(io.BytesIO(content)):
        with zipfile.ZipFile(io.BytesIO(content)) as wheel:
            return [(name, wheel.read(name)) for name in wheel.namelist()]
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        files = [(member.name, archive.extractfile(member)) for member in archive]
        return [(name, file.read()) for name, file in files if file is not None]
