"""Sparse Jacobian and gradient of groups of readings, in the order of a partition of the unknowns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.groups import Linear
from metrocli.adjust.model.observations import Index
from metrocli.adjust.sparse.nested_dissection import Sparse
from metrocli.adjust.sparse.partition import Partition


def gradient(linears: Sequence[Linear], parts: Partition) -> Array:
    """Return the gradient `J' residual` at the present values."""
    total = np.zeros(parts.width)
    for linear in linears:
        for touch in linear.touches:
            towards = np.einsum("dsn,dn->ns", touch.jacobian, linear.residual)
            columns = parts.columns[touch.block][touch.index]
            inside = columns >= 0
            total += np.bincount(columns[inside], towards[inside], minlength=parts.width)
    return total


def jacobian(linears: Sequence[Linear], parts: Partition) -> Sparse:
    """Return the sparse Jacobian of all groups, one below the other."""
    from scipy.sparse import csr_array, vstack

    stacked = []
    for linear in linears:
        d, n = linear.residual.shape
        values: list[Array] = []
        rows: list[Index] = []
        columns: list[Index] = []
        for touch in linear.touches:
            at = parts.columns[touch.block][touch.index]
            a, s, i = np.nonzero(touch.jacobian)
            keep = at[i, s] >= 0
            a, s, i = a[keep], s[keep], i[keep]
            values.append(touch.jacobian[a, s, i])
            rows.append(a * n + i)
            columns.append(at[i, s])
        entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
        stacked.append(csr_array(entries, shape=(d * n, parts.width)))
    return vstack(stacked, format="csr")
