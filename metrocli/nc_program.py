"""NC programs as text: words of ISO 6983-1 (G-code), one block per line, absolute positions in mm and degrees."""

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
    any_turn: str = ""
    """Word of an axis that takes any turn: it goes the shortest way to a position within one; empty for a plain word"""


CONTROLS = {
    "linuxcnc": NcDialect("P"),
    "fanuc": NcDialect("X"),
    "siemens": NcDialect("F", metric="G710", comment=("; ", ""), frame=(), any_turn="{axis}=DC({position})"),
}
"""Controls by name.

Siemens programs use its own language: SINUMERIK ONE, NC programming (12/2019), special characters, G700/G710, G4, DC.
"""
_DIGITS, _TURN = 4, 360.0


@dataclass(frozen=True)
class Rapid:
    """Move axes in rapid traverse (G0); if several axes move, the path between start and end is not defined."""

    to: Mapping[str, float]
    """Position by axis [mm, deg]"""
    any_turn: str = ""
    """Letters of the axes that take any turn, of moves by less than half a turn"""


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


@dataclass(frozen=True)
class Remark:
    """A comment between blocks."""

    text: str


Block = Rapid | Feed | Dwell | Stop | Remark


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
        case Rapid(to, any_turn):
            return [f"G0 {_position(to, any_turn, control.any_turn)}"]
        case Feed(to, speed):
            feed = f"{find_unit('mm/min', 'speed').outside(speed):.{_DIGITS}f}".rstrip("0").rstrip(".")
            return [f"G1 {_position(to)} F{feed}"]
        case Dwell(time):
            return [f"G4 {control.dwell}{time:.3f}"]
        case Stop(message):
            return [_comment(message, control), "M0"]
        case Remark(text):
            return [_comment(text, control)]


def _position(to: Mapping[str, float], any_turn: str = "", word: str = "") -> str:
    return " ".join(_word(axis.upper(), value, word if axis.upper() in any_turn else "") for axis, value in to.items())


def _word(axis: str, value: float, word: str) -> str:
    """Return the word of a position; with a `word` for axes that take any turn within 0 to 360 deg."""
    if not word:
        return f"{axis}{written(value):.{_DIGITS}f}"
    return word.format(axis=axis, position=f"{written(value) % _TURN:.{_DIGITS}f}")


def _comment(text: str, control: NcDialect) -> str:
    """Return a comment in ASCII, since controls read nothing else; parentheses in it become brackets."""
    plain = text.translate({ord("("): "[", ord(")"): "]"}).encode("ascii", "replace").decode()
    begin, end = control.comment
    return f"{begin}{' '.join(plain.split())}{end}"
