"""Corners of a chessboard as mrgingham writes them for mrcal: a vnlog table `# filename x y level`.

Sources: manual page mrgingham(1); mrcal-calibrate-cameras of github.com/dkogan/mrcal. Corners of an image follow each
other in the order of the board, so they are numbered from 0. An image without corners has `-`. A corner that was not
found has the level `-` or one below 0, whatever its coordinates. Pixel (0, 0) is the centre of the first pixel.
"""

from __future__ import annotations

from collections.abc import Mapping

from metrocli.errors import Fault, InputError
from metrocli.formats.csv_text import shortened
from metrocli.imports import Imported, ImportOptions
from metrocli.imports.lines import TextLines, is_number, to_csv
from metrocli.words import counted

_WANTED = ("filename", "x", "y")
_LEVEL = "level"


def files(lines: TextLines, options: ImportOptions) -> Imported:
    """Return observations.csv; raises InputError that lists all faults of the lines."""
    remarks = ((n, line) for n, line in enumerate(lines.lines, 1) if line.startswith("#"))
    legend = next((remark for remark in remarks if not remark[1].startswith(("##", "#!"))), None)
    names = legend[1][1:].split() if legend else []
    absent = [name for name in _WANTED if name not in names]
    if legend is None or absent:
        hint = "expected a line such as '# filename x y level'"
        raise InputError([lines.fault(f"the legend lacks {', '.join(absent)}", legend[0] if legend else None, hint)])
    at = [names.index(name) for name in _WANTED]
    level = names.index(_LEVEL) if _LEVEL in names else None
    corners, faults = dict[str, list[tuple[str, str] | None]](), list[Fault]()
    for number, line in lines.without("#", legend[0] + 1):
        cells = line.split()
        if len(cells) <= max(*at, level or 0):
            faults.append(lines.fault(f"the line has {len(cells)} fields; the legend has {len(names)}", number))
            continue
        image, place = cells[at[0]], (cells[at[1]], cells[at[2]])
        lost = place == ("-", "-") or (level is not None and cells[level].startswith("-"))
        wrong = next((text for text in place if not lost and not is_number(text)), None)
        if wrong is not None:
            faults.append(lines.fault(f"the coordinate '{wrong}' is not a number", number, "expected pixels, or - -"))
            continue
        corners.setdefault(image, []).append(None if lost else place)
    images = {image: each for image, each in corners.items() if any(each)}
    faults += _incomplete(lines, {image: len(each) for image, each in images.items()})
    if faults:
        raise InputError(shortened(faults))
    rows = [
        (image, str(number), *place)
        for image, each in images.items()
        for number, place in enumerate(each)
        if place is not None
    ]
    skipped = sum(each.count(None) for each in images.values())
    notes = [f"{skipped} corners that the file calls not found are left out (level - or below 0)"] if skipped else []
    empty = len(corners) - len(images)
    notes += [f"{counted(empty, 'image', 'have')} no corner: left out"] if empty else []
    header = ("image", "target", "u_px", "v_px")
    return {"observations.csv": to_csv(header, rows, f"from {lines.file} (vnl)", notes)}


def _incomplete(lines: TextLines, counts: Mapping[str, int]) -> list[Fault]:
    """Return a fault for each image with another number of corners than the first: its corners cannot be named."""
    if not counts:
        return [lines.fault("no image has corners")]
    first, whole = next(iter(counts.items()))
    text = "{} has {} corners, but {} has {}: corners are named by their order, so all images need all of them"
    return [lines.fault(text.format(image, n, first, whole)) for image, n in counts.items() if n != whole]
