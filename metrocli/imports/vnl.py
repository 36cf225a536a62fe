"""Corners of a chessboard as mrgingham writes them for mrcal: a vnlog table `# filename x y level`.

Source: manual page mrgingham(1). Corners of an image follow each other in the order of the board, so they are numbered
from 0. An image without corners has `-`. Pixel (0, 0) is the centre of the first pixel, as here.
"""

from __future__ import annotations

from collections import Counter

from metrocli.errors import Fault, InputError
from metrocli.formats.csv_text import shortened
from metrocli.imports import Imported, Wishes
from metrocli.imports.lines import Lines, is_number, to_csv

_WANTED = ("filename", "x", "y")


def files(lines: Lines, wishes: Wishes) -> Imported:
    """Return observations.csv; raises InputError that lists all faults of the lines."""
    remarks = ((n, line) for n, line in enumerate(lines.lines, 1) if line.startswith("#"))
    legend = next((one for one in remarks if not one[1].startswith(("##", "#!"))), None)
    names = legend[1][1:].split() if legend else []
    absent = [name for name in _WANTED if name not in names]
    if legend is None or absent:
        hint = "expected a line such as '# filename x y level'"
        raise InputError([lines.fault(f"the legend lacks {', '.join(absent)}", legend[0] if legend else None, hint)])
    at = [names.index(name) for name in _WANTED]
    counts, rows, faults = Counter[str](), [], list[Fault]()
    for number, line in lines.without("#", legend[0] + 1):
        cells = line.split()
        if len(cells) > max(at) and cells[at[1]] == cells[at[2]] == "-":
            continue
        wrong = next((cells[i] for i in at[1:] if i < len(cells) and not is_number(cells[i])), None)
        if len(cells) <= max(at):
            faults.append(lines.fault(f"the line has {len(cells)} fields; the legend has {len(names)}", number))
            continue
        if wrong is not None:
            faults.append(lines.fault(f"the coordinate '{wrong}' is not a number", number, "expected pixels, or - -"))
            continue
        image = cells[at[0]]
        rows.append((image, str(counts[image]), cells[at[1]], cells[at[2]]))
        counts[image] += 1
    faults += _incomplete(lines, counts)
    if faults:
        raise InputError(shortened(faults))
    header = ("image", "target", "u_px", "v_px")
    return {"observations.csv": to_csv(header, rows, f"from {lines.file} (vnl)")}


def _incomplete(lines: Lines, counts: Counter[str]) -> list[Fault]:
    """Return a fault for each image with another number of corners than the first: its corners cannot be named."""
    if not counts:
        return [lines.fault("no image has corners")]
    first, whole = next(iter(counts.items()))
    text = "{} has {} corners, but {} has {}: corners are named by their order, so all images need all of them"
    return [lines.fault(text.format(image, n, first, whole)) for image, n in counts.items() if n != whole]
