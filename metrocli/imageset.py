"""The interface of a set of images: named, and read one at a time."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Protocol

from metrocli.arrays import Picture


class ImageSet(Protocol):
    """Grey-value images by name, each loaded only when the iteration reaches it."""

    @property
    def names(self) -> tuple[str, ...]:
        """File names without folder, in sorted order: the image keys of tables."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of all images in pixels; raises InputError that names those of another size."""

    def size_of(self, names: Collection[str]) -> tuple[int, int]:
        """Return width and height of these images; raises as `size`."""

    def chosen(self, names: Collection[str]) -> Iterator[Picture]:
        """Yield the images with these names; no other is read."""

    def __hash__(self) -> int:
        """Return the hash of what decides its content."""

    def __iter__(self) -> Iterator[tuple[str, Picture]]:
        """Yield name and grey image, (height, width), 8 or 16 bit."""
