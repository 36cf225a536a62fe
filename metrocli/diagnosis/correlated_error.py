"""A correlated error of the readings, as a diagnosis states it."""

from __future__ import annotations

from metrocli import units
from metrocli.diagnosis.linear.candidates import Candidate
from metrocli.frozen import dataclass

_MOSTLY = 0.5
"""Share of a standard deviation in the readings below which that is stated, too"""


@dataclass(frozen=True)
class CorrelatedError:
    """A random error of the readings that varies smoothly with a covariate."""

    covariate: str
    by: str
    """Key of the units in which it is independent (tracer, image); empty if it is common to all readings"""
    length: float
    """Length of its correlation, as a share of the largest range of the covariate in a unit"""
    std: float
    """Its standard deviation, in the unit of the readings that show most of it"""
    spread: float
    """Standard uncertainty of `std`"""
    visible: float
    """Share of `std` that the unknowns leave in the readings (root mean square)"""
    unit: str
    """Internal unit of these readings"""
    log_level: float
    """ln of the level against no such process, counted over the covariates that were tried"""
    gain: float
    """By how much it raises the log-likelihood, against readings that are all noisier by one factor"""
    place: str = ""
    """The unit that alone has it; empty for all"""
    instead_of: tuple[Candidate, ...] = ()
    """The effects that are named without it, and not beside it"""

    def is_in_unit_of(self, dimension: str) -> bool:
        """Return whether its readings are of a dimension, so that its squares are a share of the misfit of these."""
        return self.unit in ("", units.internal_unit(dimension))

    def shown(self, unit: str, dimension: str) -> tuple[float, float, str]:
        """Return its standard deviation, the standard uncertainty of that, and their unit: this one if it is theirs."""
        if self.is_in_unit_of(dimension):
            of_readings = units.find_unit(unit, dimension)
            return of_readings.outside(self.std), of_readings.outside(self.spread), of_readings.symbol
        size, symbol = units.column_unit(self.std, self.unit)
        return self.std / size, self.spread / size, symbol

    def sized(self, dimension: str) -> str:
        """Return its standard deviation for sentences: "37 mm", "13 px, of which the unknowns leave 0.1 px"."""
        own = self._in_its_unit(self.std, dimension)
        if self.visible > _MOSTLY:
            return own
        return f"{own}, of which the unknowns leave {self._in_its_unit(self.std * self.visible, dimension)}"

    def _in_its_unit(self, std: float, dimension: str) -> str:
        """Return a standard deviation in the unit that suits its size."""
        if self.is_in_unit_of(dimension):
            return units.sized(std, dimension)
        size, symbol = units.column_unit(std, self.unit)
        return f"{units.two_digits(std / size)} {symbol}"
