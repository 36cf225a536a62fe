"""Errors of the linear axes that an earlier calibration of the machine gives: its tables with their covariance.

They are not estimated from the readings alone: the earlier values, and what they correlate, are readings beside those
of the job. So the uncertainty of the linear axes is in that of the rotary ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.instruments.axes.chain import axis_order
from metrocli.instruments.axes.rotary import Combinations
from metrocli.instruments.machine import (
    ALL_NAMES,
    AXES,
    SQUARENESS,
    SQUARENESS_NAMES,
    Axis,
    Machine,
    squareness_block,
)
from metrocli.result import Result
from metrocli.tasks.calibrate_machine.described import raise_if
from metrocli.tasks.calibrate_machine.problem import MachineProblem
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.tasks.calibrate_machine.tables import Determination
from metrocli.words import listed

KNOWN = "known linear axes"
_RANK = 1e-10
"""Share of the largest variance, of errors in their standard uncertainties, below which a direction is exact"""
_SAME = 1e-6
"""Ranges of knots are the same up to this [mm]"""


@dataclass(frozen=True)
class KnownAxes:
    """Errors of linear axes with their covariance, by entries of their tables and squareness."""

    axes: tuple[Axis, ...]
    names: tuple[str, ...]
    """Errors that the earlier calibration gives and the job does not estimate"""
    entries: tuple[tuple[str, float], ...]
    """Error and position of each entry; the position is nan for squareness"""
    values: Array
    covariance: Array

    def blocks(self, values: Array, blocks: Mapping[str, Block]) -> dict[str, Block]:
        """Return the blocks of a machine with these values of the entries; its other errors are as they are."""
        tables = {
            name: values[[i for i, (error, _) in enumerate(self.entries) if error == name]] for name in self.names
        }
        square = {name: float(value[0]) for name, value in tables.items() if name in SQUARENESS_NAMES}
        known = [axis.block_of(tables, self.names) for axis in self.axes] + [squareness_block(square, self.names)]
        return {block.name: _into(blocks[block.name], block, self.names) for block in known}

    def drawn(self, blocks: Mapping[str, Block], rng: np.random.Generator) -> dict[str, Block]:
        """Return the blocks of a machine with errors drawn within their covariance."""
        values, vectors = np.linalg.eigh(self.covariance)
        noise = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.normal(size=len(values)))
        return {**blocks, **self.blocks(self.values + noise, blocks)}

    def group(self, blocks: Mapping[str, Block]) -> Group:
        """Return the entries as readings: combinations of them that do not correlate."""
        std = np.sqrt(np.diag(self.covariance))
        known = std > 0
        values, vectors = np.linalg.eigh(self.covariance[np.ix_(known, known)] / std[known] / std[known][:, None])
        kept = values > _RANK * values[-1]
        # the eigenvectors of the correlation: along them entries of different units can be compared
        turned = (vectors[:, kept] / std[known][:, None]).T
        by_entry = {name: rows[known] for name, rows in self._by_values(blocks).items()}
        weights = {name: np.tensordot(turned, weight, 1) for name, weight in by_entry.items() if weight.any()}
        index = {name: np.arange(weight.shape[1])[:, None] for name, weight in weights.items()}
        read = Observations((turned @ self.values[known])[:, None], np.sqrt(values[kept])[:, None], index)
        return Group(KNOWN, Chain((Combinations(weights),)), read)

    def _by_values(self, blocks: Mapping[str, Block]) -> dict[str, Array]:
        """Return the derivatives of the entries by the values of each block, (entries, members, columns)."""
        derivatives = {
            axis.block: np.zeros((len(self.entries), *blocks[axis.block].values.shape)) for axis in self.axes
        }
        derivatives[SQUARENESS] = np.zeros((len(self.entries), *blocks[SQUARENESS].values.shape))
        for i, (name, position) in enumerate(self.entries):
            if name in SQUARENESS_NAMES:
                derivatives[SQUARENESS][i, 0, blocks[SQUARENESS].column(name)] = 1.0
                continue
            axis = next(axis for axis in self.axes if axis.letter == name[-1])
            column = blocks[axis.block].column(name)
            knot = int(np.argmin(np.abs(axis.knots - position)))
            derivatives[axis.block][i, :, column] = axis.from_raw[column][knot]
        return derivatives


def with_known_axes(problem: MachineProblem, settings: Settings, result: Result | None) -> MachineProblem:
    """Return a problem that has the errors of an earlier result; raises InputError as `known_axes` does."""
    if result is None:
        return problem
    known = known_axes(problem.machine, settings, result)
    blocks = {**problem.blocks, **known.blocks(known.values, problem.blocks)}
    model = replace(problem.model, blocks=blocks, groups=(*problem.model.groups, known.group(blocks)))
    return replace(problem, model=model, given=known.names, warnings=(*problem.warnings, *_unknown(known, result)))


def known_axes(machine: Machine, settings: Settings, result: Result) -> KnownAxes:
    """Return the errors of an earlier result that the job does not estimate.

    Raises InputError if its axes are not those of the job, or if the job estimates all that it has.
    """
    axes = tuple(axis for axis in machine.axes if axis.letter in AXES)
    raise_if(_other_axes(axes, settings, result))
    listed_entries, listed_errors = result.tables["tables_entries"], result.tables["errors"]
    status = dict(zip(listed_errors.texts("error"), listed_errors.texts("status"), strict=True))
    without_value = (Determination.UNDETERMINED, Determination.NOT_ESTIMATED)
    letters = {axis.letter for axis in axes}
    names = tuple(
        name
        for name in ALL_NAMES
        if name not in settings.estimated and status.get(name, Determination.NOT_ESTIMATED) not in without_value
        if name in SQUARENESS_NAMES or name[-1] in letters
    )
    if not names:
        text = "the job estimates all errors of the linear axes that the result has"
        hint = "write `estimate: rotary`, or leave `machine` out of the inputs"
        raise InputError([Fault(text, _file(result), hint=hint)])
    errors, positions = listed_entries.texts("error"), listed_entries.numbers("position")
    rows = np.flatnonzero(np.isin(errors, names))
    # the entries of an error stand together, in the order of its table
    values = np.concatenate([_values(result, name) for name in dict.fromkeys(errors[i] for i in rows)])
    covariance = result.arrays["tables_covariance"][np.ix_(rows, rows)]
    entries = tuple((errors[i], float(positions[i])) for i in rows)
    return KnownAxes(axes, names, entries, values, covariance)


def _file(result: Result) -> str:
    return str(result.made_from[0].path) if result.made_from else ""


def _values(result: Result, name: str) -> Array:
    if name not in SQUARENESS_NAMES:
        return result.tables[f"tables/{name}"].numbers("value")
    square = result.tables["squareness"]
    return square.numbers("end_points")[[square.texts("error").index(name)]]


def _other_axes(axes: tuple[Axis, ...], settings: Settings, result: Result) -> Iterator[Fault]:
    """Yield faults where the axes of an earlier result are not those of the job."""
    table, chain = result.tables["axes"], str(result.statistics.get("chain", ""))
    if not chain:
        text = "the result is of rotary axes that were tested alone"
        yield Fault(text, _file(result), hint="give that of X, Y and Z")
        return
    order = [AXES[i] for i in axis_order(chain)]
    own = [letter for letter in settings.machine.letters if letter in AXES]
    if [letter for letter in order if letter in own] != own:
        yield Fault(f"the result is of a machine {chain}, the job has {settings.machine.chain}", _file(result))
    letters = table.texts("axis")
    for axis in axes:
        if axis.letter not in letters:
            yield Fault(f"the result has no {axis.letter}", _file(result), hint="give that of the axes of this machine")
            continue
        low, high, knots = (table.columns[name][letters.index(axis.letter)] for name in ("low", "high", "knots"))
        if len(axis.knots) != knots or max(abs(axis.knots[0] - low), abs(axis.knots[-1] - high)) > _SAME:
            name = axis.key
            yield Fault(
                f"the result has {knots} knots of {axis.letter} from {low:g} to {high:g} mm, the job {len(axis.knots)} "
                f"from {axis.knots[0]:g} to {axis.knots[-1]:g} mm",
                _file(result),
                hint=f"write `{name}: {{range: [{low:g} mm, {high:g} mm], knots: {knots}}}`",
            )


def _unknown(known: KnownAxes, result: Result) -> Iterator[str]:
    """Yield a warning if some errors of the earlier result were not determined."""
    errors = result.tables["errors"]
    rows = zip(errors.texts("error"), errors.texts("status"), strict=True)
    undetermined = [name for name, status in rows if status == Determination.UNDETERMINED]
    together = [name for name, status in rows if status == Determination.TOGETHER and name in known.names]
    if undetermined:
        text = f"the earlier calibration does not determine {listed(undetermined)}: taken as 0, without an uncertainty"
        yield text + (f"; {listed(together)} hold for its tools only" if together else "")


def _into(block: Block, known: Block, names: tuple[str, ...]) -> Block:
    """Return a block with the values and unknowns of another one in the columns of some errors."""
    chosen = np.isin(block.columns, names)
    values = np.where(chosen, known.values, block.values)
    return replace(block, values=values, free=np.where(chosen, known.free, block.free))
