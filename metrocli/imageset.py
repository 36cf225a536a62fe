"""Images as a job sees them: named, read one at a time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Picture = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]


class ImageSet(Protocol):
    """Grey-value images by name, each loaded when it is asked for."""

    @property
    def names(self) -> tuple[str, ...]:
        """File names without folder, in sorted order: the image keys of tables."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels, the same for all."""

    def __iter__(self) -> Iterator[tuple[str, Picture]]:
        """Yield (name, grey image (height, width), 8 or 16 bit)."""
