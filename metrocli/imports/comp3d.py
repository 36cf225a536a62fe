"""Networks of Comp3D (IGN): observations `.obs` and points `.cor` as inputs of adjust-network.

Source: Comp3D documentation, OBS File and COR File (m and gon, fields separated by spaces, comments behind *). A line
of observations is `code origin target value sigma [sigma_rel [h_origin h_target]]`, one of points `code name E N h
[sigma_E sigma_N sigma_h]`. Observations become the elements of GNU Gama, and are read as those.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from xml.etree.ElementTree import Element, SubElement

from metrocli.errors import Fault, InputError
from metrocli.formats.csv_text import shortened
from metrocli.frozen import dataclass
from metrocli.imports import Imported, ImportOptions
from metrocli.imports.gama_xml import survey_of
from metrocli.imports.lines import TextLines, is_number, to_csv

_TAGS = {"1": "s-distance", "3": "s-distance", "5": "direction", "6": "z-angle", "7": "direction", "8": "azimuth"}
_LEVELLED, _DISTANCE, _ROUND = "4", ("1", "3"), "7"
_GIVEN = {"0": "", "1": "xyz", "2": "xy", "3": "z"}
"""Coordinates that the code of a point constrains"""
_READ = "codes 1 and 3 (distances), 4 (height differences), 5, 6, 7 and 8 (angles) are read"
_CC, _MM = 10000.0, 1000.0


def files(lines: TextLines, options: ImportOptions) -> Imported:
    """Return points.csv of a .cor, else readings.csv, stations.csv and heights.csv; raises InputError of all faults."""
    return _points(lines) if lines.file.lower().endswith(".cor") else _observations(lines)


def _rows(lines: TextLines) -> Iterator[tuple[int, list[str]]]:
    for number, line in enumerate(lines.lines, 1):
        fields = line.partition("*")[0].split()
        if fields:
            yield number, fields


def _points(lines: TextLines) -> Imported:
    faults, rows = list[Fault](), []
    for number, (code, *fields) in _rows(lines):
        if code == "-1":
            continue
        if code not in _GIVEN or len(fields) < 4 or not all(map(is_number, fields[1:])):
            hint = "expected: code name E N h [sigma_E sigma_N sigma_h], code 0 to 3 (points in space)"
            faults.append(lines.fault("this is not a point in space", number, hint))
            continue
        sigmas = [*fields[4:7], *[""] * 3][:3]
        known = [
            f"{float(sigma) * _MM:.10g}" if axis in _GIVEN[code] and sigma and float(sigma) >= 0 else ""
            for axis, sigma in zip("xyz", sigmas, strict=True)
        ]
        rows.append((*fields[:4], *known))
    if faults:
        raise InputError(shortened(faults))
    header = ("point", "x_m", "y_m", "z_m", "sigma_x_mm", "sigma_y_mm", "sigma_z_mm")
    return {"points.csv": to_csv(header, rows, f"from {lines.file} (comp3d)")}


@dataclass(frozen=True)
class _Observed:
    """A line of observations."""

    line: int
    code: str
    ends: tuple[str, str]
    value: str
    sigma: float
    relative: float
    heights: tuple[str, str]


def _observations(lines: TextLines) -> Imported:
    seen, faults, idle = list[_Observed](), list[Fault](), 0
    for number, fields in _rows(lines):
        code = fields[0].lstrip("-+")
        if code not in (*_TAGS, _LEVELLED):
            faults.append(lines.fault(f"'{fields[0]}' is not read", number, _READ))
        elif len(fields) < 5 or not all(map(is_number, fields[3:])):
            hint = "expected: code origin target value sigma [sigma_rel [h_origin h_target]]"
            faults.append(lines.fault("this is not an observation", number, hint))
        elif fields[0].startswith("-") or float(fields[4]) < 0:
            idle += 1
        else:
            relative, *heights = [*fields[5:8], *["0"] * (8 - len(fields))][:3]
            ends = fields[1], fields[2]
            seen.append(
                _Observed(number, code, ends, fields[3], float(fields[4]), float(relative), (heights[0], heights[1]))
            )
    own = {observed.ends: float(observed.value) for observed in seen if observed.code in _DISTANCE}
    away = {(to, begin): value for (begin, to), value in own.items()} | own
    network = _network(seen, away)
    unknown = [observed for observed in seen if observed.relative and observed.ends not in away]
    hint = "write the standard deviation of this line in sigma, and 0 in sigma_rel"
    why = "sigma_rel multiplies a distance, and the file has none between these points"
    faults += [lines.fault(why, observed.line, hint) for observed in unknown]
    if faults:
        raise InputError(shortened(faults))
    return survey_of(lines, network, "comp3d", [f"{idle} deactivated observations are left out"] * bool(idle))


def _network(seen: list[_Observed], away: Mapping[tuple[str, str], float]) -> Element:
    """Return the observations as a network of GNU Gama; each round of angles begins a set."""
    network = Element("network", {"axes-xy": "en", "angles": "left-handed"})
    section = SubElement(network, "points-observations")
    for name in dict.fromkeys(end for observed in seen for end in observed.ends):
        SubElement(section, "point", {"id": name, "adj": "xyz"})
    sets: dict[str, Element] = {}
    lines = Element("height-differences")
    for observed in seen:
        begin, to = observed.ends
        distance = away.get(observed.ends, 1.0)
        linear = observed.code in (*_DISTANCE, _LEVELLED)
        size = observed.sigma
        size += observed.relative * distance if linear else _gon(observed.relative / distance)
        cells = {"to": to, "val": observed.value, "stdev": f"{size * (_MM if linear else _CC):.10g}"}
        if observed.code == _LEVELLED:
            SubElement(lines, "dh", {"from": begin, **cells})
            continue
        if begin not in sets or observed.code == _ROUND:
            sets[begin] = SubElement(section, "obs", {"from": begin})
        tag = _TAGS[observed.code]
        heights = {} if tag == "direction" else dict(zip(("from_dh", "to_dh"), observed.heights, strict=True))
        SubElement(sets[begin], tag, cells | heights)
    if len(lines):
        section.append(lines)
    return network


def _gon(angle: float) -> float:
    from metrocli.units import find_unit

    return angle / find_unit("gon", "angle").inside(1.0)
