"""The result of a location: the unit with its covariance, the residuals of all readings, and the beams."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.adjust.robust import minimal_detectable
from metrocli.adjust.solution import Residuals, Solution, residuals_of
from metrocli.arrays import Array
from metrocli.effects.estimates import estimates, free_blocks
from metrocli.effects.estimates import tables as effect_results
from metrocli.instruments import launch_unit as lu
from metrocli.result import Estimate, Result, Scalar, ShownTable
from metrocli.table import Table
from metrocli.tasks.locate_launch_unit import KIND
from metrocli.tasks.locate_launch_unit.diagnosis import uncontrolled
from metrocli.tasks.locate_launch_unit.problem import LaunchUnitProblem
from metrocli.tasks.locate_launch_unit.readings import AlignedPoses
from metrocli.tasks.locate_launch_unit.solve import Located
from metrocli.tasks.shared.environment import blocks_of, estimates_of
from metrocli.tasks.shared.noise import JobNoise
from metrocli.tasks.shared.statistics import (
    REMOVE,
    basic_statistics,
    beyond_bound,
    job_noise_notes,
    noise_notes,
    noise_warnings,
    with_job_noise,
)
from metrocli.tasks.shared.uncontrolled import TABLE, in_words
from metrocli.words import listed

_UNITS = ("mm", "mm", "mm", "rad")
_TABLES = {"angles": tuple(lu.ENCODERS), "distances": (lu.DISTANCE,)}


def report(located: Located, method: str, noise: JobNoise | None) -> Result:
    """Return the result of a located unit."""
    covariance = located.covariance if noise is None else noise.solution.covariance_or_raise().of(lu.UNIT)
    unit = place_of_unit(located, covariance)
    if located.solution is None or located.problem is None or noise is None:
        return _as_printed(located, method, unit, covariance)
    return _as_adjusted(located, located.problem, located.solution, noise, unit, method)


def place_of_unit(located: Located, covariance: Array) -> tuple[Estimate, ...]:
    """Return x y z gamma with their standard uncertainties."""
    rows = zip(lu.COLUMNS, located.values.tolist(), np.sqrt(np.diag(covariance)).tolist(), _UNITS, strict=True)
    return tuple(Estimate(*row) for row in rows)


def _as_printed(located: Located, method: str, unit: tuple[Estimate, ...], covariance: Array) -> Result:
    """Return the result of a unit located by a formula of the paper, which leaves no residuals."""
    beams, hidden = _beams(located), uncontrolled(located.readings.receiver, located.place)
    return Result(
        kind=KIND.name,
        title="",
        estimates=unit,
        covariance=covariance,
        statistics=_statistics_as_printed(method, beams),
        tables={"beams": beams, TABLE: hidden},
        notes=(*_of_air(located), *in_words(hidden)),
        shown=(ShownTable("beams"),),
        warnings=_warning_as_printed(method),
    )


def _as_adjusted(
    located: Located,
    problem: LaunchUnitProblem,
    solution: Solution,
    noise: JobNoise,
    unit: tuple[Estimate, ...],
    method: str,
) -> Result:
    """Return the result of an adjusted unit."""
    beams, hidden = _beams(located), uncontrolled(located.readings.receiver, located.place)
    residuals, outliers = _residuals_of(located, solution), _outliers(located)
    effects, arrays = effect_results(problem.effects, noise.solution)
    rms = {
        table.units["residual"]: float(np.sqrt((table.numbers("residual") ** 2).mean())) for table in residuals.values()
    }
    statistics = basic_statistics(solution, rms) | {
        "method": method,
        "poses": len(located.readings.names),
        "critical_w": located.critical,
        "rejected": located.left_out,
    }
    delivered = (*unit, *estimates_of(noise.solution), *estimates(problem.effects, noise.solution))
    return Result(
        kind=KIND.name,
        title="",
        estimates=delivered,
        covariance=noise.solution.joint((lu.UNIT, *blocks_of(noise.solution), *free_blocks(problem.effects))),
        statistics=with_job_noise(statistics, noise),
        tables={"beams": beams, **residuals, "outliers": outliers, TABLE: hidden, **effects},
        arrays=arrays,
        shown=(ShownTable("beams"), *((ShownTable("outliers"),) if len(outliers) else ())),
        notes=(*_of_air(located), *job_noise_notes(noise), *noise_notes(solution, cures=(REMOVE,)), *in_words(hidden)),
        details=noise.details([estimate.name for estimate in delivered]),
        warnings=(
            *problem.warnings,
            *noise_warnings(solution, (REMOVE,), located.left_out),
            *_outlier_warnings(outliers, located.critical, bool(statistics["rejected"])),
            *_repeated(problem.readings),
        ),
    )


def _residuals_of(located: Located, solution: Solution) -> dict[str, Table]:
    """Return the table of the angles and that of the distances, if there are any."""
    groups = {group.name: group for group in solution.groups}
    return {
        table: _residuals(
            [(groups[name], residuals_of(solution, groups[name])) for name in names if name in groups], located
        )
        for table, names in _TABLES.items()
        if not groups.keys().isdisjoint(names)
    }


def _of_air(located: Located) -> tuple[str, ...]:
    return () if located.readings.air is None else (located.readings.air.note,)


def _statistics_as_printed(method: str, beams: Table) -> dict[str, Scalar | dict[str, float]]:
    per_pose = 2 if method == "lines" else 3
    miss = float(np.sqrt((beams.numbers("miss") ** 2).mean()))
    return {
        "method": method,
        "poses": len(beams),
        "observations": per_pose * len(beams),
        "unknowns": 3,
        "rms": {"mm": miss},
    }


def _warning_as_printed(method: str) -> tuple[str, ...]:
    ignored = "phi1 and phi2 only give gamma" if method == "closed-loop" else "distances are not used, phi1 gives gamma"
    return (
        f"method {method}: uncertainties follow from the declared noise, which is not tested; {ignored}, and all "
        "poses have equal weight; `method: adjustment` uses every reading",
    )


def _beams(located: Located) -> Table:
    """Return /beams: length and direction of each beam in the machine, and its distance from the unit."""
    readings = located.readings
    out = readings.receiver - located.place
    length = np.linalg.norm(out, axis=1)
    beams = readings.beams
    along = np.einsum("ni,ni->n", beams.towards, -out)
    miss = np.linalg.norm(-out - along[:, None] * beams.towards, axis=1)
    away = {"pose": readings.names, "length [mm]": length, "wx wy wz": out / length[:, None]}
    return Table.of({**away, "miss [mm]": miss})


def _residuals(parts: list[tuple[Group, Residuals]], located: Located) -> Table:
    """Return the residuals of groups with a common unit, with the minimal detectable error of each reading.

    It is for the test for outliers that is made, and 80 % power.
    """
    groups, of_groups = [group.observations for group, _ in parts], [residuals for _, residuals in parts]
    keys = {key: np.concatenate([np.array(o.keys[key]) for o in groups]) for key in ("pose", "reading")}
    unit = f"[{groups[0].unit}]"
    numbers = {
        f"value {unit}": [o.readings for o in groups],
        f"residual {unit}": [residuals.values for residuals in of_groups],
        f"sigma {unit}": [residuals.sigma for residuals in of_groups],
        "normalised": [residuals.normalised for residuals in of_groups],
        "redundancy": [residuals.redundancy for residuals in of_groups],
        f"detectable {unit}": [
            minimal_detectable(residuals, located.critical, located.noise) for residuals in of_groups
        ],
    }
    return Table.of(
        {**keys, **{name: np.concatenate([part[0] for part in number]) for name, number in numbers.items()}}
    )


def _outliers(located: Located) -> Table:
    """Return /outliers: the readings that do not fit the others, the largest first."""
    rows = [(outlier.pose, outlier.group, outlier.test) for outlier in located.outliers]
    return Table.of_rows(("pose [text]", "reading [text]", "w"), rows)


def _outlier_warnings(outliers: Table, critical: float, removed: bool) -> list[str]:
    rows = zip(*(outliers.texts(name) for name in ("pose", "reading")), outliers.numbers("w"), strict=True)
    names = [f"{reading} of {pose} (w = {w:.1f})" for pose, reading, w in rows]
    if not names:
        return []
    return [f"{beyond_bound(names, critical, '')}; left out" if removed else beyond_bound(names, critical)]


def _repeated(readings: AlignedPoses) -> list[str]:
    """Return a warning of poses that hold identical readings."""
    rows = np.column_stack([readings.receiver, readings.spindle, readings.angles.T])
    _, first, counts = np.unique(rows, axis=0, return_inverse=True, return_counts=True)
    same = [name for name, at in zip(readings.names, first.ravel(), strict=True) if counts[at] > 1]
    text = f"poses with identical readings count as if measured twice: {listed(same)}"
    return [text] if same else []
