"""The propagation problem of a report-uncertainty job (quantities, models, units), or all faults of the job."""

from __future__ import annotations

import keyword
import math
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from metrocli import units
from metrocli.errors import Fault
from metrocli.expressions import dimensions
from metrocli.expressions.dimensions import Compound, compound, described
from metrocli.expressions.expression import CONSTANTS, FUNCTIONS, NAME, Expression, ExpressionError
from metrocli.expressions.written import WrittenExpression
from metrocli.result import Result
from metrocli.settings import LocatedValue
from metrocli.table import Table
from metrocli.tasks.report_uncertainty import correlations
from metrocli.tasks.report_uncertainty import decisions as uncertainty_decisions
from metrocli.tasks.report_uncertainty.correlations import repeated
from metrocli.tasks.report_uncertainty.entries import Entries
from metrocli.tasks.report_uncertainty.quantity import column_of, quantity, unit_of
from metrocli.tasks.report_uncertainty.values import identity, shared, unvalidated
from metrocli.uncertainty.distributions import Normal, Sampled
from metrocli.uncertainty.inputs import CorrelatedBlock, InputQuantity, Inputs, NotSemiDefiniteError, join
from metrocli.words import suggestion

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


@dataclass(frozen=True)
class PropagationProblem:
    """The quantities and models to propagate."""

    inputs: Inputs
    models: Mapping[str, Expression]
    units: Mapping[str, Compound]
    """Unit of each measurand, as the job states it"""
    nodes: Mapping[str, LocatedValue]
    warnings: tuple[str, ...] = ()


def faults(settings: Entries) -> Iterable[Fault | tuple[str, ...]]:
    """Yield the faults of a job that show without its files."""
    for key, entries in (("measurands", settings.measurands), ("quantities", settings.quantities)):
        if not entries and not (key == "quantities" and settings.inputs.results):
            yield key, f"the key '{key}' is missing", "or give volume and contributors"
    yield from _Collector(settings, None, None).faults
    yield from uncertainty_decisions.faults(settings.tolerance, settings.measurands)
    yield from uncertainty_decisions.target_faults(settings.target, settings.measurands)


def build(
    settings: Entries, results: Mapping[str, Result], files: Mapping[str, Table]
) -> PropagationProblem | list[Fault]:
    """Return the problem of a job with its files, or the faults of the job."""
    collected = _Collector(settings, results, files)
    if collected.faults:
        return collected.faults
    assert collected.inputs is not None
    models = {name: placed.value.model.expression for name, placed in settings.measurands.items()}
    prefixes = {collected.target(name).partition(".")[0] for name in collected.named}
    used = {name: result for name, result in results.items() if name in prefixes}
    warnings = [*collected.warnings, *shared(used, settings.quantities), *_heavy_tails(collected.inputs)]
    return PropagationProblem(collected.inputs, models, collected.stated_units, settings.measurands, tuple(warnings))


def _heavy_tails(inputs: Inputs) -> list[str]:
    few = [q.name for q in inputs.quantities if q.dof <= 2 and isinstance(q.distribution, Normal)]
    message = "has 2 degrees of freedom or fewer: its t distribution has no standard deviation"
    return [f"{name} {message}. Mean and std of Monte Carlo depend on chance, its intervals do not" for name in few]


@dataclass
class _Collector:
    """Collects quantities and models of a job, and its faults; without results and files it checks what it can."""

    settings: Entries
    results: Mapping[str, Result] | None
    files: Mapping[str, Table] | None
    faults: list[Fault] = field(default_factory=list)
    quantities: dict[str, InputQuantity] = field(default_factory=dict)
    units: dict[str, Compound] = field(default_factory=dict)
    """Unit of each quantity that has one, whether or not its value has a fault"""
    stated_units: dict[str, Compound] = field(default_factory=dict)
    """Unit that the job states for each measurand"""
    named: tuple[str, ...] = ()
    """Quantities and estimates that the models name, in their order"""
    inputs: Inputs | None = None
    """None until all is collected without a fault"""
    reserved: set[str] = field(default_factory=set)
    """Quantities with the name of a function, a constant or a keyword: no model can name them"""
    warnings: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        for name, placed in self.settings.quantities.items():
            self._read_quantity(name, placed)
        models: list[WrittenExpression] = [placed.value.model for placed in self.settings.measurands.values()]
        self.named = tuple(dict.fromkeys(name for model in models for name in model.expression.names))
        blocks = self._read_results()
        for model in models:
            self._check_names(model)
        self._check_use()
        for name, placed in self.settings.measurands.items():
            self._check_measurand(name, placed)
        known = {*self.settings.quantities, *self.named}
        self.faults += correlations.misnamed(self.settings.correlations, known, self.results is not None)
        if not self.faults and all(name in self.quantities for name in self.named):
            self._join_inputs(blocks)

    def _read_quantity(self, name: str, placed: LocatedValue) -> None:
        node = placed.node
        if not _NAME.fullmatch(name) or "__" in name:
            hint = "letters, digits and _, beginning with a letter"
            self.faults.append(node.fault(f"'{name}' cannot be the name of a quantity", hint))
        elif name in FUNCTIONS or name in CONSTANTS or keyword.iskeyword(name):
            self.reserved.add(name)
            hint = f"write {name}_ or {name}1"
            self.faults.append(node.fault(f"'{name}' is reserved: it names a function, a constant or a keyword", hint))
        elif name in self.settings.inputs.results:
            self.faults.append(node.fault(f"'{name}' is the name of a result too", "give one of them another name"))
        if self.target(name) != name:
            self._check_estimate(name, placed)
            return
        by_readings, by_samples = (getattr(placed.value, key, None) is not None for key in ("readings", "samples"))
        if (by_readings or by_samples) and self.files is None:
            # the unit is that of a column, which the file may not have
            return
        if unit := unit_of(placed):
            self.units[name] = unit
        table = (self.files or {}).get(f"{node.path}.{'readings' if by_readings else 'samples'}")
        if read := quantity(name, placed, table, self.faults):
            self.quantities[name] = read
            self.units[name] = read.unit

    def target(self, name: str) -> str:
        """Return the name of the estimate that a quantity stands for, or its own name if it is not an estimate."""
        placed = self.settings.quantities.get(name)
        return (getattr(placed.value, "estimate", None) or name) if placed is not None else name

    def _check_estimate(self, name: str, placed: LocatedValue) -> None:
        prefix, _, estimate = self.target(name).partition(".")
        node, files = placed.node.at("estimate"), self.settings.inputs.results
        if prefix not in files:
            hint = suggestion(prefix, files) if files else "name the result under `inputs: {results: {NAME: FILE.h5}}`"
            self.faults.append(node.fault(f"there is no result '{prefix}' under inputs", hint))
        elif self.results is not None:
            known = [item.name for item in self.results[prefix].estimates]
            if estimate not in known:
                hint = suggestion(estimate, known)
                self.faults.append(node.fault(f"the result '{prefix}' has no estimate '{estimate}'", hint))

    def _read_results(self) -> list[CorrelatedBlock]:
        """Return the estimates that the models name: one block for each file, even if it has several names."""
        files: dict[str, list[tuple[str, Result, int]]] = {}
        for name in self.named:
            prefix, _, estimate = self.target(name).partition(".")
            result = (self.results or {}).get(prefix)
            known = [item.name for item in result.estimates] if result is not None else []
            if result is not None and estimate in known:
                files.setdefault(identity(result), []).append((name, result, known.index(estimate)))
        return [block for estimates in files.values() if (block := self._block_of(estimates)) is not None]

    def _block_of(self, estimates: list[tuple[str, Result, int]]) -> CorrelatedBlock | None:
        """Return estimates of one result (name, result, its number there) in units of the models; None with a fault."""
        _, result, _ = estimates[0]
        at = [index for _, _, index in estimates]
        compounds = [compound(result.estimates[index].unit) for index in at]
        scale = np.array([unit.factor for unit in compounds])
        covariance = np.asarray(result.covariance)[np.ix_(at, at)] * scale[:, None] * scale
        size = np.sqrt(np.abs(np.diag(covariance)))
        # rounding leaves a difference from symmetry, but not one of 1e-6 of the standard deviations
        if not np.isfinite(covariance).all() or (abs(covariance - covariance.T) > 1e-6 * np.outer(size, size)).any():
            node = self.settings.measurands[next(iter(self.settings.measurands))].node
            self.faults.append(
                node.fault(f"the result of {estimates[0][0]} has no valid covariance", "run its job again")
            )
            return None
        dofs = [result.degrees_of_freedom(result.estimates[index].name) for index in at]
        for (name, _, index), unit, dof, variance in zip(estimates, compounds, dofs, np.diag(covariance), strict=True):
            shape = Normal(math.sqrt(max(float(variance), 0.0)))
            value = result.estimates[index].value * unit.factor
            self.warnings += unvalidated(name, result, result.estimates[index].name)
            self.quantities[name] = InputQuantity(name, value, shape, dof, unit)
            self.units[name] = unit
        return CorrelatedBlock(tuple(name for name, _, _ in estimates), (covariance + covariance.T) / 2)

    def _check_names(self, model: WrittenExpression) -> None:
        for part in model.expression.parts:
            if part.operation != NAME or part.name in self.settings.quantities or part.name in self.quantities:
                continue
            prefix, point, _ = part.name.partition(".")
            if point and prefix in self.settings.inputs.results:
                if self.results is None:
                    continue
                known = [f"{prefix}.{estimate.name}" for estimate in self.results[prefix].estimates]
                message = f"the result '{prefix}' has no estimate '{part.name[len(prefix) + 1 :]}'"
            elif point:
                known = list(self.settings.inputs.results)
                message = f"there is no result '{prefix}' under inputs"
            else:
                known = [*self.settings.quantities, *FUNCTIONS]
                message = f"there is no quantity '{part.name}'"
            hint = suggestion(part.name if point and prefix in self.settings.inputs.results else prefix, known)
            hint = hint if known else "name the result under `inputs: {results: {NAME: FILE.h5}}`"
            self.faults.append(model.fault(ExpressionError(message, part.start, hint)))
        for part, name, factor in dimensions.angles(model.expression):
            angle = self.quantities.get(name)
            if angle is not None and angle.unit.text == "1" and min(abs(factor), 1) * abs(angle.value) > 2 * math.pi:
                message = f"{part.operation} takes radians, and {name} = {angle.value:g} is more than a turn"
                hint = f"give {name} its unit: {angle.value:g} deg for degrees, {angle.value:g} rad for radians"
                self.faults.append(model.fault(ExpressionError(message, part.start, hint)))

    def _check_use(self) -> None:
        for name, placed in self.settings.quantities.items():
            if name not in self.named and self.settings.measurands and name not in self.reserved:
                hint = "check the names in the models, or leave the quantity out"
                self.faults.append(placed.node.fault(f"the quantity '{name}' is in no model", hint))

    def _check_measurand(self, name: str, placed: LocatedValue) -> None:
        model: WrittenExpression = placed.value.model
        if not _NAME.fullmatch(name):
            self.faults.append(
                placed.node.fault(f"'{name}' cannot be the name of a measurand", "letters, digits and _")
            )
        try:
            stated = compound("" if placed.value.unit == "1" else placed.value.unit)
        except units.QuantityError as error:
            self.faults.append(placed.node.at("unit").fault(f"{placed.node.path}.unit: {error.message}", error.hint))
            return
        if not model.expression.names:
            self.faults.append(model.fault(ExpressionError("the model names no quantity", 0, "e.g. 'ls + d'")))
        if not all(item in self.units for item in model.expression.names):
            return
        try:
            unit = dimensions.unit_of(model.expression, self.units)
        except ExpressionError as error:
            self.faults.append(model.fault(error))
            return
        if unit.powers != stated.powers or unit.point != stated.point:
            node = placed.node.at("unit") if placed.node.get("unit") else model.node
            message = f"{placed.node.path}: the model gives {described(unit)}, the unit is that of {described(stated)}"
            self.faults.append(node.fault(message, f"unit: one such as {_example(unit)}"))
        self.stated_units[name] = stated

    def _join_inputs(self, blocks: list[CorrelatedBlock]) -> None:
        """Join the quantities with their correlations."""
        declared = [placed.value for placed in self.settings.correlations]
        self.faults += correlations.refused(self.settings.correlations, self.quantities, blocks)
        if self.faults:
            return
        readings = list(self._readings())
        repeats = [
            repeated(*reading)
            for reading in readings
            if not isinstance(self.quantities[reading[0]].distribution, Sampled)
        ]
        self.faults += [fault for fault in repeats if isinstance(fault, Fault)]
        self.warnings += [message for message in repeats if isinstance(message, str)]
        together = correlations.simultaneous(readings, {frozenset(pair.between) for pair in declared})
        self.warnings += [pair.message for pair in together]
        pairs = [(*pair.between, pair.value) for pair in (*declared, *together)]
        # quantities in the order of the job, then estimates of results in the order of the models
        order = [quantity for name, quantity in self.quantities.items() if name in self.named]
        try:
            self.inputs = join(
                order, pairs, blocks, self._simultaneous_samples({name for pair in declared for name in pair.between})
            )
        except NotSemiDefiniteError as error:
            first = next(iter(self.settings.measurands.values())).node
            self.faults.append(correlations.contradiction(error, self.settings.correlations, first))

    def _readings(self) -> Iterable[tuple[str, Table, str]]:
        """Yield the name, table and column of each quantity that is given by readings or by samples."""
        for name in self.named:
            placed = self.settings.quantities.get(name)
            for key in ("readings", "samples"):
                table = (self.files or {}).get(f"{placed.node.path}.{key}") if placed is not None else None
                if placed is not None and table is not None and self.quantities[name].distribution is not None:
                    yield name, table, column_of(placed.value, table)

    def _simultaneous_samples(self, declared: Collection[str]) -> Iterable[list[str]]:
        """Yield the names of samples in the same file, without those whose correlation the job declares."""
        files: dict[str, list[str]] = {}
        for name in self.named:
            shape = self.quantities[name].distribution
            if isinstance(shape, Sampled) and name not in declared:
                files.setdefault(shape.file, []).append(name)
        return (names for names in files.values() if len(names) > 1)


def _example(unit: Compound) -> str:
    if unit.point or unit.number:
        return "'degC'" if unit.point else "1"
    dimension = next((d for d in units.DIMENSIONS.values() if described(unit) == d.phrase), None)
    return f"'{dimension.unit if dimension is not None else dimensions.base_unit(unit.powers)}'"
