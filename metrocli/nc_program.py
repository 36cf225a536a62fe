"""NC programs as text: words of ISO 6983-1 (G-code), one block per line, absolute positions in mm."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from metrocli.frozen import dataclass
from metrocli.units import find_unit


@dataclass(frozen=True)
class NcDialect:
    """Conventions of a control where ISO 6983-1 leaves a choice."""

    dwell: str
    """Address of the duration in seconds of a dwell (G4)"""
    metric: str = "G21"
    comment: tuple[str, str] = ("(", ")")
    frame: tuple[str, ...] = ("%",)
    """Line that starts and ends a program; empty for none"""


CONTROLS = {
    "linuxcnc": NcDialect("P"),
    "fanuc": NcDialect("X"),
    "siemens": NcDialect("F", metric="G710", comment=("; ", ""), frame=()),
}
"""Controls by name.

Siemens programs use its own language: SINUMERIK ONE, NC programming (12/2019), special characters, G700/G710, G4.
"""
_DIGITS = 4


@dataclass(frozen=True)
class Rapid:
    """Move axes in rapid traverse (G0); if several axes move, the path between start and end is not defined."""

    to: Mapping[str, float]
    """Position by axis [mm]"""


@dataclass(frozen=True)
class Feed:
    """Move along a straight line at a feed (G1)."""

    to: Mapping[str, float]
    """Position by axis [mm]"""
    speed: float
    """Feed [mm/s]"""


@dataclass(frozen=True)
class Dwell:
    """Stand still (G4)."""

    time: float
    """Duration [s]"""


@dataclass(frozen=True)
class Stop:
    """Wait for the operator to press start (M0)."""

    message: str


Block = Rapid | Feed | Dwell | Stop


def program(title: str, remarks: Sequence[str], blocks: Iterable[Block], control: str = "linuxcnc") -> str:
    """Return the text of a program: title and remarks, `G17 G21 G40 G90 G94`, the blocks, M30.

    The control determines the word for metric units (G21 or G710). Positions have four decimals; title, remarks and
    messages become comments.
    """
    spoken = CONTROLS[control]
    lines = [*spoken.frame, *(_comment(line, spoken) for line in (title, *remarks)), f"G17 {spoken.metric} G40 G90 G94"]
    for block in blocks:
        lines += _words(block, spoken)
    return "\n".join([*lines, "M30", *spoken.frame, ""])


def written(value: float) -> float:
    """Return a position as its word states it, rounded to four decimals [mm]."""
    return round(value, _DIGITS) + 0.0  # no -0.0000


def _words(block: Block, control: NcDialect) -> list[str]:
    match block:
        case Rapid(to):
            return [f"G0 {_position(to)}"]
        case Feed(to, speed):
            feed = f"{find_unit('mm/min', 'speed').outside(speed):.{_DIGITS}f}".rstrip("0").rstrip(".")
            return [f"G1 {_position(to)} F{feed}"]
        case Dwell(time):
            return [f"G4 {control.dwell}{time:.3f}"]
        case Stop(message):
            return [_comment(message, control), "M0"]


def _position(to: Mapping[str, float]) -> str:
    return " ".join(f"{axis.upper()}{written(value):.{_DIGITS}f}" for axis, value in to.items())


def _comment(text: str, control: NcDialect) -> str:
    """Return a comment in ASCII, since controls read nothing else; parentheses in it become brackets."""
    plain = text.translate({ord("("): "[", ord(")"): "]"}).encode("ascii", "replace").decode()
    begin, end = control.comment
    return f"{begin}{' '.join(plain.split())}{end}"
