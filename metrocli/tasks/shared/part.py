"""Sizes at 20 degC (ISO 1), with the uncertainty that the temperature and the expansion of a body bring."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli import units
from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.result import Result
from metrocli.settings import KnownQuantity, QuantityLimits, Uncertain, setting
from metrocli.tasks.shared.uncontrolled import Hidden
from metrocli.uncertainty.predicted import PredictedPlaces

FIGURES = ("growth", "growth_std")
"""Statistics of a result whose points or targets are at 20 degC"""
REFERENCE = 20.0
"""Temperature at which sizes are stated [degC]"""
_SOLIDS = QuantityLimits(-1e-5, 1e-3, "what solids expand by: write e.g. 11.5e-6 1/K")
"""Coefficients of expansion of solids [1/K]: soft polymers have up to 3e-4, zirconium tungstate -9e-6"""


@dataclass(frozen=True)
class Warm:
    """A body at the measurement; its sizes are given at 20 degC."""

    temperature: KnownQuantity = setting(Uncertain("temperature"), "its temperature at the measurement")
    expansion: KnownQuantity = setting(Uncertain("expansion", _SOLIDS), "its coefficient of expansion")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a fault for an entry without a value."""
        for name, example in (("temperature", "22.1 degC"), ("expansion", "11.5e-6 1/K")):
            if np.isnan(getattr(self, name).value):
                yield name, f"the {name} has no value: write e.g. {{value: {example}, std: ...}}"

    @property
    def growth(self) -> float:
        """Relative growth from 20 degC to the temperature of the measurement, `alpha (T - 20)`."""
        return self.expansion.value * (self.temperature.value - REFERENCE)

    @property
    def std(self) -> float:
        """Standard uncertainty of the growth, that of a product of two independent quantities."""
        warm = self.temperature.value - REFERENCE
        parts = (warm * self.expansion.std, self.expansion.value * self.temperature.std)
        return float(np.linalg.norm([*parts, self.expansion.std * self.temperature.std]))

    @property
    def shrinkage(self) -> float:
        """Factor of sizes at the measurement that gives those at 20 degC, `1 / (1 + growth)`."""
        return 1 / (1 + self.growth)


def taken_as_exact(body: Warm | None, extent: float, what: str) -> Iterator[Hidden]:
    """Yield what the temperature of a body hides that a job gives without its standard uncertainty.

    extent is the error [mm] by a relative growth of 1, of `what`.
    """
    if body is not None and not body.std:
        growth = abs(body.expansion.value)
        yield Hidden(
            f"temperature of the part, stated without `std` ({what})",
            f"1 K of a part that grows by {units.sized(growth, 'ratio')}",
            growth * extent,
            "`part:` with the `std` of temperature and expansion",
        )


@dataclass(frozen=True)
class Part(Warm):
    """The part at the measurement: its points are given at 20 degC."""

    @property
    def note(self) -> str:
        """What was done, in a sentence."""
        return f"points are given at 20 degC: the part had grown by {self._size}"

    @property
    def note_of_listed(self) -> str:
        """The same for points that are listed at 20 degC and seen on the warm part."""
        return f"targets and points are listed at 20 degC: by its temperature the part has grown by {self._size}"

    @property
    def _size(self) -> str:
        return f"{units.sized(self.growth, 'ratio')} ± {units.sized(self.std, 'ratio')} (standard uncertainty)"

    @property
    def facts(self) -> dict[str, float]:
        """The growth and its standard uncertainty, for the statistics of a result."""
        return dict(zip(FIGURES, (self.growth, self.std), strict=True))

    def of_points(self, places: Array, covariance: Array) -> tuple[Array, Array]:
        """Return points (n, 3) and their covariances (n, 3, 3) at 20 degC.

        The origin of the frame stays: `x / (1 + g)` with the covariance `C / (1 + g)^2 + u(g)^2 x x'`.
        """
        at = places * self.shrinkage
        # growth is one number for all points, so that they share its error: `x x'` is its covariance
        return at, covariance * self.shrinkage**2 + self.std**2 * at[:, :, None] * at[:, None]

    def of_factors(self, at: Array, common: Array, core: Array) -> tuple[Array, Array]:
        """Return the factors C (n, 3, k) and K (k, k) of the covariance of two points, with the growth that they share.

        at (n, 3) are the points at 20 degC.
        """
        k = len(core)
        wider = np.zeros((k + 1, k + 1))
        wider[:k, :k], wider[k, k] = core, self.std**2
        return np.concatenate([common * self.shrinkage, at[:, :, None]], axis=2), wider

    def of_places(self, places: PredictedPlaces, about: Array) -> PredictedPlaces:
        """Return places at 20 degC, with the growth that they share; the point `about` (3,) stays."""
        at = (places.values - about) * self.shrinkage
        common, core = self.of_factors(at, places.common, places.core)
        return PredictedPlaces(at + about, common, core, places.own * self.shrinkage**2)


def growth_of(result: Result) -> dict[str, float]:
    """Return the growth that the points of a result, or its targets, are free of; empty if they are as measured.

    A result with corrected points has these at 20 degC, and leaves those of its network as measured.
    """
    if "corrected" in result.tables:
        return {}
    figures = {name: result.statistics.get(name) for name in FIGURES}
    return {name: value for name, value in figures.items() if isinstance(value, float)}
