"""Medians without `numpy.ma`, which `numpy.median` loads: that takes longer than the adjustment of a small job."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array, Index


def median(values: Array) -> Array:
    """Return the median along the last axis of values (..., n), as `numpy.median`; nan where a value is nan."""
    n = values.shape[-1]
    if not n:
        return np.full(values.shape[:-1], np.nan)
    parted = np.partition(values, [(n - 1) // 2, n // 2, n - 1], axis=-1)  # nan counts as the largest
    middle: Array = (parted[..., (n - 1) // 2] + parted[..., n // 2]) / 2
    return np.where(np.isnan(parted[..., -1]), np.nan, middle)


def medians_of(values: Array, member: Index, count: int) -> Array:
    """Return the median of the values (n,) of each member, (count,), nan for one without any."""
    counts = np.bincount(member, minlength=count)
    begin, known = np.cumsum(counts) - counts, counts > 0
    # sorted by member and value, the values of a member follow each other, so that counts give its middle ones
    ordered = values[np.lexsort((values, member))]
    medians = np.full(count, np.nan)
    medians[known] = (ordered[(begin + (counts - 1) // 2)[known]] + ordered[(begin + counts // 2)[known]]) / 2
    return medians
