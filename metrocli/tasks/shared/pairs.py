"""Lengths between two members, such as targets or balls, that stand in a list twice."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator


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
