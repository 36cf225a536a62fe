"""Files that only one program writes: they need no mapping."""

from __future__ import annotations

import re

from metrocli.errors import InputError
from metrocli.imports.cameras import program_of
from metrocli.imports.lines import TextLines

_SIGNS = {
    "gama-xml": r"<gama-(local|xml)\b",
    "lgc2": r"^\*(?:TITR|POIN|CALA)\b",
    "metashape-markers": r"<marker\s+marker_id=",
    "vnl": r"^#\s*filename\s+x\s+y\b",
}


_NOT_READ = {
    "GSI of Leica": r"^\*?(?:11|41)[0-9]{4}[+-][0-9A-Za-z]{8}",
    "M5 of Zeiss or Trimble": r"^For M5\|Adr",
    "camera or point list of MicMac": r"<(?:ExportAPERO|DicoAppuisFlottant|SetOfMesureAppuisFlottants)\b",
    "camera of Pix4D": r"^Pix4D camera calibration file",
    "target of Kalibr": r"^target_?[tT]ype\s*:",
}
_EXPORT = "export a table of it, one row a reading, and read that with a mapping"
_CAMERA = "docs/tasks/align-part.md has the camera file that jobs read, in pixels"
_INSTEAD = {
    "camera or point list of MicMac": f"export points as a table; {_CAMERA}",
    "camera of Pix4D": f"its numbers are mm; {_CAMERA}",
    "target of Kalibr": "write `pattern: {type: aprilgrid, columns: .., rows: .., pitch: .., marker_size: ..}`",
}


def must_be_read(lines: TextLines) -> None:
    """Raise InputError, with what to do, for a file of a program whose files are not read."""
    text = "\n".join(lines.lines)
    for name, sign in _NOT_READ.items():
        if re.search(sign, text, re.MULTILINE):
            raise InputError(
                [lines.fault(f"this is a file that is not read: {name}", None, _INSTEAD.get(name, _EXPORT))]
            )


def format_of(lines: TextLines) -> str | None:
    """Return the format of a file that only files of one program have; None for any other, such as a table."""
    text = "\n".join(lines.lines)
    known = (name for name, sign in _SIGNS.items() if re.search(sign, text, re.MULTILINE))
    return next(known, None) or program_of(text)
