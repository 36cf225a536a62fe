"""An effect: a physical cause that a model can leave out, described as one entry of a table."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np

from metrocli import units
from metrocli.adjust.model.blocks import Space
from metrocli.adjust.model.chain import Link
from metrocli.arrays import Array
from metrocli.expressions.written import OfUnit
from metrocli.frozen import dataclass
from metrocli.settings import Number, Spec, Text, WithUnit
from metrocli.units import parse_quantity
from metrocli.words import in_a_row

_NUMBER = re.compile(r"(?<!\S)\d+(\.\d*)?(e[+-]?\d+)?(?!\S)")
"""A number among the words of usual sizes; the 1 of the unit 1/mm is not one"""
ELAPSED, WARMING = "elapsed", "warming"
"""Conditions that effects vary with: time since the earliest reading [s], and temperature minus that of it [K]"""
DRIVERS = {"t": ELAPSED, "T": WARMING}
"""Allowed values of the key `by`, and the condition that each stands for"""
_FORMS = {"t": "by time", "T": "by temperature"}
COLUMN = {"t": "t_s", "temp": "temp_degC", "distance": "distance_mm"} | {
    name: text
    for axis in "xyz"
    for name, text in (
        (f"speed_{axis}", "t_s in the track of a path"),
        (f"since_{axis}", f"from_{axis} that agrees with the order of the readings"),
    )
}
"""Column of the file that holds a condition, for messages"""
READ_BY = {
    "list of {point}": "a list that gives it with a standard deviation above zero",
    "exact list of {point}": "a list that gives it with sigma 0",
    "heights of {point}": "height differences that read it",
    "station in order": "stations without times",
}
"""What a condition at a place needs that is not a column, for messages"""
MakeLink = Callable[[str, Mapping[str, str]], Link]
"""Builds the link of an effect from the name of its block and the place where it acts"""


Grid = Callable[[Mapping[str, Array]], Array]
"""Returns the values of a scanned parameter to try, from the conditions of the readings"""


def change_points(conditions: Mapping[str, Array]) -> Array:
    """Return the midpoints between successive times of reading: the times at which something may have changed."""
    times = np.unique(conditions["t"])
    return np.asarray((times[1:] + times[:-1]) / 2)


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect; at 0 the effect is absent."""

    name: str
    dimension: str = ""
    """One of `units.DIMENSIONS`; empty for a plain number"""
    plausible: float = 1.0
    """Largest size that can be believed, in the internal unit; a job that leaves it less certain is undetermined"""
    place: str = ""
    """For a scanned parameter that names a place, such as `view`, instead of a number: the kind of place"""
    grid: Grid | None = None
    """For a scanned parameter that is a number: the values that it may have, in ascending order"""
    whole: bool = False
    """Whether its grid holds all values that it can have, so that none in between is tried"""
    tried: int = 120
    """Number of grid values that `diagnose` tries first; it then refines between the best one and its neighbours"""
    base: str = ""
    """Its unit in base units, such as "mm s-2", if no dimension has it"""
    shown: str = ""
    """The unit of its definition where no dimension has it, such as um/kN; else empty"""
    given: float = 1.0
    """That unit in base units"""

    @property
    def spec(self) -> Spec:
        """How its value is read from a job file: as text, a quantity with unit, or a plain number."""
        if self.place:
            return Text()
        if self.base:
            return OfUnit(self.base)
        return WithUnit(self.dimension) if self.dimension else Number()

    @property
    def unit(self) -> str:
        """The internal unit."""
        return units.internal_unit(self.dimension) if self.dimension else self.base or "1"

    def readable(self, size: float) -> tuple[float, str]:
        """Return a size of it and the unit that suits it; that of its definition where no dimension has the unit."""
        return units.readable(size, self.dimension) if self.dimension else (size / self.given, self.shown or self.base)

    def sized(self, size: float) -> str:
        """Return a size of it to two digits, for sentences: "0.21 um"."""
        value, shown = (size, "") if self.dimension else self.readable(size)
        return f"{units.sized(value, self.dimension)} {shown}".strip()


def sizes(names: str, dimension: str, plausible: str) -> tuple[Parameter, ...]:
    """Return parameters, their names with blanks between them, of one plausible size given as a text."""
    return tuple(Parameter(name, dimension, parse_quantity(plausible, dimension)) for name in names.split())


@dataclass(frozen=True)
class Effect:
    """One entry of a table of effects.

    An effect is a link that takes and gives the same quantity (`link`), or columns of a block that the model has but
    does not estimate (`columns_of`). Several entries of one name are forms of one cause and differ in `by`.
    """

    name: str
    cause: str
    """The cause in one sentence, for reports"""
    parameters: tuple[Parameter, ...]
    link: MakeLink | None = None
    """Its block has one column for each parameter, then one for each scanned parameter"""
    columns_of: str = ""
    """Block of the model whose columns, named as the parameters, are set free"""
    beside: tuple[str, ...] = ()
    """Columns of that block without which they change nothing"""
    where: tuple[str, ...] = ()
    """Kinds of place that define where it acts: tracer, image, axis, ..."""
    by: str = ""
    """t or T if it varies with time or temperature, else empty"""
    scanned: tuple[Parameter, ...] = ()
    """Parameters that enter stepwise, such as the time of a jump: a job gives them, `diagnose` searches them"""
    space: Space = Space.FLAT
    """How a step of the adjustment changes its parameters"""
    needs: tuple[str, ...] = ()
    """Conditions that it needs: t, temp, ...; in `from_{axis}` the name of the axis replaces the braces"""
    among: tuple[str, ...] = ()
    """The names that its place can have, where a kind of place has others too, such as rotary axes; empty for all"""
    not_first: tuple[str, ...] = ()
    """Kinds of place whose first name is the reference for the others, so that the effect cannot act there"""
    confused_with: tuple[str, ...] = ()
    """Names of effects with a similar signature"""
    formula: str = ""
    """What it changes, in the symbols of docs/instruments; t and T count from the earliest reading"""
    note: str = ""
    """What else a reader of its page must know: what absorbs it, a remedy, the size of a common cause"""
    usual: str = ""
    """Sizes that the cause usually has, such as "0.1 to 5 ppm"; empty if none are known"""
    reveal: str = ""
    """What to measure to detect it, or to separate it from the effects in `confused_with`"""
    source: str = ""
    """Paper, standard or practice that describes it"""
    limited: bool = False
    """Whether `diagnose` tries it only where it sees sizes up to the plausible, not up to those that can be adjusted"""
    selects: bool = False
    """Whether its link finds the readings of its place itself, because a reading concerns several places of the kind"""
    turns: bool = False
    """Whether its parameters form a vector that turns with the frame of a free network"""
    of_one_reading: bool = False
    """Whether it spoils a single reading; `diagnose` finds such an effect as an outlier"""
    of_all: str = ""
    """The cause where it acts at all places of its kind, with sizes that scatter about 0; empty if none is usual"""
    throughout: bool = False
    """Whether `diagnose` seeks it at all places at once only: at one of them it is a wrong reading"""
    noise: str = ""
    """Key under `noise:` of a job that declares the standard deviation of its sizes at all places; empty if none"""
    definition: str = ""
    """For a user-defined effect: its definition, one line of YAML"""
    lacks: str = ""
    """Why it may not act: what the data of a user-defined effect lack, such as "needs a column load"; else empty"""

    @property
    def keys(self) -> tuple[str, ...]:
        """Kinds of place that a job names for it: all of `where` but `by`."""
        return tuple(key for key in self.where if key != "by")

    @property
    def form(self) -> str:
        """The cause with its form where it has several: "spindle-growth by time"."""
        return f"{self.name} {_FORMS[self.by]}" if self.by else self.name

    @property
    def remedy(self) -> str:
        """What to do, for messages, where readings lack a column that it needs, or the model one."""
        if self.beside:
            return "leave it out"
        simulated = "; a simulation that chooses its own readings, not those of a file, has no further columns"
        return f"measure it with each reading{simulated if self.definition else ''}"

    @property
    def is_step(self) -> bool:
        """Whether it acts on the readings from a scanned time on."""
        return len(self.scanned) == 1 and self.scanned[0].grid is change_points

    @property
    def is_smooth(self) -> bool:
        """Whether its parameters scatter about 0 themselves, as those of the shape of a lens do."""
        return self.throughout and not self.keys

    @property
    def everywhere(self) -> str:
        """Where it acts at all its places, for messages: "at every image"."""
        return "throughout" if self.is_smooth else f"at every {self.keys[0]}"

    @property
    def common(self) -> Parameter | None:
        """The standard deviation of its parameters if it can act at all places of one kind at once, else None.

        Each place then has sizes of its own that scatter about 0: all targets of a printed list are off, or all poses.
        Without a kind of place, its parameters do: those of the shape of a lens.
        """
        first = self.parameters[0]
        alike = all(p.dimension == first.dimension for p in self.parameters)
        apart = self.selects or self.scanned or self.of_one_reading or self.turns
        if self.link is None or not (len(self.keys) == 1 or self.is_smooth) or apart or not alike:
            return None
        return Parameter("std", first.dimension, first.plausible)

    def acts_at(self, where: Mapping[str, str]) -> bool:
        """Return whether a place is among those that it can have."""
        return not self.among or all(where[key] in self.among for key in self.keys)

    def needed(self, where: Mapping[str, str]) -> tuple[str, ...]:
        """Return the names of the conditions that it needs at a place."""
        return tuple(name.format(**where) for name in self.needs)

    def larger(self, factor: float) -> Effect:
        """Return the effect with usual and plausible sizes that are a factor larger."""
        if factor == 1:
            return self
        usual = _NUMBER.sub(lambda number: f"{float(f'{float(number[0]) * factor:.2g}'):g}", self.usual)
        parameters = tuple(replace(parameter, plausible=parameter.plausible * factor) for parameter in self.parameters)
        return replace(self, usual=usual, parameters=parameters)

    @cached_property
    def usual_sizes(self) -> tuple[float, float] | None:
        """Smallest and largest usual size in the internal unit of its first parameter, None if none are known."""
        if not self.usual:
            return None
        low, high = self.usual.split(" to ")
        unit = "" if " " in low else high.partition(" ")[2]
        least, most = (self._internal(text) for text in (f"{low} {unit}".strip(), high))
        return least, most

    def _internal(self, text: str) -> float:
        dimension = self.parameters[0].dimension
        return parse_quantity(text, dimension) if dimension and " " in text else float(text)

    @cached_property
    def plausible(self) -> float:
        """Largest usual size; without one the root mean square over the parameters of the dimension of the first."""
        if self.usual_sizes is not None:
            return self.usual_sizes[1]
        alike = [p.plausible for p in self.parameters if p.dimension == self.parameters[0].dimension]
        return float(np.sqrt(np.mean(np.square(alike))))

    @property
    def all_parameters(self) -> tuple[Parameter, ...]:
        """Its parameters, followed by its scanned parameters."""
        return (*self.parameters, *self.scanned)


def needed_in_words(conditions: Mapping[str, str]) -> str:
    """Return what a file or a job needs for conditions at a place, by the form of the name of each."""
    columns = in_a_row([COLUMN.get(name, name) for form, name in conditions.items() if form not in READ_BY])
    others = [READ_BY[form] for form in conditions if form in READ_BY]
    return " and ".join([*([f"a column {columns}"] if columns else []), *others])
