"""Length errors of a result against a maximum permissible error (ISO 10360-2:2009, ISO 14253-1)."""

from __future__ import annotations

from collections.abc import Sequence

from metrocli import units
from metrocli.errors import InputError, UsageError
from metrocli.frozen import dataclass
from metrocli.table import Table
from metrocli.uncertainty.numbers import COVERAGE
from metrocli.uncertainty.verification import Deviation

ASKED = 105
"""Lengths of a complete test: five, three times each, in seven positions (ISO 10360-2:2009)"""
CONFORMS, FAILS, OPEN = "yes", "no", "undecided"


@dataclass(frozen=True)
class Permitted:
    """A maximum permissible error `A + B L` of lengths L."""

    constant: float
    """A [mm]"""
    proportional: float

    def at(self, length: float) -> float:
        """Return the largest permitted error of a length [mm]."""
        return self.constant + self.proportional * length


@dataclass(frozen=True)
class LengthError:
    """The error of one length, against what is permitted."""

    name: str
    error: float
    """Indicated (by the result) minus calibrated [mm]"""
    permitted: float
    test: float
    """U of the calibrated length, k = 2 [mm]: what the decision is uncertain by (ISO/TS 23165)"""

    @property
    def share(self) -> float:
        """The part of the MPE that is used, `(|E| + U) / MPE`."""
        return (abs(self.error) + self.test) / self.permitted

    @property
    def conforms(self) -> str:
        """Whether the error conforms: `|E| <= MPE - U` yes, `|E| > MPE + U` no, else undecided (ISO 14253-1)."""
        if abs(self.error) + self.test <= self.permitted:
            return CONFORMS
        return FAILS if abs(self.error) - self.test > self.permitted else OPEN


def permitted(text: str) -> Permitted:
    """Return the MPE written as '1.5 um + 3 um/m' or '2 um'; raises UsageError for another form or an MPE of zero."""
    parts = [part.strip() for part in text.split("+")]
    try:
        constant = units.parse_quantity(parts[0], "length")
        proportional = units.parse_quantity(parts[1], "ratio") if len(parts) == 2 else 0.0
    except units.QuantityError as error:
        raise UsageError(f"--mpe '{text}': {error.message}; write e.g. '1.5 um + 3 um/m'") from error
    if len(parts) > 2 or constant < 0 or proportional < 0 or constant + proportional == 0:
        raise UsageError(f"--mpe '{text}' is not a maximum permissible error: write e.g. '1.5 um + 3 um/m' or '2 um'")
    return Permitted(constant, proportional)


def length_errors(deviations: Sequence[Deviation], check: Table, limit: Permitted) -> tuple[LengthError, ...]:
    """Return the error of each length of the check; raises InputError for points, and for lengths whose MPE is zero."""
    if "length" not in check:
        raise InputError([check.fault("--mpe needs lengths", "expected the columns from, to, length_mm, sigma_mm")])
    lengths, sigma = check.numbers("length").tolist(), check.numbers("sigma").tolist()
    without = [row for row, length in enumerate(lengths) if not limit.at(length) > 0]
    if without:
        hint = "expected a length above zero, or an MPE with a constant part, such as '1.5 um + 3 um/m'"
        raise InputError(check.faults_at(without, lambda _: "the MPE of this length is zero", lambda _: hint))
    return tuple(
        LengthError(deviation.name, -deviation.value, limit.at(length), COVERAGE[0] * spread)
        for deviation, length, spread in zip(deviations, lengths, sigma, strict=True)
    )


def ratio(errors: Sequence[LengthError]) -> float:
    """Return the largest `(|E| + U) / MPE`: the lengths conform if it is at most 1."""
    return max(error.share for error in errors)
