"""Networks of LGC2 (CERN): set-ups, angles and distances as inputs of adjust-network.

Source: LGC2 user manual, General File Layout, Instruments, Points (github.com/geodetic-metrology-tools/LGC2). Lengths
are in m, angles in gon clockwise from Y, sigmas in mm and cc. Comments stand behind %, or after # in the first column.
The observations become the elements of GNU Gama, and are read as those.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from math import hypot, pi
from xml.etree.ElementTree import Element, SubElement

from metrocli.errors import Fault, InputError
from metrocli.formats.csv_text import shortened
from metrocli.frozen import dataclass
from metrocli.imports import Imported, ImportOptions
from metrocli.imports.gama_xml import survey_of
from metrocli.imports.lines import TextLines, is_number

_FIXED = {"*CALA": "xyz", "*POIN": "", "*VXY": "z", "*VXZ": "y", "*VYZ": "x", "*VZ": "xy"}
"""Coordinates that a kind of point holds"""
_READINGS: dict[str, tuple[str, ...]] = {
    "*ANGL": ("direction",),
    "*ZEND": ("z-angle",),
    "*DIST": ("s-distance",),
    "*DHOR": ("distance",),
    "*PLR3D": ("direction", "z-angle", "s-distance"),
}
_READ = "*INSTR with *POLAR, points, *TSTN with *V0, *ANGL, *ZEND, *DIST, *DHOR and *PLR3D are read"
_ELLIPSOIDS, _SIGMAS = ("*RS2K", "*LEP", "*SPHE"), ("SX", "SY", "SZ")
_NUMBERS, _TEXTS = ("TH", "THSE", "OBSE", "IH", "IHSE", "ICSE", "PPM", "DCOR", "TCSE"), ("TRGT", "ID")
"""Flags that have a value: a number, or a text"""
_CC = 2 * pi / 4e6
"""A cc in rad"""


@dataclass(frozen=True)
class _Target:
    """What the instrument states of one of its targets: sigmas, correction and height, and its own heights."""

    angle: float
    zenith: float
    distance: float
    ppm: float
    correction: float
    centring: float
    height: float
    height_sigma: float


@dataclass(frozen=True)
class _Instrument:
    default: str
    height: float
    height_sigma: float
    centring: float
    targets: dict[str, _Target] = field(default_factory=dict)


@dataclass(frozen=True)
class _Setup:
    """A set-up, and its observations: line, round, element, target point, value, flags."""

    point: str
    instrument: _Instrument
    height: float
    seen: list[tuple[int, int, str, str, float, dict[str, str]]] = field(default_factory=list)


class _NetworkFile:
    """Reads the sections of a file in their order."""

    def __init__(self, lines: TextLines) -> None:
        self.lines, self.faults, self.notes = lines, list[Fault](), list[str]()
        self.instruments: dict[str, _Instrument] = {}
        self.points: dict[str, tuple[str, list[str]]] = {}
        """What is held, and the coordinates"""
        self.setups: list[_Setup] = []
        self.section, self.rounds, self.begun = "", 0, False

    def read(self) -> None:
        for number, words in _rows(self.lines):
            key = words[0].upper()
            if key.startswith("*"):
                self._keyword(number, key, words[1:])
            elif self.begun and not self._row(number, words):
                self.faults.append(self.lines.fault(f"this is not a line of {self.section}", number, _READ))
        if not self.begun:
            text = "without *INSTR this is the older layout of LGC1"
            self.faults.append(self.lines.fault(text, hint="LGC2 writes *INSTR before its points"))

    def _keyword(self, number: int, key: str, words: list[str]) -> None:
        self.begun |= key == "*INSTR"
        if key in _ELLIPSOIDS:
            self.notes.append(f"{key}: metrocli takes plumb lines as parallel, and heights as z")
        if not self.begun or key in ("*INSTR", "*END", "*FIN"):
            self.section = ""
        elif key == "*POLAR" and len(words) > 4 and all(map(is_number, words[2:5])):
            height, spread, centring = map(float, words[2:5])
            self.instruments[words[0]], self.section = _Instrument(words[1], height, spread, centring), key
        elif key == "*TSTN" and len(words) > 1:
            self._setup(number, words)
        elif key == "*V0" and self.setups:
            self.rounds += 1
        elif key in _FIXED or (key in _READINGS and self.setups):
            self.section = key
        else:
            self.faults.append(self.lines.fault(f"{' '.join([key, *words[:2]])} is not read", number, _READ))
            self.section = ""

    def _setup(self, number: int, words: list[str]) -> None:
        flags, own = self._flags(number, words[2:]), self.instruments.get(words[1], _Instrument("", 0.0, 0.0, 0.0))
        if words[1] not in self.instruments:
            hint = "*INSTR lists it as *POLAR, with its targets"
            self.faults.append(self.lines.fault(f"'{words[1]}' is not an instrument of this file", number, hint))
        if "IHFIX" not in flags:
            hint = "write IHFIX and IH with its height, or name the point of the instrument itself"
            self.faults.append(self.lines.fault("the height of the instrument is an unknown of LGC2", number, hint))
        if "ROT3D" in flags:
            hint = "read its readings as a table, and give its instrument `type: tracker` in the job"
            self.faults.append(self.lines.fault("a station that is not levelled (ROT3D) is not read", number, hint))
        self.setups.append(_Setup(words[0], own, float(flags.get("IH", own.height) or 0)))
        self.rounds += 1

    def _row(self, number: int, words: list[str]) -> bool:
        """Read a line below a keyword; return whether it is one."""
        if self.section == "*POLAR":
            return self._target(number, words)
        if self.section in _FIXED:
            return self._point(number, words)
        elements = _READINGS.get(self.section)
        if elements is None:
            return True  # below what is not read, which is a fault of its own
        values = words[1 : 1 + len(elements)]
        if len(values) < len(elements) or not all(map(is_number, values)):
            return False
        flags = self._flags(number, words[1 + len(elements) :])
        for element, value in zip(elements, values, strict=True):
            self.setups[-1].seen.append((number, self.rounds, element, words[0], float(value), flags))
        target = flags.get("TRGT", self.setups[-1].instrument.default)
        known = self.setups[-1].instrument.targets
        if known and target not in known:
            text = f"'{target}' is not a target of the instrument"
            self.faults.append(self.lines.fault(text, number, "*POLAR lists its targets"))
        return True

    def _flags(self, number: int, words: list[str]) -> dict[str, str]:
        """Return the flags of a line with their values; those without one have an empty text."""
        flags, rest = dict[str, str](), list(words)
        while rest:
            name = rest.pop(0).upper()
            value = rest.pop(0) if name in (*_NUMBERS, *_TEXTS) and rest else ""
            if name in _NUMBERS and (not is_number(value) or (name == "OBSE" and float(value) < 0)):
                text = f"{name} has the value '{value}'"
                self.faults.append(self.lines.fault(text, number, f"expected: {name} and a number"))
                value = "0"
            flags[name] = value
        return flags

    def _target(self, number: int, words: list[str]) -> bool:
        if len(words) < 11 or not all(map(is_number, words[1:11])):
            return False
        angle, zenith, distance, ppm, free, correction, _, centring, height, spread = map(float, words[1:11])
        if min(angle, zenith, distance) <= 0:
            text, hint = (
                "a standard deviation of the target is not above zero",
                "expected: those of angles and distance",
            )
            self.faults.append(self.lines.fault(text, number, hint))
        if free:
            self.notes.append(f"{words[0]}: the distance correction, an unknown there, is held at {correction:g} m")
        own = _Target(angle, zenith, distance, ppm, correction, centring, height, spread)
        list(self.instruments.values())[-1].targets[words[0]] = own
        return True

    def _point(self, number: int, words: list[str]) -> bool:
        if len(words) < 4 or not all(map(is_number, words[1:4])):
            return False
        given = dict(zip(words[4::2], words[5::2], strict=False))
        held = {name for name, value in given.items() if name in _SIGMAS and is_number(value) and not float(value)}
        if len(held) < len(words[4:]) / 2:
            hint = "take them out here, and write sigma_x_mm, sigma_y_mm, sigma_z_mm into points.csv"
            self.faults.append(self.lines.fault("sigmas of a point other than 0 are not read", number, hint))
        axes = {*_FIXED[self.section], *(name[1].lower() for name in held)}
        self.points[words[0]] = ("".join(sorted(axes)), words[1:4])
        return True

    def network(self) -> Element:
        """Return the network as GNU Gama writes it."""
        network = Element("network", {"axes-xy": "en", "angles": "left-handed"})
        section = SubElement(network, "points-observations")
        for name, (held, at) in self.points.items():
            free = "".join(axis for axis in "xyz" if axis not in held)
            marks = {key: axes for key, axes in (("fix", held), ("adj", free)) if axes}
            SubElement(section, "point", {"id": name, **dict(zip("xyz", at, strict=True)), **marks})
        for setup in self.setups:
            away = {to: value for _, _, element, to, value, _ in setup.seen if "distance" in element}
            sets: dict[int, Element] = {}
            for _, turn, element, to, value, flags in setup.seen:
                if turn not in sets:
                    sets[turn] = SubElement(section, "obs", {"from": setup.point, "from_dh": f"{setup.height:.10g}"})
                cells = _cells(setup, element, value, flags, away.get(to))
                SubElement(sets[turn], element, {"to": to, **cells})
        return network


def _cells(setup: _Setup, element: str, value: float, flags: dict[str, str], away: float | None) -> dict[str, str]:
    """Return value, standard deviation and height of the target; what is not centred counts at the distance."""
    own = setup.instrument.targets.get(flags.get("TRGT", setup.instrument.default), _Target(*[0.0] * 8))
    across = hypot(setup.instrument.centring, own.centring) / 1e3
    up = hypot(setup.instrument.height_sigma, own.height_sigma) / 1e3
    stated = float(flags.get("OBSE", 0) or 0)
    heights = {} if element == "direction" else {"to_dh": f"{float(flags.get('TH', own.height) or 0):.10g}"}
    if "distance" in element:
        value += own.correction
        size = hypot(stated or own.distance + own.ppm * value / 1e3, 1e3 * across)
    else:
        beside = (across if element == "direction" else hypot(across, up)) / (away or float("inf")) / _CC
        size = hypot(stated or (own.angle if element == "direction" else own.zenith), beside)
    return {"val": f"{value:.12g}", "stdev": f"{size:.10g}", **heights}


def _rows(lines: TextLines) -> Iterator[tuple[int, list[str]]]:
    for number, line in enumerate(lines.lines, 1):
        words = line.partition("%")[0].split()
        if words and not words[0].startswith("#"):
            yield number, words


def files(lines: TextLines, options: ImportOptions) -> Imported:
    """Return points.csv, stations.csv and readings.csv; raises InputError that lists all faults."""
    reader = _NetworkFile(lines)
    reader.read()
    if reader.faults:
        raise InputError(shortened(reader.faults))
    return survey_of(lines, reader.network(), "lgc2", reader.notes)
