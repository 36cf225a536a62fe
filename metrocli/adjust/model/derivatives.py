"""Products of derivatives, reading by reading."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array

_MANY = 6
"""Rows of a derivative beyond which those that are zero are left out of a product: a pose has six, all in use"""


def through(outer: Array, inner: Array) -> Array:
    """Return the product of derivatives reading by reading: (a, b, n), (b, c, n) -> (a, c, n)."""
    n = outer.shape[-1] if inner.shape[-1] == 1 else inner.shape[-1]
    if len(inner) > _MANY:
        # an effect on one axis changes few of the errors of all axes
        used = np.flatnonzero(inner.any(axis=(1, 2)))
        outer, inner = outer[:, used], inner[used]
        if not len(used):
            return np.zeros((len(outer), inner.shape[1], n))
    product: Array = np.einsum("abn,bcn->acn", outer, inner)
    return product


def by_slots(outer: Array, inner: Array) -> list[Array]:
    """Return the products of derivatives by each member that a reading uses (k, a, b, n), or its one (a, b, n)."""
    if outer.ndim == 3:
        return [through(outer, inner)]
    return [through(one, own) for one, own in zip(outer, np.split(inner, len(outer), axis=-1), strict=True)]
