"""The volume form of a job: its points and the uncertainty from each contributor, or all faults of the job."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import Fault, InputError
from metrocli.expressions.derivatives import NoValueError
from metrocli.expressions.dimensions import compound, described, unit_of
from metrocli.expressions.expression import NAME, ExpressionError
from metrocli.expressions.written import Measure
from metrocli.frozen import dataclass
from metrocli.geometry.poses import EULER
from metrocli.result import Result
from metrocli.settings import LocatedValue
from metrocli.tasks.report_uncertainty.entries import Contributor, Entries
from metrocli.tasks.report_uncertainty.values import contributors, identity, shared
from metrocli.uncertainty.volume import AXES, Contribution, grid, of_models, of_pose
from metrocli.words import suggestion

PLACES = ("X", "Y", "Z")
"""Names of a point's coordinates in the models of contributors"""


_MACHINE = "calibrate-machine"
"""Kind of the results whose uncertainty is that of tables alone"""


@dataclass(frozen=True)
class VolumeProblem:
    """Points of the volume, and the contributions to their uncertainty."""

    points: Array
    contributions: tuple[Contribution, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...] = ()


def faults(settings: Entries) -> Iterable[Fault | tuple[str, ...]]:
    """Yield the faults of a job that show without its files."""
    for key in ("volume", "contributors"):
        if not getattr(settings, key):
            yield key, f"the key '{key}' is missing", "a volume needs its contributors"
    for key in ("quantities", "measurands", "correlations", "target"):
        if getattr(settings, key):
            yield key, f"{key} and a volume are both given", "write two jobs"
    tolerance = settings.tolerance
    if tolerance is not None and not (isinstance(tolerance, LocatedValue) and isinstance(tolerance.value, Measure)):
        yield "tolerance", "the tolerance of a volume is one width", "write e.g. 'tolerance: 2 mm', the full width"
    elif tolerance is not None and (
        tolerance.value.unit.powers != compound("mm").powers or tolerance.value.number <= 0
    ):
        yield "tolerance", f"the tolerance is {described(tolerance.value.unit)}", "a length above zero: its full width"
    yield from _of_contributors(settings)


def _of_contributors(settings: Entries) -> Iterable[Fault]:
    seen: dict[str, LocatedValue] = {}
    for placed in settings.contributors:
        given: Contributor = placed.value
        if given.name in seen:
            yield placed.node.fault(f"two contributors have the name '{given.name}'", "give each a different name")
        seen[given.name] = placed
        if given.result is not None and given.result not in settings.inputs.results:
            hint = suggestion(given.result, settings.inputs.results) if settings.inputs.results else "name it there"
            message = f"there is no result '{given.result}' under inputs"
            yield placed.node.at("result").fault(message, hint)
        for model in given.model or ():
            for part in model.expression.parts:
                prefix = part.name.partition(".")[0]
                if part.operation == NAME and part.name not in PLACES and prefix not in settings.inputs.results:
                    hint = suggestion(prefix, [*PLACES, *settings.inputs.results])
                    yield model.fault(
                        ExpressionError(
                            f"'{part.name}' is neither X, Y, Z nor an estimate of a result", part.start, hint
                        )
                    )


def build(settings: Entries, results: Mapping[str, Result]) -> VolumeProblem:
    """Return the problem of a job with its files; raises InputError with all faults."""
    wanted = settings.volume
    assert wanted is not None
    points = grid(wanted.from_, wanted.to, wanted.grid)
    lengths = np.abs(points - np.asarray(wanted.origin))
    contributions: list[Contribution] = []
    wrong: list[Fault] = []
    for placed in settings.contributors:
        given: Contributor = placed.value
        try:
            std, uniform, dof = _size(placed, results, points, lengths)
        except InputError as error:
            wrong += error.faults
            continue
        dof = given.dof if given.dof is not None else dof
        contributions.append(Contribution(given.name, std, uniform, dof, given.source or ""))
    if wrong:
        raise InputError(wrong)
    notes = tuple(_not_contained(settings, results))
    return VolumeProblem(points, tuple(contributions), tuple(_double(settings, results)), notes)


def _not_contained(settings: Entries, results: Mapping[str, Result]) -> Iterable[str]:
    """Yield a note for each contributor that is made of a machine's result: what that result leaves out."""
    for placed in settings.contributors:
        given: Contributor = placed.value
        names = {name.partition(".")[0] for model in given.model or () for name in model.expression.names}
        used = sorted({given.result, *names} & results.keys(), key=str)
        for name in used:
            if results[str(name)].kind == _MACHINE:
                yield (
                    f"contributor '{given.name}': the result '{name}' states the uncertainty of the estimated errors; "
                    "the machine's repeatability and its errors between knots are not in it: give them as contributors"
                )


def _size(
    placed: LocatedValue, results: Mapping[str, Result], points: Array, lengths: Array
) -> tuple[Array, bool, float]:
    """Return standard uncertainties (n, 3) or (1, 3), whether the distribution is rectangular, and the dof."""
    given: Contributor = placed.value
    if given.result is not None:
        result = results[given.result]
        dof = min(result.degrees_of_freedom(estimate.name) for estimate in result.estimates)
        return _of_result(placed, result, points), False, dof
    if given.model is not None:
        return _of_model(placed, results, points), False, math.inf
    if given.std is not None:
        return _along_axes(given.std), given.distribution == "uniform", math.inf
    if given.half_width is not None:
        return _along_axes(given.half_width) / math.sqrt(3), True, math.inf
    if given.expansion is not None:
        heat = given.expansion
        warmth = heat.std if heat.std is not None else (heat.half_width or 0.0) / math.sqrt(3)
        slope = math.hypot(heat.alpha * warmth, heat.difference * (heat.alpha_std or 0.0))
        # the sum of two parts is no longer rectangular
        return lengths * slope, heat.std is None and heat.difference == 0, math.inf
    assert given.length_error is not None
    error = given.length_error
    return (error.constant + error.proportional * lengths) / math.sqrt(3), True, math.inf


def _along_axes(value: float | tuple[float, float, float]) -> Array:
    return np.broadcast_to(np.asarray(value, dtype=float), (1, 3))


def _of_result(placed: LocatedValue, result: Result, points: Array) -> Array:
    """Return the standard uncertainties (n, 3) from the pose in a result, or from x, y and z alone."""
    names = [estimate.name for estimate in result.estimates]
    wanted = EULER if all(name in names for name in EULER) else AXES
    missing = [name for name in wanted if name not in names]
    if missing:
        message = f"the result '{placed.value.result}' ({result.kind}) has no {', '.join(missing)}"
        hint = "a pose (x y z alpha beta gamma), or x y z; else give a model of it"
        raise InputError([placed.node.at("result").fault(message, hint)])
    at = [names.index(name) for name in wanted]
    scale = np.array([compound(result.estimates[index].unit).factor for index in at])
    covariance = np.asarray(result.covariance)[np.ix_(at, at)] * scale[:, None] * scale
    if not np.isfinite(covariance).all():
        raise InputError([placed.node.at("result").fault("its covariance has entries that are not finite")])
    if wanted is AXES:
        return np.sqrt(np.maximum(np.diag(covariance), 0.0))[None, :]
    values = np.array([result.estimates[index].value for index in at]) * scale
    return of_pose(values, covariance, points)


def _of_model(placed: LocatedValue, results: Mapping[str, Result], points: Array) -> Array:
    """Return the standard uncertainties (n, 3) from expressions in estimates of one or more results."""
    models = placed.value.model
    names = list(dict.fromkeys(name for model in models for name in model.expression.names if name not in PLACES))
    values: dict[str, float | Array] = dict(zip(PLACES, points.T, strict=True))
    known = dict.fromkeys(PLACES, compound("mm"))
    covariance = np.zeros((len(names), len(names)))
    files: dict[str, Result] = {}
    places: dict[str, list[tuple[int, int]]] = {}
    for n, name in enumerate(names):
        prefix, _, estimate = name.partition(".")
        result = results[prefix]
        estimates = [item.name for item in result.estimates]
        if estimate not in estimates:
            message = ExpressionError(
                f"the result '{prefix}' has no estimate '{estimate}'", 0, suggestion(estimate, estimates)
            )
            raise InputError([next(model for model in models if name in model.expression.names).fault(message)])
        at = estimates.index(estimate)
        unit = compound(result.estimates[at].unit)
        values[name] = result.estimates[at].value * unit.factor
        known[name] = unit
        files[identity(result)] = result
        places.setdefault(identity(result), []).append((n, at))
    for file, pairs in places.items():
        own, theirs = map(list, zip(*pairs, strict=True))
        scale = np.array([known[names[n]].factor for n in own])
        covariance[np.ix_(own, own)] = (
            np.asarray(files[file].covariance)[np.ix_(theirs, theirs)] * scale[:, None] * scale
        )
    for model in models:
        try:
            if not unit_of(model.expression, known).powers == compound("mm").powers and model.expression.names:
                raise ExpressionError("the error along an axis is a length", 0, "X Y Z are in mm, angles in rad")
        except ExpressionError as error:
            raise InputError([model.fault(error)]) from error
    try:
        return of_models([model.expression for model in models], values, covariance, names)
    except NoValueError as error:
        raise InputError([models[0].fault(error)]) from error


def _double(settings: Entries, results: Mapping[str, Result]) -> Iterable[str]:
    """Yield warnings of sources that are counted twice, and of contributors with a common source."""
    placed = [item.value for item in settings.contributors]
    labels = {label: given.name for given in placed for label in (given.source, given.name) if label}
    for given in placed:
        for label in given.includes:
            if label in labels and labels[label] != given.name:
                twice = f"the figures of '{given.name}' contain it, and '{labels[label]}' adds it"
                yield f"'{label}' is counted twice: {twice}"
    sources: dict[str, list[str]] = {}
    for given in placed:
        if given.source:
            sources.setdefault(given.source, []).append(given.name)
    for source, names in sources.items():
        if len(names) > 1:
            message = f"{' and '.join(names)} have the common source '{source}'"
            # a common source is fully correlated (docs/tasks/report-uncertainty.md)
            yield f"{message}: they are added linearly, because they are fully correlated"
    yield from _of_results(placed, results, labels)


def _of_results(placed: list[Contributor], results: Mapping[str, Result], labels: Mapping[str, str]) -> Iterable[str]:
    held: dict[str, str] = {}
    for given in placed:
        held |= {name: given.name for name in _results_of(given) if name not in held}
    used = {name: results[name] for name in held}
    yield from shared(used)
    for name, result in used.items():
        for label in sorted(contributors(result) & set(labels)):
            if labels[label] != held[name]:
                twice = f"it is in the budget of the result {name}, and '{labels[label]}' adds it"
                yield f"'{label}' is counted twice: {twice}"
    seen: dict[str, str] = {}
    for given in placed:
        for file in dict.fromkeys(identity(results[name]) for name in _results_of(given)):
            first = seen.setdefault(file, given.name)
            if first != given.name:
                yield f"'{given.name}' and '{first}' are the same result: it is counted twice"


def _results_of(given: Contributor) -> list[str]:
    """Return the names of the results that a contributor uses, in the order in which it names them."""
    named = [name.partition(".")[0] for model in given.model or () for name in model.expression.names]
    return list(dict.fromkeys([given.result] if given.result else [name for name in named if name not in PLACES]))
