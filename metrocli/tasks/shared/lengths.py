"""Lengths of tracking interferometers, as every kind of job takes them: their noise, the stops, and the scales."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Protocol, Self, TypeVar

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group, prior, prior_of_members
from metrocli.adjust.rounds import in_rounds
from metrocli.adjust.solution import Solution, residuals_of
from metrocli.arrays import Array, Index
from metrocli.effects.model import Model
from metrocli.errors import UndeterminedError
from metrocli.frozen import dataclass
from metrocli.instruments import tracer as t
from metrocli.settings import Choice, Either, WithUnit, setting
from metrocli.tasks.shared.noise import model_setting
from metrocli.units.people import format_quantity

ESTIMATED = "estimated"
REPEATABILITY = Either(WithUnit("length", minimum=0.0), Choice(ESTIMATED))
REPEATABILITY_WORDS = "standard deviation of each coordinate at a return to the same place; or estimated"
_SETTLED = 1e-3
"""An estimated repeatability has converged when a round changes it by less than this fraction"""
_LEAST = 0.02
"""Least repeatability that is estimated, as a share of the constant part of the noise"""


@dataclass(frozen=True)
class LengthNoise:
    """Standard deviation of a length, `sqrt(a^2 + b^2 (l + l0)^2)` (Härtig et al., weights of eq. 2)."""

    constant: float = setting(WithUnit("length", positive=True), "a: the part that does not depend on the length")
    proportional: float = setting(WithUnit("ratio", minimum=0.0), "b: the part proportional to the path", default=0.0)
    repeatability: float | str | None = setting(REPEATABILITY, REPEATABILITY_WORDS, default=None)
    model: str = model_setting()


@dataclass(frozen=True)
class Scale:
    """Prior knowledge of the tracers' scales."""

    uncertainty: float = setting(
        WithUnit("ratio", positive=True), "standard uncertainty of each tracer's scale about 1 (eq. 4), its own part"
    )
    common: float | None = setting(
        WithUnit("ratio", minimum=0.0),
        "standard uncertainty of the error that all scales share, as of one weather station; 0 without one",
        default=None,
    )


@dataclass(frozen=True)
class PathNoise:
    """Standard deviation of lengths, `sqrt(a^2 + b^2 (l + l0)^2 + r^2)` with the adjusted dead paths.

    r is the repeatability of the carrier's return, for lengths that are the only one of their stop. Lengths that share
    a stop share its deviation: it is an unknown of theirs, with the prior r (`stop_priors`).
    """

    constant: float
    proportional: float
    repeatability: float = 0.0
    std: float | None = None
    """Standard uncertainty of an estimated repeatability, inf before it is estimated; None if it is given"""

    @classmethod
    def of(cls, noise: LengthNoise) -> PathNoise:
        """Return the noise of the settings; an estimated repeatability starts at the constant part."""
        if noise.repeatability == ESTIMATED:
            return cls(noise.constant, noise.proportional, noise.constant, np.inf)
        return cls(noise.constant, noise.proportional, float(noise.repeatability or 0.0))

    @property
    def facts(self) -> dict[str, float]:
        """Statistics of the repeatability [mm]; none without it."""
        if not self.repeatability:
            return {}
        return {"repeatability": self.repeatability, **({} if self.std is None else {"repeatability_std": self.std})}

    @property
    def notes(self) -> tuple[str, ...]:
        """Return a sentence on an estimated repeatability."""
        if self.std is None:
            return ()
        if not np.isfinite(self.std):
            return ("the repeatability cannot be estimated: no stop has a length that the others control",)
        value = format_quantity(self.repeatability, "mm", self.std)
        what = "repeatability of the return to a place, each coordinate"
        return (f"{what}: {value} (standard uncertainty), estimated from the lengths",)

    def __call__(self, group: Group, blocks: Mapping[str, Block]) -> Array:
        """Return the standard deviations of a group of lengths, (1, n)."""
        observations = group.observations
        path = observations.readings[0] + blocks[t.TRACER].values[observations.index[t.TRACER], 3]
        returned = self.repeatability * observations.conditions.get(t.ALONE, np.zeros(1))
        return np.asarray(np.sqrt(self.constant**2 + (self.proportional * path) ** 2 + returned**2)[None])

    def at(self, group: Group, blocks: Mapping[str, Block]) -> Group:
        """Return a group of lengths with its standard deviations."""
        return group.with_observations(replace(group.observations, sigma=self(group, blocks)))

    def times(self, factor: float) -> PathNoise:
        """Return the noise with all its parts times a factor."""
        constant, proportional, returned = self.constant, self.proportional, self.repeatability
        return PathNoise(factor * constant, factor * proportional, factor * returned, self.std)

    def renewed(self, solution: Solution, name: str) -> PathNoise:
        """Return the noise with the repeatability after one step of Fisher scoring (restricted maximum likelihood).

        `name` is the group of the lengths. With v the residual, r_i the redundancy and s_i the standard deviation of
        each reading that contains it f_i times (variance groups), the step of the variance is
        `sum f^2 (v^2/s^4 - r_i/s^2) / sum(f^4 r_i/s^4)`. The deviations of stops count as readings of zero
        (Förstner 1979; Koch, Parameter Estimation, 1999, 3.6).
        """
        score, information = 0.0, 0.0
        for group in solution.groups:
            if group.name == name or group.chain.blocks == (t.STOP,):
                share = group.observations.conditions.get(t.ALONE, np.zeros(1)) if group.name == name else np.ones(1)
                residuals, ratios = residuals_of(solution, group), group.observations.ratios
                variance = residuals.sigma**2 / (1.0 if ratios is None else ratios**2)
                excess = residuals.values**2 / residuals.sigma**2 - residuals.redundancy
                score += float((share * excess / variance).sum())
                information += float((share * residuals.redundancy / variance**2).sum())
        if not information:
            return replace(self, std=np.inf)
        # not 0: the prior of the stops would divide by it
        least = (_LEAST * self.constant) ** 2
        value = float(np.sqrt(max(self.repeatability**2 + score / information, least)))
        # the standard uncertainty of the variance is sqrt(2 / information);
        # that of its root is this over twice the root
        return replace(self, repeatability=value, std=float(np.sqrt(2 / information) / (2 * value)))


class Noisy(Protocol):
    """An adjustment of lengths whose noise may have an unknown repeatability."""

    @property
    def noise(self) -> PathNoise | None:
        """Standard deviations of the lengths; None without lengths."""

    def with_noise(self, noise: PathNoise, blocks: Mapping[str, Block]) -> Self:
        """Return the adjustment at the values of `blocks` with another noise."""


P = TypeVar("P", bound=Noisy)


def with_repeatability(problem: P, adjusted: Callable[[P], Solution], name: str) -> tuple[P, Solution]:
    """Return the solution, and the problem with a repeatability that is estimated; `name` is the group of lengths.

    Raises UndeterminedError where only a repeatability as large as the residuals hides the unknowns.
    """
    before: list[Solution] = []

    def solve(problem: P) -> Solution:
        try:
            before.append(adjusted(problem))
        except UndeterminedError as error:
            if before and problem.noise is not None:
                raise _hidden_by(problem.noise, before[-1], name) from error
            raise
        return before[-1]

    def renewed(problem: P, solution: Solution) -> tuple[P, bool]:
        noise = problem.noise
        if noise is None or noise.std is None or not solution.outcome.good:
            return problem, False
        better = noise.renewed(solution, name)
        change = abs(better.repeatability - noise.repeatability)
        return problem.with_noise(better, solution.blocks), not change < _SETTLED * noise.repeatability

    return in_rounds(problem, solve, renewed)


def _hidden_by(noise: PathNoise, before: Solution, name: str) -> UndeterminedError:
    """Return the error of a model that does not fit, so that the repeatability grows until nothing is determined."""
    misfit = float(np.sqrt(before.cost / max(before.dof, 1)))
    group = before.group(name)
    worst = int(np.abs(group.residuals(before.blocks)[0]).argmax())
    of = " ".join(f"{key} {names[worst]}" for key, names in group.observations.keys.items())
    return UndeterminedError(
        f"the model does not fit the lengths: their residuals are {misfit:.0f} times the declared noise.\n"
        f"  With the repeatability of {noise.repeatability:.2g} mm that follows they do not determine the unknowns.\n"
        f"  The largest residual is that of {of}.\n"
        "  Check it, and the names, the units and the signs of the files and settings",
        misfit,
    )


def stops_of(point: Index, time: Array | None) -> Index:
    """Return the number of the stop of each length, from 1; 0 for a length that is the only one of its stop, (n,).

    Lengths to one point at one time belong to one stop. Without times each length has a stop of its own.
    """
    if time is None:
        return np.zeros(len(point), dtype=np.intp)
    _, stop, counts = np.unique(np.stack([point, time]), axis=1, return_inverse=True, return_counts=True)
    # numbered from 1 among stops of several lengths; 0 stays for the others
    number = np.where(counts > 1, np.cumsum(counts > 1), 0)
    return np.asarray(number[stop.ravel()], dtype=np.intp)


def shared_at_stops(own: Array, stops: Index, repeatability: float, rng: np.random.Generator) -> Array:
    """Return the deviations of the carrier, (n, 3): one draw for all lengths of a stop, `own` for others."""
    shared = rng.normal(0.0, repeatability, (int(stops.max(initial=0)) + 1, 3))[stops]
    return np.where((stops == 0)[:, None], own, shared)


def stop_priors(block: Block | None, repeatability: float) -> list[Group]:
    """Return the prior of the deviations of stops: zero with the repeatability in each coordinate."""
    if block is None:
        return []
    return [prior(block, np.arange(1, len(block.members)), np.full((len(block.members) - 1, 3), repeatability))]


def with_noise(model: Model, name: str, noise: PathNoise) -> Model:
    """Return a model whose group `name` of lengths, and whose prior of stops, have this noise at the model's values."""
    model = model.with_group(noise.at(model.group(name), model.blocks))
    for group in stop_priors(model.blocks.get(t.STOP), noise.repeatability):
        model = model.with_group(model.group(group.name).with_observations(group.observations))
    return model


def scale_priors(scale: Scale | None, block: Block) -> list[Group]:
    """Return the prior of the scales, with the covariance `u^2 I + c^2 1 1'` if they share an error c."""
    if scale is None:
        return []
    own, common, m = scale.uncertainty, scale.common, len(block.members)
    if common:
        return [prior_of_members(block, (4,), own**2 * np.eye(m) + common**2, np.arange(m))]
    return [prior(block, np.arange(m), np.full((m, 1), own), columns=(4,))]
