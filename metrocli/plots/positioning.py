"""Positioning of the axes by ISO 230-2: mean deviations in both directions with their spread."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.plots.style import Canvas
from metrocli.result import Result

_ROTARY = "ABC"
_IN_UNIT = {False: 1e3, True: np.degrees(3600.0)}
"""um in mm, or arcsec in rad, by whether the axis is rotary"""
_FIGURES = ("A", "R", "E", "B", "M")
_ONE_WAY = ("A_up", "R_up", "E_up", "A_down", "R_down", "E_down")


@dataclass(frozen=True)
class PositioningLine:
    """The runs of one line along an axis."""

    axis: str
    name: str
    position: Array
    """(n,) mm, or deg of a rotary axis"""
    up: Array
    down: Array
    """(n,) µm or arcsec: mean deviation in each direction"""
    s_up: Array
    s_down: Array
    """(n,) µm or arcsec: standard deviation; nan with one run"""
    figures: tuple[tuple[str, float], ...]
    """A, R, E, B, M in µm or arcsec, nan where a direction has one run; those of one direction if there is no other"""

    @property
    def units(self) -> tuple[str, str]:
        """Units of position and deviation."""
        return ("deg", "arcsec") if self.axis in _ROTARY else ("mm", "µm")


def data(result: Result, about: str) -> tuple[PositioningLine, ...] | None:
    """Return the lines with their figures."""
    table, targets = result.tables.get("positioning"), result.tables.get("positioning_targets")
    if table is None or targets is None or not len(table):
        return None
    names = [np.array(targets.texts(key)) for key in ("axis", "at", "line")]
    lines = []
    for row in range(len(table)):
        key = [table.texts(name)[row] for name in ("axis", "at", "line")]
        own = np.logical_and.reduce([column == value for column, value in zip(names, key, strict=True)])
        turns = key[0] in _ROTARY
        size = _IN_UNIT[turns]
        position = np.degrees(targets.numbers("angle")) if turns else targets.numbers("position")
        up, down, s_up, s_down = (targets.numbers(name)[own] * size for name in ("up", "down", "s_up", "s_down"))
        both = np.isfinite(up).all() and np.isfinite(down).all()
        letters = _FIGURES if both else _ONE_WAY
        figures = tuple((letter, float(table.numbers(letter)[row]) * size) for letter in letters)
        name = ", ".join(filter(None, key[1:]))
        lines.append(PositioningLine(key[0], name, position[own], up, down, s_up, s_down, figures))
    return tuple(lines) or None


def height(lines: tuple[PositioningLine, ...]) -> float:
    """Return the height of the figure in inches."""
    return 2.1 * len(lines) + 0.4


def draw(canvas: Canvas, lines: tuple[PositioningLine, ...]) -> str:
    """Draw the figure and return its caption."""
    theme = canvas.theme
    for axes, line in zip(canvas.axes(len(lines), 1), lines, strict=True):
        sides = (("up ↑", line.up, line.s_up, theme.first, "o"), ("down ↓", line.down, line.s_down, theme.second, "s"))
        for name, mean, spread, colour, marker in sides:
            if not np.isfinite(mean).any():
                continue
            axes.plot(line.position, mean, marker=marker, ms=3.5, color=colour, label=f"mean {name}")
            if np.isfinite(spread).all():
                axes.fill_between(line.position, mean - 2 * spread, mean + 2 * spread, color=colour, alpha=0.18, lw=0)
        axes.axhline(0, color=theme.muted, lw=0.6)
        of_position, unit = line.units
        axes.set_xlabel(f"{line.axis} ({of_position})")
        axes.set_ylabel(f"deviation ({unit})")
        numbers = ", ".join(f"{letter} {value:.3g}" for letter, value in line.figures if np.isfinite(value))
        axes.set_title(f"{line.axis}, {line.name}: {numbers} {unit}", fontsize=8.5)
        axes.legend(loc="best", ncols=2)
    return (
        "Bands: mean ± 2 s of each direction. A: accuracy, R: repeatability, E: systematic deviation, each of both "
        "directions, B: reversal value, M: range of the mean deviation. A and R need several runs in each direction."
    )
