"""The noise that was found: its level relative to the declared one, and variance groups (a tracer, an image).

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Mask
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.evidence.parts import LARGEST
from metrocli.diagnosis.evidence.prices import PRIOR
from metrocli.diagnosis.linear.distributions import chi_interval
from metrocli.diagnosis.linear.projection import FEWEST, READING, Linearised
from metrocli.effects.variance_groups import readings_at
from metrocli.frozen import dataclass

if TYPE_CHECKING:
    from metrocli.diagnosis.evidence.state import State

AS_OTHERS = 1.4
"""Ratio of standard deviations below which a variance group counts as noisy as the others"""
DECLARED_SIGMA = "given"
"""Key of a variance group of prior values that the job states with a sigma, such as known points"""


@dataclass(frozen=True)
class NoiseRatio:
    """The noise of the readings relative to the declared one, with its 95 % interval."""

    ratio: float
    low: float
    high: float
    dof: float
    """Degrees of freedom from which it was found"""

    @property
    def as_declared(self) -> bool:
        """Whether its interval contains the declared noise."""
        return self.low <= 1 <= self.high

    @property
    def is_implausible(self) -> bool:
        """Whether it is surely more than ten times the declared noise: some readings, or a file, are wrong."""
        return self.low > float(np.exp(LARGEST / 2))


@dataclass(frozen=True)
class VarianceGroup:
    """A variance group: a part of the readings, or of the prior values, that has a noise of its own."""

    key: str
    """The kind of place, or `DECLARED_SIGMA`"""
    name: str
    ratio: float
    """Ratio of its standard deviation to that of the others"""


def noise_of(state: State) -> NoiseRatio:
    """Return the white noise that a state leaves, with its 95 % interval (chi-squared).

    With less than one degree of freedom nothing shows it: then the declared one counts, with its own.
    """
    shown = state.noise_freedoms >= 1
    dof = state.noise_freedoms if shown else PRIOR
    alone = shown and not state.random
    squares = float(state.residual @ state.residual) if alone else state.variance * dof
    low, high = chi_interval(squares, dof)
    return NoiseRatio(float(np.sqrt(squares / dof)), low, high, dof)


def variance_groups(job: AdjustedJob, system: Linearised) -> Iterator[tuple[str, str, Mask]]:
    """Yield kind, name and rows of all parts of a measurement that may have a noise of their own."""
    for key in (*job.units, *job.noisier):
        for name in job.model.places[key].names:
            rows = system.rows_at({key: name})
            if rows.any():
                yield key, name, rows
    # a single group has no other to be compared with
    for group in job.model.readings if job.model.readings[1:] else ():
        if group.observations.count >= FEWEST:
            yield READING, group.name, system.rows_of(group)
    for group in job.model.groups:
        if group.name not in job.model.measured and group.observations.readings.size >= FEWEST:
            yield DECLARED_SIGMA, group.name, system.rows_of(group)


def weights_of(job: AdjustedJob, units: Sequence[VarianceGroup]) -> Mapping[str, Array]:
    """Return factors on whitened readings of each group that bring the noise of some units to that of the others."""
    weights = {group.name: np.ones(group.observations.count) for group in job.model.groups}
    for unit in units:
        given = unit.key == DECLARED_SIGMA
        for group in job.model.groups if given else job.model.readings:
            at = readings_at(job.model, group, READING if given else unit.key, unit.name)
            weights[group.name][at] /= unit.ratio
    return weights
