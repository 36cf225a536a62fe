"""One measurement with a hidden effect, and what was found in it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatch

from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.findings import Diagnosis

ALIKE = 0.9
"""Cosine of what is visible of two effects from which they are near aliases"""


@dataclass(frozen=True)
class Hidden:
    """An effect that is in the readings."""

    name: str
    """A name that begins with _ is in no table"""
    where: Mapping[str, str]
    values: Mapping[str, float]
    near: float = 0.0
    """Largest cosine of what is visible of it with another candidate"""
    form: str = ""
    """Its `by` where the name has several forms: parameters of different forms cannot be compared"""
    within: frozenset[str] = frozenset()
    """Of an effect in no table: names that are wide enough to be right for it"""

    @property
    def distinct(self) -> bool:
        """Whether it is not a near alias of another candidate."""
        return self.near < ALIKE


@dataclass(frozen=True)
class Case:
    """A measurement and its truth."""

    scenario: str
    adjusted: Callable[[], AdjustedJob]
    hidden: tuple[Hidden, ...] = ()
    outliers: frozenset[tuple[str, ...]] = frozenset()
    """Keys of the readings that are wrong"""
    noise: float = 1.0
    """True noise over the declared one"""
    power: float | None = None
    """Power of a test of the hidden effect alone that knows the covariance of all errors, where it is computed"""


@dataclass(frozen=True)
class Found:
    """What a diagnosis said of a case."""

    case: Case
    diagnosis: Diagnosis
    seconds: float = 0.0
    covered: tuple[bool, ...] = field(default=())
    """For each named effect that is in the readings, whether its 95 % region holds the truth"""


@dataclass(frozen=True)
class Campaign:
    """The seeded cases of a kind of job, scenarios in turn."""

    case: Callable[[int, bool], Case]
    """The case of a number; a small one, if the other argument is true"""
    scenarios: tuple[str, ...]
    longest: float = 5.0
    """CPU seconds that one diagnosis may take"""

    def cases(self, numbers: Iterable[int], only: str = "", small: bool = False) -> Iterator[Case]:
        """Yield cases by their numbers, of scenarios by name or pattern (`nothing*`) or, without a name, of all."""
        for number in numbers:
            if fnmatch(self.scenarios[number % len(self.scenarios)], only or "*"):
                yield self.case(number, small)
