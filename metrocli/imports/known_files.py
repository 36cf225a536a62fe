"""Files that only one program writes: they need no mapping."""

from __future__ import annotations

import re

from metrocli.imports.cameras import program_of
from metrocli.imports.lines import TextLines

_SIGNS = {
    "gama-xml": r"<gama-(local|xml)\b",
    "metashape-markers": r"<marker\s+marker_id=",
    "vnl": r"^#\s*filename\s+x\s+y\b",
}


def format_of(lines: TextLines) -> str | None:
    """Return the format of a file that only files of one program have; None for any other, such as a table."""
    text = "\n".join(lines.lines)
    known = (name for name, sign in _SIGNS.items() if re.search(sign, text, re.MULTILINE))
    return next(known, None) or program_of(text)
