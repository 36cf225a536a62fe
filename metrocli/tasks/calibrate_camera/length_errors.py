"""Length measuring error of a network: calibrated lengths between its targets that take no part in the adjustment.

VDI/VDE 2634 part 1: error = measured minus calibrated length, within `A + K L`, at most B. Its test is seven lines of
at least five lengths each, whose longest is at least two thirds of the diagonal of the volume.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli.adjust.solution import Solution
from metrocli.arrays import Array, Index
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.instruments.camera import TARGET
from metrocli.result import Scalar
from metrocli.table import Table
from metrocli.tasks.calibrate_camera.readings import ends_of
from metrocli.tasks.calibrate_camera.settings import LengthLimit
from metrocli.uncertainty.numbers import COVERAGE
from metrocli.units import format_quantity

LINES, ON_A_LINE, LONGEST = 7, 5, 2 / 3
"""What the guideline asks for: lines, lengths on each, and the longest one in diagonals of the volume"""
_WITH_SCALE = 6
"""Inner constraints of a network whose scale is known"""


@dataclass(frozen=True)
class LengthErrors:
    """The table `length_errors`, its statistics and notes."""

    table: Table
    statistics: dict[str, Scalar]
    notes: tuple[str, ...]


def length_errors(tests: Table, solution: Solution, seen: Index, limit: LengthLimit | None) -> LengthErrors:
    """Return the errors of test lengths; `seen` (targets,) is the number of images of each target.

    `u^2 = e' (Q_aa + Q_bb - Q_ab - Q_ba) e + sigma^2`, e the direction of the length. Raises InputError for ends that
    the network does not place, and for a network without a scale of its own.
    """
    if solution.conditions > _WITH_SCALE:
        hint = "give `inputs: scale_bars`, or targets with known places"
        raise InputError([tests.fault("the network has no scale that lengths could test", hint)])
    block = solution.blocks[TARGET]
    ends = ends_of(tests, block.members, seen, "test length")
    measured, variance = _measured(solution, ends)
    calibrated = tests.numbers("length")
    error, std = measured - calibrated, np.sqrt(np.maximum(variance, 0.0) + tests.numbers("sigma") ** 2)
    en = np.abs(error) / (COVERAGE[0] * std)
    table = Table.of(
        {
            "from": tests.texts("from"),
            "to": tests.texts("to"),
            "line": tests.texts("line") if "line" in tests else [str(row + 1) for row in range(len(tests))],
            "calibrated [mm]": calibrated,
            "measured [mm]": measured,
            "error [mm]": error,
            "std [mm]": std,
            "en": en,
        }
    )
    largest = int(np.abs(error).argmax())
    statistics: dict[str, Scalar] = {
        "test_lengths": len(error),
        "length_measuring_error": float(np.abs(error).max()),
        "length_max_en": float(en.max()),
    }
    notes = [
        f"length measuring error (VDI/VDE 2634-1) of {len(error)} test lengths: "
        f"{format_quantity(float(error[largest]), 'mm', float(std[largest]))} (standard uncertainty) at most, "
        f"{tests.texts('from')[largest]} - {tests.texts('to')[largest]}; largest E_n {en.max():.2f}"
    ]
    if limit is not None:
        allowed = limit.of(calibrated)
        table = table.joined({"limit [mm]": allowed})
        share = np.abs(error) / allowed
        statistics["length_error_over_limit"] = float(share.max())
        verdict = "kept" if share.max() <= 1 else "NOT kept"
        notes.append(f"the limit is {verdict}: at most {100 * share.max():.0f} % of it is used")
    placed = block.values[seen > 1]
    notes += list(_short_of_the_guideline(table, float(np.linalg.norm(np.ptp(placed, axis=0)))))
    return LengthErrors(table, statistics, tuple(notes))


def _measured(solution: Solution, ends: Index) -> tuple[Array, Array]:
    """Return the lengths between targets of a network and their variances, (n,)."""
    values, covariance = solution.blocks[TARGET].values, solution.covariance_or_raise()
    away = values[ends[1]] - values[ends[0]]
    measured = np.linalg.norm(away, axis=1)
    along = away / measured[:, None]
    each, between = covariance.members(TARGET), covariance.apart(TARGET, *ends)
    whole = each[ends[0]] + each[ends[1]] - between - np.swapaxes(between, 1, 2)
    return measured, np.einsum("na,nab,nb->n", along, whole, along)


def _short_of_the_guideline(table: Table, diagonal: float) -> Iterator[str]:
    """Yield what the test lacks of the guideline."""
    lines, counts = np.unique(table.texts("line"), return_counts=True)
    longest = float(table.numbers("calibrated").max()) / diagonal
    if len(lines) < LINES or counts.min() < ON_A_LINE or longest < LONGEST:
        yield (
            f"less than the guideline asks for: {len(lines)} lines (of {LINES}), {counts.min()} lengths on the "
            f"line with fewest (of {ON_A_LINE}), longest {100 * longest:.0f} % of the diagonal ({100 * LONGEST:.0f} %)"
        )
