"""The kinds of numpy arrays, as annotations name them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]
    Index = npt.NDArray[np.intp]
    Mask = npt.NDArray[np.bool_]
    Texts = npt.NDArray[np.str_]
    Bytes = npt.NDArray[np.uint8]
    Values = Array | npt.NDArray[np.int64] | Texts | Mask
    Picture = Bytes | npt.NDArray[np.uint16]
else:  # numpy takes longer to load than a job that is up to date
    Array = Index = Mask = Texts = Bytes = Values = Picture = Any


def extents(places: Array) -> Array:
    """Return the extent of places (n, k) along each axis, (k,): far faster than `np.ptp` over the longer axis."""
    import numpy as np

    return np.array([np.ptp(column) for column in places.T])


def keep_memory() -> None:
    """Let the process keep what it frees, for what follows: new pages cost more time than most arithmetic on them.

    glibc learns it from a large array that is freed (`mallopt`, M_MMAP_THRESHOLD), which needs no page itself.
    """
    import numpy as np

    np.empty(32_000_000, dtype=np.uint8)
