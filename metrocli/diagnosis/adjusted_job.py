"""What is diagnosed: an adjusted job, its readings' covariates, and the effects that could be in it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask
from metrocli.adjust.solution import Solution
from metrocli.effects.effect import Effect
from metrocli.effects.model import Model

PerReading = Mapping[str, Array]
"""By the name of a group of readings, values (n,) or (k, n)"""


@dataclass(frozen=True)
class Covariate:
    """Something that an unknown effect could vary with; smooth functions of it are tried."""

    name: str
    """As the file has it: t_s, temp_degC, or in words: beam direction"""
    values: PerReading
    """(n,), or (k, n) where it has several coordinates, such as a direction"""
    degree: int = 5
    """Of the polynomials that are tried, or the highest harmonic"""
    angle: bool = False
    """It comes round: harmonics of it are tried"""
    periodic: bool = False
    """Sines of it are tried, over a scan of periods"""
    together: bool = False
    """Its coordinates (k, n) are the terms themselves, of readings of all groups at once: an unknown that moves"""


@dataclass(frozen=True)
class Delivered:
    """What the job is run for: a block whose members are points or the like."""

    what: str
    """In words: point coordinates"""
    block: str
    columns: tuple[int, ...]
    unit: str
    """Unit for people, such as um"""
    dimension: str
    also: tuple[str, ...] = ()
    """More blocks of the same kind, with the same columns"""

    @property
    def blocks(self) -> tuple[str, ...]:
        """All blocks."""
        return (self.block, *self.also)


@dataclass(frozen=True)
class Standing:
    """An effect on a job's own block at a size that is not estimated, about which all is linear."""

    effect: Effect
    instance: tuple[str, ...]
    sizes: tuple[float, ...]
    """Of its parameters"""


@dataclass(frozen=True)
class AdjustedJob:
    """An adjusted job as diagnosis sees it."""

    kind: str
    model: Model
    """At its solution, with the weights it was given"""
    effects: tuple[Effect, ...]
    covariates: tuple[Covariate, ...]
    units: tuple[str, ...]
    """Kinds of place that may have a noise and smooth functions of their own: the tracers, the images"""
    folds: Mapping[str, Index]
    """For each group of readings the part (n,) that is held out together"""
    delivered: Delivered
    refit: Callable[[Model, Mapping[str, Mask]], Solution]
    """Adjusts a model made from this one to some of the readings of each group"""
    reading: tuple[str, str] = ("um", "length")
    """Unit and dimension in which held-out errors of readings are told"""
    replicates: Mapping[str, Index] = field(default_factory=dict)
    """For each group a number (n,) that readings have in common which were repeated under the same conditions"""
    astray: float = 0.0
    """How far places are from where the files say, over what is plausible; beyond 1 a file is wrong"""
    fewest: int = 3
    """Components of readings that an effect must touch; what touches fewer is an outlier"""
    single_components: bool = False
    """Whether the components of a reading (u, v) go wrong one by one"""
    declared: str = ""
    """The noise as the job declares it, in words"""
    adjusted: frozenset[tuple[str, tuple[str, ...]]] = frozenset()
    """Cause and place of effects with which its unknowns were adjusted"""
    standing: tuple[Standing, ...] = ()
    """Those of them that stand in its model at the size found; what is looked for is in the residuals without them"""
    patient: bool = False
    """Whether all is looked for at once, also beside large effects with which it was not adjusted"""
    not_sought: Mapping[str, str] = field(default_factory=dict)
    """Names of effects that these readings cannot be searched for, each with the reason"""
    offers: Callable[[Model], Iterable[tuple[str, Model]]] = field(default=lambda model: ())
    """What could be measured in addition, in words, with the model of that measurement"""
