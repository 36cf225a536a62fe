"""A small interpreter of NC programs, for tests: it moves, notes what was done where, and refuses what it does not know."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
_WORD = re.compile(r"([A-Z])([+-]?[0-9]+(?:\.[0-9]*)?)")
_SETTINGS = {"G17", "G40", "G90", "G94"}
_PLAIN = {"linuxcnc": "P", "fanuc": "X"}
"""Controls with `%`, G21 and comments in parentheses, and their word of a dwell; the other one is Siemens"""


@dataclass
class Run:
    """What a program did."""

    at: Array
    rapids: list[tuple[Array, Array]] = field(default_factory=list)
    feeds: list[tuple[Array, Array, float]] = field(default_factory=list)
    """From, to, mm/min"""
    dwells: list[tuple[Array, float]] = field(default_factory=list)
    stops: int = 0
    ended: bool = False
    comments: list[str] = field(default_factory=list)


def run(text: str, start: Array, control: str = "linuxcnc") -> Run:
    """Carry out a program from a position."""
    done, settings, feed = Run(np.array(start, dtype=float)), set[str](), float("nan")
    lines, plain, dwell = text.splitlines(), control in _PLAIN, _PLAIN.get(control, "F")
    wanted = _SETTINGS | {"G21" if plain else "G710"}
    if plain:
        assert (lines.pop(0), lines.pop()) == ("%", "%")
    for line in lines:
        assert not done.ended, "something follows M30"
        assert line.isascii() and len(line) < 128
        if line.startswith(";") and not plain:
            done.comments.append(line[1:].strip())
            continue
        if line.startswith("(") and plain:
            assert line.endswith(")") and "(" not in line[1:] and ")" not in line[:-1]
            done.comments.append(line[1:-1])
            continue
        words = _WORD.findall(line)
        assert "".join(letter + number for letter, number in words) == line.replace(" ", ""), line
        code, rest = words[0][0] + words[0][1], {letter: float(number) for letter, number in words[1:]}
        if code in wanted:
            settings |= {letter + number for letter, number in words}
        elif code in ("G0", "G1"):
            assert settings == wanted, "moves before G17, millimetres, G40 G90 G94"
            target = done.at.copy()
            for i, axis in enumerate("XYZ"):
                target[i] = rest.get(axis, target[i])
            if code == "G0":
                assert set(rest) <= set("XYZ")
                done.rapids.append((done.at, target))
            else:
                feed = rest.get("F", feed)
                assert feed > 0, "no feed"
                done.feeds.append((done.at, target, feed))
            done.at = target
        elif code == "G4":
            done.dwells.append((done.at, rest[dwell]))
        elif code == "M0":
            done.stops += 1
        elif code == "M30":
            done.ended = True
        else:
            raise AssertionError(f"unknown word {code}")
    assert done.ended
    return done


def nearest(place: Array, a: Array, b: Array) -> float:
    """Distance of a place from a straight move, by 2,001 points of it."""
    share = np.linspace(0, 1, 2001)[:, None]
    return float(np.linalg.norm(a + share * (b - a) - place, axis=1).min())
