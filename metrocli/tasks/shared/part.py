"""Sizes at 20 degC (ISO 1), with the uncertainty that the temperature and the expansion of a body bring."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from metrocli import units
from metrocli.adjust.model.blocks import Array
from metrocli.settings import Known, Limits, Uncertain, setting

REFERENCE = 20.0
"""Temperature at which sizes are stated [degC]"""
_SOLIDS = Limits(-1e-3, 1e-3, "what solids expand by: write e.g. 11.5e-6 1/K")
"""Coefficients of expansion of solids [1/K]; soft polymers have up to 3e-4"""


@dataclass(frozen=True)
class Warm:
    """A body at the measurement; its sizes are given at 20 degC."""

    temperature: Known = setting(Uncertain("temperature"), "its temperature at the measurement")
    expansion: Known = setting(Uncertain("expansion", _SOLIDS), "its coefficient of expansion")

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


@dataclass(frozen=True)
class Part(Warm):
    """The part at the measurement: its points are given at 20 degC."""

    @property
    def note(self) -> str:
        """What was done, in a sentence."""
        size = units.sized(self.growth, "ratio")
        return f"points are given at 20 degC: the part had grown by {size} ± {units.sized(self.std, 'ratio')}"

    def of_points(self, places: Array, covariance: Array) -> tuple[Array, Array]:
        """Return points (n, 3) and their covariances (n, 3, 3) at 20 degC.

        The origin of the frame stays: `x / (1 + g)` with the covariance `C / (1 + g)^2 + u(g)^2 x x'`.
        """
        at = places * self.shrinkage
        return at, covariance * self.shrinkage**2 + self.std**2 * at[:, :, None] * at[:, None]

    def of_factors(self, at: Array, common: Array, core: Array) -> tuple[Array, Array]:
        """Return the factors C (n, 3, k) and K (k, k) of the covariance of two points, with the growth that they share.

        at (n, 3) are the points at 20 degC.
        """
        k = len(core)
        wider = np.zeros((k + 1, k + 1))
        wider[:k, :k], wider[k, k] = core, self.std**2
        return np.concatenate([common * self.shrinkage, at[:, :, None]], axis=2), wider
