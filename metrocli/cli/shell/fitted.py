"""Text for the width and the colours of a terminal; files and pipes get it as it is."""

from __future__ import annotations

import os
import re
import textwrap
from collections.abc import Iterator, Sequence
from itertools import groupby

_GAP = "  "
"""Between two columns of a table there are at least these spaces; prose has single ones"""
_OF_A_FILE = re.compile(r" *\d* *\|( |$)")
"""A line of a file that a message shows, and the mark below it"""
_EXCERPT, _TABLE, _PROSE = "excerpt", "table", "prose"
_LEAST = 16
"""Narrowest column whose cells are broken into lines"""
_PLAIN, _RED, _GREEN, _YELLOW = "\x1b[0m", "\x1b[1;31m", "\x1b[32m", "\x1b[33m"
_COLOURS = (
    (
        re.compile(r"^(error|DOUBTFUL):|\bNOT met\b|(?<=^status: )(doubtful|requirements not met)|(?<= )error(?=: )"),
        _RED,
    ),
    (re.compile(r"^warning:|(?<=^verdict: )(explained|indistinct|unexplained|mistaken).*"), _YELLOW),
    (re.compile(r"(?<=^status: )done|(?<=^verdict: )clean(?=$)|(?<=^required ).*: met\b"), _GREEN),
)
"""Words that decide, by line, and their colours; the words say the same without"""


def terminal_size(file: int) -> tuple[int, int]:
    """Return the columns and lines of the terminal of an open file; 80 and 24 where it does not know them."""
    try:
        columns, lines = os.get_terminal_size(file)
    except OSError:
        columns, lines = 0, 0
    return columns or 80, lines or 24


def coloured(text: str) -> str:
    """Return a text whose deciding words have a colour: status, verdict, warnings, errors, requirements."""
    return "\n".join(map(_coloured_line, text.split("\n")))


def _coloured_line(line: str) -> str:
    for words, colour in _COLOURS:
        line = words.sub(lambda match, colour=colour: f"{colour}{match[0]}{_PLAIN}", line)  # type: ignore[misc]
    return line


def fitted(text: str, width: int) -> str:
    """Return a text whose lines have at most `width` characters, as far as words and columns allow.

    Prose is broken between words. A table that is too wide is shown in parts one below the other; each begins with the
    columns that tell its rows apart.
    """
    lines: list[str] = []
    for kind, some in groupby(text.split("\n"), _kind):
        block = list(some)
        if kind == _EXCERPT or max(map(len, block)) <= width:
            lines += block
        elif kind == _TABLE:
            lines += _table(block, width)
        else:
            lines += (part for line in block for part in _prose(line, width))
    return "\n".join(lines)


def _kind(line: str) -> str:
    if _OF_A_FILE.match(line):
        return _EXCERPT
    return _TABLE if _GAP in line.strip() else _PROSE


def _prose(line: str, width: int) -> list[str]:
    indent = line[: len(line) - len(line.lstrip())]
    return textwrap.wrap(
        line, width, subsequent_indent=f"{indent}  ", break_long_words=False, break_on_hyphens=False
    ) or [line]


def _table(lines: Sequence[str], width: int) -> Iterator[str]:
    """Yield the lines of a table in parts of at most `width` characters."""
    columns = _columns(lines)
    keys = 1 if len(columns) < 3 or len(set(columns[0])) == len(columns[0]) else 2
    while keys and (room := width - sum(len(column[0]) + len(_GAP) for column in columns[:keys])) < _LEAST:
        keys -= 1
    if not keys or len(columns) <= keys:
        yield from lines
        return
    parts: list[list[list[str]]] = []
    left = 0
    for column in columns[keys:]:
        if len(column[0]) > left:
            parts.append([])
            left = room
        parts[-1].append(column)
        left -= len(column[0]) + len(_GAP)
    for number, part in enumerate(parts):
        if number:
            yield ""
        yield from _rows(columns[:keys], part, room)


def _rows(keys: Sequence[Sequence[str]], part: Sequence[Sequence[str]], room: int) -> Iterator[str]:
    """Yield the rows of a part of a table that are not empty; cells that have no room are broken into lines."""
    before = sum(len(column[0]) + len(_GAP) for column in keys)
    wide = len(part[0][0]) > room
    for row in zip(*keys, *part, strict=True):
        *cells, end = row
        if not "".join(row[len(keys) :]).strip():
            continue
        broken = textwrap.wrap(end, room, break_long_words=False, break_on_hyphens=False) if wide else [end]
        first, *more = broken or [""]
        yield _GAP.join([*cells, first]).rstrip()
        yield from (" " * before + line for line in more)


def _columns(lines: Sequence[str]) -> list[list[str]]:
    """Return the columns of a table, which end where all lines have two spaces; cells of one are equally long."""
    width = max(map(len, lines))
    padded = [line.ljust(width) for line in lines]
    used = "".join(" " if all(line[k] == " " for line in padded) else "x" for k in range(width))
    spans = [match.span() for match in re.finditer("x+(?: x+)*", used)]
    return [[line[start:end] for line in padded] for start, end in spans]
