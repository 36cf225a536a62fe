"""`noise: structured`: the uncertainties of a job whose readings share errors, by image, pose or time.

Method: docs/algorithms/cluster-robust-covariance.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Protocol, Self, TypeVar

import numpy as np

from metrocli.adjust.clusters.robust import FROM_RESIDUALS, STRUCTURED, Clusters, cluster_robust
from metrocli.adjust.rounds import in_rounds, variance_component
from metrocli.adjust.solution import Residuals, Solution
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.result import Scalar
from metrocli.settings import Choice, setting
from metrocli.tasks.shared.diagnosed import in_parts

NOISE_HELP = (
    "standard deviation of an image coordinate, or 'estimated' from the residuals, "
    "or 'structured': estimated, and readings of one image may share errors"
)
DECLARED = "declared"
POINTS_IN_TIME = "blocks of successive points"
_MOST_BLOCKS, _LEAST_IN_BLOCK = 6, 2
"""Measurements in time are cut into so many blocks at most, of so many points at least"""
_ROUNDS, _SETTLED = 6, 1e-3
"""Adjustments until the noise agrees with the residuals, and the relative change at which it does"""


class Scalable(Protocol):
    """A problem whose readings can have another noise."""

    def with_noise_times(self, factor: float) -> Self:
        """Return the problem with the standard deviations of its readings times a factor."""


class Read(Protocol):
    """A solved problem."""

    @property
    def read(self) -> Sequence[Residuals]:
        """The residuals of all readings, group by group."""


P = TypeVar("P", bound=Scalable)
S = TypeVar("S", bound=Read)


def model_setting() -> str:
    """Return the setting of what the declared parts of the noise are."""
    text = (
        "declared: the parts are the noise; estimated: they are it up to a factor from the residuals; "
        "structured: estimated, and readings taken together may share errors"
    )
    chosen: str = setting(Choice(DECLARED, *FROM_RESIDUALS), text, default=DECLARED)
    return chosen


def weighed(model: str, problem: P, solve: Callable[[P], S], kept: Callable[[P], S] | None = None) -> tuple[S, float]:
    """Return the solution of a problem, and how many times the declared noise its readings have; 1 if it is declared.

    `kept` solves it without outliers, where the noise is that of the readings left. Raises UndeterminedError without
    degrees of freedom.
    """
    if model == DECLARED:
        return solve(problem), 1.0

    def scaled(state: tuple[P, float], solved: S) -> tuple[tuple[P, float], bool]:
        change = variance_component(solved.read)
        if abs(change - 1) <= _SETTLED:
            return state, False
        return (state[0].with_noise_times(change), state[1] * change), True

    solves = kept or solve
    (weighted, factor), solved = in_rounds((problem, 1.0), lambda state: solves(state[0]), scaled, _ROUNDS)
    return (solved if kept is None else solve(weighted)), factor


def in_blocks(order: Array) -> Index:
    """Return the block (n,) of each of n measurements, of about equally many that follow each other."""
    # six: sixteen blocks gave intervals that hold 85 % of the truth, fewer leave too few degrees of freedom
    # (docs/algorithms/cluster-robust-covariance.md)
    count = min(_MOST_BLOCKS, max(len(order) // _LEAST_IN_BLOCK, 1))
    return in_parts(order, count)


def count(clusters: Index) -> int:
    """Return the number of clusters."""
    return len(np.unique(clusters))


class Robust(Protocol):
    """A covariance over clusters."""

    @property
    def clusters(self) -> int:
        """Number of clusters."""

    def inflation(self, names: Sequence[str]) -> float:
        """Return the root mean square growth of the standard uncertainties of blocks."""

    def dof(self, names: Sequence[str]) -> Array:
        """Return the degrees of freedom (k,) of the variances of the free entries of blocks."""


@dataclass(frozen=True)
class Structured:
    """How the readings of a job share errors, and what that changes."""

    robust: Robust
    delivered: tuple[str, ...]
    """Blocks of the result whose growth counts"""
    estimates: tuple[str, ...]
    """Blocks of the estimates"""
    over: str
    """What is left out in turn, in words: images"""

    @property
    def inflation(self) -> float:
        """Root mean square growth of the standard uncertainties of the result against independent errors."""
        return self.robust.inflation(self.delivered)

    @property
    def statistics(self) -> dict[str, Scalar]:
        """What /statistics has besides those of estimated noise."""
        return {
            "noise_model": f"cluster-robust over {self.over}",
            "clusters": self.robust.clusters,
            "inflation": self.inflation,
        }

    @cached_property
    def dof(self) -> float | None:
        """The least degrees of freedom of the estimates, which all have because their errors are joint."""
        dofs = self.robust.dof(self.estimates)
        return float(dofs.min()) if len(dofs) else None

    def details(self, names: Sequence[str]) -> dict[str, dict[str, float]]:
        """Return the degrees of freedom of the estimates."""
        return {} if self.dof is None else {name: {"dof": self.dof} for name in names}

    @property
    def note(self) -> str:
        """The line of the report."""
        dof = "" if self.dof is None else f", with {self.dof:.1f} degrees of freedom"
        return (
            f"noise: structured: readings taken together may share errors. The covariance is cluster-robust over "
            f"{self.robust.clusters} {self.over}; standard uncertainties are {self.inflation:.2f} times "
            f"those for white noise{dof}"
        )


@dataclass(frozen=True)
class JobNoise:
    """What the noise of a job is, and the solution whose covariance counts it."""

    solution: Solution
    model: str = DECLARED
    factor: float = 1.0
    """How many times the declared noise the readings have; 1 if it is declared"""
    structured: Structured | None = None

    def details(self, names: Sequence[str]) -> dict[str, dict[str, float]]:
        """Return the degrees of freedom of the estimates, where they are not those of the adjustment."""
        return self.structured.details(names) if self.structured is not None else {}


def job_noise(
    solved: tuple[Solution, float],
    model: str,
    clusters: Callable[[], Clusters],
    estimates: Sequence[str],
    delivered: Sequence[str] = (),
) -> JobNoise:
    """Return the noise of a solution and of the factor on what is declared, with what readings of one cluster share.

    `estimates` are the blocks of the estimates, `delivered` those of the result whose growth counts, if they are
    others. Raises as `cluster_robust` does.
    """
    solution, factor = solved
    if model != STRUCTURED:
        return JobNoise(solution, model, factor)
    chosen = clusters()
    robust = cluster_robust(solution, chosen)
    shared = Structured(robust, tuple(delivered or estimates), tuple(estimates), chosen.over)
    return JobNoise(robust.solution, model, factor, shared)
