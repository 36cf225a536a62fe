"""A measurement as a plain function of its unknowns, adjusted by least squares with derivatives from differences."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
_STEP = 1e-6
_RANK = 1e-9
_ROUNDS = 3


@dataclass(frozen=True)
class Model:
    """Readings as a function of unknowns. Prior knowledge of unknowns is given as further readings."""

    predict: Callable[[Array], Array]
    """(k,) -> (n,)"""
    sigma: Array
    """(n,)"""
    truth: Array
    """Unknowns from which readings are simulated, (k,)"""
    quantities: Mapping[str, Callable[[Array], float]]
    """What is delivered, in the frame in which it is delivered"""
    rows: Mapping[tuple[str, ...], int]
    """Row of each reading by its names"""

    @cached_property
    def inverse(self) -> tuple[Array, Array]:
        """The whitened derivatives (n, k) and their pseudo-inverse (k, n)."""
        columns = []
        for i, value in enumerate(self.truth):
            step = np.zeros(len(self.truth))
            step[i] = _STEP * max(abs(value), 1.0)
            columns.append((self.predict(self.truth + step) - self.predict(self.truth - step)) / (2 * step[i]))
        jacobian = np.stack(columns, axis=1) / self.sigma[:, None]
        size = np.linalg.norm(jacobian, axis=0)
        u, s, v = np.linalg.svd(jacobian / size, full_matrices=False)
        kept = s > _RANK**0.5 * s[0]
        return jacobian, np.asarray((v[kept].T / s[kept]) @ u[:, kept].T / size[:, None])

    def in_units(self, factor: float) -> Model:
        """Return it with its quantities times a factor, such as 1000 for um."""
        scaled = {name: (lambda x, one=one: factor * one(x)) for name, one in self.quantities.items()}
        return replace(self, quantities=scaled)

    def adjusted(self, readings: Array) -> tuple[Array, Array]:
        """Return the unknowns and the whitened residuals, reading minus model, of readings."""
        _, inverse = self.inverse
        x = self.truth.copy()
        for _ in range(_ROUNDS):
            x = x + inverse @ ((readings - self.predict(x)) / self.sigma)
        return x, (readings - self.predict(x)) / self.sigma

    @cached_property
    def redundancy(self) -> Array:
        """Share of an error of each reading that its residual shows, (n,)."""
        jacobian, inverse = self.inverse
        return np.asarray(1 - np.einsum("nk,kn->n", jacobian, inverse))

    def read(self, rng: np.random.Generator, times: float = 1.0) -> Array:
        """Return simulated readings with noise of so many times the declared one."""
        return self.predict(self.truth) + times * self.sigma * rng.normal(size=len(self.sigma))
