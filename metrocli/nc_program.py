"""NC programs as text: ISO 6983-1 words (G-code), one block a line, absolute positions in millimetre."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from metrocli.units import find_unit

DWELL_WORDS = {"linuxcnc": "P", "fanuc": "X", "siemens": "F"}
"""The word of a dwell in seconds (G4), by control; ISO 6983-1 leaves it open"""
_DIGITS = 4


@dataclass(frozen=True)
class Rapid:
    """Move some axes in rapid traverse (G0); of several axes the path between is not defined."""

    to: Mapping[str, float]
    """[mm] by axis"""


@dataclass(frozen=True)
class Feed:
    """Move along a straight line at a feed (G1)."""

    to: Mapping[str, float]
    """[mm] by axis"""
    speed: float
    """[mm/s]"""


@dataclass(frozen=True)
class Dwell:
    """Stand still (G4)."""

    time: float
    """[s]"""


@dataclass(frozen=True)
class Stop:
    """Wait for the operator to press start (M0)."""

    message: str


Block = Rapid | Feed | Dwell | Stop


def program(title: str, remarks: Sequence[str], blocks: Iterable[Block], control: str = "linuxcnc") -> str:
    """Return the text of a program: remarks, `G17 G21 G40 G90 G94`, the blocks, M30.

    Positions have four decimals; remarks and messages become comments in parentheses.
    """
    lines = ["%", *(_comment(line) for line in (title, *remarks)), "G17 G21 G40 G90 G94"]
    for block in blocks:
        lines += _words(block, DWELL_WORDS[control])
    return "\n".join([*lines, "M30", "%", ""])


def _words(block: Block, dwell: str) -> list[str]:
    match block:
        case Rapid(to):
            return [f"G0 {_position(to)}"]
        case Feed(to, speed):
            feed = f"{find_unit('mm/min', 'speed').outside(speed):.{_DIGITS}f}".rstrip("0").rstrip(".")
            return [f"G1 {_position(to)} F{feed}"]
        case Dwell(time):
            return [f"G4 {dwell}{time:.3f}"]
        case Stop(message):
            return [_comment(message), "M0"]


def _position(to: Mapping[str, float]) -> str:
    return " ".join(f"{axis.upper()}{round(value, _DIGITS) + 0.0:.{_DIGITS}f}" for axis, value in to.items())


def _comment(text: str) -> str:
    """Return a comment; parentheses within it would end it, and controls read ASCII only."""
    plain = text.translate({ord("("): "[", ord(")"): "]"}).encode("ascii", "replace").decode()
    return f"({' '.join(plain.split())})"
