"""One input quantity of a job: its best estimate, distribution and degrees of freedom from its keys."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import numpy as np

from metrocli import units
from metrocli.errors import Fault
from metrocli.expressions.dimensions import Compound, compound, described
from metrocli.expressions.written import Measure
from metrocli.frozen import dataclass
from metrocli.settings import LocatedValue
from metrocli.table import Table
from metrocli.tasks.report_uncertainty.entries import InputEntry
from metrocli.uncertainty.distributions import (
    Arcsine,
    Counts,
    CurvilinearTrapezoid,
    Distribution,
    Exponential,
    Normal,
    Sampled,
    Trapezoidal,
    Uniform,
)
from metrocli.uncertainty.inputs import InputQuantity
from metrocli.words import suggestion

_OTHER_NAMES = {"rectangular": "uniform", "U": "arcsine", "poisson": "counts"}
_WIDTHS = {"uniform": math.sqrt(3), "triangular": math.sqrt(6), "arcsine": math.sqrt(2)}
"""Ratio of half-width to standard deviation"""
SHARES = ("percent", "ppm", "ppb")
"""Units of a width that is a share of its value"""


class _Wrong(Exception):
    """A fault of a quantity: the key, the message, and a hint what to write."""

    def __init__(self, key: str, message: str, hint: str) -> None:
        super().__init__(message)
        self.key = key
        self.message = message
        self.hint = hint


@dataclass(frozen=True)
class Dispersion:
    """A distribution with its degrees of freedom."""

    distribution: Distribution | None
    dof: float = math.inf


def unit_of(placed: LocatedValue) -> Compound | None:
    """Return the unit of a quantity from its value; None without one."""
    given = placed.value
    if isinstance(given, Measure):
        return given.unit
    best = given.value or given.mean
    return best.unit if best is not None else None


def quantity(name: str, placed: LocatedValue, table: Table | None, faults: list[Fault]) -> InputQuantity | None:
    """Return a quantity of a job, or None and append to `faults`; `table` holds its readings or samples."""
    given = placed.value
    if isinstance(given, Measure):
        return InputQuantity(name, given.value, None, math.inf, given.unit)
    try:
        return _from_table(name, given, table) if given.readings or given.samples else _written(name, given)
    except _Wrong as wrong:
        faults.append(placed.node.at(wrong.key).fault(f"{placed.node.path}: {wrong.message}", wrong.hint))
        return None


def _written(name: str, given: InputEntry) -> InputQuantity:
    if given.value is not None and given.mean is not None:
        raise _Wrong("mean", "value and mean are both given", "they are the same; give one")
    best = given.value or given.mean
    if best is None:
        raise _Wrong("", "there is no best estimate", "give value: ... (or mean, or readings)")
    if given.column is not None:
        raise _Wrong("column", "a column is named, but no readings or samples", "give readings: FILE.csv")
    spread = _spread(given, best)
    # q counted events give a gamma distribution with mean q + 1 (JCGM 101, 6.4.11)
    value = best.value + 1 if isinstance(spread.distribution, Counts) else best.value
    return InputQuantity(name, value, spread.distribution, spread.dof, best.unit)


def _spread(given: InputEntry, best: Measure) -> Dispersion:
    widths = [key for key in ("std", "half_width", "U") if getattr(given, key) is not None]
    if len(widths) > 1:
        raise _Wrong(widths[1], f"{' and '.join(widths)} are both given", "give one uncertainty only")
    if (given.U is None) != (given.k is None):
        raise _Wrong("U" if given.U else "k", "U needs its k, and k its U", "write e.g. {value: .., U: 30 nm, k: 2}")
    width = _width(getattr(given, widths[0]), best) if widths else None
    shape = _OTHER_NAMES.get(given.distribution or "", given.distribution or "")
    dof = math.inf if given.dof is None else given.dof
    if shape in ("exponential", "counts"):
        return Dispersion(_of_value_alone(shape, best, widths), dof)
    if width is None:
        if given.distribution or given.dof is not None or given.inexactness or given.beta is not None:
            raise _Wrong("", "there is no uncertainty", "give std or half_width")
        return Dispersion(None)
    std = width / given.k if given.k is not None else width
    distribution = _shaped(shape, given, std, best)
    if shape == "t" and given.dof is None:
        raise _Wrong("distribution", "a t distribution needs its degrees of freedom", "give dof")
    return Dispersion(distribution if std > 0 else None, dof)


def _of_value_alone(shape: str, best: Measure, widths: list[str]) -> Distribution:
    if widths:
        raise _Wrong(widths[0], f"the distribution {shape} follows from the value alone", f"leave {widths[0]} out")
    if shape == "exponential":
        if best.number <= 0:
            raise _Wrong("", "the mean of an exponential distribution is above zero", "give value: above 0")
        return Exponential(best.value)
    if best.unit.powers or best.number < 0 or best.number != int(best.number):
        raise _Wrong(
            "", "a count is a whole number, 0 or more, without a unit", "write e.g. {value: 25, distribution: counts}"
        )
    return Counts(int(best.number))


def _shaped(shape: str, given: InputEntry, width: float, best: Measure) -> Distribution:
    """Return the distribution of a shape, with a width that is a standard deviation or a half-width."""
    by_half_width = given.half_width is not None
    if shape == "sampled":
        raise _Wrong("distribution", "a sampled distribution needs its values", "give samples: FILE.csv")
    if shape in ("normal", "t") and by_half_width:
        raise _Wrong("half_width", f"a {shape} distribution has no half-width", "give std")
    if given.beta is not None and shape != "trapezoidal":
        raise _Wrong("beta", "beta belongs to the trapezoidal distribution", "leave it out")
    if given.inexactness is not None and shape not in ("curvilinear-trapezoid", ""):
        raise _Wrong("inexactness", "inexactness belongs to the curvilinear trapezoid", "leave it out")
    if shape in ("normal", "t") or (not shape and not by_half_width):
        return Normal(width)
    if shape == "curvilinear-trapezoid" or given.inexactness is not None:
        return _curvilinear(given, width, best)
    beta = given.beta
    if shape == "trapezoidal":
        if beta is None:
            raise _Wrong("distribution", "a trapezoid needs beta", "beta: its top as a share of its base, 0 to 1")
        return Trapezoidal(width if by_half_width else width * math.sqrt(6 / (1 + beta**2)), beta)
    half = width if by_half_width else width * _WIDTHS[shape or "uniform"]
    makes: dict[str, Callable[[float], Distribution]] = {"triangular": Trapezoidal, "arcsine": Arcsine}
    return makes.get(shape, Uniform)(half)


def _curvilinear(given: InputEntry, width: float, best: Measure) -> Distribution:
    if given.half_width is None or given.inexactness is None:
        raise _Wrong("distribution", "a curvilinear trapezoid needs half_width and inexactness", "give both")
    inexactness = _size(given.inexactness, best)
    if inexactness > width:
        raise _Wrong("inexactness", "the inexactness is larger than the half-width", "at most as large")
    return CurvilinearTrapezoid(width, inexactness) if inexactness else Uniform(width)


def _width(measure: Measure, best: Measure) -> float:
    """Return a width in base units; in a unit of shares (%, ppm) it is a share of the value."""
    share, own = (units.plain_symbol(item.unit.text) for item in (measure, best))
    if share not in SHARES or share == own:
        return _size(measure, best)
    key, text = _key(measure), measure.node.text
    if own in ("1", *SHARES):
        sizes = [f"{size / best.unit.factor:.6g}" for size in (measure.value * abs(best.value), measure.value)]
        hint = (
            f"write {sizes[0]} for a share of the value, {sizes[1]} for a difference from it, in the unit of the value"
        )
        raise _Wrong(key, f"'{text}' is ambiguous for a value that is a plain number", hint)
    if best.unit.point:
        raise _Wrong(key, f"'{text}' of a temperature in degC has no meaning", "write it in K")
    if best.value == 0:
        raise _Wrong(key, f"'{text}' of a value of 0 is not an uncertainty", f"write it in {best.unit.text}")
    return _not_negative(measure) * abs(best.value)


def _size(measure: Measure, best: Measure) -> float:
    """Return a width in base units; it must have the kind of unit of its quantity and not be negative."""
    if measure.unit.powers != best.unit.powers:
        message = f"{_key(measure)} is {described(measure.unit)}, the value {described(best.unit)}"
        hint = "write it without a unit" if best.unit.number else f"write it in {best.unit.text}"
        raise _Wrong(_key(measure), message, hint)
    return _not_negative(measure)


def _not_negative(measure: Measure) -> float:
    if measure.number < 0:
        raise _Wrong(_key(measure), f"{_key(measure)} is negative: {measure.node.text}", "0 or more")
    return measure.value


def _key(measure: Measure) -> str:
    return measure.node.path.rpartition(".")[2]


def _from_table(name: str, given: InputEntry, table: Table | None) -> InputQuantity:
    """Return the quantity of a table: readings by mean and its standard uncertainty (JCGM 100, 4.2), or samples."""
    sampled = given.samples is not None or given.distribution == "sampled"
    others = ("value", "mean", "std", "half_width", "U", "k", "dof", "inexactness", "beta")
    extra = [key for key in others if getattr(given, key) is not None]
    if extra or (given.readings and given.samples) or given.distribution not in (None, "sampled"):
        key = extra[0] if extra else "distribution" if given.distribution else "samples"
        raise _Wrong(key, f"readings or samples give the whole quantity; {key} is too much", f"leave {key} out")
    if table is None:
        raise _Wrong("readings", "the file of readings is missing", "give the path of a CSV")
    column = column_of(given, table)
    unit = _unit_of_column(column)
    values = table.numbers(column) * unit.factor
    if len(values) < 2:
        raise _Wrong("readings", "one reading gives no standard deviation", "give two readings or more")
    mean = float(values.mean())
    alike = np.ptp(values) == 0
    if alike and not sampled:
        best = f"{values[0] / unit.factor:.12g}" + ("" if unit.text == "1" else f" {unit.text}")
        raise _Wrong(
            "readings",
            f"all {len(values)} readings are {best}: they scatter less than the instrument resolves",
            f"give its resolution (JCGM 100, F.2.2.1): {{value: {best}, half_width: half of its step}}",
        )
    if sampled:
        deviations = tuple((values - mean).tolist())
        return InputQuantity(name, mean, None if alike else Sampled(deviations, table.file), math.inf, unit)
    std = float(values.std(ddof=1)) / math.sqrt(len(values))
    return InputQuantity(name, mean, Normal(std), float(len(values) - 1), unit)


def column_of(given: InputEntry, table: Table) -> str:
    """Return the column of a quantity: the one it names, or the only column of numbers."""
    numeric = [column for column in table if table.columns[column].dtype.kind == "f"]
    if given.column is None:
        if len(numeric) == 1:
            return numeric[0]
        raise _Wrong(
            "readings", f"{table.file} has {len(numeric)} columns of numbers", f"column: one of {', '.join(numeric)}"
        )
    if given.column not in table:
        raise _Wrong("column", f"{table.file} has no column '{given.column}'", suggestion(given.column, list(table)))
    if given.column not in numeric:
        raise _Wrong("column", _first_text(given.column, table), "numbers in every row, decimal point")
    return given.column


def _first_text(column: str, table: Table) -> str:
    cells = table.texts(column)
    row = next(n for n, cell in enumerate(cells) if not re.fullmatch(r"[+-]?[0-9.]+([eE][+-]?[0-9]+)?", cell))
    return f"{table.file}:{table.lines[row]}: '{cells[row]}' in the column '{column}' is not a number"


def _unit_of_column(column: str) -> Compound:
    """Return the unit at the end of a column's name; without one, the column holds plain numbers."""
    endings = {ending: unit.symbol for d in units.DIMENSIONS for ending, unit in units.suffixes(d).items()}
    matches = [ending for ending in endings if column.endswith(f"_{ending}")]
    return compound(endings[max(matches, key=len)] if matches else "1")
