"""A board in words, as on the command line."""

from __future__ import annotations

import re

from metrocli.errors import UsageError
from metrocli.targets.pattern import GRIDS
from metrocli.words import suggestion

_SIZE, _LENGTH = re.compile(r"([0-9]+)x([0-9]+)"), re.compile(r"([0-9.]+)\s*(mm|cm|um|m|in|inch)")
_SECOND = {
    "charuco": "marker_size",
    "aprilgrid": "marker_size",
    "circles": "diameter",
    "asymmetric-circles": "diameter",
}
"""Key of the second length of a board"""
_EXAMPLE = "e.g. 'chessboard 9x6 25 mm', 'charuco 11x8 15 mm 11 mm 4x4_50', 'circles 10x8 25 mm 15 mm'"


def board_in_words(board: str) -> dict[str, str]:
    """Return the keys of a pattern from type, columns x rows of its points, pitch, and what its type has more.

    Raises UsageError for words that describe no board.
    """
    kind, _, rest = board.strip().partition(" ")
    if kind not in GRIDS:
        raise UsageError(f"--board '{board}': no board '{kind}'; {suggestion(kind, GRIDS)}; {_EXAMPLE}")
    lengths = [f"{number} {unit}" for number, unit in _LENGTH.findall(rest)]
    sizes, *others = _LENGTH.sub(" ", rest).split() or [""]
    size = _SIZE.fullmatch(sizes)
    keys = ["pitch", *([_SECOND[kind]] if kind in _SECOND else [])]
    if size is None or not lengths or len(lengths) > len(keys) or len(others) > (kind == "charuco"):
        raise UsageError(
            f"--board '{board}' is not type, columns x rows, pitch, and what its type has more; {_EXAMPLE}"
        )
    words = {"type": kind, "columns": size[1], "rows": size[2], **dict(zip(keys, lengths, strict=False))}
    return words | ({"dictionary": others[0]} if others else {})
