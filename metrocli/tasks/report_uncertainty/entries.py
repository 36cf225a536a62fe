"""The keys of a report-uncertainty job, each with its meaning and its own checks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import field
from pathlib import Path
from typing import Any

from metrocli.expressions.written import AnyQuantity, Measure, ModelText, WrittenExpression
from metrocli.frozen import dataclass
from metrocli.result import Result
from metrocli.settings import (
    ANY_KIND,
    At,
    Choice,
    Either,
    FileOf,
    ListOf,
    LocatedValue,
    MapOf,
    Number,
    Section,
    TableFile,
    Text,
    Whole,
    WithUnit,
    setting,
    settings_of,
)
from metrocli.table import Columns, Table
from metrocli.tasks.report_uncertainty.values import DegreesOfFreedom, Limit, Probability, Trials

READINGS = Columns((), (), "readings", every=True)
SHAPES = (
    "normal", "t", "uniform", "triangular", "trapezoidal", "curvilinear-trapezoid", "arcsine", "exponential", "counts",
    "sampled", "rectangular", "U", "poisson",
)  # fmt: skip
"""Distributions; the last three are synonyms."""
FACTOR = Number(0.5, 100)
"""Coverage factors, from less than that of 50 % to more than that of 99 % with one degree of freedom"""


@dataclass(frozen=True)
class InputResults:
    """Results of other jobs."""

    results: Mapping[str, Path] = setting(
        MapOf(FileOf(ANY_KIND)), "results of other jobs, by the name they have in the models", default={}
    )


@dataclass(frozen=True)
class Files:
    """The content of the input files, and of the tables that other keys name, by the path of the key."""

    results: Mapping[str, Result] = field(default_factory=dict)
    files: Mapping[str, Table] = field(default_factory=dict)


@dataclass(frozen=True)
class InputEntry:
    """An input quantity: its best estimate and its uncertainty."""

    value: Measure | None = setting(AnyQuantity(), "best estimate", default=None)
    mean: Measure | None = setting(AnyQuantity(), "best estimate (the same as value)", default=None)
    std: Measure | None = setting(AnyQuantity(), "standard uncertainty", default=None)
    half_width: Measure | None = setting(AnyQuantity(), "half-width of the distribution", default=None)
    U: Measure | None = setting(AnyQuantity(), "expanded uncertainty of a certificate, with its k", default=None)
    k: float | None = setting(FACTOR, "coverage factor of U", default=None)
    dof: float | None = setting(DegreesOfFreedom(), "degrees of freedom of the uncertainty", default=None)
    distribution: str | None = setting(Choice(*SHAPES), "shape of the distribution", default=None)
    inexactness: Measure | None = setting(
        AnyQuantity(), "half-width of the half-width, of a curvilinear trapezoid", default=None
    )
    beta: float | None = setting(
        Number(minimum=0, maximum=1), "top of a trapezoid as a share of its base", default=None
    )
    readings: Path | None = setting(TableFile(READINGS), "CSV of readings: type A evaluation", default=None)
    samples: Path | None = setting(TableFile(READINGS), "CSV of values of an earlier evaluation", default=None)
    column: str | None = setting(Text(), "column of readings or samples", default=None)
    estimate: str | None = setting(
        Text(), "estimate of a result, such as net.T-1.x, whose own name cannot stand in a model", default=None
    )

    def faults(self) -> Iterable[tuple[str, ...]]:
        """Yield the faults of keys that contradict each other or are incomplete."""
        others = [name for name, _ in settings_of(type(self)).items() if name != "estimate"]
        extra = next((name for name in others if getattr(self, name) is not None), None)
        if self.estimate is not None and extra is not None:
            message = f"the result gives the value and uncertainty of an estimate; {extra} is too much"
            yield extra, message, f"leave {extra} out"


@dataclass(frozen=True)
class CorrelationEntry:
    """The correlation of two quantities."""

    between: tuple[str, str] = setting(ListOf(Text(), 2, distinct=True), "two quantities")
    value: float = setting(Number(-1, 1), "correlation coefficient")


@dataclass(frozen=True)
class Measurand:
    """An output quantity."""

    model: WrittenExpression = setting(ModelText(), "expression in the quantities")
    unit: str = setting(Text(), "unit of the result", default="1")


@dataclass(frozen=True)
class CoverageSetting:
    """Coverage of the expanded uncertainty: a probability or a factor k."""

    probability: float | None = setting(Probability(0.5), "coverage probability", default=None)
    k: float | None = setting(FACTOR, "coverage factor", default=None)

    def faults(self) -> Iterable[tuple[str, ...]]:
        """Yield the faults of keys that contradict each other or are incomplete."""
        if self.probability is not None and self.k is not None:
            yield "k", "probability and k are both given", "give one of them"


@dataclass(frozen=True)
class MonteCarlo:
    """Settings of the Monte Carlo method: trials, digits, seed."""

    trials: int | None = setting(Trials(), "number of trials, or adaptive", default=1_000_000)
    digits: int = setting(
        Whole(1, 3),
        "digits of the standard uncertainty that count: in adaptive runs, and where GUM is judged",
        default=2,
    )
    seed: int = setting(Whole(0), "seed of the random numbers", default=0)
    most: int = setting(Whole(100_000, 1_000_000_000), "most trials of an adaptive run", default=10_000_000)


@dataclass(frozen=True)
class Process:
    """Prior distribution of the measured items."""

    mean: Measure = setting(AnyQuantity(), "mean of the items")
    std: Measure = setting(AnyQuantity(), "their standard deviation")


@dataclass(frozen=True)
class Tolerance:
    """A tolerance, and optionally the items and the wanted risk for a decision by JCGM 106."""

    between: tuple[Measure | None, Measure | None] = setting(ListOf(Limit(), 2), "lower and upper limit")
    process: Process | None = setting(Section(Process), "items before measurement, for global risks", default=None)
    risk: float | None = setting(Probability(), "wanted risk of wrong acceptance, for a guard band", default=None)


@dataclass(frozen=True)
class VolumeEntry:
    """Grid of points in a working volume, in the frame of the part."""

    from_: tuple[float, float, float] = setting(ListOf(WithUnit("length"), 3), "one corner", key="from")
    to: tuple[float, float, float] = setting(ListOf(WithUnit("length"), 3), "the opposite corner")
    grid: tuple[int, int, int] = setting(ListOf(Whole(1, 1000), 3), "points along each axis", default=(5, 5, 5))
    origin: tuple[float, float, float] = setting(
        ListOf(WithUnit("length"), 3), "point from which lengths and expansion count", default=(0.0, 0.0, 0.0)
    )

    def faults(self) -> Iterable[tuple[str, ...]]:
        """Yield the faults of keys that contradict each other or are incomplete."""
        points = self.grid[0] * self.grid[1] * self.grid[2]
        if points > 2_000_000:
            yield (
                "grid",
                f"{points} points are more than 2000000",
                "take a coarser grid: extremes lie at corners and edges",
            )
        for low, high, count in zip(self.from_, self.to, self.grid, strict=True):
            if count == 1 and low != high:
                yield "grid", "one point along an axis with an extent", "take 2 or more"
                return


@dataclass(frozen=True)
class Expansion:
    """Thermal expansion: `u² = L² (alpha² u²(dT) + dT² u²(alpha))` (JCGM 100, 5.1.2)."""

    alpha: float = setting(WithUnit("expansion", minimum=0.0), "coefficient of expansion")
    alpha_std: float | None = setting(
        WithUnit("expansion", minimum=0.0), "standard uncertainty of the coefficient", default=None
    )
    difference: float = setting(
        WithUnit("temperature difference"), "difference dT of the temperature from that of the lengths", default=0.0
    )
    half_width: float | None = setting(
        WithUnit("temperature difference", minimum=0.0), "half-width of the temperature", default=None
    )
    std: float | None = setting(
        WithUnit("temperature difference", minimum=0.0), "standard uncertainty of the temperature", default=None
    )

    def faults(self) -> Iterable[tuple[str, ...]]:
        """Yield the faults of keys that contradict each other or are incomplete."""
        if (self.half_width is None) == (self.std is None):
            yield "", "an expansion needs half_width or std of the temperature", "give one of them"
        if self.difference != 0 and self.alpha_std is None:
            yield "", "at a difference from the reference temperature alpha's uncertainty counts", "give alpha_std"


@dataclass(frozen=True)
class LengthErrorEntry:
    """Largest length measurement error (VDI/VDE 2634): `constant + proportional L`, rectangular."""

    constant: float = setting(WithUnit("length", minimum=0.0), "part that does not depend on the length")
    proportional: float = setting(WithUnit("ratio", minimum=0.0), "part proportional to the length", default=0.0)


@dataclass(frozen=True)
class Contributor:
    """A source of uncertainty of the points of the volume."""

    name: str = setting(Text(), "name, for the budget")
    result: str | None = setting(Text(), "result of another job, propagated to each point", default=None)
    std: float | tuple[float, float, float] | None = setting(
        Either(WithUnit("length", minimum=0.0), ListOf(WithUnit("length", minimum=0.0), 3)),
        "standard uncertainty along each axis", default=None,
    )  # fmt: skip
    half_width: float | tuple[float, float, float] | None = setting(
        Either(WithUnit("length", minimum=0.0), ListOf(WithUnit("length", minimum=0.0), 3)),
        "half-width of a rectangular distribution along each axis", default=None,
    )  # fmt: skip
    expansion: Expansion | None = setting(Section(Expansion), "thermal expansion", default=None)
    length_error: LengthErrorEntry | None = setting(
        Section(LengthErrorEntry), "largest length measurement error", default=None
    )
    model: tuple[WrittenExpression, WrittenExpression, WrittenExpression] | None = setting(
        ListOf(ModelText(), 3), "error along each axis, in estimates of results and X Y Z (mm)", default=None
    )
    distribution: str = setting(Choice("normal", "uniform"), "shape for std in Monte Carlo", default="normal")
    dof: float | None = setting(DegreesOfFreedom(), "degrees of freedom", default=None)
    source: str | None = setting(Text(), "what the uncertainty comes from, where others have it too", default=None)
    includes: tuple[str, ...] = setting(ListOf(Text()), "sources that its figures contain already", default=())

    def faults(self) -> Iterable[tuple[str, ...]]:
        """Yield the faults of keys that contradict each other or are incomplete."""
        given = [name for name in FORMS if getattr(self, name) is not None]
        if len(given) != 1:
            message = f"has {' and '.join(given)}" if given else "has no uncertainty"
            yield "", f"the contributor '{self.name}' {message}", f"give one of {', '.join(FORMS)}"


FORMS = ("result", "std", "half_width", "expansion", "length_error", "model")


@dataclass(frozen=True)
class Entries:
    """All keys of a report-uncertainty job."""

    inputs: InputResults = setting(Section(InputResults), "results of other jobs", default=InputResults())
    quantities: Mapping[str, LocatedValue] = setting(
        MapOf(At(Either(AnyQuantity(), Section(InputEntry)))), "input quantities, by name", default={}
    )
    correlations: tuple[LocatedValue, ...] = setting(ListOf(At(Section(CorrelationEntry))), "correlations", default=())
    measurands: Mapping[str, LocatedValue] = setting(MapOf(At(Section(Measurand))), "output quantities", default={})
    coverage: CoverageSetting = setting(Section(CoverageSetting), "what U covers", default=CoverageSetting())
    monte_carlo: MonteCarlo = setting(Section(MonteCarlo), "Monte Carlo", default=MonteCarlo())
    volume: VolumeEntry | None = setting(Section(VolumeEntry), "working volume, instead of quantities", default=None)
    contributors: tuple[LocatedValue, ...] = setting(
        ListOf(At(Section(Contributor))), "what makes the points of the volume uncertain", default=()
    )
    tolerance: Any = setting(
        Either(At(AnyQuantity()), MapOf(At(Either(ListOf(Limit(), 2), Section(Tolerance))))),
        "limits of measurands, or the full width of the tolerance in a volume", default=None,
    )  # fmt: skip
    target: Mapping[str, Measure] = setting(
        MapOf(AnyQuantity()), "wanted U of measurands, for the reverse budget", default={}
    )
