"""Places where user-defined effects can act: the quantities of a kind's chains, with the variables known there."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from functools import partial

import numpy as np

from metrocli.adjust.model.chain import LinkContext, Step
from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array
from metrocli.effects.effect import ELAPSED, WARMING
from metrocli.expressions.dimensions import Compound, base_unit
from metrocli.frozen import dataclass

Evaluate = Callable[[Array, LinkContext], Step]
"""Returns a variable (1, n) at the quantity's value (in, n), with its derivatives as a link has them"""
NOMINAL = ("X", "Y", "Z")
"""Conditions: nominal coordinates of the point of a reading (`Model.nominal`)"""
ALONG = "along"
"""Component along the axis at which an effect acts"""


@dataclass(frozen=True)
class Variable:
    """A variable of an expression: what the chain or the file knows at a reading."""

    name: str
    unit: str
    """Its unit as a text of base units (mm, s, K, px), rad, or 1"""
    at: Evaluate
    blocks: tuple[str, ...] = ()
    """Blocks that it depends on"""
    needs: tuple[str, ...] = ()
    """Conditions without which a reading does not have it"""
    of_data: bool = False
    """Whether it is a further column of the data; a parameter of the same name comes before it"""
    heading_unit: str = ""
    """Unit of such a column in the heading, such as kN"""


OfPlace = Callable[[str], tuple[Variable, ...]]
"""Returns the variables that exist only at a place of one kind, such as the position along the axis x"""


@dataclass(frozen=True)
class Acting:
    """A quantity on which user-defined effects can act."""

    name: str
    """The value of `acts_on`, such as length or point-in-machine"""
    quantity: Quantity
    units: tuple[str, ...]
    """Unit of each component"""
    components: tuple[str, ...] = ("",)
    """Names of the components; one empty name for a scalar"""
    variables: tuple[Variable, ...] = ()
    where: tuple[str, ...] = ()
    """Kinds of place at which effects on it can have sizes of their own"""
    of_place: Mapping[str, OfPlace] = field(default_factory=dict)
    """For a kind of place, such as the axis: further variables there"""
    refused: Mapping[str, str] = field(default_factory=dict)
    """Names that columns of the data would have if their headings were others, each with what to write"""
    split: Mapping[str, Mapping[str, tuple[Quantity, int]]] = field(default_factory=dict)
    """For a kind of place, such as the encoder: the component of another quantity that stands for each of its names"""

    def variables_at(self, where: Mapping[str, str]) -> dict[str, Variable]:
        """Return the variables by name that expressions can use at a place (kind of place to name)."""
        variables = list(self.variables)
        for key, of_place in self.of_place.items():
            if key in where:
                variables += of_place(where[key])
        if any(key in where for key in self.split):
            variables[0] = component(self.name, self.units[0], self.at(where)[1])
        return {variable.name: variable for variable in variables}

    def all_units(self) -> dict[str, str]:
        """Return the unit of every variable by name, also of those that exist only at a place of some kind."""
        more = [variable for of_place in self.of_place.values() for variable in of_place("xy")]
        return {variable.name: variable.unit for variable in (*self.variables, *more)}

    def at(self, where: Mapping[str, str]) -> tuple[Quantity, int]:
        """Return the quantity on which an effect acts at a place, and its component if that is only one of several."""
        for key, names in self.split.items():
            if key in where:
                return names[where[key]]
        return self.quantity, 0

    def numbers(self, name: str, where: Mapping[str, str]) -> int:
        """Return the number of a component by its name, at a place."""
        if any(key in where for key in self.split):
            return self.at(where)[1]
        return self.components.index(where["axis"] if name == ALONG else name)

    def unit_of(self, name: str) -> str:
        """Return the unit of a component; that along an axis has the unit of the first one."""
        return self.units[0 if name == ALONG else self.components.index(name)]


def condition(name: str, unit: str, key: str, *needs: str) -> Variable:
    """Return a variable that is a condition of the readings, a constant of the adjustment."""

    def at(value: Array, local: LinkContext) -> Step:
        return Step(local.observations.conditions[key][None])

    return Variable(name, unit, at, needs=needs or (key,))


def measured(name: str, heading: str, unit: Compound) -> Variable:
    """Return a variable that is a column of the data, by its heading and its unit; its value is in base units."""

    def at(value: Array, local: LinkContext) -> Step:
        return Step(unit.factor * local.observations.conditions[heading][None])

    text = "K" if unit.point else unit.text
    return Variable(name, base_unit(unit.powers), at, needs=(heading,), of_data=True, heading_unit=text)


def component(name: str, unit: str, number: int) -> Variable:
    """Return the variable that is one component of the quantity itself."""

    def at(value: Array, local: LinkContext) -> Step:
        by_input = np.zeros((1, len(value), 1))
        by_input[0, number] = 1.0
        return Step(value[number : number + 1], by_input)

    return Variable(name, unit, at)


def components(names: Sequence[str], units: Sequence[str]) -> tuple[Variable, ...]:
    """Return all components of the quantity itself as variables."""
    return tuple(component(name, unit, number) for number, (name, unit) in enumerate(zip(names, units, strict=True)))


TIMED = (condition("t", "s", ELAPSED, "t"), condition("T", "K", WARMING, "temp"))
"""Time and temperature since the earliest reading"""
PLACE = tuple(condition(axis, "mm", axis) for axis in NOMINAL)
"""Nominal coordinates of the point of a reading"""


def commanded(axis: str) -> tuple[Variable, ...]:
    """Return the variables at an axis of a machine: its nominal position, and the direction from which it came."""
    approach = f"from_{axis}"
    return (condition("position", "mm", axis.upper(), "X"), condition("approach", "1", approach))


def of_pair(pair: str) -> tuple[Variable, ...]:
    """Return the variables at a pair of axes such as xy: the nominal positions of both."""
    return tuple(condition(name, "mm", axis.upper(), "X") for name, axis in zip(("first", "second"), pair, strict=True))


def _beam(start: str, value: Array, local: LinkContext) -> Array:
    """Return the vector (3, n) from the origin, or from the place in the first columns of a block."""
    return value - (local.rows(start)[:3] if start else 0.0)


def _polar(beam: Array, what: str) -> tuple[Array, Array]:
    """Return distance, azimuth or elevation of vectors (3, n), and its derivatives by them (3, n)."""
    x, y, z = beam
    level2 = np.maximum(x * x + y * y, 1e-300)
    level = np.sqrt(level2)
    if what == "azimuth":
        return np.arctan2(y, x), np.stack([-y / level2, x / level2, np.zeros_like(x)])
    square = level2 + z * z
    if what == "elevation":
        return np.arctan2(z, level), np.stack([-x * z / level, -y * z / level, level]) / square
    distance = np.sqrt(square)
    return distance, beam / distance


def _seen_from(start: str, what: str, value: Array, local: LinkContext) -> Step:
    polar, by_beam = _polar(_beam(start, value, local), what)
    by_block = {}
    if start:
        by_start = np.zeros((1, local.blocks[start].size, len(polar)))
        by_start[0, :3] = -by_beam
        by_block[start] = by_start
    return Step(polar[None], by_beam[None], by_block)


def seen_from(start: str = "", names: Sequence[str] = ("distance", "azimuth", "elevation")) -> tuple[Variable, ...]:
    """Return distance, azimuth and elevation of a point from the origin, or from the place of a block.

    The azimuth is `atan2(y, x)`, the elevation `atan2(z, sqrt(x^2 + y^2))`, both in the frame of the point.
    """
    units = {"distance": "mm", "azimuth": "rad", "elevation": "rad"}
    blocks = (start,) if start else ()
    return tuple(Variable(name, units[name], partial(_seen_from, start, name), blocks) for name in names)


def _along_beam(start: str, number: int, value: Array, local: LinkContext) -> Step:
    by_input = np.zeros((1, 3, 1))
    by_input[0, number] = 1.0
    by_start = np.zeros((1, local.blocks[start].size, 1))
    by_start[0, number] = -1.0
    return Step(_beam(start, value, local)[number : number + 1], by_input, {start: by_start})


def beam_from(start: str) -> tuple[Variable, ...]:
    """Return the components of the vector to a point from the place of a block."""
    return tuple(
        Variable(f"beam_{axis}", "mm", partial(_along_beam, start, number), (start,))
        for number, axis in enumerate("xyz")
    )


XYZ, MM = ("x", "y", "z"), ("mm",) * 3


def scalar(name: str, quantity: Quantity, unit: str, where: tuple[str, ...], *more: Variable) -> Acting:
    """Return a scalar as a place to act: itself, time, temperature, nominal coordinates, and more."""
    own = component(name, unit, 0)
    return Acting(name, quantity, (unit,), variables=(own, *TIMED, *PLACE, *more), where=where)


def point(name: str, quantity: Quantity, where: tuple[str, ...], *more: Variable) -> Acting:
    """Return a point as a place to act: its components, time, temperature, nominal coordinates, and more."""
    return Acting(name, quantity, MM, XYZ, (*components(XYZ, MM), *TIMED, *PLACE, *more), where)
