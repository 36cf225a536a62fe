"""The air of lengths: their correction to its refractive index, and the uncertainty that all of them share.

An interferometer counts wavelengths of the light in the air. It reads `n d / n_a` for the path d, with the index n of
the air and the index n_a that it assumes. A reading is the change of this since the station was set to zero. So
`l n_a / n_0 + l0 = (n / n_0) d`, n_0 the index at the first reading of the station and l0 its dead path.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from metrocli import units
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group, prior
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array
from metrocli.errors import InputError, all_faults
from metrocli.frozen import dataclass
from metrocli.instruments.air import CIDDOR, EDLEN, STANDARD_CARBON_DIOXIDE, Weather, index
from metrocli.instruments.tracer import AIR
from metrocli.result import SCALE, Estimate
from metrocli.settings import UNKNOWN, Choice, KnownQuantity, QuantityLimits, Section, Uncertain, WithUnit, setting
from metrocli.table import Table, columns
from metrocli.tasks.shared.weather import in_another_unit, remarks

WEATHER = columns("pressure? [pressure]", "humidity? [humidity]")
"""Columns of a reading's own weather, besides its temperature"""
_COLUMNS = {"temperature": "temp", "pressure": "pressure", "humidity": "humidity"}
_WORDS = {"temperature": "temperature", "pressure": "pressure", "humidity": "relative humidity"}
_HEADINGS = {"temperature": "temp_degC", "pressure": "pressure_hPa", "humidity": "humidity_percent"}
_HOLD = "where the equations of the air hold"
_LIMITS = {
    "temperature": QuantityLimits(-40.0, 100.0, f"-40 to 100 degC, {_HOLD}"),
    "pressure": QuantityLimits(100.0, 1400.0, f"100 to 1400 hPa, {_HOLD}"),
    "humidity": QuantityLimits(0.0, 100.0, f"0 to 100 percent, {_HOLD}"),
}
"""Weather for which the equations hold (Ciddor 1996; NIST, Index of Refraction of Air, VI)"""
_LIGHT = QuantityLimits(300e-6, 1700e-6, f"300 to 1700 nm, {_HOLD}")
_CARBON_DIOXIDE = QuantityLimits(0.0, 2000e-6, "0 to 2000 ppm: outdoor air has 420 ppm, a crowded room 2000 ppm")
_STEPS = {"temperature": 0.01, "pressure": 0.1, "humidity": 0.1}
"""Steps of the derivatives of the index"""
_ROUNDING = 1e-13
"""Relative difference of two indices that is rounding"""
_REACH = 1e-2
"""Plausible relative error of the index, as of a scale"""


def _of_air(spec: type[WithUnit] | type[Uncertain], name: str, default: object) -> Any:
    """Return the setting of the temperature, the pressure or the humidity of the air."""
    return setting(spec(name, limits=_LIMITS[name]), f"{_WORDS[name]} of the air", default=default)


@dataclass(frozen=True)
class Assumed:
    """The air that the instrument assumes."""

    temperature: float = _of_air(WithUnit, "temperature", 20.0)
    pressure: float = _of_air(WithUnit, "pressure", 1013.25)
    humidity: float = _of_air(WithUnit, "humidity", 50.0)


@dataclass(frozen=True)
class Environment:
    """The air through which lengths were read, and the air that the instrument assumed."""

    temperature: KnownQuantity = _of_air(Uncertain, "temperature", UNKNOWN)
    pressure: KnownQuantity = _of_air(Uncertain, "pressure", UNKNOWN)
    humidity: KnownQuantity = _of_air(Uncertain, "humidity", UNKNOWN)
    wavelength: KnownQuantity = setting(
        Uncertain("wavelength", _LIGHT), "vacuum wavelength of the laser", default=KnownQuantity(632.99e-6)
    )
    assumed: Assumed = setting(Section(Assumed), "the air that the instrument assumes", default=Assumed())
    correction: str = setting(Choice(CIDDOR, EDLEN), "equation of the refractive index", default=CIDDOR)
    carbon_dioxide: float = setting(
        WithUnit("ratio", limits=_CARBON_DIOXIDE),
        "carbon dioxide of the air, by volume",
        default=STANDARD_CARBON_DIOXIDE,
    )

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a fault for a wavelength without a value, and for carbon dioxide that the equation has no term for."""
        if np.isnan(self.wavelength.value):
            yield "wavelength", "the wavelength has no value: write e.g. {value: 632.99 nm, std: 0.1 pm}"
        if self.correction == EDLEN and self.carbon_dioxide != STANDARD_CARBON_DIOXIDE:
            yield "carbon_dioxide", "the equation of Edlén is for air with 450 ppm: use `correction: ciddor`"

    def index(self, weather: Weather) -> Array:
        """Return the refractive index of the air."""
        return index(self.correction, weather, self.wavelength.value, self.carbon_dioxide)

    @property
    def assumes(self) -> float:
        """The index that the instrument assumes."""
        air = self.assumed
        return float(self.index(Weather(air.temperature, air.pressure, air.humidity)))


@dataclass(frozen=True)
class Air:
    """The air at n lengths."""

    ratio: Array
    """Index at each reading over that at the first reading of its station, (n,)"""
    towards: Array
    """Factor of each reading: assumed index over that at the first reading of its station, (n,)"""
    std: float
    """Relative standard uncertainty that all lengths share"""
    mean: float
    """Mean index"""
    assumed: float

    @property
    def block(self) -> Block:
        """The block of the relative error of the index, which all lengths share."""
        free = np.array([[self.std > 0]])
        return Block(AIR, np.zeros((1, 1)), ("scale",), free=free, reach=np.array(_REACH), noun="air")

    @property
    def note(self) -> str:
        """What was corrected, in a sentence."""
        change = self.assumed / self.mean - 1
        if abs(change) < _ROUNDING:
            return f"the air is the one that the lengths assume: index {self.mean:.9f}"
        size = units.sized(change, "ratio")
        return f"lengths are corrected for the air by {size}: index {self.mean:.9f}, assumed {self.assumed:.9f}"


def priors_of(air: Air | None) -> list[Group]:
    """Return the prior of the error of the index; empty if the air is exact or not given."""
    if air is None or not air.std:
        return []
    return [prior(air.block, np.zeros(1, dtype=np.intp), np.array([[air.std]]))]


def estimates_of(solution: Solution) -> tuple[Estimate, ...]:
    """Return the factor of all lengths that the error of the index is, about 1; empty if it is not an unknown."""
    block = solution.blocks.get(AIR)
    if block is None or not block.free.any():
        return ()
    return (Estimate("air.scale", 1 + float(block.values[0, 0]), float(solution.std(AIR)[0, 0]), "1", SCALE),)


def blocks_of(solution: Solution) -> tuple[str, ...]:
    """Return the name of the block of these estimates."""
    return (AIR,) if estimates_of(solution) else ()


def air_of(environment: Environment | None, table: Table, by: str = "") -> Air | None:
    """Return the air at the rows of a table, a column before an entry of the job; None without `environment:`.

    `by` is the column of the stations; without it each reading is a distance, which has no dead path. Raises InputError
    for an entry that is given nowhere, and for each row for which the equations do not hold.
    """
    if environment is None:
        return None
    weather: dict[str, Array] = {}
    with all_faults() as each:
        for name in _COLUMNS:
            with each():
                weather[name] = _values(environment, table, name)
    refractive = np.broadcast_to(environment.index(Weather(**weather)), (len(table),))
    first = _first(table, by) if by else np.arange(len(table))
    zero = refractive[first]
    std = _relative(environment, {name: float(values.mean()) for name, values in weather.items()})
    assumed = environment.assumes
    return Air(refractive / zero, assumed / zero, std, float(refractive.mean()), assumed)


def unused(environment: Environment | None, table: Table) -> tuple[str, ...]:
    """Return warnings of weather in another unit, and of columns without `environment:` or entries beside a column.

    The standard uncertainty of such an entry is used.
    """
    if environment is not None:
        beside = (
            f"environment: the value of {name} is not used, since {table.file} has the column {_HEADINGS[name]}"
            for name, column in _COLUMNS.items()
            if column in table and not np.isnan(getattr(environment, name).value)
        )
        return (*beside, *remarks(table))
    columns = [_HEADINGS[name] for name in ("pressure", "humidity") if name in table]
    if not columns:
        return ()
    return (f"{table.file}: {' and '.join(columns)}: only used with `environment:`",)


def _values(environment: Environment, table: Table, name: str) -> Array:
    column, given = _COLUMNS[name], getattr(environment, name).value
    if column in table:
        values = table.numbers(column)
        limits = _LIMITS[name]
        wrong = np.flatnonzero((values < limits.low) | (values > limits.high))
        if wrong.size:
            text = f"is outside {limits.text}"
            faults = table.faults_at(
                wrong,
                lambda row: f"{name}: {values[row]:g} {text}",
                lambda row: in_another_unit(table, column, float(values[row])),
            )
            raise InputError(faults)
        return values
    if np.isnan(given):
        text = f"environment: the {name} of the air is missing"
        hint = f"give `environment: {{{name}: ...}}` in the job, or a column {_HEADINGS[name]} here"
        raise InputError([table.fault(text, hint)])
    # a table without rows has a mean of its weather all the same
    return np.full(max(len(table), 1), given)


def _first(table: Table, by: str) -> Array:
    """Return for each row the first reading of its station: the earliest, or the first in a file without times."""
    _, station = np.unique(np.asarray(table.columns[by]), return_inverse=True)
    order = np.argsort(table.numbers("t"), kind="stable") if "t" in table else np.arange(len(table))
    _, first = np.unique(station[order], return_index=True)
    # `order` leads from the order of time back to the rows of the file
    return np.asarray(order[first][station])


def _relative(environment: Environment, weather: dict[str, float]) -> float:
    """Return the relative standard uncertainty of lengths from that of the weather and of the wavelength."""
    light = environment.wavelength
    parts = [light.std / light.value]
    for name, step in _STEPS.items():
        # numerically: both equations are smooth, and their derivatives are long
        low, high = (float(environment.index(Weather(**{**weather, name: weather[name] + s}))) for s in (-step, step))
        parts.append((high - low) / (2 * step) * getattr(environment, name).std)
    return float(np.linalg.norm(parts))
