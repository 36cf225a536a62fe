"""Products of the columns of parts, each pair computed once for a measurement.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.evidence.likelihood import Products
from metrocli.diagnosis.evidence.measurement import Measurement
from metrocli.diagnosis.evidence.parts import Fixed, Random
from metrocli.diagnosis.linear.basis import Columns
from metrocli.diagnosis.linear.projection import MOST_OF_STATE

KeyedColumns = tuple[object, Array]
"""Columns (rows, k) of a part of a state, with the key by which their products are cached"""
_REDUCED = "free of unknowns"
"""Begins the key of columns that are free of the shared unknowns, too"""


def _free_of_local(m: Measurement, parts: Sequence[KeyedColumns]) -> list[KeyedColumns]:
    """Return the columns of parts, with their keys, without what local unknowns absorb."""
    return _held(m, parts, partial(_without_local, m))


def _free_of_all(m: Measurement, parts: Sequence[KeyedColumns]) -> list[KeyedColumns]:
    """Return the columns X of parts without what the unknowns absorb, `X - A A'X`, with keys of their own.

    A are the orthonormal columns of the shared unknowns, free of the local ones.
    """

    def without(columns: Array) -> Array:
        left, shared = _without_local(m, columns), m.system.basis.shared
        return left - shared @ (shared.T @ left)

    return _held(m, [((_REDUCED, key), columns) for key, columns in parts], without)


def _without_local(m: Measurement, columns: Array) -> Array:
    basis = m.system.basis.of_members
    return columns - basis.combined(basis.coordinates(columns)) if basis.members else columns


def _held(m: Measurement, parts: Sequence[KeyedColumns], without: Callable[[Array], Array]) -> list[KeyedColumns]:
    """Return the columns of parts, without something; they are held for later.

    If these are too many, those that were asked for longest ago give way, and are made again when they are needed.
    """
    held = {key: m.columns.pop(key) for key, _ in parts if key in m.columns}
    if new := [(key, columns) for key, columns in parts if key not in held]:
        # all at once: many parts are errors of one reading
        left = without(np.concatenate([columns for _, columns in new], axis=1))
        ends = np.cumsum([columns.shape[1] for _, columns in new])[:-1]
        # copies: a part of an array would hold the whole of it
        held |= {key: own.copy() for (key, _), own in zip(new, np.split(left, ends, axis=1), strict=True)}
    older = list(m.columns)
    m.columns.update((key, held[key]) for key, _ in parts)
    count = sum(columns.size for columns in m.columns.values())
    for key in older:
        if count <= MOST_OF_STATE:
            break
        count -= m.columns.pop(key).size
    return [(key, held[key]) for key, _ in parts]


def shared_parts(
    m: Measurement, fixed: Sequence[Fixed], random: Sequence[Random], unknowns: bool = True
) -> list[KeyedColumns]:
    """Return the shared columns of unknowns, random and fixed parts with their keys, free of local unknowns.

    Without the unknowns the others are free of these as well.
    """
    others: list[KeyedColumns] = [((part.kind, part.key), part.columns) for part in random if not part.local]
    others += [((part.sort, part.key), part.columns) for part in fixed]
    if unknowns:
        return [("unknowns", m.system.basis.shared), *_free_of_local(m, others)]
    return _free_of_all(m, others)


def _local_parts(m: Measurement, random: Sequence[Random]) -> list[KeyedColumns]:
    """Return the columns of errors of single members with their keys, free of the unknowns of these."""
    return _free_of_local(m, [((part.kind, part.key), part.columns) for part in random if part.local])


def local_columns(m: Measurement, random: Sequence[Random]) -> Array:
    """Return the columns of errors of single members, free of their unknowns, (rows, k)."""
    return np.concatenate([np.zeros((m.system.rows, 0)), *(columns for _, columns in _local_parts(m, random))], axis=1)


def products_of(
    m: Measurement, fixed: Sequence[Fixed], random: Sequence[Random], known: Products | None = None
) -> Products:
    """Return the products of all columns of a state, those of the unknowns as well where members have errors.

    Products of two parts are computed once. `known` are those of a state that has some of the parts.
    """
    local = _local_parts(m, random)
    # errors of a member change what its unknowns absorb, and with these what the shared unknowns do
    shared = shared_parts(m, fixed, random, bool(local))
    parts = tuple((key, columns.shape[1]) for key, columns in (*shared, *local))
    if known is not None and known.parts == parts:
        return known
    gram, right = _gram(m, shared, known)
    unknowns = shared[0][1].shape[1] if local else 0
    # of each column the number of its random part, whose variance it has; -1 for those without a prior
    of_shared = [np.full(unknowns, -1)]
    of_shared += [np.full(part.columns.shape[1], j) for j, part in enumerate(random) if not part.local]
    of_shared += [np.full(part.rank, -1) for part in fixed]
    of_local = [np.full(part.columns.shape[1], j) for j, part in enumerate(random) if part.local]
    empty, members = np.zeros(0, dtype=np.intp), m.system.basis.members if local else 0
    own = np.zeros((members, 0, 0))
    mixed = np.zeros((members, 0, len(right) + 1))
    if local:
        own, mixed = (
            np.concatenate([products_of_members(m, random, other, m.cache) for other in others], axis=2)
            for others in (local, [*shared, ("residual", m.system.residual[:, None])])
        )
    return Products(
        gram,
        right,
        m.squares,
        m.dof,
        unknowns,
        np.concatenate([*of_shared, empty]).astype(np.intp),
        np.concatenate([*of_local, empty]).astype(np.intp),
        own,
        mixed,
        parts,
    )


def products_of_members(
    m: Measurement, random: Sequence[Random], other: tuple[object, Columns], cache: dict[object, Array]
) -> Array:
    """Return the products of the errors of each member with columns (rows, p) and their key, (members, k, p).

    Those of each part are computed once, and kept in `cache`: that of the measurement, or that of its families.
    """
    products = list[Array]()
    for key, columns in _local_parts(m, random):
        of_pair = "of members", key, other[0]
        if of_pair not in cache:
            cache[of_pair] = _by_members(m, columns, other[1])
        products.append(cache[of_pair])
    return np.concatenate(products, axis=1)


def _by_members(m: Measurement, columns: Array, others: Columns) -> Array:
    """Return the products of columns (rows, k) with others (rows, p) over the rows of each member, (members, k, p)."""
    if isinstance(others, np.ndarray):
        return np.stack([columns[rows].T @ others[rows] for rows in m.rows_of_members])
    from scipy.sparse import csr_matrix

    # all members in one product: taking rows out of a sparse matrix costs more than their products
    (rows, k), local = columns.shape, m.system.basis.member >= 0
    # k columns of each member, with values in its rows only; rows without a member are zero at the first
    places = (np.where(local, m.system.basis.member, 0)[:, None] * k + np.arange(k)).ravel()
    values = np.where(local[:, None], columns, 0.0).ravel()
    side_by_side = csr_matrix((values, places, k * np.arange(rows + 1)), shape=(rows, m.system.basis.members * k))
    return np.asarray((side_by_side.T @ others).toarray().reshape(m.system.basis.members, k, others.shape[1]))


def _gram(m: Measurement, shared: Sequence[KeyedColumns], known: Products | None) -> tuple[Array, Array]:
    """Return the products of shared parts with each other and with the residual.

    Those of two parts that `known` has are taken from it.
    """
    ends = np.cumsum([0, *(columns.shape[1] for _, columns in shared)])
    gram, right = np.empty((ends[-1], ends[-1])), np.empty(ends[-1])
    at = {} if known is None else known.places
    old = [i for i, (key, _) in enumerate(shared) if key in at]
    if known is not None and old:
        here = np.concatenate([np.arange(ends[i], ends[i + 1]) for i in old])
        there = np.concatenate([np.arange(*at[shared[i][0]]) for i in old])
        gram[np.ix_(here, here)], right[here] = known.gram[np.ix_(there, there)], known.right[there]
    residual = "residual", m.system.residual[:, None]
    for i in sorted({*range(len(shared))} - {*old}):
        rows = slice(ends[i], ends[i + 1])
        right[rows] = _product(m, shared[i], residual)[:, 0]
        for j, other in enumerate(shared):
            # in one order of the two, so that either finds the product of the other in the cache
            block = _product(m, shared[i], other) if i <= j else _product(m, other, shared[i]).T
            gram[rows, ends[j] : ends[j + 1]] = block
            gram[ends[j] : ends[j + 1], rows] = block.T
    return gram, right


def _product(m: Measurement, first: KeyedColumns, other: KeyedColumns) -> Array:
    """Return the product of the columns of two parts, computed once."""
    key = "product", first[0], other[0]
    if key not in m.cache:
        m.cache[key] = first[1].T @ other[1]
    return m.cache[key]
