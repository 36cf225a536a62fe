"""Points as SpatialAnalyzer exports them: lines `[[Collection] Group] Target x y z`, comments begin with //.

Source: SpatialAnalyzer User Manual, Exporting ASCII Formatted Points. Separators are spaces or commas. The file does
not state its unit.
"""

from __future__ import annotations

from collections import Counter

from metrocli.errors import Fault, InputError
from metrocli.formats.csv_text import shortened
from metrocli.imports import Imported, ImportOptions
from metrocli.imports.lines import TextLines, is_number, must_be_length, to_csv

_COMMENT = "//"
_HINT = "expected: [[Collection] Group] Target x y z, exported without uncertainties, times or offsets"


def files(lines: TextLines, options: ImportOptions) -> Imported:
    """Return points.csv; raises UsageError without a unit, InputError that lists all faults of the lines."""
    must_be_length(options.unit)
    names, places, faults = [], [], list[Fault]()
    for number, line in lines.without(_COMMENT):
        cells = [cell.strip() for cell in line.split(",")] if "," in line else line.split()
        wrong = _wrong(cells)
        if wrong:
            faults.append(lines.fault(wrong, number, _HINT))
        names.append(tuple(cells[:-3]))
        places.append(cells[-3:])
    if not names:
        faults.append(lines.fault("the file has no points", None, _HINT))
    shown = _distinct(names)
    if not faults and len(set(shown)) < len(shown):
        name, count = Counter(shown).most_common(1)[0]
        faults.append(lines.fault(f"the point '{name}' is there {count} times", None, "give each point its own name"))
    if faults:
        raise InputError(shortened(faults))
    header = ("point", *(f"{axis}_{options.unit}" for axis in "xyz"))
    rows = [(name, *place) for name, place in zip(shown, places, strict=True)]
    return {"points.csv": to_csv(header, rows, f"from {lines.file} (sa-ascii)")}


def _wrong(cells: list[str]) -> str:
    """Return what is wrong with the cells of a line, or nothing."""
    if not 4 <= len(cells) <= 6:
        return f"the line has {len(cells)} fields instead of 4 to 6"
    if all(map(is_number, cells)) and len(cells) == 6:
        return "six numbers without a name"
    for cell in cells[:-3]:
        if is_number(cell) and not cell.isdigit():
            return f"the name '{cell}' is a number with a sign or decimals, so more than x y z follows the name"
    for cell in cells[-3:]:
        if not is_number(cell):
            return f"the coordinate '{cell}' is not a number"
    return ""


def _distinct(names: list[tuple[str, ...]]) -> list[str]:
    """Return the shortest names that are distinct: the target, else with its group, else with its collection."""
    for parts in (1, 2, 3):
        short = ["::".join(name[-parts:]) for name in names]
        if len(set(short)) == len(short):
            break
    return short
