"""The interface of a set of images: named, of equal size, and read one at a time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from metrocli.arrays import Picture


class ImageSet(Protocol):
    """Grey-value images by name, each loaded only when the iteration reaches it."""

    @property
    def names(self) -> tuple[str, ...]:
        """File names without folder, in sorted order: the image keys of tables."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels, the same for all images."""

    def __hash__(self) -> int:
        """Return the hash of what decides its content."""

    def __iter__(self) -> Iterator[tuple[str, Picture]]:
        """Yield name and grey image, (height, width), 8 or 16 bit."""
