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
