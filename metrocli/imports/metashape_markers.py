"""Markers of Metashape: the XML that it exports (and that of a frame of its projects) has the image points of markers.

Source: files shown in public repositories (kayze/AfterEffects-to-Metashape, README; DBAT, writepsmarkertbl.m). A chunk
has `camera id label` and `marker id label`, a marker perhaps a `reference x y z`. Its frames have `marker marker_id`
with `location camera_id pinned x y`. A location that is not pinned is predicted by Metashape, not measured. The origin
is the corner of the first pixel.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from decimal import Decimal
from xml.etree import ElementTree

from metrocli.errors import Fault, InputError
from metrocli.formats.csv_text import shortened
from metrocli.frozen import dataclass
from metrocli.imports import Imported, ImportOptions
from metrocli.imports.lines import TextLines, is_number, must_be_length, to_csv
from metrocli.words import listed

_CENTRE = Decimal("0.5")
_AXES = ("x", "y", "z")
Element = ElementTree.Element
Row = tuple[str, ...]


def files(lines: TextLines, options: ImportOptions) -> Imported:
    """Return observations.csv, and targets.csv where markers have places and their unit is given.

    Raises UsageError for an unknown unit, InputError that lists all faults of the file.
    """
    try:
        root = ElementTree.fromstring("\n".join(lines.lines))
    except ElementTree.ParseError as error:
        raise InputError([lines.fault(f"this is not XML: {error}", error.position[0])]) from error
    named = _Names(_labels(root, "camera"), _labels(root, "marker"))
    faults, predicted = (
        [*_alike(lines, "cameras", named.cameras), *_alike(lines, "markers", named.markers)],
        Counter[str](),
    )
    rows = list(_measured(lines, root, named, faults, predicted))
    twice = [f"{image}/{target}" for (image, target), count in Counter(row[:2] for row in rows).items() if count > 1]
    if twice and not faults:
        faults.append(lines.fault(f"image points that are there twice: {listed(twice, 5)}", None, "export one frame"))
    if not rows and not faults:
        hint = "expected <location camera_id pinned x y> below <marker marker_id>: Export Markers, XML"
        faults.append(lines.fault("no marker is measured in an image", None, hint))
    if faults:
        raise InputError(shortened(faults))
    notes = [f"{sum(predicted.values())} places that are not pinned are left out: predicted, not measured"]
    origin = f"from {lines.file} (metashape-markers)"
    header = ("image", "target", "u_px", "v_px")
    texts = {"observations.csv": to_csv(header, rows, origin, notes if predicted else ())}
    places = [row for row in _places(root) if row[0] in {target for _, target, *_ in rows}]
    if places and options.unit and _geographic(root):
        hint = "convert the markers to a local system in Metashape; without --unit the image points alone are read"
        raise InputError([lines.fault("the places of markers are longitude and latitude, no lengths", None, hint)])
    return texts | ({"targets.csv": _targets(places, options.unit, origin)} if places and options.unit else {})


@dataclass(frozen=True)
class _Names:
    """Labels by their numbers in the file."""

    cameras: Mapping[str, str]
    markers: Mapping[str, str]


def _labels(root: Element, tag: str) -> dict[str, str]:
    return {
        element.get("id", ""): element.get("label", element.get("id", "")).strip()
        for element in root.iter(tag)
        if element.get("id") is not None
    }


def _alike(lines: TextLines, what: str, labels: Mapping[str, str]) -> list[Fault]:
    """Return a fault if several have one label."""
    alike = [label for label, count in Counter(labels.values()).items() if count > 1]
    hint = "export one chunk, and give each a label of its own"
    return [lines.fault(f"{what} with one label: {listed(alike, 5)}", None, hint)] if alike else []


def _measured(
    lines: TextLines, root: Element, named: _Names, faults: list[Fault], predicted: Counter[str]
) -> Iterator[Row]:
    """Yield image, target, u and v of each pinned location; count the others."""
    for marker in root.iter("marker"):
        number = marker.get("marker_id")
        for place in () if number is None else marker.iter("location"):
            camera, values = place.get("camera_id", ""), [place.get(axis, "") for axis in _AXES[:2]]
            target = named.markers.get(number or "", number or "")
            if place.get("pinned", "true") == "false":
                predicted[target] += 1
            elif not all(map(is_number, values)):
                faults.append(lines.fault(f"marker '{target}' in camera {camera}: x or y is not a number"))
            elif named.cameras and camera not in named.cameras:
                faults.append(lines.fault(f"marker '{target}' is in camera {camera}, which the file does not list"))
            else:
                uv = [str(Decimal(value) - _CENTRE) for value in values]
                yield named.cameras.get(camera, camera), target, *uv


def _geographic(root: Element) -> bool:
    """Return whether the coordinate system of the markers has angles; the WKT of a projected one has its base, too."""
    systems = [(element.text or "").upper() for element in root.iter("reference")]
    return any("GEOG" in system and "PROJC" not in system for system in systems)


def _places(root: Element) -> Iterator[Row]:
    """Yield the label and the place of each marker that has one."""
    for marker in root.iter("marker"):
        reference = marker.find("reference")
        values = [] if reference is None else [reference.get(axis, "") for axis in _AXES]
        if values and all(map(is_number, values)):
            yield marker.get("label", marker.get("id", "")).strip(), *values


def _targets(places: list[Row], unit: str, origin: str) -> str:
    must_be_length(unit)
    return to_csv(("target", *(f"{axis}_{unit}" for axis in _AXES)), places, origin)
