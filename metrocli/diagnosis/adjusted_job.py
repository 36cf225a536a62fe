"""What is diagnosed: an adjusted job, the covariates of its readings, and the effects that its model could lack."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import field
from typing import Any

import numpy as np

from metrocli.adjust.clusters.robust import ESTIMATED
from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Index, Mask, Observations
from metrocli.adjust.solution import Solution
from metrocli.effects.acting import Acting
from metrocli.effects.correlated import NAME as CORRELATED_ERROR
from metrocli.effects.covariates import Covariate
from metrocli.effects.effect import Effect
from metrocli.effects.model import Model
from metrocli.frozen import dataclass

ABSURD = 10.0
"""Median residual, in declared standard deviations, above which mistakes in the files are tried"""
BETTER = 10.0
"""How many times closer to the plausible a job must be after a correction"""


@dataclass(frozen=True)
class Delivered:
    """The result for which the job is run: a block whose members are points or the like."""

    what: str
    """In words, e.g. point coordinates"""
    block: str
    columns: tuple[int, ...]
    unit: str
    """Unit in which it is shown, such as um"""
    dimension: str
    also: tuple[str, ...] = ()
    """Further blocks of the same kind, with the same columns"""
    reported: Mapping[str, Array] = field(default_factory=dict)
    """Matrices (columns, members, members) by which values of a block become those that are reported, if others are"""
    moved: Callable[[Effect, Mapping[str, str]], Array | None] = lambda effect, where: None
    """Move of what is measured itself (all members, columns, parameters) by a unit effect; not an error of it"""

    @property
    def blocks(self) -> tuple[str, ...]:
        """Names of all its blocks."""
        return (self.block, *self.also)

    def of(self, values: Callable[[str], Array]) -> Array:
        """Return what is reported (all members, columns, ...) of the values (members, columns, ...) of each block."""
        return np.concatenate([self._reported(name, values(name)) for name in self.blocks])

    def _reported(self, name: str, values: Array) -> Array:
        """Return what is reported of the values of a block, `sum_n R_cmn v_nc`."""
        if name not in self.reported:
            return values
        return np.asarray(np.einsum("cmn,nc...->mc...", self.reported[name], values))


@dataclass(frozen=True)
class Standing:
    """An effect on one of the job's own blocks that is in the model at a fixed size, about which all is linearised."""

    effect: Effect
    instance: tuple[str, ...]
    sizes: tuple[float, ...]
    """Values of its parameters"""


@dataclass(frozen=True)
class MemberSubset:
    """The local members whose readings are diagnosed, where all would take more memory than there is."""

    kind: str
    """What they are: point, image"""
    count: int
    of: int
    """How many have readings"""

    def __str__(self) -> str:
        return f"{self.count} of {self.of} {self.kind}s"


class Budget:
    """CPU time of a search in the thread that made it: when it is spent, the search ends with what it has found."""

    def __init__(self, seconds: float = math.inf) -> None:
        self.seconds = seconds
        self.ended = False
        """Whether a search ended because of it"""
        self.interrupted = False
        """Whether somebody ended the search"""
        self._start = time.thread_time()

    def interrupt(self) -> None:
        """End the search with what it has found."""
        self.interrupted = True

    def spent(self) -> bool:
        """Return whether the time is spent or the search interrupted; `ended` remembers the former."""
        if self.interrupted:
            return True
        self.ended = self.ended or self.left() <= 0
        return self.ended

    def left(self) -> float:
        """Return what is left [s]."""
        return self.seconds - (time.thread_time() - self._start)


Ordered = Callable[[Callable[[int], Any], Iterable[int]], Iterable[Any]]
"""Applies a function to numbers, as `map` does, perhaps on other processors; results have the order of the numbers."""


REPORTED = {"mm": ("um", "length"), "rad": ("urad", "angle"), "px": ("px", "pixel")}
"""Unit and dimension in which errors of readings are reported, by their internal unit"""


@dataclass(frozen=True)
class AdjustedJob:
    """An adjusted job, as diagnosis uses it."""

    kind: str
    model: Model
    """The model at its solution, with the weights that the job was given"""
    effects: tuple[Effect, ...]
    covariates: tuple[Covariate, ...]
    units: tuple[str, ...]
    """Kinds of place that may have their own noise and their own smooth functions: the tracers, the images"""
    folds: Mapping[str, Index]
    """For each group of readings the number of the part (n,) in which it is held out for cross-validation"""
    delivered: Delivered
    refit: Callable[[Model, Mapping[str, Mask]], Solution]
    """Adjusts a model derived from this one to some of the readings of each group"""
    noisier: tuple[str, ...] = ()
    """Further kinds of place that may have their own noise: the lines"""
    list_offset: float = 0.0
    """Distance of places from where the files list them, relative to what is plausible; above 1 a file is wrong"""
    left_out: int = 0
    """Number of readings that its adjustment left out as outliers"""
    outliers: str = ""
    """Whether the job reports outliers or removes those which its diagnosis has; "" where it can do neither"""
    fewest: int = 3
    """Fewest components of readings that an effect must change; what changes fewer is an outlier"""
    single_components: bool = False
    """Whether the components of a reading (u, v) are tested as outliers one by one"""
    certified: frozenset[str] = frozenset()
    """Groups of which a wrong reading is a cause of its own, such as the certificate of a bar, and no outlier"""
    places: tuple[Acting, ...] = ()
    """Quantities on which a law can act"""
    declared: str = ""
    """The noise that the job declares, in words"""
    noise_model: str = ""
    """estimated or structured, if the size of the noise follows from the residuals"""
    model_key: str = "noise"
    """Key of the job under which these words stand: `model` beside declared parts"""
    adjusted: frozenset[tuple[str, tuple[str, ...]]] = frozenset()
    """Cause and place of the effects that were adjusted to reach the present values of its unknowns"""
    standing: tuple[Standing, ...] = ()
    """Those of them that are in its model at a fixed size; the search treats the residuals as if they were not"""
    sharing: int = 0
    """Number of parts (images) whose readings may share errors with `noise: structured`; 0 if the kind has no such"""
    states_correlated: bool = False
    """Whether a job of its kind can have correlated errors in its model"""
    not_sought: Mapping[str, str] = field(default_factory=dict)
    """Names of effects that cannot be searched for in these readings, each with the reason"""
    noticed: tuple[str, ...] = ()
    """What its kind warns of that no residual shows"""
    budget: Budget = field(default_factory=Budget)
    """CPU time for the search of effects"""
    made_together: tuple[str, ...] = ()
    """Keys that all readings of one exposure or pose share; empty if each reading is made on its own"""
    variations: Callable[[Model, Observations], Iterable[tuple[str, Observations]]] = field(
        default=lambda model, readings: ()
    )
    """How readings could be made again otherwise than before: in words, with their changed conditions"""
    offers: Callable[[Model], Iterable[tuple[str, Model]]] = field(default=lambda model: ())
    """Further measurements that the kind of job proposes: in words, with the model of that measurement"""
    part: MemberSubset | None = None
    """The part of a larger job that this is; None if it is whole"""

    @property
    def reading(self) -> tuple[str, str]:
        """Unit and dimension in which errors of readings are reported: those of the first component."""
        return REPORTED[self.model.readings[0].observations.unit_of_each[0]]

    @property
    def reach(self) -> float:
        """Median of the distances that were read [mm], nan without any."""
        groups = [group.observations for group in self.model.readings]
        read = [np.abs(group.readings[0]) for group in groups if group.unit_of_each == ("mm",)]
        return float(np.median(np.concatenate(read))) if read else math.nan

    @property
    def smooth_covariates(self) -> list[Covariate]:
        """The covariates with which errors of all readings may vary smoothly: each group of readings has them."""
        names = [group.name for group in self.model.readings]
        alone = (covariate for covariate in self.covariates if not covariate.together)
        return [covariate for covariate in alone if all(name in covariate.values for name in names)]

    @property
    def has_effects(self) -> bool:
        """Whether it requests effects beside correlated errors; the search has added those that stand."""
        return sum(added.effect.name != CORRELATED_ERROR for added in self.model.added) > len(self.standing)

    @property
    def declares_noise(self) -> bool:
        """Whether its whole noise is declared: no part of it follows the residuals."""
        return not self.noise_model and ESTIMATED not in self.declared


@dataclass(frozen=True)
class Misfit:
    """How far an adjusted job is from the plausible; above 1 it is absurd."""

    residuals: float
    """Median residual, relative to ten declared standard deviations"""
    places: float
    """Distance of places from where the files list them, relative to what is plausible"""
    spread: float = 0.0
    """Root mean square residual, in declared standard deviations"""
    left_out: int = 0
    """Readings left out as outliers"""
    reach: float = math.nan
    """Median of the distances that were read [mm]"""

    @property
    def worst(self) -> float:
        """The larger of residuals and places."""
        return max(self.residuals, self.places)

    def spoilt_alike(self, other: Misfit, shrinks: float) -> bool:
        """Whether a correction of the files only takes wrong readings out of the fit, so that the median falls.

        Lengths that get less weight beside angles do that. The root mean square does not fall with it.
        """
        return self.residuals >= 1 and other.spread * BETTER > self.spread * shrinks

    def ratio(self, other: Misfit, shrinks: float = 1.0) -> float:
        """Return how many times larger its square is than that of the job after a correction of its files.

        `shrinks` is the factor by which the correction makes residuals smaller, whatever is wrong.
        """
        # the same measure of both: where the residuals fit, the places are wrong, and the other files must mend these
        if self.residuals >= 1:
            before, after = self.residuals, other.residuals
        else:
            before, after = self.places, other.places
        return (before * shrinks / max(after, 1e-12)) ** 2


def misfit_of(job: AdjustedJob) -> Misfit:
    """Return how far the residuals and the places of an adjusted job are from the plausible."""
    whitened = [_whitened(group, job) for group in job.model.readings]
    # the median, and the worst group: some wrong readings make no file wrong, but one group in a wrong unit does
    medians = [float(np.median(np.abs(values))) for values in whitened]
    spreads = [float(np.sqrt(np.mean(values**2))) for values in whitened]
    return Misfit(
        max(medians, default=0.0) / ABSURD, job.list_offset, max(spreads, default=0.0), job.left_out, job.reach
    )


def _whitened(group: Group, job: AdjustedJob) -> np.typing.NDArray[np.float64]:
    return np.asarray(group.observations.whitened(group.residuals(job.model.blocks)))
