"""Undetermined combinations of unknowns, found before any result is given out.

Unknowns are scaled by their plausible reach. An uncertainty above 1 in any direction then means that the linearised
result is useless there, whether the matrix is exactly singular or only nearly so.
Method: docs/algorithms/rank-in-words.md.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.outcome import Combination
from metrocli.adjust.schur.layout import Layout
from metrocli.adjust.schur.normals import EliminatedMembers, Normals
from metrocli.arrays import Array

_INFLATION = 1e6
"""Reach of an unknown without a stated one, in standard deviations that it would have with all other unknowns known"""
_ROUNDING = 1e-14
"""Eigenvalues below this fraction of the largest are rounding"""
_SHARE = 0.25
"""Parts of a combination smaller than this fraction of its largest part are not named"""
_NAMED = 3


def open_combinations(
    blocks: Mapping[str, Block], layout: Layout, normals: Normals, matrix: Array
) -> tuple[Combination, ...]:
    """Return the undetermined combinations at the present values; empty if everything is determined."""
    # an open member makes D singular, and the reduced matrix meaningless
    single = _open_members(blocks, layout, normals)
    if single or not layout.width:
        return single
    reach = _reach(blocks, layout, normals.diagonal)
    scaled = matrix * reach[:, None] * reach
    if _surely_determined(scaled):
        return ()
    values, vectors = np.linalg.eigh(np.nan_to_num(scaled))
    combinations = []
    for value, vector in zip(values, vectors.T, strict=True):
        # where eigenvalues span 14 digits those above 1 can be rounding as well, and a direction of rounding is open
        if value < max(1.0, _ROUNDING * values[-1]):
            combinations.append(_combination(blocks, layout, vector * reach, normals, value))
    return tuple(combinations)


def _surely_determined(scaled: Array) -> bool:
    """Return whether the trace of the inverse is below 1 beyond rounding, so that no direction can be open.

    A Cholesky factor costs far less than the eigenvalues, and most jobs are determined.
    """
    try:
        root = np.linalg.inv(np.linalg.cholesky(scaled))
    except np.linalg.LinAlgError:
        return False
    if not np.isfinite(root).all():
        return False
    inverse = float((root**2).sum())
    return bool(inverse < 1 and inverse * np.trace(scaled) * _ROUNDING < 1)


def _reach(blocks: Mapping[str, Block], layout: Layout, diagonal: Array) -> Array:
    reach = np.full(layout.width, np.inf)
    for name, columns in layout.columns.items():
        full = np.broadcast_to(blocks[name].reach, columns.shape)
        reach[columns[columns >= 0]] = full[columns >= 0]
    return _limited(reach, diagonal)


def _limited(reach: Array, diagonal: Array) -> Array:
    """Return the reach, limited to `_INFLATION` standard deviations of the unknown with all others known."""
    alone = np.where(diagonal > 0, _INFLATION / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), np.inf)
    limited = np.minimum(reach, alone)
    return np.where(np.isfinite(limited), limited, 1.0)


def _open_members(blocks: Mapping[str, Block], layout: Layout, normals: Normals) -> tuple[Combination, ...]:
    """Return the members of the eliminated block that their own readings do not determine."""
    if layout.eliminated is None:
        return ()
    return tuple(combination for part in normals.parts for combination in _open_in(blocks[layout.eliminated], part))


def _open_in(block: Block, part: EliminatedMembers) -> list[Combination]:
    matrices, free = part.normals(), block.free[part.members]
    diagonal = np.einsum("mii->mi", matrices)
    reach = np.where(free, _limited(np.broadcast_to(block.reach, diagonal.shape), np.where(free, diagonal, 0.0)), 1.0)
    if _all_determined(part, reach):
        return []
    names = np.arange(len(block.members))[part.members]
    # 2 on the diagonal of fixed entries: above the bound of 1, so they are never called open
    scaled = matrices * reach[:, :, None] * reach[:, None, :] + np.eye(block.size) * ~free[:, None, :] * 2
    values, vectors = np.linalg.eigh(scaled)
    # 1 is an uncertainty as large as what is plausible: beyond it linearisation has no meaning
    bad = np.flatnonzero(values[:, 0] < 1)
    combinations = []
    for member in bad:
        vector = np.abs(vectors[member, :, 0]) * free[member]
        parts = [
            (block.name, column, f"{block.noun} {block.members[names[member]]}".strip(), float(share))
            for column, share in zip(block.columns, vector / vector.max(), strict=True)
            if share > _SHARE
        ]
        combinations.append(Combination(tuple(parts), _spread(float(values[member, 0]))))
    return combinations


def _all_determined(part: EliminatedMembers, reach: Array) -> bool:
    """Return whether the trace of the inverse is below 1 for every member, so that none can be open."""
    try:
        inverse = part.inverse()
    except np.linalg.LinAlgError:
        return False
    traces = np.einsum("mii,mi->m", inverse, 1 / reach**2)
    # a negative variance is the mark of a matrix that rounding has made indefinite: then its trace proves nothing
    return bool((traces < 1).all() and (np.einsum("mii->mi", inverse) >= 0).all())


def _combination(
    blocks: Mapping[str, Block], layout: Layout, step: Array, normals: Normals, value: float
) -> Combination:
    moves: dict[str, Array] = {}
    for name, columns in layout.columns.items():
        moves[name] = np.where(columns >= 0, step[np.maximum(columns, 0)], 0.0)
    if layout.eliminated:
        # members move by -W step; only sizes are named, so the sign does not matter
        moves[layout.eliminated] = normals.following(step) * blocks[layout.eliminated].free
    relative = {name: np.abs(move) / _unit(blocks[name], move) for name, move in moves.items()}
    largest = max(float(part.max(initial=0.0)) for part in relative.values()) or 1.0
    parts = [part for name, share in relative.items() for part in _named(blocks[name], share / largest)]
    return Combination(tuple(sorted(parts, key=lambda part: -part[3])), _spread(value))


def _unit(block: Block, move: Array) -> Array:
    """Return the scale of each column: its reach or, without one, its own largest change."""
    return np.where(np.isfinite(block.reach), block.reach, np.maximum(np.abs(move).max(axis=0), 1e-300))


def _named(block: Block, shares: Array) -> list[tuple[str, str, str, float]]:
    """Return the parts of a combination that are worth naming, column by column."""
    parts = []
    for column, share in zip(block.columns, shares.T, strict=True):
        taking = np.flatnonzero(share > _SHARE)
        if len(taking) == 0:
            continue
        members = ""
        if len(block.members) > 1:
            # "all images" is truer than a list of most of them, whose few others lie just below the share
            if len(taking) > 0.7 * len(block.members):
                members = f"all {block.noun}s".strip()
            else:
                names = ", ".join(block.members[i] for i in taking[:_NAMED]) + (
                    f" and {len(taking) - _NAMED} more" if len(taking) > _NAMED else ""
                )
                members = f"{block.noun} {names}".strip()
        parts.append((block.name, column, members, float(share.max())))
    return parts


def _spread(value: float) -> float:
    """Return the standard uncertainty along an eigenvector, from its eigenvalue."""
    # beyond 3e4 times what is plausible a number means nothing
    return float(1 / np.sqrt(value)) if value > 1e-9 else float("inf")
