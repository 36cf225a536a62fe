"""What a diagnosis finds: effects with their sizes and gains, outliers, remaining structure, and the verdict."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum

import numpy as np

from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.correlated_error import CorrelatedError
from metrocli.diagnosis.detectability import Detectability
from metrocli.diagnosis.evidence.gain import Gain
from metrocli.diagnosis.evidence.identified import IdentifiedEffect
from metrocli.diagnosis.evidence.prices import LITTLE
from metrocli.diagnosis.extended_fit import EffectSize
from metrocli.diagnosis.laws.law import Law
from metrocli.diagnosis.linear.projection import READING
from metrocli.diagnosis.noise import DECLARED_SIGMA, NoiseRatio, VarianceGroup
from metrocli.diagnosis.status import Conclusions
from metrocli.diagnosis.trials import Mistaken
from metrocli.diagnosis.wrong_readings import Outlier
from metrocli.effects.effect import Effect
from metrocli.frozen import dataclass


class Verdict(StrEnum):
    """The verdict of a diagnosis."""

    CLEAN = "clean"
    """The residuals are what the noise predicts"""
    EXPLAINED = "explained"
    """The named effects leave no structure"""
    INDISTINCT = "indistinct"
    """An effect is present, but others explain the readings as well"""
    UNEXPLAINED = "unexplained"
    """Structure remains that no known effect explains, or more noise than readings of that kind have"""
    MISTAKEN = "mistaken"
    """A file has a mistake; the rest of the diagnosis is for the corrected job"""
    NOT_DECIDED = "not-decided"
    """A quick diagnosis, which did not look for all that could be left"""


DEPENDS_ON, OF_EACH = "depends_on", "of_each"
"""Keys of what a correlated error varies with, and of the units in which it is independent"""
UNREACHED = "what the search did not reach"
"""What structure varies with if the search ended before it was looked at"""


@dataclass(frozen=True)
class RemainingStructure:
    """Structure that no known effect explains."""

    p_value: float
    depends_on: tuple[str, ...]
    where: tuple[str, ...] = ()
    """The units (tracers, images) whose readings show it; empty if all do"""
    size: float = 0.0
    """Its visible size: root mean square over those readings, in their unit"""
    share: float | None = None
    """Its share in the squares of held-out errors without the effects; None if none is identified, or if it shows in
    readings of another unit than these errors"""
    beside: float = 0.0
    """Share of errors that vary smoothly beside it, and that are left too"""
    declared: bool = False
    """Whether the noise that the job declares includes it"""
    unit: str = ""
    """Internal unit of these readings; empty for that of the report"""


@dataclass(frozen=True)
class Instead:
    """An effect at all its places, a larger noise of some readings, or a correlated error, that explains as well."""

    name: str
    """Of an effect at all its places, `noise`, or `correlated-error`"""
    where: Mapping[str, str]
    """The group of readings, or the place, that has its own noise; what an error depends on; empty for an effect"""
    odds: float
    """Ratio of its likelihood to that of what was found"""

    def __str__(self) -> str:
        if DECLARED_SIGMA in self.where:
            return f"the sigma of each {self.where[DECLARED_SIGMA].removeprefix('prior of ')}"
        if DEPENDS_ON in self.where:
            units = (f" of each {name}" if key == OF_EACH else f" of {key} {name}" for key, name in self.where.items())
            return f"an error that varies smoothly with {self.where[DEPENDS_ON]}{''.join(list(units)[1:])}"
        place = " ".join(name if key == READING else f"{key} {name}" for key, name in self.where.items())
        return f"{self.name} of {place}" if self.where else f"{self.name} everywhere"


@dataclass(frozen=True)
class RandomEffect:
    """An effect at all its places, with sizes that scatter about 0."""

    effect: Effect
    std: float
    """Standard deviation of its parameters, in their internal unit"""
    spread: float
    """Standard uncertainty of `std`"""
    log_level: float
    """ln of the significance level against no such scatter"""
    places: int
    """Number of its places that the readings show"""
    rivals: tuple[Instead, ...]
    gain: Gain
    shift: float
    """Largest change of the delivered result when it is taken into the model"""

    @property
    def times_usual(self) -> float | None:
        """`std` less twice its standard uncertainty, in the largest usual size; None if none is known."""
        return _times_usual(self.effect, self.std, self.spread)

    def __str__(self) -> str:
        return f"{self.effect.name} everywhere"


def _times_usual(effect: Effect, size: float, std: float) -> float | None:
    return None if effect.usual_sizes is None else max(float(size - 2 * std), 0.0) / effect.usual_sizes[1]


@dataclass(frozen=True)
class Unconfirmed:
    """An effect that the readings seem to require, but that held-out readings do not confirm."""

    name: str
    """Of the effect, with its place"""
    log_score: float
    size_level: float | None = None
    """Level at which its size differs from 0 beside what it changes without single units, if that speaks against it"""

    @property
    def against(self) -> str:
        """What speaks against it, in words."""
        if self.size_level is None:
            return f"log score {self.log_score:+.1f}{'' if self.log_score <= 0 else ', too little'}"
        return f"its size is within what it changes when parts of the readings are left out, p = {self.size_level:.2g}"


@dataclass(frozen=True)
class Finding:
    """One effect that was identified."""

    effect: IdentifiedEffect
    sizes: tuple[EffectSize, ...]
    gain: Gain
    shift: float
    """Largest change of the delivered result by it"""
    other_shape_from: float
    """Relative difference in shape from which another cause would have been detected beside it (80 % power)"""
    errors: tuple[Instead, ...] = ()
    """Larger noise of the readings at its place (image), or a correlated error, that explains them as well"""

    @property
    def confirmed(self) -> bool:
        """Whether held-out readings confirm it; what they do not is in no extended job."""
        return self.gain.log_score > 0

    @property
    def times_usual(self) -> float | None:
        """Its size less twice its standard uncertainty, in the largest usual size; None if none is known."""
        effect = self.effect.alternative.effect
        first = effect.parameters[0].dimension
        # neither values that were scanned nor those that are not determined, which have no standard uncertainty
        known = (
            (size.value, size.std) for size in self.sizes if size.std is not None and size.parameter.dimension == first
        )
        return _times_usual(effect, *np.linalg.norm(np.reshape([*known], (-1, 2)), axis=0))

    def __str__(self) -> str:
        return str(self.effect.alternative)

    @property
    def instead(self) -> tuple[str, ...]:
        """What explains the readings as well, in words."""
        # effects that explain them together only are listed once
        together = {
            frozenset(map(str, (rival.alternative, *rival.beside))): str(rival)
            for rival in reversed(self.effect.rivals)
        }
        return (*reversed(together.values()), *map(str, self.errors))


@dataclass(frozen=True)
class Diagnosis:
    """The findings about the model of a job."""

    job: AdjustedJob
    noise: NoiseRatio
    variance_groups: tuple[VarianceGroup, ...]
    outliers: tuple[Outlier, ...]
    findings: tuple[Finding, ...]
    left: RemainingStructure | None
    before: float
    """Significance level of the strongest structure before anything was named, counted over all that was tried"""
    after: float
    """Significance level of the strongest smooth structure left"""
    design: Detectability
    separate_by: tuple[str, ...]
    adjusts: bool = True
    """Whether the job can be adjusted with the named effects"""
    together: Gain | None = None
    """Gain of all named effects together, if there are several"""
    whole: Gain | None = None
    """Gain of all named effects and of those at all their places together, if there are such"""
    scatters: tuple[RandomEffect, ...] = ()
    """Effects at all places of a kind; all other findings are beside them"""
    unconfirmed: tuple[Unconfirmed, ...] = ()
    """Effects that held-out readings do not confirm; they are not in the model"""
    laws: tuple[Law, ...] = ()
    """The simplest sums of terms that explain what no effect does, one for each number of terms"""
    correlated_errors: tuple[CorrelatedError, ...] = ()
    """Smooth random errors that belong to the noise; all effects are found beside them"""
    limited: float | None = None
    """The limit of CPU time [s], if the search ended there"""
    interrupted: bool = False
    """Whether the user interrupted the search for laws, which ended with what it had found"""
    quick: bool = False
    """Whether no correlated errors, smooth effects and laws were looked for"""
    mistaken: Mistaken | None = None
    """A mistake in the files; all other findings are those of the job without it"""

    @property
    def identified(self) -> tuple[Finding | RandomEffect, ...]:
        """The effects, at one place or at all of theirs, the one with the largest held-out log score first."""
        return tuple(sorted([*self.findings, *self.scatters], key=lambda effect: -effect.gain.log_score))

    @property
    def conclusions(self) -> Conclusions:
        """What it concludes on each candidate with."""
        named, scattered = (f.effect for f in self.findings), (scatter.effect.name for scatter in self.scatters)
        return Conclusions(tuple(named), tuple(scattered), not self.ended_early)

    @property
    def law(self) -> Law | None:
        """The law with the most evidence, if any predicts held-out readings better."""
        return next((law for law in self.laws if law.chosen), None)

    @property
    def gain(self) -> Gain | None:
        """The gain of all that is identified: of the effects, or of one at all its places."""
        return self.whole or self.together or (self.findings[0].gain if self.findings else None)

    @property
    def _little_is_left(self) -> bool:
        """Whether what is left is declared, or a small part of a misfit that identified effects explain."""
        left = self.left
        return left is not None and (left.declared or (left.share is not None and left.share + left.beside < LITTLE))

    @property
    def ended_early(self) -> str:
        """Why it ended before all was tried, in words; "" if it did not."""
        return "interrupted" if self.interrupted else f"limit of {self.limited:g} s" if self.limited is not None else ""

    @property
    def found_nothing_yet(self) -> bool:
        """Whether the time was spent before the search found anything of what is there."""
        findings = self.findings, self.scatters, self.laws, self.correlated_errors, self.unconfirmed
        unreached = self.left is not None and self.left.depends_on == (UNREACHED,)
        return self.limited is not None and not self.interrupted and unreached and not any(findings)

    @property
    def verdict(self) -> Verdict:
        """The verdict, which the report states first."""
        if self.mistaken is not None:
            return Verdict.MISTAKEN
        if self.quick:
            return Verdict.NOT_DECIDED
        too_noisy = self.job.declares_noise and self.noise.is_implausible
        if too_noisy or (self.left is not None and not self._little_is_left):
            return Verdict.UNEXPLAINED
        if not self.findings and not self.scatters:
            # a little beside the effects of an extended job
            return Verdict.CLEAN if self.left is None or self.left.declared else Verdict.EXPLAINED
        instead = [finding.instead for finding in self.findings] + [scatter.rivals for scatter in self.scatters]
        confirmed = self.scatters or any(finding.confirmed for finding in self.findings)
        # what predicts readings worse than the job without it explains nothing, however much evidence it has
        explains = confirmed and (self.gain is None or self.gain.explains)
        # of a model that has its effects already, whatever the cause of that little is
        little = self.job.has_effects and self.gain is not None and self.gain.explained < LITTLE
        return Verdict.EXPLAINED if little or (explains and not any(instead)) else Verdict.INDISTINCT
