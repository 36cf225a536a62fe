"""A sparse model of COLMAP as text: images.txt has the image points, points3D.txt the points that they show.

Source: colmap.github.io/format.html. An image has two lines: number, quaternion, shift, camera and name, then `X Y
POINT3D_ID` of each image point, -1 for those that show no point of the model. The centre of the first pixel is
(0.5, 0.5) there. The unit of the points is that of nothing, unless their scale was set.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from decimal import Decimal

from metrocli.errors import Fault, InputError
from metrocli.formats.csv_text import shortened
from metrocli.imports import Imported, ImportOptions
from metrocli.imports.lines import TextLines, is_number, must_be_length, to_csv

_IMAGE, _POINT = 10, 12
"""Fields of the first line of an image, and fewest of a point, which two images show"""
_CENTRE = Decimal("0.5")


def files(lines: TextLines, options: ImportOptions) -> Imported:
    """Return observations.csv of images.txt, one for each of several cameras, or targets.csv of points3D.txt.

    Raises UsageError for points without a unit, InputError that lists all faults of the lines.
    """
    first = next((line.split() for _, line in lines.without("#")), [])
    points = len(first) >= _POINT and len(first) % 2 == 0 and all(map(is_number, first))
    return _targets(lines, options.unit) if points else _observations(lines)


def _targets(lines: TextLines, unit: str) -> Imported:
    must_be_length(unit)
    rows, faults = [], list[Fault]()
    for number, line in lines.without("#"):
        cells = line.split()[:4]
        if len(cells) < 4 or not all(map(is_number, cells)):
            faults.append(lines.fault("expected POINT3D_ID X Y Z R G B ERROR TRACK[]", number))
        rows.append(cells)
    if faults:
        raise InputError(shortened(faults))
    header = ("target", *(f"{axis}_{unit}" for axis in "xyz"))
    return {"targets.csv": to_csv(header, rows, f"from {lines.file} (colmap-model)")}


def _observations(lines: TextLines) -> Imported:
    faults, of_camera, lost, twice = list[Fault](), dict[str, list[tuple[str, ...]]](), 0, 0
    for camera, name, number, cells in _images(lines, faults):
        rows = of_camera.setdefault(camera, [])
        if len(cells) % 3 or not all(map(is_number, cells)):
            faults.append(lines.fault(f"expected X Y POINT3D_ID of each image point of {name}", number))
            continue
        counts = Counter(cells[2::3])
        lost += counts.pop("-1", 0)
        twice += sum(count for count in counts.values() if count > 1)
        for x, y, point in zip(cells[::3], cells[1::3], cells[2::3], strict=True):
            if counts[point] == 1:
                rows.append((name, point, str(Decimal(x) - _CENTRE), str(Decimal(y) - _CENTRE)))
    if not faults and not any(of_camera.values()):
        faults.append(lines.fault("no image point shows a point of the model", None, "expected images.txt of COLMAP"))
    if faults:
        raise InputError(shortened(faults))
    notes = [f"{lost} image points show no point of the model and are left out"] if lost else []
    notes += [f"{twice} image points show a point that their image shows again and are left out"] if twice else []
    header = ("image", "target", "u_px", "v_px")
    return {
        f"observations{f'-{camera}' if len(of_camera) > 1 else ''}.csv": to_csv(
            header, rows, f"from {lines.file} (colmap-model, camera {camera})", notes
        )
        for camera, rows in of_camera.items()
    }


def _images(lines: TextLines, faults: list[Fault]) -> Iterator[tuple[str, str, int, list[str]]]:
    """Yield camera and name of each image, and number and fields of the line of its image points (it may be empty)."""
    numbered = [(n, line) for n, line in enumerate(lines.lines, 1) if not line.startswith("#")]
    while numbered and not numbered[-1][1].strip():
        numbered.pop()
    for start in range(0, len(numbered), 2):
        number, line = numbered[start]
        cells = line.split(maxsplit=_IMAGE - 1)
        if len(cells) < _IMAGE or not all(map(is_number, cells[:-1])):
            text = "expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, and the image points in the next line"
            faults.append(lines.fault(text, number))
            return
        at, points = numbered[start + 1] if start + 1 < len(numbered) else (number, "")
        yield cells[8], cells[9].strip(), at, points.split()
