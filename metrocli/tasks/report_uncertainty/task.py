"""The task report-uncertainty: run and check a job."""

from __future__ import annotations

from metrocli.errors import InputError, UndeterminedError
from metrocli.expressions.derivatives import NoValueError
from metrocli.expressions.written import WrittenExpression
from metrocli.result import Result
from metrocli.tasks.job import Job, Task
from metrocli.tasks.report_uncertainty import volume_problem, volume_report
from metrocli.tasks.report_uncertainty.entries import Files
from metrocli.tasks.report_uncertainty.problem import PropagationProblem, build
from metrocli.tasks.report_uncertainty.report import BothMethods, report
from metrocli.tasks.report_uncertainty.settings import Settings
from metrocli.uncertainty import monte_carlo
from metrocli.uncertainty.correlated import UnreachableError
from metrocli.uncertainty.propagation import Coverage, Propagated, covered, propagate
from metrocli.uncertainty.trials import plan_of
from metrocli.uncertainty.workers import Workers


def run(job: Job[Settings, Files]) -> Result:
    """Return measurands with their uncertainty; raises InputError, UndeterminedError or NotConvergedError."""
    settings, workers = job.settings, job.workers or Workers()
    if settings.volume is not None:
        return volume_report.run(settings, job.files.results, workers)
    problem = _problem(job)
    wanted = settings.coverage
    coverage = Coverage(wanted.probability or 0.95, wanted.k)
    propagated = _propagated(problem)
    outcome = None
    if settings.monte_carlo.trials != 0:
        dofs = [linear.dof for linear in propagated.measurands.values()]
        outcome = _trials(settings, problem, max(covered(coverage, dof) for dof in dofs), workers)
    elif any(linear.replaced for linear in propagated.measurands.values()):
        name = next(name for name, linear in propagated.measurands.items() if linear.replaced)
        raise UndeterminedError(
            f"{name}: {propagated.measurands[name].notes[0]}\n  the law of propagation does not apply there; "
            "use Monte Carlo: `monte_carlo: {trials: 1000000}`"
        )
    return report(BothMethods(problem, propagated, coverage, outcome, settings))


def check(job: Job[Settings, Files]) -> None:
    """Raise InputError with all faults of a job and its files, without a Monte Carlo run."""
    if job.settings.volume is not None:
        volume_problem.build(job.settings, job.files.results)
    else:
        _propagated(_problem(job))


def _problem(job: Job[Settings, Files]) -> PropagationProblem:
    problem = build(job.settings, job.files.results, job.files.files)
    if isinstance(problem, list):
        raise InputError(problem)
    return problem


def _propagated(problem: PropagationProblem) -> Propagated:
    try:
        return propagate(problem.models, problem.inputs)
    except NoValueError as error:
        models: list[WrittenExpression] = [placed.value.model for placed in problem.nodes.values()]
        # the message points to the model whose part has no value
        model = next(model for model in models if _fails(model, problem))
        raise InputError([model.fault(error)]) from error


def _fails(model: WrittenExpression, problem: PropagationProblem) -> bool:
    try:
        propagate({"": model.expression}, problem.inputs)
    except NoValueError:
        return True
    return False


def _trials(
    settings: Settings, problem: PropagationProblem, probability: float, workers: Workers
) -> monte_carlo.MonteCarloResult:
    wanted = settings.monte_carlo
    try:
        units = {name: unit.factor for name, unit in problem.units.items()}
        plan = plan_of(problem.models, problem.inputs, wanted.seed, probability, wanted.trials, units)
    except UnreachableError as error:
        pair = {problem.inputs.names[index] for index in error.between}
        # the pair can be estimates of a result, correlated through quantities of other shapes; then no declared
        # correlation is that of the pair itself
        declared = [placed for placed in settings.correlations if set(placed.value.between) == pair]
        node = (*declared, *settings.correlations)[0].node
        message = f"{' and '.join(sorted(pair))}: {error}"
        raise InputError([node.fault(message, "use a smaller correlation, or other distributions")]) from error
    return monte_carlo.run(plan, workers, wanted.digits, wanted.most)


TASK = Task(Files, run, check)
