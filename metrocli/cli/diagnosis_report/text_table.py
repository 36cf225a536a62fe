"""A table of text: columns as wide as their longest cell."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def text_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a table; columns without any cell are left out."""
    lines = [tuple(head), *map(tuple, rows)]
    kept = [i for i in range(len(head)) if any(line[i] for line in lines[1:])]
    widths = {i: max(len(line[i]) for line in lines) for i in kept}
    return ["  ".join(f"{line[i]:{widths[i]}}" for i in kept).rstrip() for line in lines]
