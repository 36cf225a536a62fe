"""Finished chunks of a long computation, kept in a folder beside its result until it is complete."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Any

import numpy as np

from metrocli.frozen import dataclass


@dataclass(frozen=True)
class ChunkFolder:
    """A folder with one .npz file for each finished chunk: KEY OF THE COMPUTATION-NUMBER.npz."""

    folder: Path

    def get(self, key: str, number: int) -> dict[str, Any] | None:
        """Return the arrays of a chunk, or None if its file is missing or damaged."""
        path = self._path(key, number)
        if not path.is_file():
            return None
        from zipfile import BadZipFile

        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as held:
                return dict(held)
        except (OSError, ValueError, BadZipFile):
            return None

    def put(self, key: str, number: int, value: dict[str, Any]) -> None:
        """Write the arrays of a chunk, whole or not at all; disk errors are ignored: the job runs without."""
        with contextlib.suppress(OSError):
            self.folder.mkdir(parents=True, exist_ok=True)
            aside = self._path(key, number).with_suffix(f".{os.getpid()}.tmp")
            with aside.open("wb") as file:
                np.savez(file, **value)
            aside.replace(self._path(key, number))

    def clear(self) -> None:
        """Remove all chunks and the folder."""
        if self.folder.is_dir():
            for path in [*self.folder.glob("*.npz"), *self.folder.glob("*.tmp")]:
                path.unlink(missing_ok=True)
            with contextlib.suppress(OSError):
                self.folder.rmdir()

    def _path(self, key: str, number: int) -> Path:
        return self.folder / f"{key}-{number:06d}.npz"
