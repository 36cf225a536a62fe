"""report-uncertainty: GUM and Monte Carlo, from quantities and other jobs' results to an uncertainty and a decision."""

from __future__ import annotations

from collections.abc import Mapping

from metrocli.errors import InputError, UndeterminedError
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.report_uncertainty.problem import Problem, build
from metrocli.tasks.report_uncertainty.report import KIND, Found, report
from metrocli.tasks.report_uncertainty.settings import Inputs, Settings
from metrocli.tasks.report_uncertainty.values import Model
from metrocli.uncertainty import monte_carlo
from metrocli.uncertainty.correlated import UnreachableError
from metrocli.uncertainty.derivatives import NoValueError
from metrocli.uncertainty.propagation import Coverage, Propagated, covered, propagate
from metrocli.uncertainty.trials import plan_of
from metrocli.uncertainty.workers import Workers

SUMMARY = "GUM and Monte Carlo uncertainty, budget, capability"


def run(
    settings: Settings,
    results: Mapping[str, Result] | None = None,
    files: Mapping[str, Table] | None = None,
    workers: Workers | None = None,
) -> Result:
    """Return measurands with their uncertainty; raises InputError, UndeterminedError or NotConvergedError."""
    if settings.volume is not None:
        from metrocli.tasks.report_uncertainty import volume_report

        return volume_report.run(settings, results or {}, workers or Workers())
    problem = _problem(settings, results or {}, files or {})
    wanted = settings.coverage
    coverage = Coverage(wanted.probability or 0.95, wanted.k)
    propagated = _propagated(problem)
    outcome = None
    if settings.monte_carlo.trials != 0:
        outcome = _trials(settings, problem, covered(coverage), workers or Workers())
    elif any(linear.replaced for linear in propagated.measurands.values()):
        name = next(name for name, linear in propagated.measurands.items() if linear.replaced)
        raise UndeterminedError(
            f"{name}: {propagated.measurands[name].notes[0]}\n  the law of propagation does not apply there; "
            "ask for Monte Carlo: `monte_carlo: {trials: 1000000}`"
        )
    return report(Found(problem, propagated, coverage, outcome, settings))


def check(
    settings: Settings, results: Mapping[str, Result] | None = None, files: Mapping[str, Table] | None = None
) -> None:
    """Raise InputError with all that is wrong with a job and its files, without computing."""
    if settings.volume is not None:
        from metrocli.tasks.report_uncertainty import volume_problem

        volume_problem.build(settings, results or {})
    else:
        _propagated(_problem(settings, results or {}, files or {}))


def _problem(settings: Settings, results: Mapping[str, Result], files: Mapping[str, Table]) -> Problem:
    problem = build(settings, results, files)
    if isinstance(problem, list):
        raise InputError(problem)
    return problem


def _propagated(problem: Problem) -> Propagated:
    try:
        return propagate(problem.models, problem.inputs)
    except NoValueError as error:
        models: list[Model] = [placed.value.model for placed in problem.nodes.values()]
        # The expression in which the part stands that has no value.
        model = next(model for model in models if _fails(model, problem))
        raise InputError([model.fault(error)]) from error


def _fails(model: Model, problem: Problem) -> bool:
    try:
        propagate({"": model.expression}, problem.inputs)
    except NoValueError:
        return True
    return False


def _trials(settings: Settings, problem: Problem, probability: float, workers: Workers) -> monte_carlo.Outcome:
    wanted = settings.monte_carlo
    try:
        units = {name: unit.factor for name, unit in problem.units.items()}
        plan = plan_of(problem.models, problem.inputs, wanted.seed, probability, wanted.trials, units)
    except UnreachableError as error:
        pair = {problem.inputs.names[index] for index in error.between}
        # Estimates of a result can be the pair, which a declared correlation ties to other shapes.
        declared = [placed for placed in settings.correlations if set(placed.value.between) == pair]
        node = (*declared, *settings.correlations)[0].node
        said = f"{' and '.join(sorted(pair))}: {error}"
        raise InputError([node.fault(said, "use a smaller correlation, or other distributions")]) from error
    return monte_carlo.run(plan, workers, wanted.digits, wanted.most)


__all__ = ["KIND", "SUMMARY", "Inputs", "Settings", "check", "run"]
