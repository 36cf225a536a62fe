"""The result of a machine calibration: tables, squareness, identifiability, and the error over the volume."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from metrocli import units
from metrocli.adjust.solution import Solution
from metrocli.effects.estimates import estimates as effect_estimates
from metrocli.effects.estimates import free_blocks
from metrocli.effects.estimates import tables as effect_results
from metrocli.instruments.machine import SQUARENESS, SQUARENESS_NAMES, TOOL
from metrocli.instruments.six_dof import ANGULAR
from metrocli.result import Estimate, Result, ShownTable
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import KIND
from metrocli.tasks.calibrate_machine.acceptance.paths import paths
from metrocli.tasks.calibrate_machine.acceptance.rotary_axes import mount, rotary_motion
from metrocli.tasks.calibrate_machine.acceptance.runs import positioning_of, shown_figures
from metrocli.tasks.calibrate_machine.problem import PLACES_OF_AXES
from metrocli.tasks.calibrate_machine.rank.identifiability import Identifiability
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.tasks.calibrate_machine.solve import AdjustedMachine
from metrocli.tasks.calibrate_machine.tables import (
    Determination,
    Tables,
    entries,
    least_squares_squareness,
    linear_axes,
    lines,
    on_workpiece,
    positions,
    rotary_axes,
    stations,
    tables_of,
    tool_names,
    tracker,
    unit_of,
)
from metrocli.tasks.calibrate_machine.volume_report import NOT_CONTAINED, volume_tables
from metrocli.tasks.calibrate_machine.warnings import (
    cures,
    identifiability_notes,
    machine_warnings,
    misplaced,
    uncontrolled,
)
from metrocli.tasks.shared.noise import JobNoise
from metrocli.tasks.shared.statistics import (
    Statistics,
    basic_statistics,
    estimates_of_block,
    job_noise_notes,
    noise_notes,
    with_job_noise,
)
from metrocli.tasks.shared.uncontrolled import TABLE, in_words

SIGN = "actual minus commanded"


def report(solved: AdjustedMachine, settings: Settings, noise: JobNoise, listed: Table | None = None) -> Result:
    """Return the result of a solved calibration; `listed` are the positions of kinematic tests."""
    solution, added = noise.solution, solved.problem.effects
    tables = tables_of(solved.problem.machine, solution, settings.scales)
    identified = solved.identified
    effect_tables, effect_arrays = effect_results(added, solution)
    hidden = uncontrolled(solved, tables, settings)
    where = mount(solved.problem.machine, solution)
    known = [name for name in _wanted(identified) if identified.status[name] != Determination.UNDETERMINED]
    turning, along = rotary_motion(tables, known), paths(tables, solved, settings, noise.factor, listed)
    volume = {}
    alone = solved.problem.positioning_alone
    if not alone:
        volume = volume_tables(tables, identified, settings.volume, solved.problem.tools_used)
    tools = (TOOL,) if solution.blocks[TOOL].free.any() else ()
    estimates = (*_estimates(solution), *effect_estimates(added, solution))
    doubts, far_off = misplaced(solved)
    figures, of_figures = positioning_of(tables, solved, settings, noise.factor)
    return Result(
        kind=KIND.name,
        title="",
        estimates=estimates,
        covariance=solution.joint((*_places(solution), *tools, *free_blocks(added))),
        statistics=with_job_noise(_statistics(solved, settings), noise),
        tables={
            **{f"tables/{name}": _table(tables, name, identified) for name in _wanted(identified)},
            "errors": _errors(tables, identified),
            "squareness": _squareness(tables, identified),
            "axes": linear_axes(tables.machine),
            **rotary_axes(tables.machine),
            **turning,
            **along,
            "tools": _tools(solved, solution),
            **on_workpiece(solution),
            **tracker(solution),
            **lines(solution),
            **stations(solution),
            **where,
            **positions(solution),
            **figures,
            **volume,
            "residuals": _residuals(solved),
            "suspects": _suspects(solved),
            "rejected": _named_tests(solved, [name for name, _ in solved.rejected], [w for _, w in solved.rejected]),
            "tables_entries": entries(tables),
            TABLE: hidden,
            **effect_tables,
        },
        arrays={"tables_covariance": tables.covariance, **effect_arrays},
        warnings=(*machine_warnings(solved, settings, of_figures), *far_off),
        doubts=tuple(doubts),
        shown=(
            ShownTable("errors", ("error", "status", "with", "largest", "largest_std", "unit")),
            ShownTable("volumetric"),
            *map(ShownTable, (*where, *turning, *list(along)[:1])),
            *(shown_figures(name, table) for name, table in figures.items()),
            *([ShownTable("suspects")] if len(solved.suspects.rows) else []),
        ),
        notes=(*_notes(solved, settings, noise), *in_words(hidden)),
        details=noise.details([estimate.name for estimate in estimates]),
    )


def _notes(solved: AdjustedMachine, settings: Settings, noise: JobNoise) -> Iterator[str]:
    """Yield what the machine was measured and adjusted with, in sentences."""
    yield ""
    yield from identifiability_notes(solved.identified)
    yield from solved.problem.notes
    yield from _at_20_degrees(settings)
    yield from solved.problem.noise.notes if solved.problem.noise else ()
    if not solved.problem.positioning_alone:
        yield NOT_CONTAINED
    yield from job_noise_notes(noise)
    yield from noise_notes(noise.solution, cures(settings))


def _at_20_degrees(settings: Settings) -> Iterator[str]:
    """Yield what was done with the scales of the axes, in a sentence for each."""
    for letter, scale in settings.scales.items():
        size = f"{units.sized(scale.growth, 'ratio')} ± {units.sized(scale.std, 'ratio')} (standard uncertainty)"
        yield f"E{letter}{letter} is given for a scale of 20 degC: at the measurement it had grown by {size}"


def _wanted(identified: Identifiability) -> list[str]:
    """Return the names of the errors with tables that the job estimates."""
    return [name for name in identified.tables if identified.status[name] != Determination.NOT_ESTIMATED]


def _estimates(solution: Solution) -> tuple[Estimate, ...]:
    """Return the estimated squareness errors, then the estimated tool vectors."""
    tool, estimates = solution.blocks[TOOL], tuple[Estimate, ...]()
    for name in _places(solution):
        block = solution.blocks[name]
        own = tuple((unit_of(column),) for column in block.columns)
        estimates += estimates_of_block(block, solution.std(name), own, lambda _, column: column)
    if not tool.free.any():
        return estimates
    names = dict(zip(tool.members, tool_names(solution.blocks), strict=True))
    spread, units = solution.std(TOOL), (("mm",),) * 3
    return estimates + estimates_of_block(tool, spread, units, lambda tool, axis: f"{names[tool]}.{axis}")


def _table(tables: Tables, name: str, identified: Identifiability) -> Table:
    """Return an error table; if it is not determined, its values are nan and its standard uncertainties inf."""
    position, value, std = tables.of(name)
    if identified.status[name] == Determination.UNDETERMINED:
        value, std = np.full_like(value, np.nan), np.full_like(std, np.inf)
    unit, axis = unit_of(name), next(axis for axis in tables.machine.axes if axis.letter == name[-1])
    return Table.of({f"position [{axis.unit}]": position, f"value [{unit}]": value, f"std [{unit}]": std})


def _errors(tables: Tables, identified: Identifiability) -> Table:
    names = _wanted(identified) if identified.problem.positioning_alone else identified.names
    of = [tables.of(name) for name in names]
    open_ones = np.array([identified.status[name] == Determination.UNDETERMINED for name in names])
    largest = np.array([np.abs(value).max() for _, value, _ in of])
    std = np.array([std.max() for _, _, std in of])
    return Table.of(
        {
            "error": names,
            "axis": [name[-1] for name in names],
            "unit": [unit_of(name) for name in names],
            "status": [identified.status[name] for name in names],
            "with": [" ".join(identified.partners.get(name, ())) for name in names],
            "largest": np.where(open_ones, np.nan, largest),
            "largest_std": np.where(open_ones, np.inf, std),
        }
    )


def _squareness(tables: Tables, identified: Identifiability) -> Table:
    lsq, covariance = least_squares_squareness(tables)
    ends = [tables.of(name) for name in SQUARENESS_NAMES]
    return Table.of(
        {
            "error": SQUARENESS_NAMES,
            "status": [identified.status[name] for name in SQUARENESS_NAMES],
            "end_points [rad]": [value[0] for _, value, _ in ends],
            "s_end_points [rad]": [std[0] for _, _, std in ends],
            "least_squares [rad]": lsq,
            "s_least_squares [rad]": np.sqrt(np.maximum(np.diag(covariance), 0.0)),
        }
    )


def _places(solution: Solution) -> tuple[str, ...]:
    """Return the names of the blocks that say how the axes lie: squareness, and those that have unknowns."""
    others = (name for name in PLACES_OF_AXES[1:] if name in solution.blocks and solution.blocks[name].free.any())
    return (SQUARENESS, *others)


def _tools(solved: AdjustedMachine, solution: Solution) -> Table:
    block = solution.blocks[TOOL]
    std = solution.std(TOOL) if block.free.any() else np.zeros(block.values.shape)
    used, open_ones = solved.problem.tools_used, solved.identified.open_tools
    listed = block.members[: len(solved.problem.machine.tools)]
    return Table.of(
        {
            "tool": tool_names(solution.blocks),
            "x y z [mm]": block.values,
            "sx sy sz [mm]": std,
            "measured": [name in used for name in block.members],
            "predictable": [name in listed and name not in open_ones for name in block.members],
        }
    )


def _residuals(solved: AdjustedMachine) -> Table:
    observations, residuals = solved.problem.readings.observations, solved.residuals
    machine = solved.problem.machine
    places = np.stack([observations.conditions[axis.coordinate] for axis in machine.axes])
    columns: dict[str, Any] = {**observations.keys, **machine.columns(places)}
    for i, component in enumerate(observations.components):
        unit = "rad" if component in ANGULAR else "mm"
        columns |= {
            f"residual_{component} [{unit}]": residuals.values[i],
            f"sigma_{component} [{unit}]": observations.deviations[i],
            f"normalised_{component}": residuals.normalised[i],
            f"redundancy_{component}": residuals.redundancy[i],
        }
    return Table.of(columns)


def _suspects(solved: AdjustedMachine) -> Table:
    names = solved.problem.names
    return _named_tests(solved, [names[i] for i in solved.suspects.rows.tolist()], solved.suspects.tests.tolist())


def _named_tests(solved: AdjustedMachine, names: list[str], tests: list[float]) -> Table:
    key = next(iter(solved.problem.readings.observations.keys))
    order = np.argsort(-np.array(tests, dtype=float), kind="stable")
    return Table.of({key: np.array(names, dtype=str)[order], "w": np.array(tests, dtype=float)[order]})


def _statistics(solved: AdjustedMachine, settings: Settings) -> Statistics:
    identified, values = solved.identified, solved.residuals.values
    angles = np.array([name in ANGULAR for name in solved.problem.readings.observations.components])
    parts = {"mm": values[~angles], "rad": values[angles]}
    rms = {unit: float(np.sqrt((part**2).mean())) for unit, part in parts.items() if part.size}
    return {
        **basic_statistics(solved.solution, rms),
        "method": settings.method,
        **({} if settings.angular else {"chain": settings.machine.chain}),
        "sign": SIGN,
        "straightness": "zero at both ends",
        "rank": identified.rank,
        "possible_rank": identified.unknowns,
        "ratio": identified.ratio,
        "undetermined": " ".join(identified.undetermined),
        "together": " ".join(identified.together),
        "readings": solved.problem.readings.observations.count,
        "rejected": len(solved.rejected),
        "critical_w": solved.suspects.critical,
        **(solved.problem.noise.facts if solved.problem.noise else {}),
        **solved.problem.facts,
    }
