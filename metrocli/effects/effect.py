"""What an effect is: a physical cause that a model can leave out, as one entry of a table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from metrocli import units
from metrocli.adjust.model.blocks import Array, Space
from metrocli.adjust.model.chain import Link
from metrocli.settings import Number, Quantity, Spec, Text

ELAPSED, WARMING = "elapsed", "warming"
"""Conditions that effects vary with: time since the earliest reading [s], and temperature minus its value there [K]"""
DRIVERS = {"t": ELAPSED, "T": WARMING}
"""What `by` may be, and the condition it stands for"""
COLUMN = {"t": "t_s", "temp": "temp_degC", "distance": "distance_mm"}
"""The column of a file that gives a condition which an effect needs"""
MakeLink = Callable[[str, Mapping[str, str]], Link]
"""Makes the link from the name of its block and the place where it acts"""


Grid = Callable[[Mapping[str, Array]], Array]
"""Gives the values to try from the conditions of the readings"""


def change_points(conditions: Mapping[str, Array]) -> Array:
    """Return the times between readings, at which something may have changed."""
    times = np.unique(conditions["t"])
    return np.asarray((times[1:] + times[:-1]) / 2)


@dataclass(frozen=True)
class Parameter:
    """A size of an effect; 0 means that there is none."""

    name: str
    dimension: str = ""
    """One of `units.DIMENSIONS`; a plain number without one"""
    plausible: float = 1.0
    """The largest size that such a cause usually has, in the internal unit"""
    place: str = ""
    """Of a scanned parameter: the kind of place it names instead of being a number, such as `view`"""
    grid: Grid | None = None
    """Of a scanned parameter that is a number: the values that it may have, in order"""
    tried: int = 120
    """How many of them `diagnose` tries at first; it then looks between the best and its neighbours"""

    @property
    def spec(self) -> Spec:
        """How it is read."""
        if self.place:
            return Text()
        return Quantity(self.dimension) if self.dimension else Number()

    @property
    def unit(self) -> str:
        """The internal unit."""
        return units.internal_unit(self.dimension) if self.dimension else "1"


@dataclass(frozen=True)
class Effect:
    """One entry of a table of effects.

    An effect is a link that takes and gives the same quantity (`link`), or columns of a block that the model has but
    does not estimate (`columns_of`). Several entries of one name are forms of one cause, told apart by `by`.
    """

    name: str
    cause: str
    """One sentence for people"""
    parameters: tuple[Parameter, ...]
    link: MakeLink | None = None
    """Its block has the parameters and then the scanned ones as columns"""
    columns_of: str = ""
    """The block whose columns of the parameters' names are freed"""
    where: tuple[str, ...] = ()
    """Kinds of place that say where it acts: tracer, image, axis, ..."""
    by: str = ""
    """t or T, where it varies with one of them"""
    scanned: tuple[Parameter, ...] = ()
    """Parameters that no derivative finds, such as the time of a jump: a job gives them, `diagnose` searches them"""
    space: Space = Space.FLAT
    """How its parameters change by a step of the adjustment"""
    needs: tuple[str, ...] = ()
    """Conditions without which it cannot be modelled: t, temp, ...; `from_{axis}` is another one at each place"""
    not_first: tuple[str, ...] = ()
    """Kinds of place whose first name is what the others are compared with, and therefore is none for this effect"""
    confused_with: tuple[str, ...] = ()
    reveal: str = ""
    """What to measure so that it is seen, or told from what it is confused with"""
    source: str = ""
    turns: bool = False
    """Its parameters are a vector that turns with the frame of a free network"""
    of_one_reading: bool = False
    """It spoils a single reading: an outlier, which `diagnose` finds as such"""

    @property
    def keys(self) -> tuple[str, ...]:
        """The kinds of place that an instance names."""
        return tuple(key for key in self.where if key != "by")

    def needed(self, where: Mapping[str, str]) -> tuple[str, ...]:
        """Return the conditions that it needs at a place."""
        return tuple(name.format(**where) for name in self.needs)

    @property
    def all_parameters(self) -> tuple[Parameter, ...]:
        """The parameters, then the scanned ones."""
        return (*self.parameters, *self.scanned)
