"""Spatial and plane networks of GNU Gama as inputs of adjust-network.

Source: GNU Gama manual, XML input data format for gama-local (points in m, angles in gon or d-m-s, standard deviations
in mm and cc or arcsec). North is +y and east +x in what is written. A station stands over its point, once for
each set of observations and each height of its instrument. An angle is two directions of a round of its own, each with
1/sqrt(2) of its standard deviation. An azimuth is a direction of a station whose x axis is to the north. A plane
network has all its points at one height: z = 0, by height differences 0.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from decimal import Decimal, InvalidOperation
from xml.etree import ElementTree

from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.imports import Imported, ImportOptions
from metrocli.imports.lines import TextLines, to_csv

_TOWARDS = {"e": ("x", 1), "w": ("x", -1), "n": ("y", 1), "s": ("y", -1)}
_AXES = ("ne", "sw", "es", "wn", "en", "nw", "se", "ws")
_READ = {
    "direction": ("hz", "direction-stdev"),
    "s-distance": ("d", "distance-stdev"),
    "distance": ("d", "distance-stdev"),
    "azimuth": ("hz", "azimuth-stdev"),
    "z-angle": ("zd", "zenith-angle-stdev"),
}
_HINT = "with stdev: <direction>, <angle>, <azimuth>, <s-distance>, <z-angle>, <dh>, or <distance> of a plane network"
_HORIZONTAL = ("direction", "angle", "azimuth")
_UPRIGHT = ("s-distance", "z-angle", "dh", "vec")
_STATIONS = ("station", "instrument", "over", "height_mm", "sigma_height_mm", "gamma_deg")
_NORTH = "90"
"""Direction of the x axis of a station whose readings are azimuths, from +x, which is east"""
INSTRUMENT = "TS1"
"""Name of the instrument in what is written: declare it as a total station"""
Element = ElementTree.Element


def files(lines: TextLines, options: ImportOptions) -> Imported:
    """Return readings.csv, stations.csv, points.csv and heights.csv; raises InputError that lists all faults."""
    try:
        root = _bare(ElementTree.fromstring("\n".join(lines.lines)))
    except ElementTree.ParseError as error:
        raise InputError([lines.fault(f"this is not XML: {error}", error.position[0])]) from error
    network = root if root.tag == "network" else root.find("network")
    if network is None:
        raise InputError([lines.fault("there is no <network>", None, "expected: the XML input of gama-local")])
    return survey_of(lines, network, "gama-xml")


def survey_of(lines: TextLines, network: Element, form: str, notes: Iterable[str] = ()) -> Imported:
    """Return the files of a network; raises InputError that lists all faults."""
    reader = _NetworkSections(lines, network)
    survey = reader.read()
    if reader.faults:
        raise InputError(reader.faults)
    left_out = [f"{reader.left_out} observations of points without fix or adj are left out"] if reader.left_out else []
    origin = f"from {lines.file} ({form})"
    return {name: to_csv(header, rows, origin, [*notes, *left_out]) for name, (header, rows) in survey.items() if rows}


def _bare(root: Element) -> Element:
    """Return the tree with names of elements without their namespace."""
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    return root


def _without_unlisted(network: Element) -> int:
    """Take out the observations of points that are neither fixed nor adjusted, as Gama does; return their number."""
    used = {point.get("id", "").strip() for point in network.iter("point") if point.get("fix") or point.get("adj")}
    count = 0
    for section in network.iter("points-observations"):
        for group in section:
            for element in list(group):
                ends = [element.get("from", group.get("from")), *(element.get(end) for end in ("to", "bs", "fs"))]
                if any(end and end.strip() not in used for end in ends):
                    group.remove(element)
                    count += 1
    return count


def _setups(obs: Element) -> dict[tuple[str, str, bool], list[Element]]:
    """Return the observations of a set by point and height of their instrument, and by whether they are azimuths.

    Directions and angles do not depend on the height; they join the first other observation from their point.
    """

    def place(element: Element) -> tuple[str, str, bool]:
        name = element.get("from", obs.get("from", "")).strip()
        return name, element.get("from_dh", obs.get("from_dh", "0")), element.tag == "azimuth"

    def is_level(element: Element) -> bool:
        return element.tag in _HORIZONTAL and element.get("from_dh") is None

    upright = [place(element) for element in obs if not is_level(element)]
    setups: dict[tuple[str, str, bool], list[Element]] = {}
    for element in obs:
        key = place(element)
        if is_level(element) and not key[2]:
            key = next((other for other in upright if other[0] == key[0]), key)
        setups.setdefault(key, []).append(element)
    return setups


@dataclass(frozen=True)
class _Shot:
    """What one set reads of one target."""

    station: str
    target: str
    height: str
    cells: dict[str, str]


class _NetworkSections:
    """The sections of a network, read one after the other."""

    def __init__(self, lines: TextLines, network: Element) -> None:
        self.lines, self.network, self.faults = lines, network, list[Fault]()
        self.axes = network.get("axes-xy", "ne")
        self.clockwise = network.get("angles", "left-handed") == "left-handed"
        self.left_out = _without_unlisted(network)
        self.plane = not any(
            element.tag in _UPRIGHT
            or element.get("z")
            or "z" in (element.get("fix", "") + element.get("adj", "")).lower()
            for element in network.iter()
        )
        if self.axes not in _AXES:
            self._refuse(f"axes-xy is '{self.axes}'", f"one of {', '.join(_AXES)}")
            self.axes = "en"

    def _refuse(self, message: str, hint: str = _HINT) -> None:
        fault = self.lines.fault(message, None, hint)
        if fault not in self.faults:
            self.faults.append(fault)

    def read(self) -> Mapping[str, tuple[tuple[str, ...], list[tuple[str, ...]]]]:
        """Return header and rows of each file."""
        points, shots, heights = list[tuple[str, ...]](), list[_Shot](), list[tuple[str, ...]]()
        stations: list[tuple[str, ...]] = []
        sets = [element for section in self.network.iter("points-observations") for element in section.iter("obs")]
        often = Counter(key[0] for angles in sets for key in _setups(angles))
        number: Counter[str] = Counter()
        for section in self.network.iter("points-observations"):
            for element in section:
                if element.tag == "point":
                    points += self._point(element)
                elif element.tag == "obs":
                    for (name, height, by_north), observations in _setups(element).items():
                        number[name] += 1
                        station = f"{name}-{number[name]}" if often[name] > 1 else f"S{name}"
                        shots += self._set(section, observations, station, name)
                        high = "0" if self.plane else str(self._number(height, element) * 1000)
                        stations.append((station, INSTRUMENT, name, high, "0", _NORTH if by_north else ""))
                elif element.tag == "height-differences":
                    heights += self._heights(element)
                else:
                    self._refuse(f"<{element.tag}> is not read")
        hz = "hz" if self.clockwise else "az"
        heights += self._one_height(points, shots, stations) if self.plane else ()
        columns = (f"{hz}_gon", f"sigma_{hz}_mgon", "zd_gon", "sigma_zd_mgon", "d_m", "sigma_d_mm")
        keys = ("hz", "sigma_hz", "zd", "sigma_zd", "d", "sigma_d")
        rows = [
            (
                shot.station,
                shot.target,
                *(shot.cells.get(key, "") for key in keys),
                shot.height,
                shot.cells.get("round", ""),
            )
            for shot in shots
        ]
        return {
            "readings.csv": (("station", "point", *columns, "th_m", "round"), rows),
            "stations.csv": (_STATIONS, stations),
            "points.csv": (("point", "x_m", "y_m", "z_m", "sigma_x_mm", "sigma_y_mm", "sigma_z_mm"), points),
            "heights.csv": (("from", "to", "dh_m", "sigma_mm"), heights),
        }

    def _point(self, element: Element) -> Iterator[tuple[str, ...]]:
        """Yield a listed point: a fixed coordinate has the standard deviation 0, an adjusted one none."""
        if self.plane:
            element.set("z", "0")
            element.set("fix", element.get("fix", "") + ("z" if element.get("fix") else ""))
        if not all(element.get(axis) for axis in "xyz"):
            if element.get("fix"):
                name = element.get("id", "")
                self._refuse(
                    f"point {name} is fixed and lacks a coordinate", "give it, an approximate one if it is free"
                )
            return
        place, sigma = {"z": element.get("z", "")}, {"z": "0" if "z" in element.get("fix", "").lower() else ""}
        for axis, letter in zip("xy", self.axes, strict=True):
            ours, sign = _TOWARDS[letter]
            value = self._number(element.get(axis, ""), element)
            place[ours] = str(value * sign)
            sigma[ours] = "0" if axis in element.get("fix", "").lower() else ""
        yield element.get("id", ""), *(place[axis] for axis in "xyz"), *(sigma[axis] for axis in "xyz")

    def _set(self, section: Element, observations: list[Element], station: str, over: str) -> Iterator[_Shot]:
        """Yield the readings of a set-up, target by target."""
        shots: dict[str, list[_Shot]] = {}
        # horizontal angles come last: they do not depend on heights, and join what else was read of their target
        numbered = sorted(enumerate(observations, 1), key=lambda pair: pair[1].tag in _HORIZONTAL)
        for number, observation in numbered:
            for name, target, height, cells in self._readings(section, observation, over, number):
                seen = shots.setdefault(target, [])
                fits = (
                    sighting
                    for sighting in seen
                    if name not in sighting.cells and (name == "hz" or sighting.height == height)
                )
                shot = next(fits, None)
                if shot is None:
                    shot = _Shot(station, target, height, {})
                    seen.append(shot)
                    yield shot
                shot.cells.update(cells)

    def _readings(
        self, section: Element, observation: Element, over: str, number: int
    ) -> Iterator[tuple[str, str, str, dict[str, str]]]:
        """Yield quantity, target, height and cells of an observation; an angle is two directions."""
        if observation.tag == "angle":
            sigma = self._spread(observation, "hz", section.get("angle-stdev", ""))
            each = {"sigma_hz": str(float(sigma or "nan") / 2**0.5), "round": f"angle {number}"}
            for end, value in (("bs", "0"), ("fs", self._value(observation, "hz"))):
                yield "hz", observation.get(end, "").strip(), "", {"hz": value, **each}
        elif observation.tag not in _READ or (observation.tag == "distance" and not self.plane):
            self._refuse(f"<{observation.tag}> in the set from {over} is not read")
        else:
            name, default = _READ[observation.tag]
            target, height = observation.get("to", "").strip(), "" if self.plane else observation.get("to_dh", "")
            sigma = self._spread(observation, name, section.get(default, ""))
            yield name, target, height, {name: self._value(observation, name), f"sigma_{name}": sigma}

    @staticmethod
    def _one_height(
        points: list[tuple[str, ...]], shots: list[_Shot], stations: list[tuple[str, ...]]
    ) -> Iterator[tuple[str, ...]]:
        """Yield a height difference 0 to each point of a plane network that is not fixed."""
        used = dict.fromkeys([row[2] for row in stations] + [shot.target for shot in shots])
        fixed = [row[0] for row in points if row[6]]
        first = next((name for name in fixed if name in used), next(iter(used), ""))
        for name in used:
            if name != first and name not in fixed:
                yield first, name, "0", "1"

    def _value(self, element: Element, name: str) -> str:
        """Return an angle in gon, or a distance in m."""
        text = element.get("val", "")
        if name == "d" or "-" not in text.lstrip("-+"):
            self._number(text, element)
            return text
        parts = [self._number(part, element) for part in text.lstrip("-+").split("-")]
        degrees = parts[0] + parts[1] / 60 + (parts[2] / 3600 if len(parts) > 2 else Decimal(0))
        return str((-degrees if text.startswith("-") else degrees) * 10 / 9)

    def _spread(self, element: Element, name: str, default: str) -> str:
        """Return the standard deviation in mm, or in mgon: 10 cc, or 0.324 arcsec a cc."""
        text = element.get("stdev", default)
        if not text:
            self._refuse(f"<{element.tag}> to {element.get('to') or element.get('fs')} has no stdev")
            return ""
        if name == "d":
            parts = [float(part) for part in text.split()]
            away = float(self._number(element.get("val", ""), element)) / 1000
            more = parts[1] * away ** (parts[2] if len(parts) > 2 else 1.0) if len(parts) > 1 else 0.0
            return str(parts[0] + more) if more else text.split()[0]
        in_seconds = "-" in element.get("val", "").lstrip("-+")
        return str(self._number(text, element) / (Decimal("3.24") if in_seconds else 10))

    def _heights(self, group: Element) -> Iterator[tuple[str, ...]]:
        for element in group:
            spread = element.get("stdev") or self._of_way(element)
            if element.tag != "dh" or not spread:
                self._refuse(f"<{element.tag}> of height differences without stdev and dist is not read")
                continue
            yield element.get("from", ""), element.get("to", ""), element.get("val", ""), spread

    def _of_way(self, element: Element) -> str:
        """Return the standard deviation of a levelled way of some km, `sigma_apr sqrt(dist)` mm; empty without one."""
        way, parameters = element.get("dist"), self.network.find("parameters")
        apriori = "10" if parameters is None else parameters.get("sigma-apr", "10")
        return str(self._number(way, element).sqrt() * self._number(apriori, element)) if way else ""

    def _number(self, text: str, element: Element) -> Decimal:
        try:
            return Decimal(text.strip())
        except InvalidOperation:
            self._refuse(f"<{element.tag}>: '{text}' is not a number")
            return Decimal(1)
