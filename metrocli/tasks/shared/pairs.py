"""Rows of one meaning that stand in a list twice: lengths of the same ends, readings of the same point."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import TIME, Index


def repeated(
    pairs: Iterable[tuple[Hashable, Hashable]], values: Iterable[float] | None = None
) -> Iterator[tuple[int, int]]:
    """Yield each row whose pair, in either direction, is that of an earlier row, and that row.

    With `values` only pairs of the same value count.
    """
    first: dict[object, int] = {}
    listed = list(pairs)
    for row, (pair, value) in enumerate(zip(listed, values or [0.0] * len(listed), strict=True)):
        before = first.setdefault((frozenset(pair), value), row)
        if before != row:
            yield row, before


def told_apart(keys: Mapping[str, tuple[str, ...]], pair: Index, time: Array | None) -> dict[str, tuple[str, ...]]:
    """Return the keys of readings, with their times where what they read (its number, (n,)) is read twice."""
    if time is None or len(np.unique(pair)) == len(pair):
        return dict(keys)
    return {**keys, TIME: tuple(f"{one:.10g} s" for one in time.tolist())}


def name_of(keys: Mapping[str, tuple[str, ...]], key: str, row: int) -> str:
    """Return a key of a reading, with its time where the keys have that: `T2 (2000 s)`."""
    return f"{keys[key][row]} ({keys[TIME][row]})" if TIME in keys else keys[key][row]
