"""Changes of the files of a project, by which a hint is provoked or not."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

Edit = Callable[[str], str]
Rows = list[list[str]]


def then(*edits: Edit) -> Edit:
    """Make several changes of one file, one after the other."""

    def change(text: str) -> str:
        for edit in edits:
            text = edit(text)
        return text

    return change


def put(old: str, new: str) -> Edit:
    """Put a text in the place of another one, which is there."""

    def change(text: str) -> str:
        assert old in text, f"{old} is not in the file"
        return text.replace(old, new)

    return change


def by(pattern: str, new: str, count: int = 0) -> Edit:
    """Put a text in the place of what matches a pattern, in all places or the first `count`."""

    def change(text: str) -> str:
        assert re.search(pattern, text, re.MULTILINE), f"{pattern} matches nothing"
        return re.sub(pattern, new, text, count=count, flags=re.MULTILINE)

    return change


def more(lines: str) -> Edit:
    return lambda text: text.rstrip("\n") + "\n" + lines + "\n"


def whole(text: str) -> Edit:
    """Write a file anew."""
    return lambda _: text


def rows(change: Callable[[list[str], Rows], Rows]) -> Edit:
    """Change the rows of a CSV file by its header; comments go."""

    def edit(text: str) -> str:
        head, *body = [line.split(",") for line in text.splitlines() if line and not line.startswith("#")]
        changed = change(head, body)
        return "".join(",".join(row) + "\n" for row in [head, *changed])

    return edit


def cells(name: str, change: Callable[[str], object], only: str = "") -> Edit:
    """Change the cells of a column, of all rows or of those that have a cell `only`."""

    def on(head: list[str], body: Rows) -> Rows:
        at = head.index(name)
        return [
            [*row[:at], str(change(row[at])), *row[at + 1 :]] if row[at] and (not only or only in row) else row
            for row in body
        ]

    return rows(on)


def times(factor: float, *names: str, only: str = "") -> Edit:
    return then(*(cells(name, lambda cell: float(cell) * factor, only) for name in names))


def exchanged(name: str, one: str, other: str, only: str = "") -> Edit:
    """Exchange two names in a column."""
    return cells(name, lambda cell: {one: other, other: one}.get(cell, cell), only)


def without(name: str) -> Edit:
    """Leave out a column."""

    def on(head: list[str], body: Rows) -> Rows:
        at = head.index(name)
        del head[at]
        return [[*row[:at], *row[at + 1 :]] for row in body]

    return rows(on)


def reordered(name: str, only: str, order: Callable[[Sequence[str]], Sequence[str]]) -> Edit:
    """Put the cells of a column, in the rows that have a cell `only`, into another order."""

    def on(head: list[str], body: Rows) -> Rows:
        at, mine = head.index(name), [row for row in body if not only or only in row]
        for row, cell in zip(mine, order([row[at] for row in mine]), strict=True):
            row[at] = cell
        return body

    return rows(on)


def first(count: int) -> Edit:
    """Keep the first rows only."""
    return rows(lambda head, body: body[:count])
